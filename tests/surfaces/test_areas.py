"""Areas from shares of samples, against edges that are known."""

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
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.measurement import ShareLaw
from tofmix.sensor import NoiseCurve, Sensor
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


@pytest.mark.slow
def test_equal_brightness_makes_detections_areas() -> None:
    same = Case("same light", ShareLaw.DETECTIONS, 1.0, 1.0)
    found = errors_of(edges_of(known(same, seed=7, texture=0.0), ShareLaw.DETECTIONS))
    assert abs(found.median) < 0.01
    assert found.within >= 0.9


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
