"""Every rule holds for what the estimator gives, and each one notices its own breach."""

import numpy as np
import pytest
from support.made_up import made_up_layers

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.flags import Status
from tofmix.invariants import layer_rules
from tofmix.layers import Layers
from tofmix.sensor import Sensor

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
