"""ROS bags and calibration files: exact values, stamps, amplitudes, topics, units and intrinsics; and refusals."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bags import AMPLITUDE, DEPTH, INFO, KINDS, Bag, new_bag
from support.reading import depths, read_source

from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers import open_source
from tofmix.io.importers.base import SourceRequest
from tofmix.io.importers.intrinsics import read_calibration
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


def test_mono16_is_depth_by_the_name_of_its_topic_and_its_unit_must_be_given(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(DEPTH, images()[0], stamp_ns=SECOND, encoding="mono16")
        bag.image(AMPLITUDE, images()[1], stamp_ns=SECOND, encoding="mono16")
    for request in (SourceRequest(), SourceRequest(topic=DEPTH)):
        with open_source(path, request) as source:
            assert "the unit is not known" in source.unit_unknown
            np.testing.assert_array_equal(next(source.frames).depth, images()[0])


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


LENS, OTHER = (5.0, 5.5, 2.5, 1.5), (7.0, 7.5, 2.5, 1.5)
PINHOLE = Pinhole(fx=5.0, fy=5.5, cx=2.5, cy=1.5)
IMAGE = np.full((4, 6), 900, "u2")


def frames(bag: Bag, count: int = 6, topic: str = DEPTH) -> None:
    for number in range(count):
        bag.image(topic, IMAGE, stamp_ns=(10 + number) * SECOND)


@pytest.mark.parametrize(
    ("topic", "info"),
    [
        ("/device_0/sensor_1/Depth_0/image/data", "/device_0/sensor_1/Depth_0/info/camera_info"),
        ("/depth/image_raw", "/depth/camera_info"),
        ("/depth_to_rgb/image_raw", "/depth_to_rgb/camera_info"),
        ("/camera/aligned_depth_to_color/image_raw", "/camera/aligned_depth_to_color/camera_info"),
        ("/stereo/depth", "/stereo/camera_info"),
        ("/tof/depth", "/tof/depth/camera_info"),
    ],
)
def test_camera_info_is_found_under_the_names_of_drivers(tmp_path: Path, topic: str, info: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info("/color/camera_info", (4, 6), OTHER)
        bag.info(info, (4, 6), LENS)
        bag.image(topic, IMAGE, stamp_ns=SECOND)
    source, _ = read_source(path)
    assert (source.pinhole, source.notes) == (PINHOLE, ())


def test_camera_info_elsewhere_is_named_where_none_is_beside_the_depths(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info("/color/camera_info", (4, 6), OTHER)
        bag.image(DEPTH, IMAGE, stamp_ns=SECOND)
    source, _ = read_source(path)
    text = f"{path}: no camera_info beside {DEPTH}; --camera-info takes one of: /color/camera_info"
    assert (source.pinhole, source.notes, source.lens_unknown) == (None, (text,), text)
    assert read_source(path, lens_given=True)[0].notes == ()


def test_the_first_calibrated_message_is_used_and_the_blank_ones_are_counted(tmp_path: Path) -> None:
    with new_bag(tmp_path, "ros1") as (bag, path):
        for number, lens in enumerate([(0.0,) * 4, (0.0,) * 4, LENS, LENS]):
            bag.info(INFO, (4, 6), lens, stamp_ns=1 + number)
        frames(bag)
    source, _ = read_source(path)
    assert source.pinhole == PINHOLE
    assert source.notes == (f"{path}: {INFO}: 2 of its messages are not calibrated (zeros); the others are used",)


def test_projection_is_used_without_a_camera_matrix(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (0.0,) * 4, distortion=(0.1,) * 8, model="rational_polynomial", projection=LENS)
        frames(bag)
    source, _ = read_source(path)
    assert (source.pinhole, source.notes) == (PINHOLE, ())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("late_ns", [0, 1000, -1000])
def test_a_lens_that_changes_is_refused_with_its_frames_and_the_cut(tmp_path: Path, kind: str, late_ns: int) -> None:
    """A message of the frame's own time stamp belongs to it, although it comes before or after it in the bag."""
    with new_bag(tmp_path, kind) as (bag, path):
        for number in range(6):
            stamp = (10 + number) * SECOND
            bag.info(INFO, (4, 6), LENS if number < 4 else OTHER, stamp_ns=stamp, bag_ns=stamp + late_ns)
        frames(bag)
    cut = 14 * SECOND + min(0, late_ns)
    command = f"rosbag filter {path} first.bag 't.to_nsec() < {cut}'" if kind == "ros1" else f"start_time_ns: {cut}"
    text = "the lens changes: fx 5 fy 5.5 cx 2.5 cy 1.5 up to frame 3, fx 7 fy 7.5 cx 2.5 cy 1.5 from frame 4 on"
    with pytest.raises(BadInputError, match=f"{text}.*{re.escape(command)}"):
        read_source(path)
    assert read_source(path, lens_given=True)[0].pinhole is None


