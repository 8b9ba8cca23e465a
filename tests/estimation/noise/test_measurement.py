"""The measured curve against the one that samples were drawn with, and its parts against slow references."""

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drawing import draw
from support.sizes import sized

from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.noise.curve import CurveSettings, NoiseSettings, locate, single_share
from tofmix.estimation.noise.measurement import MeasuredNoise, disagreement, measure_noise
from tofmix.estimation.noise.series import (
    CLIP_SIGMAS,
    LEAST_KEPT,
    LEAST_SAMPLES,
    TREND_DEGREES,
    Series,
    _limits_of_shape,
    drawn_limits,
    memory_correction,
    quantisation_step,
    read_series,
    series_statistics,
    shaped_as_one,
)
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

BARE = Sensor(name="no curve", range_min_mm=300.0, range_max_mm=6000.0)


def pixels_at(
    rng: np.random.Generator, sensor: Sensor, range_mm: NDArray[np.float64], *, multi: float, n: int = 100
) -> NDArray[np.float64]:
    """Samples (n, pixel) of pixels at these ranges, a share of which see a second surface up to 8 sigma behind."""
    assert sensor.noise is not None
    behind = range_mm + rng.uniform(0.5, 8.0, range_mm.size) * sensor.noise.sigma(range_mm)
    share = np.where(rng.random(range_mm.size) < multi, rng.uniform(0.1, 0.9, range_mm.size), 1.0)
    mean = np.where(rng.random((n, range_mm.size)) < share, range_mm, behind)
    return np.asarray(mean + rng.standard_normal(mean.shape) * sensor.noise.sigma(mean))


def recording(samples: NDArray[np.floating], rows: int = 40) -> ArrayRecording:
    """Whole millimetres, and a camera without a curve."""
    return ArrayRecording(np.rint(samples).reshape(len(samples), rows, -1), BARE)


def series(samples: NDArray[np.float32]) -> Series:
    """One series a pixel, without amplitudes."""
    return Series(samples, np.arange(len(samples)), np.full(len(samples), np.nan))


def worst(measured: MeasuredNoise, sensor: Sensor, seen_mm: NDArray[np.float64]) -> float:
    """Largest relative error at the middle of each 200 mm that 200 pixels see."""
    assert sensor.noise is not None
    cell = np.floor(seen_mm / 200.0)
    values, counts = np.unique(cell, return_counts=True)
    at = np.array([np.median(seen_mm[cell == value]) for value in values[counts >= 200]])
    assert at.size
    return float(np.abs(measured.curve.sigma(at) / sensor.noise.sigma(at) - 1.0).max())


@pytest.mark.parametrize("multi", [pytest.param(0.0, marks=pytest.mark.slow), 0.4])
@pytest.mark.parametrize("scene", ["floor", pytest.param("boards", marks=pytest.mark.slow)])
def test_the_curve_is_right_to_5_per_cent(rng: np.random.Generator, sensor: Sensor, multi: float, scene: str) -> None:
    seen = rng.uniform(600.0, 5000.0, 6000)
    if scene == "boards":
        seen = rng.choice([700.0, 1700.0, 3600.0], 6000) * (1.0 + 0.04 * rng.random(6000))
    measured = measure_noise(recording(pixels_at(rng, sensor, seen, multi=multi)))
    assert worst(measured, sensor, seen) < 0.05
    assert measured.step_mm == pytest.approx(1.0)


