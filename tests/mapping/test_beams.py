import math
from dataclasses import replace

import numpy as np
import pytest
from support.alike import MakeLayers

from tofmix.mapping.beams import CLEAR_STDERRS, MAX_INCIDENCE_DEG, beams_from_layers, beams_from_ranges
from tofmix.sensor import Sensor


def test_every_layer_is_a_hit_with_its_share(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0, 2000.0], [0.3, 0.6], no_return=0.1, samples=50, stderr=7.0)
    beams = beams_from_layers(layers, camera)
    np.testing.assert_allclose(beams.samples[3, 4], [15, 30, 0], rtol=1e-6)
    np.testing.assert_allclose(beams.samples_no_return, 5, rtol=1e-6)
    assert beams.free_to_mm == 6000 - 2 * 10
    half = 1000 * math.radians(1.0) / 2 * math.tan(math.radians(MAX_INCIDENCE_DEG))
    assert beams.near_mm[0, 0, 0] == pytest.approx(1000 - half)
    assert beams.far_mm[0, 0, 0] == pytest.approx(1000 + half)
    assert beams.clear_to_mm[0, 0, 0] == pytest.approx(1000 - half - CLEAR_STDERRS * 7)
    assert np.isnan(beams.near_mm[..., 2]).all()
    assert beams.reach_mm == beams.free_to_mm


def test_improbable_layer_is_ignored(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0], [0.9], probability=0.8, no_return=0.1)
    assert beams_from_layers(layers, camera).samples.sum() == 0
    assert beams_from_layers(layers, camera, min_probability=0.8).samples.sum() > 0
    with pytest.raises(ValueError, match=r"min_probability: 1\.1"):
        beams_from_layers(layers, camera, min_probability=1.1)


def test_without_a_range_limit_there_is_no_no_return(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0], [1.0], no_return=math.nan)
    beams = beams_from_layers(layers, replace(camera, range_max_mm=None))
    assert beams.samples_no_return.sum() == 0
    assert beams.reach_mm == beams.far_mm[0, 0, 0]


def test_a_mean_is_one_hit_or_no_return(camera: Sensor) -> None:
    beams = beams_from_ranges([[1500.0, 5985.0, math.nan]], [[25, 25, 0]], camera)
    np.testing.assert_array_equal(beams.samples[0, :, 0], [25, 0, 0])
    np.testing.assert_array_equal(beams.samples_no_return[0], [0, 25, 0])
    assert beams.near_mm[0, 0, 0] - beams.clear_to_mm[0, 0, 0] == pytest.approx(CLEAR_STDERRS * 10 / 5)


def test_beams_refuse_invalid_shapes_and_probabilities(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0], [1.0])
    with pytest.raises(ValueError, match="no field of view"):
        beams_from_layers(layers, replace(camera, fov_vertical_deg=None))
    with pytest.raises(ValueError, match="expected an image"):
        beams_from_layers(layers.reshaped((64,)), camera)
    with pytest.raises(ValueError, match="does not match range"):
        beams_from_ranges([[1.0, 2.0]], [[1.0]], camera)


def test_uncertain_range_lowers_the_probability_of_a_hit(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0, 2000.0], [0.5, 0.4], stderr=50.0)
    layers.range_stderr[..., 1] = 0.0
    beams = beams_from_layers(layers, camera)
    within = beams.probability_within(50.0)[2, 3]
    np.testing.assert_allclose(within, [0.682689, 1.0, 0.0], atol=1e-5)  # one standard error, none, no surface
    assert (beams.probability_within(5.0)[..., 0] < 0.1).all()
