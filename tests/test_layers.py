"""Layers, their flags and rules, layers as points, and what lost samples say."""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import binom
from support.made_up import LayersInMemory, made_up_layers

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.flags import STATUS_MEANINGS, Status, mixing_name, status_name
from tofmix.invariants import layer_rules
from tofmix.layers import LAYER_FIELDS, OPTIONAL_FIELDS, Layers
from tofmix.lost_samples import Losses, learn_losses
from tofmix.optics.equiangular import Equiangular
from tofmix.points import POINT_DTYPE, LayerPoints, fields_of_names
from tofmix.sensor import Sensor


def test_layers_and_statuses_are_listed_once() -> None:
    assert [f.name for f in fields(Layers)] == [spec.name for spec in (*LAYER_FIELDS, *OPTIONAL_FIELDS)]
    assert len({spec.name for spec in LAYER_FIELDS}) == len(LAYER_FIELDS)
    names = ["ok", "too_few_samples", "not_converged", "no_surface", "degenerate"]
    assert [status_name(value) for value in range(5)] == names
    assert set(STATUS_MEANINGS) == set(Status)
    assert (status_name(9), mixing_name(9)) == ("status_9", "mixing_9")


def test_empty_layers_have_zero_counts_and_nan_values() -> None:
    layers = Layers.empty((2, 3), 4)
    assert layers.shape == (2, 3)
    assert layers.max_layers == 4
    for spec in LAYER_FIELDS:
        values = getattr(layers, spec.name)
        assert values.shape == ((2, 3, 4) if spec.per_layer else (2, 3))
        assert values.dtype == np.dtype(spec.dtype)
        assert np.isnan(values).all() if spec.dtype == "f4" else not values.any()


FRAMES = np.array([20, 20])
PLACE = (1, 2, 3)


def broken(layers: Layers, circle_mm: float | None = None) -> set[tuple[str, str]]:
    return {(r.name, r.text) for r in layer_rules(layers, FRAMES, circle_mm=circle_mm) if r.broken.any()}


@pytest.fixture
def layers() -> Layers:
    made = made_up_layers((2, 5, 6), 4)
    made.n_modes[PLACE] = 2
    made.status[PLACE] = Status.OK
    for name, values in (
        ("range", [1000, 2000]),
        ("sigma", [5, 5]),
        ("weight", [0.5, 0.4]),
        ("range_stderr", [1, 1]),
        ("weight_stderr", [0.1, 0.1]),
        ("probability", [1, 0.9]),
    ):
        getattr(made, name)[PLACE] = [*values, np.nan, np.nan]
    made.weight_outlier[PLACE], made.weight_no_return[PLACE] = 0.05, 0.05
    return made


def test_consistent_layers_break_no_rule(layers: Layers) -> None:
    assert broken(layers, 7500.0) == set()


@pytest.mark.parametrize("sigma", list(SigmaMode))
@pytest.mark.parametrize("circle", [None, 6000.0])
def test_estimated_layers_pass_all_invariants(
    sensor: Sensor, rng: np.random.Generator, sigma: SigmaMode, circle: float | None
) -> None:
    samples = rng.normal(2000.0, 30.0, (20, 2, 40, 3)) + np.where(rng.random((20, 2, 40, 3)) < 0.4, 700, 0)
    samples[:, :, :5] = np.nan
    samples[2:, :, 5:8] = np.nan
    samples[:, :, 8:12] = rng.uniform(300, 6000, (20, 2, 4, 3))
    options = EstimateOptions(sigma=sigma, unambiguous_range_mm=circle, max_iter=5)
    found = layer_pixels(samples.reshape(20, -1, 3), sensor, options).reshaped((2, 40, 3))
    assert {int(s) for s in np.unique(found.status)} >= {0, 1}
    assert broken(found, circle) == set()


@pytest.mark.parametrize(
    ("name", "index", "value", "rule"),
    [
        ("n_modes", (), 5, "at most 4"),
        ("range", (1,), np.nan, "finite for the first"),
        ("range", (2,), 3000.0, "finite for the first"),
        ("sigma", (0,), np.inf, "finite for the first"),
        ("weight", (3,), 0.0, "finite for the first"),
        ("probability", (2,), 1.0, "never infinite"),
        ("range_stderr", (0,), np.inf, "never infinite"),
        ("range", (0,), 2500.0, "near to far"),
        ("range", (1,), 7600.0, "within [0, 7500) mm"),
        ("sigma", (1,), 0.0, "above 0"),
        ("weight", (1,), -0.1, "between 0 and 1"),
        ("range_stderr", (0,), -1.0, "above 0"),
        ("weight_stderr", (0,), -1.0, "not below 0"),
        ("probability", (0,), 1.01, "between 0 and 1"),
        ("weight_no_return", (), np.nan, "between 0 and 1 where"),
        ("weight_outlier", (), 1.2, "between 0 and 1 where"),
        ("weight", (1,), 0.41, "sums to 1"),
        ("status", (), 77, "one of 0, 1"),
        ("status", (), 3, "have no layer"),
        ("n_modes", (), 0, "have a layer"),
        ("range_stderr", (0,), np.nan, "ok has a standard error"),
        ("status", (), 1, "0 where nothing was fitted"),
        ("n_samples", (), 21, "at most the frames"),
        ("invalid_share", (), np.nan, "between 0 and 1 in"),
        ("invalid_share", (), 0.5, "without one of the n_samples"),
        ("log_likelihood", (), np.nan, "finite where a pixel was fitted"),
    ],
)
def test_each_breach_is_noticed_where_it_is(
    layers: Layers, name: str, index: tuple[int, ...], value: float, rule: str
) -> None:
    layers.n_peaks[PLACE] = 2
    getattr(layers, name)[(*PLACE, *index)] = value
    found = [r for r in layer_rules(layers, FRAMES, circle_mm=7500.0) if r.broken.any()]
    assert any(rule in r.text for r in found), [r.text for r in found]
    for one in found:
        assert np.argwhere(one.broken).tolist() == [list(PLACE)]


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