@pytest.mark.slow
def test_200_pixels_are_enough(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    errors = []
    for _ in range(sized(5, 2)):
        seen = rng.uniform(1480.0, 1520.0, 200)
        measured = measure_noise(recording(pixels_at(rng, sensor, seen, multi=0.4)))
        errors.append(float(measured.curve.sigma(1500.0) / sensor.noise.sigma(1500.0)) - 1.0)
    assert np.abs(errors).max() < 0.05


@pytest.mark.slow
def test_drift_pattern_outliers_stuck_and_invalid_samples_leave_sigma(rng: np.random.Generator, sensor: Sensor) -> None:
    seen = rng.uniform(600.0, 5000.0, 6000)
    samples = pixels_at(rng, sensor, seen, multi=0.3)
    samples += 40.0 * (1.0 - np.exp(-np.arange(100) / 40.0))[:, None] + rng.normal(0.0, 20.0, 6000)
    wild = rng.random(samples.shape) < 0.01
    samples[wild] = rng.uniform(300.0, 6000.0, wild.sum())
    samples[:, :300] = 1234.0
    samples[rng.random(samples.shape) < 0.1] = np.nan
    measured = measure_noise(recording(samples))
    assert worst(measured, sensor, seen[300:]) < 0.05
    assert measured.outlier_probability == pytest.approx(0.01, rel=0.15)


@pytest.mark.slow
def test_sigma_of_noise_with_a_memory_is_measured(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    seen = rng.uniform(1000.0, 3000.0, 3000)
    noise = rng.standard_normal((100, 3000))
    for k in range(1, 100):
        noise[k] = 0.5 * noise[k - 1] + np.sqrt(0.75) * noise[k]
    measured = measure_noise(recording(seen + noise * sensor.noise.sigma(seen)))
    assert worst(measured, sensor, seen) < 0.05


@pytest.mark.slow
def test_samples_without_a_return_give_sigma_at_range_max(rng: np.random.Generator, sensor: Sensor) -> None:
    seen = np.concatenate([rng.uniform(1000.0, 1100.0, 1600), np.full(400, 6000.0)])
    samples = pixels_at(rng, sensor, seen, multi=0.0)
    measured = measure_noise(recording(samples))
    assert measured.curve.sigma(6000.0) == pytest.approx(200.0, rel=0.05)
    samples[:, 1600:] = 6000.0 + rng.integers(0, 2, (100, 400))  # a constant is not noise
    assert measure_noise(recording(samples)).curve.range_mm[-1] < 1300.0


@pytest.mark.parametrize(
    ("sigma", "step", "margin"),
    [
        (5.0, 10.0, 0.05),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((3.0, 10.0, 0.15), (1.0, 1.0, 0.05))),
    ],
)
def test_coarse_steps_are_taken_out(rng: np.random.Generator, sigma: float, step: float, margin: float) -> None:
    seen = rng.uniform(1000.0, 1500.0, 2000)
    samples = np.rint((seen + sigma * rng.standard_normal((100, 2000))) / step) * step
    measured = measure_noise(recording(samples))
    assert measured.step_mm == pytest.approx(step)
    assert measured.curve.sigma(1250.0) == pytest.approx(sigma, rel=margin)


def test_noise_below_a_step_is_a_bound_not_zero() -> None:
    measured = measure_noise(recording(np.tile(np.repeat([1000.0, 1001.0, 1002.0, 1003.0], 10), (20, 1))))
    assert measured.curve.sigma_mm == pytest.approx(1.0 / np.sqrt(12.0), rel=0.05)


@pytest.mark.parametrize("p", [0.0, pytest.param(0.001, marks=pytest.mark.slow), 0.03])
def test_outliers_are_counted(rng: np.random.Generator, sensor: Sensor, p: float) -> None:
    samples = draw(rng, sensor, ranges_mm=[2000.0], shares=[1.0], n=100, pixels=4000, outliers=p)
    measured = measure_noise(recording(samples))
    assert 0 < measured.outlier_probability < 1
    # The margin is four standard deviations of the count.
    assert measured.outlier_probability == pytest.approx(p, abs=4 * np.sqrt(p * 4e5 + 1) / 4e5 + 0.05 * p)


@pytest.mark.slow
def test_weak_surfaces_are_no_outliers(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[2000.0, 4000.0], shares=[0.9, 0.1], n=100, pixels=2000)
    clean = draw(rng, sensor, ranges_mm=[2000.0], shares=[1.0], n=100, pixels=2000)
    measured = measure_noise(recording(np.hstack([samples, clean])))
    assert measured.outlier_probability < 2e-4  # 10 % of half the samples would be 0.05


def one_by_one(samples: NDArray[np.float32], step: float) -> NDArray[np.float64]:
    """Statistics (7, series), each series alone: samples far from its polynomial are set aside, four times."""
    out = np.zeros((7, len(samples)))
    for k, row in enumerate(samples.astype(np.float64)):
        known = np.isfinite(row)
        n, time = int(known.sum()), (2.0 * np.arange(len(row)) / len(row) - 1.0)[known]
        out[0, k] = n
        if n < LEAST_SAMPLES:
            continue
        degree = next(degree for least, degree in TREND_DEGREES if n >= least)
        powers = np.vander(time, degree + 1)
        centre = np.median(row[known])
        values, trend, keep = row[known] - centre, np.zeros(n), np.ones(n, dtype=bool)
        for _ in range(4):
            rest = values - trend
            away = np.abs(rest - np.median(rest))
            keep = away <= max(CLIP_SIGMAS * MAD_TO_SIGMA * np.median(away) * (1.0 + 5.0 / n), 2.0 * step)
            trend = powers @ np.linalg.lstsq(powers[keep], values[keep], rcond=None)[0]
        rest, left = (values - trend)[keep], int(keep.sum())
        if left < max(degree + 3, LEAST_KEPT * n):
            continue
        square = rest @ rest
        out[1:4, k] = left, centre + np.median(values[keep]), square / (left - degree - 1)
        if square > 1e-12:
            both = keep[1:] & keep[:-1]
            lagged = ((values - trend)[1:] * (values - trend)[:-1])[both].sum()
            shape = np.mean(rest**3) / np.mean(rest**2) ** 1.5, np.mean(rest**4) / np.mean(rest**2) ** 2
            out[4:, k] = *shape, lagged / square
    return out


def test_statistics_of_all_series_together_equal_those_of_each_alone(rng: np.random.Generator) -> None:
    samples = rng.normal(2000.0, 20.0, (40, 60)).astype(np.float32)
    samples[:20] += 3.0 * np.linspace(-9.0, 9.0, 60, dtype=np.float32) ** 2  # a drift
    samples[rng.random(samples.shape) < 0.1] = np.nan
    samples[rng.random(samples.shape) < 0.03] += 500.0
    samples[1, LEAST_SAMPLES:] = np.nan
    samples[2, LEAST_SAMPLES - 1 :] = np.inf
    samples[3] = 1234.0
    samples[4, ::2] += 3000.0  # two surfaces: too few are near one trend, or all are
    samples[5, 20:] = np.nan
    samples[6, 30:] = np.nan
    samples[7, 9:] = rng.choice([1000.0, 3000.0, 5000.0], 51)
    for step in (0.0, 30.0):
        found = series_statistics(series(samples), step)
        for name, expected in zip(found._fields, one_by_one(samples, step), strict=True):
            np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-6, atol=1e-6, err_msg=name)
        assert found.kept[2] == 0


