"""Noise beyond sigma(r) through the files and commands: simulate, import, estimate, info, verify, report, inspect."""

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from support.commandline import Tofmix
from support.learnt_noises import ALL, SIGMA_MM, Made, made, write_files
from support.noise_parts import model_text, shape_keys, skewed

from tofmix.errors import ExitCode
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.recording.recording_file import open_recording

CONTRACT = Path(__file__).parents[3] / "shared" / "check_contract.py"
PARTS = shape_keys(skewed()) + "width_spread = 0.2\n"


_MADE: dict[str, bytes] = {}  # the recording and its layers, by file name


def _made_once(tofmix: Tofmix, path: Path, *arguments: object) -> Path:
    """The file that a command writes; the command runs for the first test alone."""
    if path.name not in _MADE:
        tofmix.done(*arguments, "-o", path)
        _MADE[path.name] = path.read_bytes()
    path.write_bytes(_MADE[path.name])
    return path


@pytest.fixture
def layers(tofmix: Tofmix, recording: Path, tmp_path: Path) -> Path:
    return _made_once(tofmix, tmp_path / "a.layers.h5", "estimate", recording, "--noise", "file")


@pytest.fixture
def recording(tofmix: Tofmix, tmp_path: Path) -> Path:
    np.save(tmp_path / "share.npy", np.linspace(0.0, 0.3, 96, dtype=np.float32).reshape(8, 12))
    text = model_text(PARTS + 'background = "share.npy"\n').replace("frames = 60", "frames = 20")
    (tmp_path / "model.toml").write_text(text)  # few samples a pixel: thresholds are drawn for fewer counts
    return _made_once(tofmix, tmp_path / "a.h5", "simulate", tmp_path / "model.toml")


def test_recording_has_the_parts_under_the_names_of_the_contract(recording: Path) -> None:
    with h5py.File(recording) as root:
        group, shape = root["sensor"], skewed()
        np.testing.assert_array_equal(group["noise_shape_z"], shape.z)
        np.testing.assert_array_equal(group["noise_shape_density"], shape.density)
        assert group.attrs["noise_width_spread"] == 0.2
        share = group["noise_background"]
        np.testing.assert_allclose(share, np.linspace(0.0, 0.3, 96).reshape(8, 12), atol=1e-7)
        assert [share.dims[axis][0].name for axis in (0, 1)] == ["/row", "/col"]
        assert root["truth/effects/noise_width"].shape == (8, 12)
    with xarray.open_dataset(recording, group="sensor", engine="h5netcdf") as opened:
        assert opened["noise_background"].shape == (8, 12)