@pytest.mark.parametrize(
    ("changed", "texts"),
    [
        ({"distortion": (0.25, 0.0, 0.0, 0.0, 0.0)}, ("distortion 0.1 0 0 0 0 up", "distortion 0.25 0 0 0 0 from")),
        ({"projection": OTHER}, ("P 5 0 2.5 0 0 5.5 1.5 0 0 0 0 0 up", "P 7 0 2.5 0 0 7.5 1.5 0 0 0 0 0 from")),
    ],
)
def test_a_lens_that_changes_elsewhere_than_in_its_centre_is_refused_with_the_parts_that_differ(
    tmp_path: Path, changed: dict[str, tuple[float, ...]], texts: tuple[str, str]
) -> None:
    settings: dict[str, Any] = {"distortion": (0.1, 0.0, 0.0, 0.0, 0.0), "model": "plumb_bob", "projection": LENS}
    with new_bag(tmp_path, "mcap") as (bag, path):
        for number in range(6):
            stamp = (10 + number) * SECOND
            given = settings | (changed if number >= 2 else {})
            bag.info(INFO, (4, 6), LENS, stamp_ns=stamp, bag_ns=stamp, **given)
        frames(bag)
    with pytest.raises(BadInputError, match=f"the lens changes: {texts[0]} to frame 1, {texts[1]} frame 2 on"):
        read_source(path)


@pytest.mark.parametrize(("second_ns", "expected"), [(2, 7.0), (99 * SECOND, 5.0)])
def test_a_lens_without_a_frame_is_no_change(tmp_path: Path, second_ns: int, expected: float) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), LENS, stamp_ns=1)
        bag.info(INFO, (4, 6), OTHER, stamp_ns=second_ns)
        frames(bag)
    source, _ = read_source(path)
    assert source.pinhole is not None
    assert source.pinhole.fx == expected


SENSOR = "/device_0/sensor_1"
SDK_DEPTH, SDK_UNIT = f"{SENSOR}/Depth_0/image/data", f"{SENSOR}/option/Depth_Units/value"


def image(dtype: str = "u2") -> NDArray[np.generic]:
    return np.arange(700, 724).reshape(4, 6).astype(dtype)


@pytest.mark.parametrize("kind", KINDS)
def test_unit_of_a_realsense_bag_is_its_message(tmp_path: Path, kind: str) -> None:
    with new_bag(tmp_path, kind) as (bag, path):
        bag.number("/device_0/sensor_0/option/Depth_Units/value", 0.01)  # of another sensor
        bag.number(SDK_UNIT, 0.0005)
        bag.image(SDK_DEPTH, image(), stamp_ns=SECOND, encoding="mono16")
    source, _ = read_source(path)
    assert (source.unit_mm, source.unit_unknown, source.notes) == (0.5, "", ())


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ((0.001, 0.0005), r"the unit changes \(0.001, 0.0005 m\)"),
        ((0.0,), "0 m is no unit"),
        ((np.nan,), "nan m is no"),
    ],
)
def test_units_that_change_or_are_none_are_refused(tmp_path: Path, values: tuple[float, ...], reason: str) -> None:
    with new_bag(tmp_path, "ros1") as (bag, path):
        for number, value in enumerate(values):
            bag.number(SDK_UNIT, value, bag_ns=1 + number)
        bag.image(SDK_DEPTH, image(), stamp_ns=SECOND, encoding="mono16")
    with pytest.raises(BadInputError, match=reason):
        read_source(path)


@pytest.mark.parametrize(
    "other",
    ["/cam/infra1/image_raw", "/cam/amplitude", "/cam/depth/confidence", "/device_0/sensor_1/Infrared_1/image/data"],
)
@pytest.mark.parametrize("encoding", ["16UC1", "mono16", "mono8"])
def test_depth_is_taken_beside_other_images_and_these_are_named(tmp_path: Path, other: str, encoding: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(other, image("u1" if encoding == "mono8" else "u2"), stamp_ns=SECOND, encoding=encoding)
        bag.image(DEPTH, image(), stamp_ns=SECOND)
    source, _ = read_source(path)
    assert source.kind == f"16UC1 images of {DEPTH}"
    assert source.notes == (f"{path}: not used: topic {other}",)
    assert read_source(path, amplitude=other)[0].notes == ()


def test_encodings_that_are_not_read_are_named_and_not_offered(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image("/cam/depth", np.zeros((4, 12), "u1"), stamp_ns=SECOND, encoding="8UC2\n")
    with pytest.raises(BadInputError, match=r"not readable as depths: /cam/depth \(8UC2\)") as refused:
        read_source(path)
    assert "--topic" not in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        ("ros1", "rosrun image_transport republish compressedDepth in:=/tof/image raw out:=/tof/image_raw"),
        ("mcap", "ros2 run image_transport republish compressedDepth raw --ros-args"),
    ],
)
def test_compressed_depths_are_named_with_the_command_that_unpacks_them(
    tmp_path: Path, kind: str, command: str
) -> None:
    topic = "/tof/image/compressedDepth"
    with new_bag(tmp_path, kind) as (bag, path):
        bag.compressed(topic, stamp_ns=SECOND)
    for request in ({}, {"topic": topic}):
        with pytest.raises(BadInputError, match=rf"{topic} holds compressed images.*{command}"):
            read_source(path, **request)


