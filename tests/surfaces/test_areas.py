"""Areas that edges, arcs and lines cut off a pixel."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from benchmarks.not_there_parts.shares import (
    CASES,
    FAR_MM,
    FAR_SIGMA_MM,
    NEAR_MM,
    NEAR_SIGMA_MM,
    TEXTURE,
    Case,
    edges_of,
    errors_of,
    record,
)

import tofmix as tm
from tofmix.arrays import FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import ShareLaw
from tofmix.surfaces.edge_shape import ARC, chord, chord_outside, covered, covered_by_both, covered_by_three, predict
from tofmix.surfaces.reconstruct import reconstruct

BY_NAME = {case.name: case for case in CASES}
CURVE = NoiseCurve(
    np.array([1.2 * NEAR_MM, 0.9 * FAR_MM]),  # the lens sees the board at ranges up to 1.1 times its distance
    np.array([NEAR_SIGMA_MM, FAR_SIGMA_MM]),
)
"""Known, where the noise is not what is tested: to learn it takes two seconds a recording."""


def known(case: Case, *, seed: int, texture: float) -> tm.Recording:
    """A recording of a camera whose noise is known."""
    return record(case, seed=seed, texture=texture).with_sensor(noise=CURVE)


class Bright(NamedTuple):
    """A bright board whose detections outnumber its area: samples, and the layers that several tests read."""

    recording: tm.Recording
    layers: Layers
    sensor: Sensor


@pytest.fixture(scope="module")
def bright() -> Bright:
    recording = known(BY_NAME["detections, equal reflectivity"], seed=6, texture=TEXTURE)
    found = tm.estimate(recording)
    return Bright(recording, found.window(0), found.sensor)


@pytest.mark.slow
@pytest.mark.long
def test_with_their_laws_the_edges_of_cameras_are_within_their_errors() -> None:
    """Errors along an edge go together, so that one image tells as little as some ten points: the mean is compared."""
    of_areas = errors_of(edges_of(known(BY_NAME["area"], seed=5, texture=TEXTURE), ShareLaw.AREA)).stated
    found = [errors_of(edges_of(known(case, seed=5, texture=0.03), case.law)) for case in CASES[1:]]
    assert all(one.points > 80 for one in found)
    assert max(abs(one.median) for one in found) < 0.02
    assert np.mean([one.within for one in found]) >= 0.85
    assert max(one.stated for one in found) < 1.3 * of_areas


def test_detections_of_a_bright_board_move_its_edges_until_the_law_is_known(bright: Bright) -> None:
    assert errors_of(reconstruct(bright.layers, bright.sensor).edges).median < -0.15
    known = replace(bright.sensor, share_law=ShareLaw.DETECTIONS)
    assert abs(errors_of(reconstruct(bright.layers, known).edges).median) < 0.02


def test_without_amplitudes_or_a_law_shares_stand_for_areas_and_are_counted(bright: Bright) -> None:
    _, layers, sensor = bright
    plain = reconstruct(layers, sensor)
    assert plain.assumed > 50
    dark = reconstruct(replace(layers, amplitude=None), replace(sensor, share_law=ShareLaw.DETECTIONS))
    assert dark.assumed == plain.assumed
    np.testing.assert_array_equal(dark.edges.col, plain.edges.col)
    area = reconstruct(layers, replace(sensor, share_law=ShareLaw.AREA))
    assert area.assumed == 0
    np.testing.assert_array_equal(area.edges.col, plain.edges.col)


def test_unmixed_shares_are_areas_under_any_law(bright: Bright) -> None:
    unmixed = replace(bright.layers, mixing=np.full(bright.layers.shape, int(Mixing.PHASOR), np.uint8))
    edges = [reconstruct(unmixed, replace(bright.sensor, share_law=law)) for law in (None, ShareLaw.DETECTIONS)]
    assert [one.assumed for one in edges] == [0, 0]
    np.testing.assert_array_equal(edges[0].edges.col, edges[1].edges.col)


def test_amplitude_of_a_layer_is_the_mean_of_its_samples(bright: Bright) -> None:
    recording, layers, _ = bright
    light, range_mm = recording.amplitude, recording.range_mm
    assert light is not None
    assert layers.amplitude is not None
    row, col = np.argwhere(layers.n_modes == 2)[3]
    nearer = np.abs(range_mm[:, row, col, np.newaxis] - layers.range[row, col, :2])
    for layer in (0, 1):
        own = light[nearer.argmin(axis=1) == layer, row, col]
        assert layers.amplitude[row, col, layer] == pytest.approx(own.mean(), rel=1e-5)


_GRID = (np.arange(400) + 0.5) / 400 - 0.5


def _pixel(x: float, y: float) -> FloatArray:
    """A collected pixel at a place, of the same grid as the fit's own."""
    pixel = np.zeros(13)
    pixel[0], pixel[1], pixel[2], pixel[5] = x, y, 1.0, 1.0
    return pixel


