"""What each effect says of a pixel's distribution, against samples: probability integral transforms are uniform."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy import stats
from support.effect_bench import Bench, Recorded, effect
from support.transform import pit

from tofmix.simulation.distribution import Prediction
from tofmix.simulation.effects import EFFECTS, Effect, PixelMap
from tofmix.simulation.exposure import predict

FRAMES = 400
ALPHA = 1e-3
TIME_S = 30.0  # later than any time constant below
PATTERN = np.random.default_rng(1).normal(0, 40, (9, 11)).astype(np.float32)
WIDER = np.random.default_rng(3).uniform(0.5, 3, (9, 11)).astype(np.float32)
PARTLY = np.clip(np.random.default_rng(4).uniform(-0.3, 1.3, (9, 11)), 0, 1).astype(np.float32)
STUCK = np.where(np.random.default_rng(2).random((9, 11)) < 0.2, 2345.0, np.nan).astype(np.float32)

CASES: list[dict[str, Any]] = [
    {},
    *({"kind": "range_offset", "offset_mm": x} for x in (0, 30, -300)),
    *({"kind": "surface_pose", "surface": "middle", "shift_mm": x} for x in (0, 60, -400)),
    *({"kind": "surface_offset", "surface": "middle", "offset_mm": x} for x in (0, 35, -300)),
    *({"kind": "wiggling", "amplitude_mm": x, "phase_rad": 0.3} for x in (0, 12, 60)),
    {"kind": "wiggling", "amplitude_mm": 12, "phase_rad": 0.3, "harmonics": ((8.0, 5.0, 1.9), (12.0, 3.0, -1.0))},
    *({"kind": "tap_mismatch", "amplitude_1_mm": x, "amplitude_2_mm": 2 * x, "phase_2_rad": 1} for x in (0, 6, 30)),
    *({"kind": "amplitude_walk", "scale_mm": x, "reference_amplitude": 100} for x in (0, 10, -40)),
    {"kind": "amplitude_walk", "scale_mm": -40, "reference_amplitude": 100, "saturation_amplitude": 60},
    *({"kind": "temperature_drift", "amplitude_mm": x, "time_constant_s": 1e-3} for x in (0, 20, -90)),
    *({"kind": "fixed_pattern", "pixel_sigma_mm": x, "column_sigma_mm": x / 2, "row_sigma_mm": x} for x in (0, 9, 40)),
    {"kind": "fixed_pattern", "map": PixelMap("", PATTERN)},
    *({"kind": "smooth_pattern", "radial_4_mm": x, "across_mm": -x / 2} for x in (0, 20, 200)),
    *({"kind": "scattering", "share": x} for x in (0, 0.03, 0.3)),
    *({"kind": "internal_reflection", "amplitude": x, "range_mm": 20} for x in (0, 3, 20)),
    *({"kind": "near_return", "share": x, "range_mm": 25, "sigma_mm": 5} for x in (0, 0.06, 0.4)),
    *({"kind": "multipath", "surface": "middle", "share": x, "extra_path_mm": 1500} for x in (0, 0.1, 0.5)),
    {"kind": "multipath", "surface": "far", "share": 0.9, "from_": "near"},
    *({"kind": "phase_wrapping", "unambiguous_range_mm": x} for x in (1e6, 3700, 1000)),
    *({"kind": "flying_pixels", "probability": x} for x in (0, 0.3, 1)),
    *({"kind": "excess_noise", "factor": x} for x in (1, 1.2, 3)),
    {"kind": "excess_noise", "factor": 2, "surface": "middle"},
    {"kind": "excess_noise", "factor": 1.5, "map": PixelMap("", WIDER)},
    {"kind": "excess_noise", "factor": 1.2, "angle_exponent": 8},
    *({"kind": "vignetting", "corner_factor": x} for x in (1, 1.5, 4)),
    *({"kind": "outliers", "probability": x} for x in (0, 0.05, 0.5)),
    *({"kind": "stuck_pixels", "share": x, "value_mm": 2000} for x in (0, 0.1, 1)),
    {"kind": "stuck_pixels", "map": PixelMap("", STUCK)},
    *({"kind": "dropout", "probability": x, "threshold": 300 * x, "threshold_noise": 10} for x in (0, 0.1, 0.5)),
    *({"kind": "interference", "probability": 1, "sigma_mm": x} for x in (0, 20, 200)),
    {"kind": "interference", "probability": 1, "sigma_mm": 150, "map": PixelMap("", PARTLY)},
    *({"kind": "saturation", "full_well_amplitude": x} for x in (1e9, 80, 36)),
    *({"kind": "quantisation", "step_mm": x} for x in (0, 7.3, 100)),
    *({"kind": "pixel_crosstalk", "share": x} for x in (0, 0.01, 0.03)),
]


def effects(*tables: dict[str, Any]) -> list[Effect]:
    return [effect(table["kind"], **{k: v for k, v in table.items() if k != "kind"}) for table in tables]


def agrees(recorded: Recorded, prediction: Prediction) -> None:
    """Transforms of all samples are uniform, in every pixel and together; so is the invalid share."""
    u = pit(prediction, recorded.stored, np.random.default_rng(5))
    assert not np.isnan(u[recorded.stored > 0]).any()
    p = [stats.kstest(x, "uniform").pvalue for x in (c[~np.isnan(c)] for c in u.T) if x.size > 30]
    if p:
        assert min(p) > ALPHA / len(p)
        assert stats.kstest(u[~np.isnan(u)], "uniform").pvalue > ALPHA
    lost = (recorded.stored == 0).sum(axis=0)
    share = np.where(np.isnan(prediction.stuck_mm), prediction.invalid, 0.0)
    chance = [stats.binomtest(int(k), FRAMES, min(float(q), 1.0)).pvalue for k, q in zip(lost, share, strict=True)]
    assert min(chance) > ALPHA / len(chance)


def test_every_kind_is_among_the_cases() -> None:
    elsewhere = {
        "motion",
        "temporal_correlation",
    }  # no draws of one distribution: other tests have their laws
    assert {case["kind"] for case in CASES if case} | elsewhere == set(EFFECTS), (
        "add the kind to CASES in tests/simulation/effects/test_prediction.py; if its samples change from frame to"
        " frame, add it to `elsewhere` in this test, and test its law in test_bias.py, test_noise.py or the like"
    )


def cases() -> Iterator[Any]:
    """All cases; the quick tests have one magnitude of each kind, the second, and the maps."""
    before: Counter[str] = Counter()
    for case in CASES:
        kind = case.get("kind", "none")
        quick = before[kind] == 1 or "map" in case or not case
        before[kind] += 1
        name = " ".join(map(str, case.values())) or "none"
        yield pytest.param(case, marks=() if quick else pytest.mark.slow, id=name)


@pytest.mark.parametrize("case", list(cases()))
def test_samples_follow_the_prediction(bench: Bench, case: dict[str, Any]) -> None:
    recorded = bench.boards(*effects(*([case] if case else [])), frames=FRAMES)
    prediction = predict(recorded.model, recorded.truth, time_s=TIME_S)
    total = prediction.weight.sum(axis=0) + prediction.invalid + prediction.outlier
    np.testing.assert_allclose(total, 1)
    if case and case["kind"] == "temperature_drift":
        recorded.stored[0] = recorded.stored[1]  # frame 0 is still cold
    agrees(recorded, prediction)


def test_samples_follow_the_prediction_of_many_effects(bench: Bench) -> None:
    """Levels in order, read-out effects in file order."""
    tables = (
        {"kind": "quantisation", "step_mm": 9.0},
        {"kind": "dropout", "probability": 0.1, "threshold": 20.0, "threshold_noise": 5.0},
        {"kind": "stuck_pixels", "share": 0.1, "value_mm": 2001.0},
        {"kind": "outliers", "probability": 0.1},
        {"kind": "range_offset", "offset_mm": -120.0},
        {"kind": "phase_wrapping", "unambiguous_range_mm": 4100.0},
        {"kind": "saturation", "full_well_amplitude": 160.0},
        {"kind": "wiggling", "amplitude_mm": 40.0, "phase_rad": 1.0},
        {"kind": "interference", "probability": 1.0, "sigma_mm": 40.0},
        {"kind": "excess_noise", "factor": 1.5},
        {"kind": "flying_pixels", "probability": 0.3},
        {"kind": "multipath", "surface": "far", "share": 0.2, "extra_path_mm": 700.0},
        {"kind": "scattering", "share": 0.05},
        {"kind": "vignetting", "corner_factor": 1.5},
        {"kind": "surface_pose", "surface": "near", "shift_mm": 100.0},
    )
    recorded = bench.boards(*effects(*tables), frames=FRAMES)
    agrees(recorded, predict(recorded.model, recorded.truth))


def test_interference_is_a_mixture_over_the_frames(bench: Bench) -> None:
    (one,) = effects({"kind": "interference", "probability": 0.4, "sigma_mm": 200.0, "burst_frames": 1.5})
    recorded = bench.boards(one, frames=3000)
    u = pit(predict(recorded.model, recorded.truth), recorded.stored, np.random.default_rng(5))
    # frames of a burst share their state: the bound allows for the spread of the share of disturbed frames
    assert stats.kstest(u.ravel(), "uniform").statistic < 4 * 0.1 * (0.24 / 3000) ** 0.5 + 2 / u.size**0.5


def test_beat_is_a_mixture_over_the_overlaps(bench: Bench) -> None:
    """Four overlaps stand for all, so that the shape is right to a percent."""
    (one,) = effects({"kind": "interference", "probability": 0.6, "sigma_mm": 300.0, "period_frames": 41.3})
    recorded = bench.boards(one, frames=2000)
    u = pit(predict(recorded.model, recorded.truth), recorded.stored, np.random.default_rng(5))
    assert stats.kstest(u.ravel(), "uniform").statistic < 0.01 + 2 / u.size**0.5


def test_motion_is_predicted_at_any_time(bench: Bench) -> None:
    (one,) = effects({"kind": "motion", "surface": "middle", "velocity_mm_s": -400.0})
    recorded = bench.boards(one, frames=40)
    u = [
        pit(predict(recorded.model, time_s=frame / 10), recorded.stored[[frame]], np.random.default_rng(frame))
        for frame in range(0, 40, 4)
    ]
    assert stats.kstest(np.ravel(u), "uniform").pvalue > ALPHA


def test_memory_changes_no_marginal(bench: Bench) -> None:
    (one,) = effects({"kind": "temporal_correlation", "coefficient": 0.6})
    plain, other = (predict(bench.boards(*e, frames=1).model) for e in ((), (one,)))
    for name in ("weight", "range_mm", "sigma_mm", "invalid"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))


@pytest.mark.slow
def test_crosstalk_predicts_mean_variance_and_shape(bench: Bench) -> None:
    """Where neighbours see several surfaces too: what the most uncertain two see is told apart."""
    (one,) = effects({"kind": "pixel_crosstalk", "share": 0.04})
    recorded = bench.boards(one, frames=4000, outlier_probability=0.0)
    prediction = predict(recorded.model, recorded.truth)
    single = (recorded.truth.n_modes.ravel() == 1) & (recorded.truth.weight_no_return.ravel() == 0)
    found = recorded.range_mm[:, single]
    weight, each = prediction.weight[:, single], prediction.range_mm[:, single]
    mean = (weight * each).sum(axis=0)
    sigma = np.sqrt((weight * (prediction.sigma_mm[:, single] ** 2 + (each - mean) ** 2)).sum(axis=0) + 1 / 12)
    shift = mean - recorded.true_mm[single]
    assert abs(shift).max() > 30
    z = (found.mean(axis=0) - mean) / (sigma / 4000**0.5)
    assert abs(z).max() < 4.5
    ratio = found.var(axis=0) / sigma**2
    assert abs(ratio - 1).max() < 5 * (2 / 4000) ** 0.5
    u = pit(prediction, recorded.stored, np.random.default_rng(7))[:, single]
    several = (weight > 0).sum(axis=0) > 1
    assert several.any()
    assert min(stats.kstest(column, "uniform").pvalue for column in u[:, several].T) > ALPHA / several.sum()


def test_probabilities_of_stored_values_sum_to_one(bench: Bench) -> None:
    tables = (
        {"kind": "quantisation", "step_mm": 3.7},
        {"kind": "dropout", "probability": 0.2},
        {"kind": "stuck_pixels", "share": 0.2, "value_mm": 5000.0},
        {"kind": "phase_wrapping", "unambiguous_range_mm": 3000.0},
    )
    model = bench.boards(*effects(*tables), frames=1).model
    prediction = predict(model)
    values = np.broadcast_to(np.arange(12_000)[:, np.newaxis], (12_000, 99))
    np.testing.assert_allclose(prediction.probability(values).sum(axis=0), 1, atol=1e-9)
    assert (prediction.probability(np.full((1, 99), 2)) == 0).all()  # 2 mm is no multiple of 3.7 mm
