"""ROS bags: the topic of the depths, and its unit."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.bags import AMPLITUDE, DEPTH, KINDS, new_bag
from support.reading import read_source

from tofmix.errors import BadInputError

SECOND = 10**9
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


def test_message_of_the_unit_beats_the_millimetres_of_16uc1(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.number(SDK_UNIT, 0.0001)
        bag.image(SDK_DEPTH, image(), stamp_ns=SECOND)
    assert read_source(path)[0].unit_mm == 0.1


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


def test_mono16_of_depth_without_a_unit_says_so(tmp_path: Path) -> None:
    with new_bag(tmp_path, "sqlite3") as (bag, path):
        bag.image("/cam/z16/image", image(), stamp_ns=SECOND, encoding="mono16")
    source, _ = read_source(path)
    assert source.unit_mm is None
    assert source.unit_unknown.startswith("/cam/z16/image: mono16 without a message")


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


def test_colour_beside_depth_needs_no_word(tmp_path: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image("/cam/color/image_raw", np.zeros((4, 18), "u1"), stamp_ns=SECOND, encoding="rgb8")
        bag.image(DEPTH, image(), stamp_ns=SECOND)
    assert read_source(path)[0].notes == ()


@pytest.mark.parametrize("topic", ["/cam/infra1/image_raw", "/cam/disparity", AMPLITUDE])
def test_images_of_another_kind_alone_are_listed(tmp_path: Path, topic: str) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.image(topic, image(), stamp_ns=SECOND)
    with pytest.raises(BadInputError, match=rf"no topic of depth images .*--topic from its images: {topic} \(16UC1\)"):
        read_source(path)


def test_depth_seen_from_the_colour_camera_and_raw_are_listed(tmp_path: Path) -> None:
    aligned = "/camera/aligned_depth_to_color/image_raw"
    with new_bag(tmp_path, "mcap") as (bag, path):
        for topic in (DEPTH, aligned):
            bag.image(topic, image(), stamp_ns=SECOND)
    with pytest.raises(BadInputError, match=rf"several topics of depth images.*{aligned} \(16UC1\), {DEPTH}"):
        read_source(path)
    assert read_source(path, topic=aligned)[0].notes == ()


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
