"""From a source's numbers to ranges: what stays exact, what is no sample, and the geometry."""

import numpy as np
import pytest
from numpy.typing import NDArray
from support.naive import beam_directions

from tofmix.io.importers.conversion import Conversion
from tofmix.optics.geometry import ray_over_depth
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2"])
def test_whole_millimetres_stay_as_they_are(dtype: str) -> None:
    depth = np.arange(256, dtype=dtype).reshape(16, 16)
    convert = Conversion(dtype=depth.dtype)
    assert convert.stored_dtype == "u2"
    range_mm = convert(depth).range_mm
    kept = depth != np.iinfo(depth.dtype).max  # the end of a type is a fill value
    np.testing.assert_array_equal(range_mm, np.where(kept, depth, 0))
    assert range_mm.dtype == np.uint16


def test_every_16_bit_count_survives_a_binary_scale() -> None:
    depth = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    range_mm = Conversion(dtype=depth.dtype, unit_mm=0.25, keep_values=True)(depth).range_mm
    assert range_mm.dtype == np.float32
    np.testing.assert_array_equal(range_mm.ravel() / 0.25, np.arange(65536))


def test_metres_become_millimetres_with_one_rounding() -> None:
    metres = np.random.default_rng(1).uniform(0.3, 8.0, (50, 60)).astype("f4")
    range_mm = Conversion(dtype=metres.dtype, unit_mm=1000.0)(metres).range_mm
    exact = metres.astype("f8") * 1000.0
    np.testing.assert_array_equal(range_mm, exact.astype("f4"))
    np.testing.assert_allclose(range_mm / 1000.0, metres, rtol=2**-23)  # and back, but for the last bit


@pytest.mark.parametrize(("dtype", "invalid"), [("u2", 65535.0), ("i4", -1.0), ("f4", 0.1), ("f8", 9999.5)])
def test_invalid_values_become_nan(dtype: str, invalid: float) -> None:
    depth = np.array([[0, 7, invalid]], dtype=dtype)
    out = Conversion(dtype=depth.dtype, invalid=(invalid, 12345.678))(depth).range_mm
    valid = out != 0 if out.dtype == np.uint16 else np.isfinite(out)
    assert valid.tolist() == [[False, True, False]]


def test_infinite_values_become_nan() -> None:
    depth = np.array([[np.nan, np.inf, -np.inf, 1e38, 1.0]], dtype="f4")
    out = Conversion(dtype=depth.dtype, unit_mm=1000.0)(depth).range_mm
    assert np.isfinite(out).tolist() == [[False, False, False, False, True]]


def _walls() -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Range over depth by the geometry under test, and by the angle between the beam and the axis."""
    pinhole = Pinhole(fx=4.0, fy=5.0, cx=2.5, cy=1.0)
    row, col = np.mgrid[0:4, 0:6]
    beams = np.stack([(col - 2.5) / 4.0, (row - 1.0) / 5.0, np.ones((4, 6))], axis=-1)
    azimuth, elevation = np.deg2rad((col - 2.5) * 60 / 6), np.deg2rad((row - 1.5) * 40 / 4)
    return {
        "pinhole": (ray_over_depth(beam_directions_of(pinhole, (4, 6))), np.linalg.norm(beams, axis=-1)),
        "grid": (
            ray_over_depth(beam_directions(4, 6, fov_horizontal_deg=60.0, fov_vertical_deg=40.0)),
            1 / (np.cos(azimuth) * np.cos(elevation)),
        ),
    }


@pytest.mark.parametrize("geometry", ["pinhole", "grid"])
def test_a_wall_across_the_axis_has_one_depth_and_longer_ranges_off_it(geometry: str) -> None:
    factor, expected = _walls()[geometry]
    depth = np.full((4, 6), 2000, dtype=np.uint16)
    convert = Conversion(dtype=depth.dtype, ray_over_depth=factor)
    assert convert.stored_dtype == "f4"
    np.testing.assert_allclose(convert(depth).range_mm, 2000 * expected, rtol=1e-7)
