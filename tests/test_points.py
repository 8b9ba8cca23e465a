"""Layers as points, against a loop over pixels."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.made_up import LayersInMemory, made_up_layers

from tofmix.optics.equiangular import Equiangular
from tofmix.points import POINT_DTYPE, LayerPoints, PointFilter, fields_of_names

SHAPE, MAX_LAYERS = (2, 4, 5), 3
VIEW: dict[str, Any] = {"optics": Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)}


def test_points_are_those_of_a_loop_over_pixels() -> None:
    layers = made_up_layers(SHAPE, MAX_LAYERS)
    points = list(LayerPoints(LayersInMemory(layers), **VIEW))
    assert [block.dtype for block in points] == [POINT_DTYPE] * 2
    number = 0
    for window, row, col in np.ndindex(*SHAPE):
        azimuth = math.radians((col - 2.0) * 47.0 / 5)
        elevation = math.radians((row - 1.5) * 39.0 / 4)
        number = 0 if (row, col) == (0, 0) else number
        for layer in range(layers.n_modes[window, row, col]):
            point = points[window][number]
            metres = float(layers.range[window, row, col, layer]) / 1000
            assert point["x"] == np.float32(metres * math.sin(azimuth) * math.cos(elevation))
            assert point["y"] == np.float32(metres * math.sin(elevation))
            assert point["z"] == np.float32(metres * math.cos(azimuth) * math.cos(elevation))
            for name in ("range", "sigma", "weight", "range_stderr", "weight_stderr", "probability"):
                np.testing.assert_array_equal(point[name], getattr(layers, name)[window, row, col, layer])
            assert (point["return_number"], point["number_of_returns"]) == (layer + 1, layers.n_modes[window, row, col])
            assert (point["row"], point["col"], point["window"]) == (row, col, window)
            assert point["status"] == layers.status[window, row, col]
            number += 1
    assert number == len(points[1])


@pytest.mark.parametrize(
    "chosen",
    [PointFilter(min_weight=0.2), PointFilter(min_probability=0.95), PointFilter(min_weight=0.1, min_probability=0.95)],
)
def test_filters_leave_out_points_and_change_none(chosen: PointFilter) -> None:
    source = LayersInMemory(made_up_layers(SHAPE, MAX_LAYERS))
    everything = np.concatenate(list(LayerPoints(source, **VIEW)))
    keep = everything["weight"] >= (chosen.min_weight or 0)
    keep &= everything["probability"] >= (chosen.min_probability or 0)
    assert 0 < keep.sum() < len(keep)
    points = LayerPoints(source, **VIEW, chosen=chosen)
    assert np.concatenate(list(points)).tobytes() == everything[keep].tobytes()  # NaN where it was
    assert points.count() == keep.sum()


def test_points_of_chosen_windows_are_written() -> None:
    source = LayersInMemory(made_up_layers(SHAPE, MAX_LAYERS))
    (chosen,) = LayerPoints(source, **VIEW, windows=[1])
    assert chosen.tobytes() == list(LayerPoints(source, **VIEW))[1].tobytes()
    assert set(chosen["window"].tolist()) == {1}


def test_unknown_probabilities_do_not_pass_a_limit() -> None:
    layers = made_up_layers(SHAPE, MAX_LAYERS)
    layers.probability[...] = np.nan
    assert LayerPoints(LayersInMemory(layers), **VIEW).count() == layers.n_modes.sum()
    assert LayerPoints(LayersInMemory(layers), **VIEW, chosen=PointFilter(min_probability=0.0)).count() == 0


def with_light() -> LayersInMemory:
    layers = made_up_layers(SHAPE, MAX_LAYERS)
    return LayersInMemory(replace(layers, amplitude=(100.0 * layers.weight).astype(np.float32)))


def test_further_fields_are_those_of_the_layer_or_its_pixel() -> None:
    source = with_light()
    names = [spec.name for spec in source.layers.fields]
    further = fields_of_names(["n_samples", "amplitude", "probability", "invalid_share"], names)
    assert [spec.name for spec in further] == ["n_samples", "invalid_share", "amplitude"]
    points = LayerPoints(source, **VIEW, further=further, intensity=True)
    plain = np.concatenate(list(LayerPoints(source, **VIEW)))
    found = np.concatenate(list(points))
    assert found.dtype.names == (*(plain.dtype.names or ()), "n_samples", "invalid_share", "amplitude", "intensity")
    for name in plain.dtype.names or ():
        np.testing.assert_array_equal(found[name], plain[name])
    assert (found["n_samples"] == 20).all()
    assert (found["invalid_share"] == 0).all()
    np.testing.assert_array_equal(found["amplitude"], (100.0 * plain["weight"]).astype(np.float32))
    np.testing.assert_array_equal(found["intensity"], found["amplitude"])
    without = LayerPoints(source, **VIEW, further=further[:2], intensity=True)
    assert "intensity" not in {spec.name for spec in without.fields}


def test_all_fields_are_those_of_the_file_and_others_are_refused() -> None:
    names = [spec.name for spec in with_light().layers.fields]
    everything = {spec.name for spec in fields_of_names(["all"], names)}
    assert {"n_samples", "invalid_share", "amplitude", "n_iter"} <= everything
    assert "mixing" not in everything
    assert "range" not in everything
    with pytest.raises(ValueError, match="unknown field 'amplitud'; choose from n_modes"):
        fields_of_names(["amplitud"], names)
    with pytest.raises(ValueError, match="the layers have no mixing; they have"):
        fields_of_names(["mixing"], names)