def test_usual_limits_of_shape_are_those_that_are_drawn() -> None:
    for index in range(9):
        assert _limits_of_shape(index, 0.1) == pytest.approx(drawn_limits(index, 0.1), rel=1e-9)
    assert NoiseSettings().strictness == 0.1
    assert _limits_of_shape(0, 0.05)[0] > _limits_of_shape(0, 0.1)[0]


def test_statistics_equal_a_slow_reference(rng: np.random.Generator) -> None:
    samples = rng.normal(2000.0, 20.0, (30, 60)).astype(np.float32)
    samples[:, 5] = np.nan
    found = series_statistics(series(samples), 1.0)
    time = np.delete(2.0 * np.arange(60) / 60 - 1.0, 5)
    for k in range(30):
        values = np.delete(samples[k].astype(np.float64), 5)
        rest = values - np.polyval(np.polyfit(time, values, 4), time)
        assert found.kept[k] == 59
        assert found.variance[k] == pytest.approx(rest @ rest / 54, rel=1e-5)
        assert found.skewness[k] == pytest.approx(np.mean(rest**3) / np.mean(rest**2) ** 1.5, abs=1e-4)
        assert found.kurtosis[k] == pytest.approx(np.mean(rest**4) / np.mean(rest**2) ** 2, rel=1e-4)


@pytest.mark.parametrize("n", [10, 26, pytest.param(100, marks=pytest.mark.slow)])
def test_picking_by_shape_does_not_bias_the_variance(rng: np.random.Generator, n: int) -> None:
    samples = rng.normal(0.0, 10.0, (8000, n)).astype(np.float32)
    found = series_statistics(series(samples), 0.0)
    picked = shaped_as_one(found, 0.2)
    assert 0.5 < picked.mean() < 0.75
    # Standard error 10 / sqrt(2 * 7 * 4600) = 0.04 at most, over 10.
    assert np.sqrt(found.variance[picked].mean()) == pytest.approx(10.0, rel=0.015)


def test_verdict_by_shape_of_a_series_does_not_depend_on_the_others(rng: np.random.Generator) -> None:
    samples = rng.normal(0.0, 10.0, (60, 120)).astype(np.float32)
    for k, valid in enumerate(rng.integers(5, 120, 60)):
        samples[k, valid:] = np.nan
    together = shaped_as_one(series_statistics(series(samples), 0.0), 0.2)
    alone = [shaped_as_one(series_statistics(series(samples[k : k + 1]), 0.0), 0.2)[0] for k in range(60)]
    assert together.tolist() == alone
    assert 0.2 < together.mean() < 0.8


def test_two_overlapping_surfaces_fail_by_shape(rng: np.random.Generator) -> None:
    far = rng.random((2000, 100)) < 0.5
    samples = (10.0 * rng.standard_normal(far.shape) + 30.0 * far).astype(np.float32)
    assert shaped_as_one(series_statistics(series(samples), 0.0), 0.2).mean() < 0.1


