"""Streams that are no depths by name, several streams side by side, and options that a source has no use for."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.io import savemat
from support import naive_png
from support.bags import new_bag
from support.reading import read_source

from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers.streams import depths_among, stream_of, stream_of_file

STACK = np.random.default_rng(4).integers(900, 1900, (5, 3, 4)).astype("u2")


def folder_of(path: Path, *kinds: str) -> Path:
    """A folder of images named ``KIND0.png`` and so on; each kind has other values."""
    path.mkdir(exist_ok=True)
    for offset, kind in enumerate(kinds):
        for number, image in enumerate(STACK + offset):
            (path / f"{kind}{number}.png").write_bytes(naive_png.encode(image))
    return path


def source_of(folder: Path, kind: str, name: str) -> tuple[Path, str]:
    """A source whose only stream has a name, and the name that ``--dataset`` takes for it."""
    if kind == "folder":
        return folder_of(folder / "images", f"{name}_"), f"{name}_#"
    if kind == "folder name":
        return folder_of(folder / name, ""), name
    if kind in ("npy", "tif", "csv"):
        path = folder / f"{name}.{kind}"
        if kind == "npy":
            np.save(path, STACK)
        elif kind == "tif":
            tifffile.imwrite(path, STACK, photometric="minisblack")
        else:
            np.savetxt(path, STACK.reshape(5, -1), fmt="%d", delimiter=",")
        return path, name
    path = folder / f"recorded.{kind}"
    if kind == "npz":
        np.savez(path, allow_pickle=False, **{name: STACK})
    elif kind == "mat":
        savemat(path, {name: STACK})
    elif kind == "h5":
        with h5py.File(path, "w") as root:
            root[name] = STACK
    else:
        metadata = {"axes": "TYX", "Channel": {"Name": [name]}}
        tifffile.imwrite(path, STACK, metadata=metadata, ome=True, photometric="minisblack")
    return path, name


ONE_STREAM = ["folder", "folder name", "npy", "tif", "csv", "npz", "mat", "h5", "ome.tif"]


@pytest.mark.parametrize("kind", ONE_STREAM)
@pytest.mark.parametrize("name", ["infrared", "confidence_image"])
def test_the_only_stream_is_refused_if_its_name_says_other_and_read_if_it_is_asked_for(
    tmp_path: Path, kind: str, name: str
) -> None:
    path, asked = source_of(tmp_path, kind, name)
    options: dict[str, Any] = {"axes": "frame,row,col"} if kind == "mat" else {}
    options |= {"shape": (3, 4)} if kind == "csv" else {}
    with pytest.raises(BadInputError, match=rf"{name}\S* holds no depths by its name, .* --dataset '?{asked}'? -o"):
        read_source(path, **options)
    _, frames = read_source(path, topic=asked, **options)
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK)


@pytest.mark.parametrize("kind", [kind for kind in ONE_STREAM if kind not in ("mat", "csv")])  # these need options
@pytest.mark.parametrize("name", ["depth_ir", "wall"])
def test_amplitudes_may_be_named_so(tmp_path: Path, kind: str, name: str) -> None:
    np.save(tmp_path / "plain.npy", STACK + 7)
    path, _ = source_of(tmp_path, kind, name)
    _, frames = read_source(tmp_path / "plain.npy", amplitude=str(path))
    np.testing.assert_array_equal([frame.amplitude for frame in frames], STACK)


@pytest.mark.parametrize("stem", ["grey_wall", "noise", "signal_low", "range_1m", "left_0", "depth_amplitude_test"])
def test_name_of_a_file_that_may_describe_the_scene_is_no_other_stream(tmp_path: Path, stem: str) -> None:
    assert stream_of_file(stem) != "other"
    np.save(tmp_path / f"{stem}.npy", STACK)
    assert read_source(tmp_path / f"{stem}.npy")[0].notes == ()


@pytest.mark.parametrize(
    ("name", "stream"),
    [
        ("/sensor/noise_filtered/depth", "depth"),
        ("/color_camera/depth/image", "depth"),
        ("/tof/depth_valid", "depth"),
        ("/valid", "other"),
        ("/depth/valid_mask", "other"),
        ("/depth_cam/ir/image_raw", "other"),
        ("ir_depth", "depth"),
        ("depth_ir", "other"),
        ("sigma_z", "other"),
        ("IRImage", "other"),
    ],
)
def test_last_part_that_says_something_decides(name: str, stream: str) -> None:
    assert stream_of(name) == stream


def test_depth_without_another_word_comes_first() -> None:
    assert depths_among(["depth_valid", "depth"]) == ["depth"]
    assert depths_among(["/rgb/depth/image", "/ir/image"]) == ["/rgb/depth/image"]


@pytest.mark.parametrize("topic", ["/cam/noise_filtered/depth", "/rgb_cam/depth/image_raw", "/cam/depth_valid"])
def test_topic_is_of_depths_by_its_last_part(tmp_path: Path, topic: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(topic, STACK[0], stamp_ns=10**9)
    assert read_source(path)[0].kind == f"16UC1 images of {topic}"


def test_two_kinds_of_images_are_listed_and_one_is_chosen(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "pair", "near_", "far_")
    with pytest.raises(BadInputError, match=r"5 of far_#, 5 of near_#; choose one: tofmix import .*--dataset 'far_#'"):
        read_source(path)
    source, frames = read_source(path, topic="far_#")
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK + 1)
    assert source.notes == (f"{path}: not used: images near_# (5)",)
    with pytest.raises(UsageError, match=r"--dataset does not apply to .*: 5 of far_#"):
        read_source(path, topic="middle")


def test_amplitudes_of_a_folder_with_depths_are_its_other_images(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "both", "depth_", "ir_")
    _, frames = read_source(path, amplitude=str(path))
    np.testing.assert_array_equal([frame.amplitude for frame in frames], STACK + 1)
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK)


@pytest.mark.parametrize("axes", ["TCYX", "CTYX", "", "ZTYX"])
def test_two_sequences_in_the_pages_of_tifffile_are_listed_and_one_is_chosen(tmp_path: Path, axes: str) -> None:
    both = np.stack([STACK, STACK + 1], axis=0 if axes == "CTYX" else 1)
    metadata = {"axes": axes} if axes else {}
    tifffile.imwrite(tmp_path / "a.tif", both, metadata=metadata, photometric="minisblack")
    with pytest.raises(BadInputError, match=r"2 channels \(channel 0, channel 1\), not one sequence"):
        read_source(tmp_path / "a.tif")
    _, frames = read_source(tmp_path / "a.tif", topic="channel 1")
    np.testing.assert_array_equal([frame.depth for frame in frames], STACK + 1)
    with pytest.raises(UsageError, match="--dataset does not apply"):
        read_source(tmp_path / "a.tif", topic="channel 2")


@pytest.mark.parametrize(
    "names",
    [
        [f"rig3.{k}" for k in range(1, 13)],
        [f"shot.2.{k}.x" for k in range(8, 12)],
        ["1.8", "1.9", "1.10", "1.80"],
        ["img_9007199254740993", "img_9007199254740994"],
        ["1700000000.05", "1700000000.1", "1700000000.25", "1700000001"],
        ["d_1700000000.125", "d_1700000000.5"],
        ["0.033", "0.1", "0.2"],
    ],
)
def test_numbers_in_names_are_counters_unless_each_name_is_one_time_stamp(tmp_path: Path, names: list[str]) -> None:
    for name, image in zip(names, np.arange(len(names), dtype="u2")[:, None, None] + STACK[0], strict=True):
        (tmp_path / f"{name}.png").write_bytes(naive_png.encode(image))
    firsts = [int(frame.depth[0, 0]) for frame in read_source(tmp_path)[1]]
    assert firsts == [int(STACK[0, 0, 0]) + k for k in range(len(names))]


@pytest.mark.parametrize(
    "option",
    [{"valid_status": ("status", (5,))}, {"columns": {"y": "row"}}, {"time_unit_s": 1e-3}],
)
@pytest.mark.parametrize("kind", ["npy", "tif", "csv", "folder", "npz", "h5"])
def test_options_without_use_are_refused(tmp_path: Path, kind: str, option: dict[str, Any]) -> None:
    path, _ = source_of(tmp_path, kind, "wall")
    shape: dict[str, Any] = {"shape": (3, 4)} if kind == "csv" else {}
    with pytest.raises((UsageError, BadInputError), match=r"--(valid-status|columns|time-unit)"):
        read_source(path, **option, **shape)


def test_unit_of_times_does_not_apply_to_a_bag(tmp_path: Path) -> None:
    with new_bag(tmp_path, "ros1") as (bag, path):
        bag.image("/cam/depth", STACK[0], stamp_ns=10**9)
    with pytest.raises(UsageError, match="--time-unit does not apply"):
        read_source(path, time_unit_s=1e-3)


def write(path: Path, **arrays: NDArray[Any]) -> Path:
    if path.suffix == ".npz":
        np.savez(path, allow_pickle=False, **arrays)
    elif path.suffix == ".mat":
        savemat(path, arrays)
    else:
        with h5py.File(path, "w") as root:
            for name, values in arrays.items():
                root[name] = values
    return path


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_times_and_codes_that_are_not_used_are_named(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"a{suffix}", depth=STACK, timestamps=np.arange(5.0), flags=np.ones(7))
    notes = " ".join(read_source(path, axes="frame,row,col")[0].notes)
    assert "not used: array timestamps" in notes
    assert "not used: array flags" in notes


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_amplitudes_beside_depths_are_named_with_the_option_that_uses_them(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"a{suffix}", depth=STACK, amplitude=STACK + 3)
    source, _ = read_source(path, axes="frame,row,col")
    assert source.notes == (f"{path}: not used: array amplitude (--amplitude amplitude uses it)",)
    assert read_source(path, axes="frame,row,col", amplitude="amplitude")[0].notes == ()


def test_codes_of_the_camera_are_used_for_a_status_of_the_same_shape_alone(tmp_path: Path) -> None:
    codes: dict[str, Any] = {"status_codes": (5, 9)}
    used = read_source(write(tmp_path / "a.npz", depth=STACK, status=np.full(STACK.shape, 5)), **codes)[0]
    assert (used.status_valid, used.notes) == ((5, 9), ())
    path = write(tmp_path / "b.npz", depth=STACK, status=np.full(5, 1))
    other = read_source(path, **codes)[0]
    assert (other.status_valid, other.notes) == ((), (f"{path}: not used: array status",))


def test_columns_of_numbers_that_are_not_used_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        ",frame,row,col,range_mm,gain,remark,exposure\n0,0,0,0,812,1.5,fine,20\n1,1,0,0,813,1.5,dark,20\n"
    )
    notes = read_source(tmp_path / "a.csv")[0].notes
    assert notes == (f"{tmp_path / 'a.csv'}: not used: column gain, exposure",)


def test_mat_of_a_struct_names_it_and_the_commands_that_save_its_part(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"rec": {"depth": STACK}})
    with pytest.raises(BadInputError, match=r"but rec \(struct\).*depth = rec\.depth; save\('a_depth\.mat', 'depth'\)"):
        read_source(tmp_path / "a.mat")