def test_points_of_chosen_windows_are_written() -> None:
    source = LayersInMemory(made_up_layers(SHAPE, MAX_LAYERS))
    (chosen,) = LayerPoints(source, **VIEW, windows=[1])
    assert chosen.tobytes() == list(LayerPoints(source, **VIEW))[1].tobytes()
    assert set(chosen["window"].tolist()) == {1}


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


SHAPE_LOST_SAMPLES = (30, 40)
BOX = (slice(5, 20), slice(10, 25))


def lost_shares(share: float, in_box: float, frames: int, seed: int = 1) -> NDArray[np.float32]:
    """Share of lost frames of each pixel: by chance, with another share in a box."""
    shares = np.full(SHAPE_LOST_SAMPLES, share)
    shares[BOX] = in_box
    return np.asarray(
        (np.random.default_rng(seed).random((frames, *SHAPE_LOST_SAMPLES)) < shares).mean(axis=0), dtype=np.float32
    )


def outside(values: NDArray[np.float64]) -> NDArray[np.float64]:
    box = np.zeros(SHAPE_LOST_SAMPLES, bool)
    box[BOX] = True
    return values[~box]


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6])
@pytest.mark.parametrize("frames", [10, 25, 100])
def test_loss_of_all_pixels_is_learnt_and_leaves_layers_sure(share: float, frames: int) -> None:
    lost = lost_shares(share, share, frames)
    losses = learn_losses(lost, frames)
    assert losses.common == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / (frames * lost.size)))
    assert losses.by_chance > 0.98
    assert np.quantile(losses.certainty(lost), 0.01) > 0.94
    assert losses.lost_share(lost).mean() < 0.005


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_pixels_of_a_dark_box_are_unsure_and_others_are_not(share: float) -> None:
    lost = lost_shares(share, 0.95, 100)
    losses = learn_losses(lost, 100)
    assert losses.common == pytest.approx(share, abs=0.02)
    assert losses.certainty(lost)[BOX].max() < 0.3
    assert losses.lost_share(lost)[BOX].min() > 0.7
    assert np.quantile(outside(losses.certainty(lost)), 0.01) > 0.999
    assert losses.is_at_limit(lost)[BOX].all()
    assert outside(losses.is_at_limit(lost).astype(float)).max() == 0


def test_certainty_is_the_integral_over_the_valid_share() -> None:
    losses = Losses(frames=20, common=0.2, by_chance=0.7)
    for valid in range(21):

        def likelihood(q: float, valid: int = valid) -> float:
            return float(binom.pmf(valid, 20, q))

        own = 0.3 * quad(likelihood, 0.0, 0.8)[0] / 0.8
        limit = 0.3 * quad(likelihood, 0.0, 0.4)[0] / 0.8
        chance = 0.7 * float(binom.pmf(valid, 20, 0.8))
        back = min(1.0, valid / 20 / 0.8)
        expected = 1.0 - limit / (own + chance) * (1.0 - back)
        assert losses.certainty([1.0 - valid / 20])[0] == pytest.approx(expected, rel=1e-6)


def test_probabilities_without_loss_keep_their_bits() -> None:
    probability = np.random.default_rng(2).random((*SHAPE_LOST_SAMPLES, 3)).astype(np.float32)
    lost = np.zeros(SHAPE_LOST_SAMPLES, np.float32)
    assert learn_losses(lost, 30).weighed(probability, lost).tobytes() == probability.tobytes()
    lost[3, 4] = 0.9
    weighed = learn_losses(lost, 30).weighed(probability, lost)
    same = np.ones(SHAPE_LOST_SAMPLES, bool)
    same[3, 4] = False
    assert weighed[same].tobytes() == probability[same].tobytes()
    assert (weighed[3, 4] < 0.2 * probability[3, 4]).all()


def test_pixels_that_are_always_masked_do_not_make_others_unsure() -> None:
    lost = lost_shares(0.1, 1.0, 50)
    losses = learn_losses(lost, 50)
    assert losses.common == pytest.approx(0.1, abs=0.01)
    assert np.quantile(outside(losses.certainty(lost)), 0.001) > 0.999
    nothing = np.ones(SHAPE_LOST_SAMPLES, np.float32)
    assert learn_losses(nothing, 50).is_at_limit(nothing).all()