@pytest.mark.parametrize(
    "coefficient", [pytest.param(0.0, marks=pytest.mark.slow), 0.3, pytest.param(0.7, marks=pytest.mark.slow)]
)
def test_memory_is_corrected_as_simulated(rng: np.random.Generator, coefficient: float) -> None:
    noise = rng.standard_normal((4000, 100))
    for k in range(1, 100):
        noise[:, k] = coefficient * noise[:, k - 1] + np.sqrt(1.0 - coefficient**2) * noise[:, k]
    found = series_statistics(series((10.0 * noise).astype(np.float32)), 0.0)
    factor = memory_correction(float(np.median(found.memory)), 100)
    assert factor * found.variance.mean() == pytest.approx(100.0, rel=0.03)


@pytest.mark.parametrize("degrees", [95])
@pytest.mark.parametrize("factor", [1.12, 1.4, 3.0])
def test_minority_of_wider_series_leaves_sigma(rng: np.random.Generator, degrees: int, factor: float) -> None:
    log_sigma = 0.5 * np.log(rng.chisquare(degrees, 1000) / degrees)
    log_sigma[:400] += np.log(factor)
    # The hardest: 40 % wider by less than one series can tell.
    found = locate([log_sigma], degrees)
    assert abs(found.log_sigma[0]) < 0.05
    single = single_share(log_sigma - found.log_sigma[0], degrees, found.chances)
    assert single[400:].mean() > single[:400].mean()


def test_bins_share_their_estimate_of_wider_series(rng: np.random.Generator) -> None:
    def errors(together: bool) -> float:
        groups = []
        for _ in range(40):
            log_sigma = 0.5 * np.log(rng.chisquare(10, 100) / 10)
            log_sigma[:40] += 0.3 * rng.exponential(size=40)
            groups.append(log_sigma)
        if together:
            return float(locate(groups, 10).log_sigma.std())
        return float(np.std([locate([group], 10).log_sigma[0] for group in groups]))

    assert errors(together=True) < 0.9 * errors(together=False)


def test_step_of_stored_ranges_is_found(rng: np.random.Generator) -> None:
    values = rng.normal(2000.0, 50.0, 20_000)
    for step in (1.0, 2.5, 10.0):
        stored = np.rint(np.rint(values / step) * step).astype(np.float32)
        assert quantisation_step(stored) == pytest.approx(step, rel=0.02)
    assert quantisation_step(values.astype(np.float32)) < 0.1
    assert quantisation_step(np.full(10, 5.0, np.float32)) < 0.1


def test_series_are_the_samples_in_any_bands(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = rng.normal(1000.0, 20.0, (250, 7, 5)).astype(np.float32)

    class Banded(ArrayRecording):
        row_step = 3

    plain = read_series(ArrayRecording(samples, sensor))
    assert plain.samples.shape == (2 * 35, 100)
    np.testing.assert_array_equal(plain.samples[35 + 12], samples[150:, 2, 2])
    np.testing.assert_array_equal(plain.samples, read_series(Banded(samples, sensor)).samples)
    few = read_series(ArrayRecording(samples, sensor), most=20)
    assert few.pixel.tolist() == [c + 5 * r for r in (0, 2, 4, 6) for c in range(5)]


def test_measurement_ignores_the_curve_of_the_file(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1500.0], shares=[1.0], n=40, pixels=400)
    wrong = Sensor(name="wrong", range_min_mm=300.0, range_max_mm=6000.0, noise=NoiseCurve(np.ones(1), np.ones(1)))
    one, other = (measure_noise(ArrayRecording(samples.reshape(40, 20, 20), s)) for s in (BARE, wrong))
    np.testing.assert_array_equal(one.curve.sigma_mm, other.curve.sigma_mm)
    range_mm, ratio = disagreement(one, NoiseCurve(np.ones(1), np.full(1, 50.0)))
    assert range_mm == pytest.approx(1500.0, abs=30)
    assert ratio == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        ((9, 20, 20), "9 frames; at least 10"),
        ((30, 3, 3), "9 pixels with 10 valid samples"),
        ((30, 5, 5), "within 12 %"),
    ],
)
def test_too_few_samples_are_refused_with_the_required_number(
    rng: np.random.Generator, shape: tuple[int, int, int], reason: str
) -> None:
    seen = np.geomspace(400.0, 5900.0, shape[1] * shape[2]).reshape(shape[1:])
    with pytest.raises(ValueError, match=reason):
        measure_noise(ArrayRecording(seen + rng.normal(0.0, 5.0, shape), BARE))


def test_settings_bound_the_series_of_a_bin(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixels_at(rng, sensor, np.full(400, 1000.0), multi=0.0, n=20)
    assert measure_noise(recording(samples)).pixels.sum() > 0
    many = NoiseSettings(curve=CurveSettings(least_in_bin=401))
    with pytest.raises(ValueError, match="at least 401 are needed"):
        measure_noise(recording(samples), settings=many)