@pytest.mark.slow
@pytest.mark.skipif(not CONTRACT.exists(), reason="the shared contract checker is not beside this checkout")
def test_files_with_noise_parts_pass_the_format_checker(recording: Path, layers: Path) -> None:
    for path in (recording, layers):
        checked = subprocess.run([sys.executable, CONTRACT, path], capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.slow
def test_layers_file_keeps_the_noise_that_was_used_and_is_the_same_in_pieces(tofmix: Tofmix, recording: Path) -> None:
    layers = tofmix.same_in_pieces(recording, "--noise", "file")
    with open_recording(recording) as given, open_layers(layers) as made:
        assert given.sensor.noise is not None
        assert made.provenance.sensor.noise is not None
        assert made.provenance.sensor.noise.same_as(given.sensor.noise)


def test_info_prints_the_noise_parts_and_verify_passes(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    for path in (recording, tmp_path / "model.toml"):
        said = tofmix.done("info", path, "--json")
        camera = json.loads(said.out)["sensor"]
        assert camera["noise_width_spread"] == 0.2
        assert camera["noise_background_median"] == pytest.approx(0.15, abs=1e-6)
        assert camera["noise_background_most"] == pytest.approx(0.3, abs=1e-6)
        assert camera["noise_shape_skewness"] == pytest.approx(1.0, abs=0.02)
        assert len(camera["noise_shape_z"]) == len(camera["noise_shape_density"]) == 121
        tofmix.done("verify", path)
        assert "noise_width_spread" in tofmix("info", path).out


def test_import_takes_the_parts_from_a_camera_file(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "frames.npy", np.full((30, 8, 12), 1500, dtype=np.uint16))
    arguments = ("import", tmp_path / "frames.npy", "--units", "mm", "--sensor", tmp_path / "model.toml")
    tofmix.done(*arguments, "-o", tmp_path / "b.h5")
    with open_recording(tmp_path / "b.h5") as made:
        assert made.sensor.noise is not None
        assert made.sensor.noise.width_spread == 0.2
        assert made.sensor.noise.background is not None
        assert made.sensor.noise.background.shape == (8, 12)
    np.save(tmp_path / "frames.npy", np.full((30, 6, 12), 1500, dtype=np.uint16))
    said = tofmix(*arguments, "-o", tmp_path / "c.h5")
    said.refused(ExitCode.BAD_INPUT, "shape (8, 12) differs from the image (6, 12)")
    assert recording.exists()
    assert not (tmp_path / "c.h5").exists()


@pytest.mark.parametrize(
    ("name", "values", "reason"),
    [
        ("noise_shape_z", None, "noise_shape_z: missing; noise_shape_z, noise_shape_density go together"),
        ("noise_shape_z", np.linspace(9.0, -9.0, 121), "its z do not ascend"),
        ("noise_shape_z", np.linspace(-9.0, 9.0, 121), "expected median 0"),
        ("noise_shape_density", np.full(121, -1.0), "a density must be at least 0"),
        ("noise_shape_density", np.full(120, 1.0), "two lists of one length"),
        ("noise_background", np.full((8, 12), 1.0), "background must be"),
        ("noise_background", np.full((8, 12), np.nan), "background must be"),
        ("noise_background", np.zeros((12, 8)), r"shape (12, 8) differs from the image (8, 12)"),
        ("noise_background", np.array([b"a"]), "expected numbers"),
    ],
)
@pytest.mark.parametrize("kind", ["recording", "layers"])
def test_unfit_datasets_are_refused_in_one_line(
    tofmix: Tofmix, request: pytest.FixtureRequest, kind: str, name: str, values: np.ndarray | None, reason: str
) -> None:
    path = request.getfixturevalue(kind)
    with h5py.File(path, "r+") as root:
        group = root["sensor"]
        if name == "noise_shape_z":
            group["noise_shape_density"].dims[0].detach_scale(group[name])
        del group[name]
        if values is not None:
            group[name] = values
    tofmix("info", path).refused(ExitCode.BAD_INPUT, reason)


@pytest.mark.parametrize("value", [-0.1, 2.5, np.nan, "wide"])
def test_unfit_width_spread_is_refused_in_one_line(tofmix: Tofmix, recording: Path, value: float | str) -> None:
    with h5py.File(recording, "r+") as root:
        root["sensor"].attrs["noise_width_spread"] = value
    said = tofmix("info", recording)
    assert said.code == ExitCode.BAD_INPUT
    assert "noise_width_spread" in said.err or "width_spread" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.slow
def test_reconcile_keeps_the_noise_parts_and_their_map(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    said = tofmix("reconcile", tmp_path / "model.toml", recording, "-o", tmp_path / "gap", "--effects", "range_offset")
    assert said.code == 0, said.err
    assert "every difference between the noise of pixels counts as width" in said.err
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "agree"
    np.testing.assert_array_equal(np.load(tmp_path / "gap" / "share.npy"), np.load(tmp_path / "share.npy"))
    tofmix.done("simulate", tmp_path / "gap" / "model.toml", "-o", tmp_path / "b.h5")
    with open_recording(recording) as given, open_recording(tmp_path / "b.h5") as made:
        every = slice(0, None)
        np.testing.assert_array_equal(given.read_range(every, every), made.read_range(every, every))


def test_reconcile_refuses_a_background_with_a_memory(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "memory.toml"
    path.write_text(model_text("background = 0.1", '[[effect]]\nkind = "temporal_correlation"\ncoefficient = 0.5\n'))
    said = tofmix("reconcile", path, recording, "-o", tmp_path / "gap")
    said.refused(ExitCode.BAD_INPUT, "no prediction for a background of 10 % beside temporal_correlation of 0.5")
    assert not (tmp_path / "gap").exists()


FRAMES, IMAGE = 80, (4, 6)
LINE = re.compile(
    r"sigma 20 mm, skewed \(1\.0\), background 15 to 15 % by pixel, widths differ by 20 %,"
    r" pixels drift by 80 mm in a window, memory 0\.1"
)


@pytest.fixture(scope="module")
def case() -> Made:
    return made(ALL, frames=FRAMES, image=IMAGE)


@pytest.fixture(scope="module")
def paths(case: Made, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_files(tmp_path_factory.mktemp("learnt"), case)


@pytest.mark.slow
def test_report_shows_learnt_noise_with_and_without_the_recording(
    tofmix: Tofmix, paths: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, layers = paths
    pages = []
    for name, options in (("with", ("--recording", recording)), ("without", ())):
        pages.append(tmp_path / f"{name}.html")
        said = tofmix.done("report", layers, *options, "--html", pages[-1])
        assert LINE.search(re.sub(r"\s+", " ", said.out))
    for page in pages:
        titles = re.findall(r"<h3>([^<]*)</h3>", page.read_text().partition("<h2>Noise</h2>")[2])
        assert titles == ["Sigma of single pixels", "Shape of the error", "Widths of the pixels", "Background"]
    assert "With --recording the points" in pages[1].read_text()


def test_json_of_report_has_the_parts_and_with_the_recording_its_scatter(
    tofmix: Tofmix, paths: tuple[Path, Path]
) -> None:
    recording, layers = paths
    alone = json.loads(tofmix("report", layers, "--json").out)["noise"]
    both = json.loads(tofmix("report", layers, "--recording", recording, "--json").out)["noise"]
    assert LINE.fullmatch(alone["line"])
    assert (alone["width_spread"], alone["memory"], alone["drift_mm"]) == (0.2, 0.1, [40.0, 10.0, 5.0])
    assert alone["widths"]["count"] == 24
    assert alone["scatter_over_sigma"] is None
    scatter = both.pop("scatter_over_sigma")
    assert both == {key: value for key, value in alone.items() if key != "scatter_over_sigma"}
    assert scatter["count"] >= 20
    assert scatter["q50"] == pytest.approx(1.0, abs=0.15)


def test_info_prints_learnt_noise_in_a_line_and_by_part(tofmix: Tofmix, paths: tuple[Path, Path]) -> None:
    text = tofmix("info", paths[1]).out
    found = re.search(r"^noise\n((?:  .*\n?)+)", text, re.MULTILINE)
    assert found is not None
    assert LINE.search(found[1])
    assert [line.split()[0] for line in found[1].splitlines()] == [
        "found",
        "shape",
        "skewness",
        "excess_kurtosis",
        "width_spread",
        "drift_mm",
        "memory",
        "background_q05",
        "background_q50",
        "background_q95",
    ]
    noise = json.loads(tofmix("info", paths[1], "--json").out)["noise"]
    assert LINE.fullmatch(noise["found"])
    assert noise["shape"] == "skewed (1.0)"
    assert (noise["width_spread"], noise["drift_mm"], noise["memory"]) == (0.2, [40.0, 10.0, 5.0], 0.1)
    assert noise["background_q50"] == pytest.approx(0.15)


@pytest.mark.slow
def test_inspect_prints_and_draws_the_mixture(
    tofmix: Tofmix, case: Made, paths: tuple[Path, Path], tmp_path: Path
) -> None:
    recording, layers = paths
    figure = tmp_path / "pixel.svg"
    time = np.linspace(-1, 1, FRAMES)
    polynomials = np.array([time, 1.5 * time**2 - 0.5, 2.5 * time**3 - 1.5 * time])
    extent = np.ptp(np.einsum("drc,dt->rct", case.drift_mm, polynomials), axis=-1)
    row, col = divmod(int(extent.argmax()), IMAGE[1])
    arguments = ("inspect", layers, "--pixel", f"{row},{col}", "--recording", recording)
    said = tofmix.done(*arguments, "-o", figure)
    own_noise = r"^  noise of the pixel: width \d\.\d\d, background \d+\.\d %, drift \(mm\): \d+\.\d$"
    assert re.search(own_noise, said.out, re.MULTILINE)
    assert "<svg" in figure.read_text()
    pixel = next(p for p in json.loads(tofmix(*arguments, "--json").out)["pixels"] if p["col"] == col)
    own = pixel["learnt_noise"]
    assert own["width"] == pytest.approx(case.width[row, col], rel=0.35)
    assert pixel["layers"][0]["sigma_mm"] == pytest.approx(SIGMA_MM * own["width"], rel=1e-5)
    assert own["background"] == pixel["weight_outlier"]
    assert own["drift_mm"][0] == pytest.approx(extent[row, col], rel=0.2)
    without = tofmix.done("inspect", layers, "--pixel", "0,0", "--json", "-o", tmp_path / "layers.png")
    assert json.loads(without.out)["pixels"][0]["learnt_noise"]["drift_mm"] is None
