"""ROS bags that rosbags' writer made: exact values, stamps, amplitudes, intrinsics; and every refusal."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bags import AMPLITUDE, DEPTH, INFO, KINDS, new_bag
from support.reading import depths, read_source

from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import SourceRequest
from tofmix.optics.pinhole import Pinhole

SECOND = 10**9
FRAMES = 5


def images(dtype: str = "u2", frames: int = FRAMES) -> NDArray[np.generic]:
    rng = np.random.default_rng(8)
    values = rng.integers(0, 65536, (frames, 4, 6)).astype(dtype)
    return values / np.float32(1000) if dtype == "f4" else values


def simple_bag(folder: Path, kind: str = "mcap", frames: int = FRAMES, dtype: str = "u2") -> Path:
    with new_bag(folder, kind) as (bag, path):
        for number, image in enumerate(images(dtype, frames)):
            bag.image(DEPTH, image, stamp_ns=(100 + number) * SECOND)
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("dtype", "unit_mm"), [("u2", 1.0), ("f4", 1000.0)])
def test_depths_come_back_exactly(tmp_path: Path, kind: str, dtype: str, unit_mm: float) -> None:
    path = simple_bag(tmp_path, kind, dtype=dtype)
    np.testing.assert_array_equal(depths(path), images(dtype))
    source, frames = read_source(path)
    assert (source.unit_mm, source.depth_axis) == (unit_mm, "z")
    assert [frame.time_s for frame in frames] == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("dtype", ["u2", "f4"])
def test_padded_rows_and_either_byte_order_are_read(tmp_path: Path, dtype: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        for number, image in enumerate(images(dtype)):
            bag.image(DEPTH, image, stamp_ns=number * SECOND + 1, padding=3 * number, big_endian=number % 2 == 1)
    np.testing.assert_array_equal(depths(path), images(dtype))


def test_a_file_of_a_bag_is_enough(tmp_path: Path) -> None:
    folder = simple_bag(tmp_path, "mcap")
    (file,) = folder.glob("*.mcap")
    np.testing.assert_array_equal(depths(file), images())
    (tmp_path / "other").mkdir()
    (file,) = simple_bag(tmp_path / "other", "sqlite3").glob("*.db3")
    np.testing.assert_array_equal(depths(file), images())


def test_time_of_the_bag_replaces_a_stamp_of_zero(tmp_path: Path) -> None:
    with new_bag(tmp_path, "ros1") as (bag, path):
        for number, image in enumerate(images()):
            bag.image(DEPTH, image, stamp_ns=0, bag_ns=(50 + 2 * number) * SECOND)
    assert [frame.time_s for frame in read_source(path)[1]] == [0.0, 2.0, 4.0, 6.0, 8.0]


@pytest.mark.parametrize("late", [False, True])
def test_amplitudes_are_matched_by_time_stamp(tmp_path: Path, late: bool) -> None:
    # Before or after the depths in the bag, and one is missing.
    with new_bag(tmp_path, "mcap") as (bag, path):
        for number, image in enumerate(images()):
            stamp = (100 + number) * SECOND
            bag.image(DEPTH, image, stamp_ns=stamp)
            if number != 2:
                amplitude = np.full((4, 6), number, dtype="u1")
                bag.image(AMPLITUDE, amplitude, stamp_ns=stamp, bag_ns=stamp + (SECOND if late else -SECOND))
    source, frames = read_source(path, amplitude=AMPLITUDE)
    assert source.has_amplitude
    np.testing.assert_array_equal([frame.depth for frame in frames], images())
    found = [None if frame.amplitude is None else int(frame.amplitude[0, 0]) for frame in frames]
    assert found == [0, 1, None, 3, 4]


def test_frames_do_not_wait_without_end_for_their_amplitudes(tmp_path: Path) -> None:
    count = 200
    with new_bag(tmp_path, "mcap") as (bag, path):
        for number in range(count):
            bag.image(DEPTH, np.full((2, 2), number + 1, "u2"), stamp_ns=(number + 1) * SECOND)
            bag.image(AMPLITUDE, np.ones((2, 2), "u1"), stamp_ns=(number + 1) * SECOND + 5)  # never the same stamp
    _, frames = read_source(path, amplitude=AMPLITUDE)
    assert [int(frame.depth[0, 0]) for frame in frames] == list(range(1, count + 1))
    assert all(frame.amplitude is None for frame in frames)


def test_intrinsics_come_from_the_camera_info_of_the_depths(tmp_path: Path) -> None:
    with new_bag(tmp_path, "sqlite3") as (bag, path):
        bag.info("/camera/color/camera_info", (480, 640), (600.0, 600.0, 320.0, 240.0))
        bag.info(INFO, (4, 6), (5.0, 5.5, 2.5, 1.5))
        bag.image(DEPTH, images()[0], stamp_ns=SECOND)
    assert read_source(path)[0].pinhole == Pinhole(fx=5.0, fy=5.5, cx=2.5, cy=1.5)
    with pytest.raises(BadInputError, match="describes 480 x 640 pixels"):
        read_source(path, camera_info="/camera/color/camera_info")
    with pytest.raises(BadInputError, match="no topic /none"):
        read_source(path, camera_info="/none")


def test_uncalibrated_camera_is_noted(tmp_path: Path) -> None:
    with new_bag(tmp_path, "ros1") as (bag, path):
        bag.info(INFO, (4, 6), (0.0, 0.0, 0.0, 0.0))
        bag.image(DEPTH, images()[0], stamp_ns=SECOND)
    source, _ = read_source(path)
    (said,) = source.notes
    assert "not calibrated" in said
    assert source.pinhole is None


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
@pytest.mark.parametrize("topic", ["/camera/depth/image_raw", "/camera/depth/image_rect_raw"])
def test_raw_images_take_the_lens_and_rectified_ones_the_projection(tmp_path: Path, kind: str, topic: str) -> None:
    """Region of interest and binning by hand: rows 100 to 107 and columns 200 to 217, joined 2 down and 3 across."""
    lens = (-0.1, 0.02, 0.001, -0.001, 0.003)
    with new_bag(tmp_path, kind) as (bag, path):
        bag.info(
            INFO,
            (480, 640),
            (600.0, 610.0, 320.0, 240.0),
            distortion=lens,
            projection=(570.0, 580.0, 330.0, 250.0),
            region=(100, 200, 8, 18),
            binning=(2, 3),
        )
        bag.image(topic, images()[0], stamp_ns=SECOND)
    source, _ = read_source(path)
    if "rect" in topic:
        assert source.pinhole == Pinhole(fx=190.0, fy=290.0, cx=130 / 3, cy=75.0)
    else:
        assert source.pinhole == Pinhole(fx=200.0, fy=305.0, cx=40.0, cy=70.0, distortion=lens)
    assert source.rectified == ("rect" in topic)
    assert source.notes == ()


def test_equidistant_lenses_are_refused_unless_rectified_or_overridden(tmp_path: Path) -> None:
    for name in ("image_raw", "image_rect"):
        folder = tmp_path / name
        folder.mkdir()
        with new_bag(folder, "mcap") as (bag, path):
            bag.info(
                INFO,
                (4, 6),
                (5.0, 5.0, 2.5, 1.5),
                distortion=(0.1, 0.0, 0.0, 0.0),
                model="equidistant",
                projection=(4.0, 4.0, 2.0, 1.0),
            )
            bag.image(f"/camera/depth/{name}", images()[0], stamp_ns=SECOND)
        if name == "image_rect":
            assert read_source(path)[0].pinhole == Pinhole(fx=4.0, fy=4.0, cx=2.0, cy=1.0)
            continue
        with pytest.raises(
            BadInputError, match=r"camera_info: distortion model equidistant is not a pinhole's;.*--fov"
        ):
            read_source(path)
        assert read_source(path, lens_given=True)[0].pinhole is None


def test_the_topic_is_chosen_or_the_candidates_are_listed(tmp_path: Path) -> None:
    second = "/other/depth"
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(DEPTH, images()[0], stamp_ns=SECOND)
        bag.image(second, images("f4")[0], stamp_ns=SECOND)
        bag.image(AMPLITUDE, np.ones((4, 6), "u1"), stamp_ns=SECOND)
    with pytest.raises(BadInputError) as refused:
        read_source(path)
    for text in (f"{DEPTH} (16UC1)", f"{second} (32FC1)", f"{AMPLITUDE} (mono8)", "--topic"):
        assert text in str(refused.value)
    np.testing.assert_array_equal(depths(path, topic=second)[0], images("f4")[0])
    with pytest.raises(BadInputError, match=f"no topic /none .*it has: {DEPTH}"):
        read_source(path, topic="/none")
    with pytest.raises(BadInputError, match="encoding 'mono8'"):
        read_source(path, topic=AMPLITUDE)


def test_a_bag_without_depths_lists_its_images(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image("/color", np.ones((4, 6), "u1"), stamp_ns=SECOND)
    with pytest.raises(BadInputError, match=r"no topic of depth images .*/color \(mono8\)"):
        read_source(path)


def test_mono16_is_depth_by_the_name_of_its_topic_and_its_unit_must_be_given(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(DEPTH, images()[0], stamp_ns=SECOND, encoding="mono16")
        bag.image(AMPLITUDE, images()[1], stamp_ns=SECOND, encoding="mono16")
    for request in (SourceRequest(), SourceRequest(topic=DEPTH)):
        with open_source(path, request) as source:
            assert "the unit is not known" in source.unit_unknown
            np.testing.assert_array_equal(next(source.frames).depth, images()[0])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("size", "3 x 6 pixels, the first frame has 4 x 6"),
        ("type", "first frame has"),
        ("short", "do not make an image of"),
    ],
)
def test_images_that_differ_are_refused(tmp_path: Path, change: str, reason: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(DEPTH, images()[0], stamp_ns=SECOND)
        image = {"size": images()[1][:3], "type": images("f4")[1]}.get(change, images()[1])
        bag.image(DEPTH, image, stamp_ns=2 * SECOND, lost_bytes=2 if change == "short" else 0)
    with pytest.raises(BadInputError, match=reason):
        read_source(path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_cut_bag_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = simple_bag(tmp_path, kind, frames=400)
    file = path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix in {".db3", ".mcap"})
    data = file.read_bytes()
    for share in (0.0, 0.3, 0.6, 0.9, 0.99):
        file.write_bytes(data[: int(share * len(data))])
        for source in {path, file}:
            with pytest.raises(BadInputError) as refused:
                read_source(source)
            assert str(path) in str(refused.value)
            assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes_are_refused_or_read(tmp_path: Path, kind: str) -> None:
    # Not every flipped byte can be seen; but none may end in anything other than frames or our own error.
    path = simple_bag(tmp_path, kind)
    file = path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix in {".db3", ".mcap"})
    data = file.read_bytes()
    rng = np.random.default_rng(4)
    refused = []
    for _ in range(40):
        broken = bytearray(data)
        for place in rng.integers(0, len(data), 20):
            broken[place] = rng.integers(0, 256)
        file.write_bytes(broken)
        try:
            read_source(file)
        except BadInputError as error:
            refused.append(str(error))
    assert refused
    assert not any("\n" in text for text in refused)


def test_bag_folder_with_broken_metadata_is_refused(tmp_path: Path) -> None:
    path = simple_bag(tmp_path, "sqlite3")
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    with pytest.raises(BadInputError, match="bag_sqlite3"):
        read_source(path)


@pytest.mark.parametrize("count", ["[[1.0]]", "9" * 30, "text"])
def test_impossible_counts_are_refused(tmp_path: Path, count: str) -> None:
    path = simple_bag(tmp_path, "sqlite3")
    metadata = path / "metadata.yaml"
    metadata.write_text(re.sub(r"message_count: \d+", f"message_count: {count}", metadata.read_text()))
    with pytest.raises(BadInputError, match="bag_sqlite3"):
        read_source(path)


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = simple_bag(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(UsageError, match=r"rosbags: pip install 'tofmix\[ros\]'"):
        read_source(path)