INFO_INTRINSICS = "height: 4\nwidth: 6\nk: [5.0, 0, 2.5, 0, 5.5, 1.5, 0, 0, 1]\nd: [0, 0, 0, 0, 0]\n"
DEPTH_INTRINSICS = {"fx": 210.5, "fy": 211.0, "cx": 88.25, "cy": 72.0, "width": 176}
COLOUR = {"fx": 600.0, "fy": 601.0, "cx": 320.0, "cy": 240.0, "width": 640}


def test_of_several_messages_the_first_one_that_is_calibrated_is_read(tmp_path: Path) -> None:
    path = tmp_path / "info.yaml"
    blank = INFO_INTRINSICS.replace("5.0", "0").replace("5.5", "0")
    path.write_text(f"{blank}---\n{blank}---\n{INFO_INTRINSICS}---\n{INFO_INTRINSICS.replace('5.0', '9.0')}---\n")
    assert read_calibration(path).pinhole((4, 6), rectified=False) == Pinhole(fx=5.0, fy=5.5, cx=2.5, cy=1.5)
    path.write_text(f"{blank}---\n{blank}---\n")
    assert not read_calibration(path).calibrated


OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>176</image_width>
<{name} type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>
    210.5 0. 88.25 0. 2.11e2
    72. 0. 0. 1.</data></{name}>
