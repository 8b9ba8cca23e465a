"""ROS bags: the camera_info of the depths."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bags import DEPTH, INFO, KINDS, Bag, new_bag
from support.reading import read_source

from tofmix.errors import BadInputError
from tofmix.io.importers.rosbag import _is_rectified
from tofmix.optics.pinhole import Pinhole

SECOND = 10**9
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


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        ("/d/image_rect", True),
        ("/d/image_rect_raw", True),
        ("/d/image_direct", False),
        ("/rect/image_raw", False),
        ("/d/rectangle", False),
    ],
)
def test_rectified_is_a_word_of_the_topics_last_part(topic: str, *, expected: bool) -> None:
    assert _is_rectified(topic) == expected


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


def test_a_calibrated_topic_is_used_where_the_nearest_one_is_blank(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (0.0,) * 4)
        bag.info(f"{DEPTH}/camera_info", (4, 6), LENS)
        frames(bag)
    source, _ = read_source(path)
    assert source.pinhole == PINHOLE
    assert "not calibrated" in source.notes[0]


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
