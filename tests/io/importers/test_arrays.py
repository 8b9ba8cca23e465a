"""NumPy's and MATLAB's files: exact values, axes, and every refusal."""

import resource
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat
from support.reading import depths, read_source

from tofmix.errors import BadInputError, StorageError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import SourceRequest

SHAPE = (6, 4, 5)
ROWS_FIRST = "row,col,frame"
FRAMES_FIRST: Literal["frame,row,col"] = "frame,row,col"


def samples(dtype: str = "u2", seed: int = 2) -> NDArray[Any]:
    return np.random.default_rng(seed).integers(1, 60000, SHAPE).astype(dtype)


def matlab_73(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays as MATLAB 7.3 does: its header, and HDF5 with the axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as root:
        for name, array in arrays.items():
            root.create_dataset(name, data=array.T).attrs["MATLAB_class"] = np.bytes_("uint16")
        root.create_group("#refs#")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def save(path: Path, version: str, **arrays: NDArray[Any]) -> Path:
    if version == "7.3":
        matlab_73(path, **arrays)
    else:
        savemat(path, arrays, do_compression=version == "7", format="5")
    return path


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2", "i4", "f4", "f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_and_npz_are_read_exactly(tmp_path: Path, dtype: str, order: Literal["C", "F"]) -> None:
    array = np.asarray(samples(dtype), order=order)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", depth=array)
    np.savez_compressed(tmp_path / "b.npz", depth=array, exposure=np.ones(3))
    for name in ("a.npy", "a.npz", "b.npz"):
        np.testing.assert_array_equal(depths(tmp_path / name), array)


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_frames_may_be_the_last_axis(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    array = np.moveaxis(samples(), 0, -1)
    np.save(path, array) if suffix == ".npy" else np.savez(path, a=array)
    np.testing.assert_array_equal(depths(path, axes=ROWS_FIRST), samples())


def test_one_image_is_one_frame(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples()[0])
    np.savez(tmp_path / "a.npz", depth=samples()[0])
    for name in ("a.npy", "a.npz"):
        np.testing.assert_array_equal(depths(tmp_path / name), samples()[:1])


def test_npz_and_mat_carry_amplitude_and_time(tmp_path: Path) -> None:
    time_s = np.arange(6) / 30.0
    np.savez(tmp_path / "a.npz", range=samples(), amplitude=samples("f4", 9), time=time_s)
    held = {"range": samples(), "amplitude": samples("f4", 9), "time": time_s[:, None]}
    save(tmp_path / "a.mat", "5", **held)
    save(tmp_path / "b.mat", "7.3", **held)
    for name in ("a.npz", "a.mat", "b.mat"):
        source, frames = read_source(tmp_path / name, amplitude="amplitude", axes=FRAMES_FIRST)
        assert source.has_amplitude
        assert source.has_time
        np.testing.assert_array_equal([frame.depth for frame in frames], samples())
        np.testing.assert_array_equal([frame.amplitude for frame in frames], samples("f4", 9))
        assert [frame.time_s for frame in frames] == time_s.tolist()


@pytest.mark.parametrize("version", [pytest.param("5", marks=pytest.mark.slow), "7.3"])
def test_mat_is_read_in_either_order_of_axes(tmp_path: Path, version: str) -> None:
    own = save(tmp_path / "own.mat", version, d=np.moveaxis(samples(), 0, -1))
    ours = save(tmp_path / "ours.mat", version, d=samples())
    np.testing.assert_array_equal(depths(own, axes=ROWS_FIRST), samples())
    np.testing.assert_array_equal(depths(ours, axes=FRAMES_FIRST), samples())
    for path in (own, ours):  # told by the sensor's image
        np.testing.assert_array_equal(depths(path, image=(4, 5)), samples())
        with pytest.raises(BadInputError, match=r"the order of its axes does not follow from .*; choose --axes"):
            read_source(path, image=(144, 176))
    single = save(tmp_path / "single.mat", version, d=samples()[0])
    np.testing.assert_array_equal(depths(single), samples()[:1])


@pytest.mark.parametrize("kind", ["npz", pytest.param("5", marks=pytest.mark.slow), "7.3"])
def test_the_array_is_chosen_or_the_candidates_are_listed(tmp_path: Path, kind: str) -> None:
    held: dict[str, Any] = {"a": samples(), "b": samples(seed=4)}
    path = tmp_path / ("a.npz" if kind == "npz" else "a.mat")
    np.savez(path, **held) if kind == "npz" else save(path, kind, **held)
    np.testing.assert_array_equal(depths(path, topic="b", axes=FRAMES_FIRST), samples(seed=4))
    with pytest.raises(BadInputError, match=r"--dataset: a \(6, 4, 5\), b \(6, 4, 5\)"):
        read_source(path, axes=FRAMES_FIRST)
    with pytest.raises(BadInputError, match=r"no array 'c'; it holds: a"):
        read_source(path, topic="c", axes=FRAMES_FIRST)


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (pytest.fail, ("unpickled",))

    array = np.array([[[Trap()]]], dtype=object)
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    np.savez(tmp_path / "a.npz", a=array)
    np.savez(tmp_path / "t.npz", a=samples(), time=np.array([Trap()] * 6, dtype=object))
    for name in ("a.npy", "a.npz", "t.npz"):
        with pytest.raises(BadInputError):
            read_source(tmp_path / name)


@pytest.mark.parametrize(
    "array",
    [np.zeros((0, 4, 5)), np.zeros(7), np.zeros((2, 2, 2, 2)), np.zeros((2, 3, 4), complex), np.array([["a", "b"]])],
)
def test_arrays_of_other_dimensions_are_refused(tmp_path: Path, array: NDArray[Any]) -> None:
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", a=array)
    for name in ("a.npy", "a.npz"):
        with pytest.raises(BadInputError, match=name):
            read_source(tmp_path / name, **({"topic": "a"} if name == "a.npz" else {}))


@pytest.mark.parametrize(
    ("share", "kind"),
    [
        pytest.param(share, kind, marks=[pytest.mark.slow] if kind == "5" and share != 0.5 else [])  # one process each
        for share in (0.0, 0.02, 0.5, 0.98)
        for kind in ("npy", "npz", "npz compressed", "5", "7.3")
    ],
)
def test_cut_files_are_refused_in_one_line(tmp_path: Path, kind: str, share: float) -> None:
    array = np.random.default_rng(1).integers(0, 60000, (20, 30, 40)).astype("u2")
    path = tmp_path / f"a.{kind[:3] if kind[0] == 'n' else 'mat'}"
    if kind == "npy":
        np.save(path, array)
    elif kind.startswith("npz"):
        (np.savez if kind == "npz" else np.savez_compressed)(path, a=array)
    else:
        save(path, kind, a=array)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(BadInputError) as refused:
        read_source(path, axes=FRAMES_FIRST)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mat_that_crashes_its_reader_is_refused(tmp_path: Path) -> None:
    # SciPy 1.17 trusts the type of the array's name and ends in a segmentation fault.
    path = save(tmp_path / "a.mat", "5", a=samples())
    data = bytearray(path.read_bytes())
    data[184] = 100
    path.write_bytes(data)
    with pytest.raises(BadInputError) as refused:
        read_source(path, axes=FRAMES_FIRST)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_compressed_mat_is_read(tmp_path: Path) -> None:
    np.testing.assert_array_equal(depths(save(tmp_path / "a.mat", "7", a=samples()), axes=FRAMES_FIRST), samples())


def test_a_damaged_npz_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.zeros((20, 30, 40), "u2"))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(BadInputError, match="CRC"):
        read_source(path)


def test_mismatched_arrays_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", range=samples(), amplitude=samples()[:3])
    np.savez(tmp_path / "t.npz", range=samples(), time=np.zeros(3))
    save(tmp_path / "a.mat", "5", range=samples(), amplitude=samples()[:3])
    save(tmp_path / "b.mat", "7.3", range=samples(), amplitude=samples()[:3])
    for name in ("a.npz", "a.mat", "b.mat"):
        with pytest.raises(BadInputError, match=r"shape \(3, 4, 5\) differs"):
            read_source(tmp_path / name, amplitude="amplitude", axes=FRAMES_FIRST)
    with pytest.raises(BadInputError, match="time: expected 6 numbers"):
        read_source(tmp_path / "t.npz")


def test_a_full_disk_while_a_mat_is_unpacked_is_no_fault_of_the_file(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mat", "5", a=samples())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))  # the child inherits it
    try:
        with (
            pytest.raises(StorageError, match=r"a\.mat is unpacked in this folder"),
            open_source(path, SourceRequest(axes=FRAMES_FIRST)),
        ):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