<distortion type_id="opencv-matrix"><rows>1</rows><cols>2</cols><dt>d</dt><data>0.1 0.2</data></distortion>
</opencv_storage>
"""
ORBBEC_INI = """; made by a viewer
[ColorIntrinsic]
fx=600
fy=601
cx=320
cy=240
width=640
height=480
[DepthIntrinsic]
fx=210.5
fy=211
cx=88.25
cy=72
width=176
height=144
"""


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("a.xml", OPENCV_XML.format(name="camera_matrix"), "in XML"),
        ("b.xml", OPENCV_XML.format(name="M1"), "in XML"),
        ("c.ini", ORBBEC_INI, "in INI"),
        ("d.txt", "210.5 0 88.25\n0 211 72\n0 0 1\n", "a matrix as text"),
        ("e.csv", "210.5,0,88.25\r\n0,211,72\r\n0,0,1\r\n", "a matrix as text"),
        ("f.txt", "[[210.5, 0., 88.25],\n [0., 211., 72.], [0., 0., 1.]]\n", "a matrix as text"),
    ],
)
def test_other_syntaxes_are_refused_with_their_numbers_as_an_option(
    tmp_path: Path, name: str, text: str, kind: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(BadInputError, match=kind) as refused:
        read_calibration(tmp_path / name)
    assert "without distortion: --intrinsics 210.5,211,88.25,72" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_arrays_of_numpy_are_refused_with_the_numbers_of_their_matrix(tmp_path: Path) -> None:
    matrix = np.array([[210.5, 0, 88.25], [0, 211, 72], [0, 0, 1]])
    np.save(tmp_path / "k.npy", matrix)
    np.savez(tmp_path / "k.npz", mtx=matrix, dist=np.zeros((1, 5)), count=3)
    for name in ("k.npy", "k.npz"):
        with pytest.raises(BadInputError, match=r"without distortion: --intrinsics 210\.5,211,88\.25,72$"):
            read_calibration(tmp_path / name)
    np.save(tmp_path / "k.npy", matrix.T[:2])
    with pytest.raises(BadInputError, match="an array that is no camera matrix"):
        read_calibration(tmp_path / "k.npy")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.xml", "<opencv_storage><camera_matrix/></opencv_storage>"),
        ("a.ini", "[Depth]\nfx=wide\n"),
        ("a.ini", "[Depth]\nfx=1\nfy\n"),
        ("a.npy", "no array"),
        ("a.npz", "no arrays"),
        ("a.txt", "1 2 3 4 5 6 7 8 9"),
    ],
)
def test_other_syntaxes_without_a_matrix_are_refused_in_one_line(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(BadInputError) as refused:
        read_calibration(tmp_path / name)
    assert "\n" not in str(refused.value)
    assert "--intrinsics" not in str(refused.value)


def test_json_of_a_camera_info_is_read(tmp_path: Path) -> None:
    path = tmp_path / "info.json"
    path.write_text(json.dumps({"K": [[5.0, 0, 2.5], [0, 5.5, 1.5], [0, 0, 1]]}, indent="\t"))
    assert read_calibration(path).pinhole((4, 6), rectified=False) == Pinhole(fx=5.0, fy=5.5, cx=2.5, cy=1.5)


@pytest.mark.parametrize(
    ("found", "option"),
    [
        ({"cam0": {"camera_model": "pinhole", "intrinsics": [210.5, 211, 88.25, 72]}}, "210.5,211,88.25,72"),
        ({"cam0": {"camera_model": "omni", "intrinsics": [0.9, 210.5, 211, 88.25, 72]}}, "210.5,211,88.25,72"),
        ({"value0": {"intrinsics": [{"camera_type": "kb4", "intrinsics": DEPTH_INTRINSICS}]}}, "210.5,211,88.25,72"),
        ({"rgbIntrinsic": COLOUR, "depthIntrinsic": DEPTH_INTRINSICS}, "210.5,211,88.25,72"),
        ([{"colour": COLOUR, "depth": DEPTH_INTRINSICS}], "210.5,211,88.25,72"),
        ({"fx": 210.5, "fy": 211, "ppx": 88.25, "ppy": 72}, "210.5,211,88.25,72"),
        # Open3D writes the columns of the matrix, DepthAI its rows.
        (
            {"width": 176, "height": 144, "intrinsic_matrix": [210.5, 0, 0, 0, 211, 0, 88.25, 72, 1]},
            "210.5,211,88.25,72 (of images of 144 x 176 pixels)",
        ),
        (
            {
                "cameraData": [
                    [2, {"width": 176, "height": 144, "intrinsicMatrix": [[210.5, 0, 88.25], [0, 211, 72], [0, 0, 1]]}]
                ]
            },
            "210.5,211,88.25,72 (of images of 144 x 176 pixels)",
        ),
        # An Azure Kinect's are parts of the sensor's size, with the corner of the first pixel at 0.
        (
            {
                "CalibrationInformation": {
                    "Cameras": [
                        {
                            "Purpose": "CALIBRATION_CameraPurposePhotoVideo",
                            "SensorWidth": 4096,
                            "SensorHeight": 3072,
                            "Intrinsics": {"ModelParameters": [0.5, 0.5, 0.7, 0.9, 0.1]},
                        },
                        {
                            "Purpose": "CALIBRATION_CameraPurposeDepth",
                            "SensorWidth": 1000,
                            "SensorHeight": 500,
                            "Intrinsics": {"ModelParameters": [0.51, 0.49, 0.25, 0.75, 5.0]},
                        },
                    ]
                }
            },
            "250,375,509.5,244.5 (of images of 500 x 1000 pixels)",
        ),
        (
            {
                "cam0": {"rostopic": "/rgb/image", "intrinsics": [600, 601, 320, 240]},
                "cam1": {"rostopic": "/depth/image", "intrinsics": [210.5, 211, 88.25, 72]},
            },
            "210.5,211,88.25,72",
        ),
        (
            {"left": DEPTH_INTRINSICS, "right": COLOUR},
            "210.5,211,88.25,72 (left) or --intrinsics 600,601,320,240 (right)",
        ),
    ],
)
def test_other_kinds_are_refused_with_their_numbers_as_an_option(tmp_path: Path, found: object, option: str) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(found, indent="\t"))
    with pytest.raises(BadInputError) as refused:
        read_calibration(path)
    assert str(refused.value).endswith(f"without distortion: --intrinsics {option}")


@pytest.mark.parametrize(
    "found", [{"fx": "a", "fy": 1, "cx": 1, "cy": 1}, {"cam0": {"intrinsics": [0, 0, 1, 1]}}, [1, 2]]
)
def test_files_without_usable_numbers_are_no_calibration(tmp_path: Path, found: object) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(found))
    with pytest.raises(BadInputError, match="not a calibration"):
        read_calibration(path)


@pytest.mark.parametrize("text", ["[" * 5000, '{"fx": 1' + "0" * 400 + ', "fy": 1, "cx": 1, "cy": 1}', "{", "\t- {"])
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(text)
    with pytest.raises(BadInputError) as refused:
        read_calibration(path)
    assert "\n" not in str(refused.value)
