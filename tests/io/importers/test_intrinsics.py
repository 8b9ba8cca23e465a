"""Calibration files that ROS tools and makers of cameras write."""

import json
from pathlib import Path

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.io.importers.intrinsics import read_calibration
from tofmix.optics.pinhole import Pinhole

INFO = "height: 4\nwidth: 6\nk: [5.0, 0, 2.5, 0, 5.5, 1.5, 0, 0, 1]\nd: [0, 0, 0, 0, 0]\n"
DEPTH = {"fx": 210.5, "fy": 211.0, "cx": 88.25, "cy": 72.0, "width": 176}
COLOUR = {"fx": 600.0, "fy": 601.0, "cx": 320.0, "cy": 240.0, "width": 640}


@pytest.mark.parametrize("text", [f"{INFO}---\n", f"---\n{INFO}---\n{INFO.replace('5.0', '9.0')}---\n"])
def test_the_first_message_of_ros2_topic_echo_is_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "info.yaml"
    path.write_text(text)
    assert read_calibration(path).pinhole((4, 6), rectified=False) == Pinhole(fx=5.0, fy=5.5, cx=2.5, cy=1.5)


def test_of_several_messages_the_first_one_that_is_calibrated_is_read(tmp_path: Path) -> None:
    path = tmp_path / "info.yaml"
    blank = INFO.replace("5.0", "0").replace("5.5", "0")
    path.write_text(f"{blank}---\n{blank}---\n{INFO}---\n{INFO.replace('5.0', '9.0')}---\n")
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
        ({"value0": {"intrinsics": [{"camera_type": "kb4", "intrinsics": DEPTH}]}}, "210.5,211,88.25,72"),
        ({"rgbIntrinsic": COLOUR, "depthIntrinsic": DEPTH}, "210.5,211,88.25,72"),
        ([{"colour": COLOUR, "depth": DEPTH}], "210.5,211,88.25,72"),
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
        ({"left": DEPTH, "right": COLOUR}, "210.5,211,88.25,72 (left) or --intrinsics 600,601,320,240 (right)"),
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