@pytest.mark.parametrize(("radius", "most"), [(4.0, 0.0025), (8.0, 0.001), (15.0, 0.0005)])
def test_area_under_an_arc_is_that_of_its_circle(radius: float, most: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        angle, offset = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(-0.5, 0.5))
        x, y = math.cos(angle) * (offset + radius), math.sin(angle) * (offset + radius)
        turn = angle + float(rng.uniform(-0.8, 0.8))
        row, col = np.rint(x - radius * math.cos(turn)), np.rint(y - radius * math.sin(turn))
        within = np.hypot(row + _GRID[:, np.newaxis] - x, col + _GRID - y) <= radius
        out = np.zeros(7)
        predict(ARC, angle, offset, 1.0 / radius, _pixel(row, col), out, np.zeros((3, 8, 2)))
        assert out[0] == pytest.approx(within.mean(), abs=most)


_PLACES = (np.arange(400) + 0.5) / 400 - 0.5
_U, _V = np.meshgrid(_PLACES, _PLACES, indexing="ij")
_LINES = [
    (float(np.cos(angle)) * scale, float(np.sin(angle)) * scale, at)
    for angle in (0.0, 0.3, np.pi / 4, 1.4, np.pi / 2, 2.5, 4.0, 5.9)
    for at in (-0.8, -0.45, -0.1, 0.0, 0.3, 0.6)
    for scale in (0.7, 1.0)
]


def _counted(line: tuple[float, float, float]) -> np.ndarray:
    return line[0] * _U + line[1] * _V + line[2] >= 0


@pytest.mark.parametrize("line", _LINES[:: len(_LINES) // 12])
def test_covered_area_equals_the_share_of_places_on_the_positive_side(line: tuple[float, float, float]) -> None:
    assert covered(*line) == pytest.approx(_counted(line).mean(), abs=2e-3)


def test_area_and_its_change_are_those_of_the_places() -> None:
    out = np.empty(3)
    for a, b, c in _LINES:
        chord(a, b, c, out)
        step = 1e-6
        assert out[0] == pytest.approx((covered(a, b, c + step) - covered(a, b, c - step)) / (2 * step), abs=1e-4)
        if out[0] > 0:  # the middle of the chord lies on the line, within the pixel
            assert a * out[1] + b * out[2] + c == pytest.approx(0.0, abs=1e-12)
            assert max(abs(out[1]), abs(out[2])) <= 0.5 + 1e-12
    work = np.empty((3, 8, 2))
    for one, other in zip(_LINES, _LINES[7:] + _LINES[:7], strict=True):
        expected = (_counted(one) & _counted(other)).mean()
        assert covered_by_both(*one, *other, work) == pytest.approx(expected, abs=4e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_area_on_one_side_of_three_lines_equals_the_share_of_places_there(side: float) -> None:
    work = np.empty((3, 8, 2))
    some = 0
    for lines in zip(_LINES, _LINES[7:] + _LINES[:7], _LINES[22:] + _LINES[:22], strict=True):
        expected = np.all([side * (a * _U + b * _V + c) >= 0 for a, b, c in lines], axis=0).mean()
        some += 0 < expected < 1
        area = covered_by_three(side, np.array(lines[0]), np.array(lines[1]), np.array(lines[2]), work)
        assert area == pytest.approx(expected, abs=4e-3)
    assert some > 10


def test_part_of_a_chord_outside_another_line_is_the_change_of_the_area_of_either() -> None:
    work, out = np.empty((3, 8, 2)), np.empty(3)
    step = 1e-6

    def either(c: float, a: float, b: float, other: tuple[float, float, float]) -> float:
        return covered(a, b, c) + covered(*other) - covered_by_both(a, b, c, *other, work)

    checked: list[FloatArray] = []
    for (a, b, c), other in zip(_LINES, _LINES[5:] + _LINES[:5], strict=True):
        chord_outside(a, b, c, *other, out)
        slope = (either(c + step, a, b, other) - either(c - step, a, b, other)) / (2 * step)
        assert out[0] == pytest.approx(slope, abs=1e-4)
        checked.append(out.copy())
    assert np.any(np.array(checked)[:, 0] > 0.1)
