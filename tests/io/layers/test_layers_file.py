"""Layers files: round trip, the contract, other readers, and refusals."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray

from tofmix.errors import BadInputError, StorageError
from tofmix.flags import Status
from tofmix.io.layers.layers_file import LayersWriter, open_layers
from tofmix.layers import LAYER_FIELDS, Layers, Provenance
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.windows import plan_windows

CONTRACT = Path(__file__).parents[4] / "shared" / "check_contract.py"
SHAPE, MAX_LAYERS = (3, 5, 4), 3


def made_up_layers() -> Layers:
    """Consistent layers without a meaning."""
    rng = np.random.default_rng(3)
    layers = Layers.empty(SHAPE, MAX_LAYERS)
    layers.n_modes[...] = rng.integers(0, MAX_LAYERS + 1, SHAPE)
    layers.n_peaks[...] = layers.n_modes
    present = np.arange(MAX_LAYERS) < layers.n_modes[..., None]
    for name in ("range", "sigma", "range_stderr"):
        values = np.sort(rng.uniform(1, 1000, present.shape), axis=-1)
        getattr(layers, name)[present] = values[present]
    layers.weight[present] = (0.9 / np.maximum(layers.n_modes, 1))[..., None].repeat(MAX_LAYERS, -1)[present]
    layers.weight_outlier[...] = 1e-4
    layers.weight_no_return[...] = 1 - 1e-4 - np.nansum(layers.weight, -1)
    layers.log_likelihood[...] = -7.5
    layers.n_samples[...] = 20
    layers.status[layers.n_modes == 0] = Status.NO_SURFACE
    return layers


def provenance() -> Provenance:
    sensor = Sensor(name="camera", range_max_mm=7500.0, noise=NoiseCurve(np.array([1.0, 2.0]), np.array([3.0, 4.0])))
    return Provenance(
        source="a.h5",
        source_sha256="ab" * 32,
        version="9.9",
        sensor=sensor,
        options={"gamma": 0.02, "sigma": "tied"},
        frames_left_out=2,
    )


def write(path: Path, layers: Layers, **settings: Any) -> None:  # noqa: ANN401  the writer's own
    writer = LayersWriter(
        path,
        windows=plan_windows(62, window=20),
        image=SHAPE[1:],
        max_layers=MAX_LAYERS,
        tile=(1, 2),
        provenance=provenance(),
        **settings,
    )
    with writer:
        for k in range(SHAPE[0]):
            part = Layers(**{spec.name: getattr(layers, spec.name)[k : k + 1] for spec in LAYER_FIELDS})
            writer.write(slice(k, k + 1), slice(0, SHAPE[1]), part)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write(tmp_path / "a.layers.h5", made_up_layers())
    return tmp_path / "a.layers.h5"


def test_layers_read_back(path: Path) -> None:
    layers = made_up_layers()
    with open_layers(path) as file:
        assert file.shape == SHAPE
        assert file.max_layers == MAX_LAYERS
        assert file.window_start.tolist() == [0, 20, 40]
        assert file.window_stop.tolist() == [20, 40, 60]
        for k in range(SHAPE[0]):
            window = file.read_window(k)
            for spec in LAYER_FIELDS:
                np.testing.assert_array_equal(getattr(window, spec.name), getattr(layers, spec.name)[k])


def test_provenance_reads_back(path: Path) -> None:
    with open_layers(path) as file:
        read, written = file.provenance, provenance()
    assert (read.source, read.source_sha256, read.version) == (written.source, written.source_sha256, written.version)
    assert (read.options, read.frames_left_out) == (written.options, written.frames_left_out)
    assert read.sensor.noise is not None
    np.testing.assert_array_equal(read.sensor.noise.sigma_mm, [3.0, 4.0])


def test_layers_file_passes_the_format_checker(path: Path) -> None:
    if not CONTRACT.exists():
        pytest.skip("the contract's checker is not beside this checkout")
    subprocess.run([sys.executable, CONTRACT, path], check=True)


def test_xarray_opens_it_with_named_dimensions(path: Path) -> None:
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert data["range"].dims == ("window", "row", "col", "layer")
        assert data["n_modes"].dims == ("window", "row", "col")
        assert data["window_start"].dims == ("window",)
        np.testing.assert_array_equal(data["weight"].values, made_up_layers().weight)


def test_nexus_finds_the_default_signal(path: Path) -> None:
    with h5py.File(path) as root:
        entry = root[root.attrs["default"]]
        view = entry[entry.attrs["default"]]
        assert [x.attrs["NX_class"] for x in (root, entry, view)] == ["NXroot", "NXentry", "NXdata"]
        assert view[view.attrs["signal"]].shape == (*SHAPE, MAX_LAYERS)
        assert [len(view[axis]) for axis in view.attrs["axes"]] == [*SHAPE, MAX_LAYERS]


def test_status_decodes_by_its_flags(path: Path) -> None:
    with h5py.File(path) as root:
        attributes = root["status"].attrs
        names = dict(zip(attributes["flag_values"].tolist(), attributes["flag_meanings"].split(), strict=True))
    assert names == {0: "ok", 1: "too_few_samples", 2: "not_converged", 3: "no_surface", 4: "degenerate"}


def test_the_same_layers_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / name, made_up_layers())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_full_disk_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.pwrite", fail)
    with pytest.raises(StorageError, match="No space left"):
        write(tmp_path / "a.layers.h5", made_up_layers())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("sigma", None, "no dataset sigma"),
        ("sigma", np.zeros(SHAPE, "f4"), "sigma: expected f4"),
        ("sigma", np.zeros((*SHAPE, MAX_LAYERS)), "sigma: expected f4"),
        ("sigma", np.zeros((*SHAPE, 9), "f4"), "sigma: shape"),
        ("window_stop", np.zeros(7, "u8"), "window_stop: shape"),
        ("range", np.zeros((0, 5, 4, 3), "f4"), "holds no layer"),
    ],
)
def test_dataset_of_wrong_shape_or_type_is_refused_with_its_name(
    path: Path, name: str, value: object, reason: str
) -> None:
    with h5py.File(path, "r+") as root:
        del root[name]
        if value is not None:
            root[name] = value
    with pytest.raises(BadInputError, match=reason), open_layers(path):
        pass


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_broken_options_are_refused(path: Path, text: str) -> None:
    with h5py.File(path, "r+") as root:
        root.attrs["options"] = text
        del root.attrs["provenance_crc32"]
    with pytest.raises(BadInputError, match="options"), open_layers(path):
        pass


def test_a_changed_byte_in_the_options_is_noticed(path: Path) -> None:
    data = path.read_bytes()
    with h5py.File(path) as root:
        texts = [str(root.attrs[key]).encode() for key in ("options", "source_sha256")]
    for text in texts:
        place = data.index(text) + len(text) // 2
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(BadInputError, match="is damaged: their checksum differs"), open_layers(path):
            pass


def test_recording_is_refused_as_layers_file(path: Path) -> None:
    with h5py.File(path, "r+") as root:
        del root.attrs["format"]
    with pytest.raises(BadInputError, match="expected a tofmix-layers file"), open_layers(path):
        pass
