"""EM under the learnt noise, also of samples on a step: its maximum, shares, held-out likelihood, and populations."""

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from scipy import integrate, optimize, stats
from scipy.optimize import minimize_scalar
from scipy.special import ndtr
from scipy.stats import norm
from support.learnt_pixels import KNOWN, LOW_MM, SIGMA_MM, TOP_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, Steps, beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt import components as names
from tofmix.estimation.learnt.acceleration import maximise, value_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    SIGMA,
    WEIGHT,
    Samples,
    add_surface,
    fill_cells,
    fill_times,
    new_fit,
    new_scratch,
    remove_surface,
    start_without_surface,
)
from tofmix.estimation.learnt.em import em_step
from tofmix.estimation.learnt.folds import SURPRISES, flat_thresholds, held_out_scores
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, Law, law_of
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.population import population_likelihoods, spread_beside_pairs
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.settings import EstimateOptions
from tofmix.noise_shape import DRIFTS, TAIL_DEGREES
from tofmix.sensor import NoiseCurve, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable

SPAN_MM = TOP_MM - LOW_MM


class Fitted(NamedTuple):
    """Numbers of a fit, as the objective has them."""

    means: FloatArray
    shares: FloatArray
    no_return: float
    background: float
    log_width: float = 0.0
    drifts: FloatArray = np.zeros((1, DRIFTS))


class Pixel:
    """One pixel's samples and the scratch to fit them in."""

    def __init__(self, samples: FloatArray, noise: PixelNoise) -> None:
        order = np.argsort(samples, kind="stable")
        self.data = Samples(samples[order], np.linspace(-1.0, 1.0, len(samples))[order])
        self.noise = noise
        self.law: Law = noise.laws()[0]
        self.beam: Beam = beam_of(camera_with(noise))
        self.scratch = new_scratch(4, len(samples))
        self.fit = new_fit(4)
        fill_times(self.data, self.scratch)
        fill_cells(self.data, self.beam, self.scratch)

    def begin(self, means: tuple[float, ...], *, background: float = 0.05, no_return: float = 0.0) -> int:
        """Equal shares at these places."""
        self.fit[:] = 0.0
        k = len(means)
        self.fit[MEAN, :k], self.fit[SIGMA, :k] = means, self.noise.curve.sigma_mm[0]
        self.fit[OWN, BACKGROUND], self.fit[WEIGHT, -1] = background, no_return
        self.fit[WEIGHT, :k] = (1.0 - background - no_return) / max(k, 1)
        return k

    def maximise(self, k: int, tol: float = 1e-9) -> int:
        return maximise(self.data, k, self.fit, self.law, self.beam, 4000, tol, self.scratch)

    def value(self, k: int) -> float:
        return value_of(self.data, k, self.fit, self.law, self.beam, self.scratch)

    def fitted(self, k: int) -> Fitted:
        return Fitted(
            self.fit[MEAN, :k].copy(),
            self.fit[WEIGHT, :k].copy(),
            float(self.fit[WEIGHT, -1]),
            float(self.fit[OWN, BACKGROUND]),
            float(self.fit[OWN, LOG_WIDTH]),
            self.fit[DRIFT : DRIFT + DRIFTS, :k].T.copy(),
        )


def written_out(samples: FloatArray, noise: PixelNoise, fitted: Fitted) -> float:
    """Logarithms of the likelihood and of the priors, from SciPy's densities and Legendre polynomials alone."""
    sigma = float(noise.curve.sigma_mm[0])
    density: Callable[[FloatArray], FloatArray] = stats.norm.pdf if noise.curve.shape is None else noise.curve.shape.pdf
    time = np.linspace(-1.0, 1.0, len(samples))
    basis = np.polynomial.legendre.legvander(time, DRIFTS)[:, 1:]
    scale = sigma * math.exp(fitted.log_width)
    likelihood = np.full(len(samples), fitted.background / SPAN_MM)
    likelihood += fitted.no_return * stats.norm.pdf(samples, TOP_MM, sigma)
    drifts = np.broadcast_to(fitted.drifts, (len(fitted.means), DRIFTS))
    for mean, share, drift in zip(fitted.means, fitted.shares, drifts, strict=True):
        likelihood += share * density((samples - basis @ drift - mean) / scale) / scale
    near, far = noise.background or (1000.0 * noise.p_outlier, 1000.0 * (1.0 - noise.p_outlier))
    value = float(np.log(likelihood).sum())
    if len(fitted.means) == 0:
        return value
    peak = near / (near + far)
    value += near * math.log(fitted.background / peak) + far * math.log((1.0 - fitted.background) / (1.0 - peak))
    if noise.curve.width_spread > 0:
        prior = stats.t(TAIL_DEGREES, scale=SCALE_OF_SPREAD * noise.curve.width_spread)
        value += float(prior.logpdf(fitted.log_width) - prior.logpdf(0.0))
    for d in range(DRIFTS):
        if noise.drift_mm[d] > 0:
            prior = stats.t(TAIL_DEGREES, scale=noise.drift_mm[d])
            value += float((prior.logpdf(drifts[:, d]) - prior.logpdf(0.0)).sum())
    return value


def best_of_scipy(samples: FloatArray, noise: PixelNoise, start: Fitted) -> tuple[Fitted, float]:
    """The maximum of `written_out` near a start, by a simplex and then by slopes."""
    k, own = len(start.means), noise.curve.width_spread > 0
    moving = [d for d in range(DRIFTS) if noise.drift_mm[d] > 0]
    sigma = float(noise.curve.sigma_mm[0])

    def of(x: FloatArray) -> Fitted:
        shares = np.exp(np.append(x[k : 2 * k], 0.0))
        shares /= shares.sum()
        drifts = np.zeros((k, DRIFTS))
        at = 2 * k + (1 if own else 0)
        for d in moving:
            drifts[:, d] = sigma * x[at : at + k]
            at += k
        return Fitted(sigma * x[:k], shares[:k], 0.0, float(shares[k]), float(x[2 * k]) if own else 0.0, drifts)

    x = np.concatenate(
        [
            start.means / sigma,
            np.log(start.shares / start.background),
            [start.log_width] if own else [],
            *[start.drifts[:, d] / sigma for d in moving],
        ]
    )
    for _ in range(3):
        for way in ("Nelder-Mead", "BFGS"):
            x = optimize.minimize(lambda x: -written_out(samples, noise, of(x)), x, method=way).x
    return of(x), written_out(samples, noise, of(x))


NOISES = {
    "Gaussian": pixel_noise(),
    "Gaussian on background": pixel_noise(background=(1.0, 6.0)),
    "Gaussian of its own width": pixel_noise(width_spread=0.3),
    "skewed on background": pixel_noise("skewed", background=(1.0, 6.0)),
    "long-tailed of its own width": pixel_noise("student", background=(1.0, 6.0), width_spread=0.3),
}


def _two_surfaces(rng: np.random.Generator, name: str = "gaussian", distance: float = 3.5) -> FloatArray:
    places = 2000.0, 2000.0 + distance * SIGMA_MM
    samples = surfaces(rng, (120, 1), places, (0.4, 0.6), errors=KNOWN[name].draw)[:, 0]
    samples[::15] = rng.uniform(LOW_MM, TOP_MM - 1000.0, 8)
    return samples


@pytest.mark.slow
@pytest.mark.parametrize("name", NOISES)
def test_objective_is_the_likelihood_and_the_priors_written_out(name: str, rng: np.random.Generator) -> None:
    noise = NOISES[name]
    samples = _two_surfaces(rng)
    samples[1::9] = TOP_MM + SIGMA_MM * rng.standard_normal(14)
    pixel = Pixel(samples, noise)
    k = pixel.begin((1990.0, 2080.0), no_return=0.1)
    for _ in range(3):
        # The kernel's table of the density has 32 points a sigma, and is a line between them.
        assert pixel.value(k) == pytest.approx(written_out(samples, noise, pixel.fitted(k)), abs=0.05)
        em_step(pixel.data, k, pixel.fit, pixel.law, pixel.beam, pixel.scratch)


@pytest.mark.slow
def test_objective_counts_drift_and_its_prior(rng: np.random.Generator) -> None:
    noise = pixel_noise(drift_mm=(15.0, 0.0, 8.0))
    samples = _two_surfaces(rng)
    pixel = Pixel(samples, noise)
    k = pixel.begin((1990.0, 2080.0))
    pixel.fit[DRIFT, :k], pixel.fit[DRIFT + 2, :k] = (12.0, -7.0), (-3.0, 9.0)
    assert pixel.value(k) == pytest.approx(written_out(samples, noise, pixel.fitted(k)), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOISES)
def test_em_ends_at_the_maximum_that_scipy_finds(name: str, rng: np.random.Generator) -> None:
    noise = NOISES[name]
    samples = _two_surfaces(
        rng, {"skewed": "skewed", "long-tailed": "student"}.get(name.split(maxsplit=1)[0], "gaussian")
    )
    pixel = Pixel(samples, noise)
    k = pixel.begin((1980.0, 2090.0))
    assert pixel.maximise(k) > 0
    found = pixel.fitted(k)
    best, value = best_of_scipy(samples, noise, found)
    margin = 1e-3 if noise.curve.shape is None else 0.02  # in sigmas: a table's slope has steps
    np.testing.assert_allclose(found.means, best.means, atol=margin * SIGMA_MM)
    np.testing.assert_allclose(found.shares, best.shares, atol=margin)
    assert found.background == pytest.approx(best.background, abs=margin)
    assert found.log_width == pytest.approx(best.log_width, abs=margin)
    assert written_out(samples, noise, found) == pytest.approx(value, abs=margin)


@pytest.mark.slow
def test_em_of_a_drifting_surface_ends_at_the_maximum_that_scipy_finds(rng: np.random.Generator) -> None:
    noise = pixel_noise(drift_mm=(20.0, 10.0, 5.0), background=(1.0, 10.0))
    time = np.linspace(-1.0, 1.0, 120)
    samples = 2000.0 + 30.0 * time - 12.0 * (1.5 * time**2 - 0.5) + SIGMA_MM * rng.standard_normal(120)
    samples[::20] = rng.uniform(LOW_MM, TOP_MM - 1000.0, 6)
    pixel = Pixel(samples, noise)
    k = pixel.begin((1980.0,))
    assert pixel.maximise(k) > 0
    found = pixel.fitted(k)
    best, value = best_of_scipy(samples, noise, found)
    np.testing.assert_allclose(found.means, best.means, atol=0.02)
    np.testing.assert_allclose(found.drifts, best.drifts, atol=0.05)
    assert written_out(samples, noise, found) == pytest.approx(value, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOISES)
def test_likelihood_never_falls_from_one_step_to_the_next(name: str, rng: np.random.Generator) -> None:
    # A line between the points of a table is no density's own: some 1e-4 nat of 1e3, and more at a skewed one's end.
    rounding = 0.05 if name.startswith("skewed") else 5e-4
    for _ in range(20):
        pixel = Pixel(_two_surfaces(rng, distance=float(rng.uniform(0.5, 8.0))), NOISES[name])
        k = pixel.begin(tuple(rng.uniform(1900.0, 2200.0, 3)), background=float(rng.uniform(0.01, 0.9)))
        before = pixel.value(k)
        for _ in range(40):
            em_step(pixel.data, k, pixel.fit, pixel.law, pixel.beam, pixel.scratch)
            after = pixel.value(k)
            assert after >= before - rounding
            before = after


def test_layers_state_the_objective_of_their_fit(rng: np.random.Generator) -> None:
    noise = pixel_noise("skewed", background=(1.0, 6.0))
    samples = surfaces(rng, (100, 8), (1500.0, 2500.0), (0.3, 0.7), errors=KNOWN["skewed"].draw, background=0.1)
    samples = samples.astype(np.float32).astype(np.float64)
    layers = layer_pixels(samples, camera_with(noise), EstimateOptions(tol=1e-6, max_iter=500))
    np.testing.assert_array_equal(layers.n_modes, 2)
    for pixel in range(8):
        fitted = Fitted(
            layers.range[pixel, :2].astype(np.float64),
            layers.weight[pixel, :2].astype(np.float64),
            float(layers.weight_no_return[pixel]),
            float(layers.weight_outlier[pixel]),
        )
        assert layers.log_likelihood[pixel] == pytest.approx(written_out(samples[:, pixel], noise, fitted), abs=0.05)


SIGMA_MM_ON_STEPS, MOST_ITERATIONS, TOLERANCE = 6.0, 50, 1.0e-3
LAW = law_of(None, background=(0.0, 1.0e9))


def beam_on(step_mm: float) -> Beam:
    curve = NoiseCurve(np.array([0.0, 8000.0]), np.array([SIGMA_MM_ON_STEPS, SIGMA_MM_ON_STEPS]))
    camera = Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0, noise=curve)
    return beam_of(camera)._replace(steps=Steps(np.zeros(1), np.array([step_mm]), np.zeros(0)))


@pytest.mark.parametrize("frames", [30, 1000])
@pytest.mark.parametrize("step", [1.0, 5.0, 10.0])
def test_em_converges_within_the_default_iterations_to_the_most_likely_range(step: float, frames: int) -> None:
    rng, step_mm = np.random.default_rng(3), step * SIGMA_MM_ON_STEPS
    beam, work = beam_on(step_mm), new_workspace(3, frames, 1)
    for _ in range(20):
        place = rng.uniform(1500.0, 4500.0)
        value = np.sort(step_mm * np.rint((place + SIGMA_MM_ON_STEPS * rng.standard_normal(frames)) / step_mm))
        data = Samples(value, np.zeros(frames))
        fill_times(data, work.scratch)
        fill_cells(data, beam, work.scratch)
        work.fit[:] = 0.0
        work.fit[names.MEAN, 0], work.fit[names.SIGMA, 0] = np.median(value), SIGMA_MM_ON_STEPS
        work.fit[names.WEIGHT, 0] = 1.0
        assert maximise(data, 1, work.fit, LAW, beam, MOST_ITERATIONS, TOLERANCE, work.scratch) > 0

        def loss(mean: float, value: np.ndarray[tuple[int], np.dtype[np.float64]] = value) -> float:
            inside = ndtr((value + 0.5 * step_mm - mean) / SIGMA_MM_ON_STEPS) - ndtr(
                (value - 0.5 * step_mm - mean) / SIGMA_MM_ON_STEPS
            )
            return -float(np.log(inside + 1e-300).sum())

        middle = float(value.mean())
        best = minimize_scalar(loss, bounds=(middle - 0.5 * step_mm, middle + 0.5 * step_mm), method="bounded")
        assert loss(float(work.fit[names.MEAN, 0])) == pytest.approx(best.fun, abs=0.05)


def steps_by_range(range_mm: list[float], step_mm: list[float]) -> Beam:
    return beam_on(1.0)._replace(steps=Steps(np.array(range_mm), np.array(step_mm), np.zeros(0)))


def test_steps_end_where_they_meet() -> None:
    beam = steps_by_range([1024.0, 2048.0 * (1.0 - 1e-9), 2048.0, 4096.0], [16.0, 16.0, 32.0, 32.0])
    value = np.concatenate([np.arange(1920.0, 2048.0, 16.0), np.arange(2048.0, 2305.0, 32.0)])
    work = new_workspace(3, len(value), 1)
    data = Samples(value.copy(), np.zeros(len(value)))
    fill_cells(data, beam, work.scratch)
    half = work.scratch[names.CELL, : len(value)]
    between = 0.5 * (value[1:] + value[:-1])
    np.testing.assert_allclose((data.value - half)[1:], between, atol=1e-4)
    np.testing.assert_allclose((data.value + half)[:-1], between, atol=1e-4)
    part = 0.02
    beam = steps_by_range([500.0, 8000.0], [500.0 * part, 8000.0 * part])
    number = np.arange(350, 410)
    work = new_workspace(3, len(number), 1)
    data = Samples(np.exp(part * number), np.zeros(len(number)))
    fill_cells(data, beam, work.scratch)
    half = work.scratch[names.CELL, : len(number)]
    step = data.value * part
    assert np.abs((data.value - half - np.exp(part * (number - 0.5))) / step).max() < 2e-3
    assert np.abs((data.value + half - np.exp(part * (number + 0.5))) / step).max() < 2e-3


def test_a_surface_where_the_step_doubles_is_at_its_most_likely_range() -> None:
    rng = np.random.default_rng(5)
    beam = steps_by_range([1024.0, 2048.0 * (1.0 - 1e-9), 2048.0, 4096.0], [15.0, 15.0, 30.0, 30.0])
    # The stored values are 2048 - 15 k below and 2048 + 30 k beyond; the cell of 2048 ends at 2040.5 and 2063.
    stored = np.concatenate([2048.0 - 15.0 * np.arange(10, 0, -1), 2048.0 + 30.0 * np.arange(10)])
    ends = np.concatenate([[-np.inf], 0.5 * (stored[1:] + stored[:-1]), [np.inf]])
    frames = 400
    work = new_workspace(3, frames, 1)
    for place in (2044.0, 2052.0, 2060.0):
        cell = np.searchsorted(ends, place + SIGMA_MM_ON_STEPS * rng.standard_normal(frames)) - 1
        data = Samples(np.sort(stored[cell]), np.zeros(frames))
        fill_times(data, work.scratch)
        fill_cells(data, beam, work.scratch)
        work.fit[:] = 0.0
        work.fit[names.MEAN, 0], work.fit[names.SIGMA, 0], work.fit[names.WEIGHT, 0] = (
            place + 3.0,
            SIGMA_MM_ON_STEPS,
            1.0,
        )
        assert maximise(data, 1, work.fit, LAW, beam, MOST_ITERATIONS, TOLERANCE, work.scratch) > 0

        def loss(mean: float, cell: np.ndarray[tuple[int], np.dtype[np.int64]] = cell) -> float:
            inside = ndtr((ends[cell + 1] - mean) / SIGMA_MM_ON_STEPS) - ndtr((ends[cell] - mean) / SIGMA_MM_ON_STEPS)
            return -float(np.log(inside + 1e-300).sum())

        best = minimize_scalar(loss, bounds=(2030.0, 2070.0), method="bounded")
        assert float(work.fit[names.MEAN, 0]) == pytest.approx(best.x, abs=0.1)


BEAM = beam_of(camera_with(pixel_noise()))


@pytest.mark.parametrize("near", [0, 1, 3, 10])
def test_start_has_no_return_for_the_samples_at_the_end_of_range(near: int) -> None:
    value = np.array([2000.0] * (10 - near) + [TOP_MM + 1.0] * near)
    fit = new_fit(2)
    fit[:] = 7.0
    start_without_surface(value, fit, BEAM)
    assert fit[WEIGHT, -1] == pytest.approx(min(0.1 * near, 0.9))  # background keeps one sample
    assert fit[OWN, BACKGROUND] + fit[WEIGHT, -1] == 1.0
    assert fit[OWN, LOG_WIDTH] == 0.0
    assert not fit[WEIGHT, :-1].any()


def test_start_without_an_end_of_range_is_background_alone() -> None:
    fit = new_fit(1)
    start_without_surface(np.array([TOP_MM]), fit, BEAM._replace(range_max=math.inf))
    assert (fit[WEIGHT, -1], fit[OWN, BACKGROUND]) == (0.0, 1.0)


def test_shares_of_added_and_removed_surfaces_come_from_and_go_to_all_others() -> None:
    fit = new_fit(2)
    fit[DRIFT : DRIFT + DRIFTS] = 9.0
    fit[MEAN, 0], fit[WEIGHT, 0], fit[WEIGHT, -1], fit[OWN, BACKGROUND] = 1000.0, 0.5, 0.3, 0.2
    assert add_surface(1, 2000.0, 0.25, fit, BEAM) == 2
    np.testing.assert_allclose(fit[WEIGHT], [0.375, 0.25, 0.225])
    assert fit[OWN, BACKGROUND] == pytest.approx(0.15)
    assert (fit[MEAN, 1], fit[SIGMA, 1]) == (2000.0, SIGMA_MM)
    assert not fit[DRIFT : DRIFT + DRIFTS, 1].any()
    fit = new_fit(3)
    fit[MEAN, :3], fit[WEIGHT, :3] = (1.0, 2.0, 3.0), (0.2, 0.3, 0.4)
    fit[OWN, BACKGROUND], fit[OWN, LOG_WIDTH] = 0.1, 0.4
    assert remove_surface(3, 1, fit) == 2
    np.testing.assert_array_equal(fit[MEAN, :2], [1.0, 3.0])
    np.testing.assert_allclose(fit[WEIGHT, :2], np.array([0.2, 0.4]) / 0.7)
    assert fit[OWN, BACKGROUND] == pytest.approx(0.1 / 0.7)
    assert remove_surface(2, 0, fit) == 1
    assert remove_surface(1, 0, fit) == 0
    assert fit[OWN, BACKGROUND] == 1.0
    assert fit[OWN, LOG_WIDTH] == 0.0  # a width without a surface is that of all


def _scores(samples: FloatArray, noise: PixelNoise) -> tuple[FloatArray, FloatArray]:
    block = np.ascontiguousarray(samples.T, dtype=np.float32)
    return held_out_scores(block, noise.laws(), beam_of(camera_with(noise)), flat_thresholds(), 4)


@pytest.mark.parametrize("factor", [0.9, 1.25])  # with a smaller one, two surfaces stand for one
def test_wrong_sigma_loses_the_kullback_leibler_distance(factor: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (200, 300), (2000.0,))
    right, _ = _scores(samples, pixel_noise())
    wrong, _ = _scores(samples, pixel_noise(sigma_mm=20.0 * factor))
    floor = SURPRISES / (TOP_MM - LOW_MM)

    def mixed(x: float, sigma: float) -> float:
        return float((1.0 - SURPRISES) * stats.norm.pdf(x, 0.0, sigma) + floor)

    def lost(x: float) -> float:
        return float(stats.norm.pdf(x, 0.0, 20.0)) * float(np.log(mixed(x, 20.0) / mixed(x, 20.0 * factor)))

    # The mean is fitted to a half of the samples: that loses half a nat a half on top, more where sigma is small.
    expected = 200 * integrate.quad(lost, -200.0, 200.0, limit=200)[0] + 1.0 * (1.0 / factor**2 - 1.0)
    assert float(np.mean(right - wrong)) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_true_shape_predicts_best(name: str, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 200), (2000.0,), errors=KNOWN[name].draw)
    score = {other: float(_scores(samples, pixel_noise(other))[0].mean()) for other in KNOWN}
    assert max(score, key=lambda other: score[other]) == name


def test_alternating_surfaces_fall_in_both_halves(rng: np.random.Generator) -> None:
    # Two targets of a frame take turns: halves by odd and even frames would each see one of them alone.
    place = np.where(np.arange(120) % 2 == 0, 1500.0, 2500.0)[:, np.newaxis]
    scores, found = _scores(place + 20.0 * rng.standard_normal((120, 40)), pixel_noise())
    np.testing.assert_array_equal(found, 2.0)
    entropy = 0.5 * np.log(2.0 * np.pi * math.e * 20.0**2) + np.log(2.0)
    assert scores.mean() / 120 == pytest.approx(-entropy, abs=0.06)


LAW_POPULATION = law_of(None, background=(0.1, 10.0))
CLUSTERS, FRAMES = 300, 100
FIRST_SCALE = 9.0


def errors(*, spread: float, apart: float, step: float) -> FloatArray:
    """Errors (cluster, frame), in sigmas, of pixels whose log widths spread, a quarter of them pairs, on a step."""
    rng = np.random.default_rng(1)
    out = np.exp(spread * rng.standard_normal((CLUSTERS, 1))) * rng.standard_normal((CLUSTERS, FRAMES))
    pairs = CLUSTERS // 4
    out[:pairs] += apart * (rng.random((pairs, FRAMES)) < 0.5)
    if step > 0.0:
        place = rng.uniform(0.0, step, (CLUSTERS, 1))
        out = step * np.rint((out + place) / step) - place
    return np.asarray(out - out.mean(axis=1, keepdims=True))


def spread_of(error: FloatArray, step: float) -> float | None:
    each = np.ones(len(error))
    return spread_beside_pairs(
        error, half=0.5 * step * each, rest=0.005 * each, span=32.0 * each, law=LAW_POPULATION, scale=FIRST_SCALE
    )


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.parametrize("apart", [2.0, 3.0])
def test_pairs_of_equal_widths_have_no_spread_of_widths(apart: float, step: float) -> None:
    assert spread_of(errors(spread=0.0, apart=apart, step=step), step) is None


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.parametrize("spread", [0.1, 0.3])
def test_widths_without_pairs_keep_the_spread_that_was_measured(spread: float, step: float) -> None:
    assert spread_of(errors(spread=spread, apart=0.0, step=step), step) == FIRST_SCALE


@pytest.mark.parametrize("step", [0.0, 1.0])
def test_widths_beside_pairs_have_their_own_spread(step: float) -> None:
    found = spread_of(errors(spread=0.3, apart=3.0, step=step), step)
    assert found is not None
    assert found == pytest.approx(0.3 * 0.831, rel=0.45)  # the scales that are tried are 41 % apart


@pytest.mark.parametrize("step", [0.6, 3.0])
def test_likelihood_is_the_integral_over_places_of_the_product_over_cells(step: float) -> None:
    error = errors(spread=0.0, apart=2.0, step=step)[:3]
    pairs, log_widths = np.array([[0.0, 1.0], [2.0, 0.3]]), np.array([-0.2, 0.3])
    each = np.ones(3)
    found = population_likelihoods(error, 0.5 * step * each, 0.1 * each, 32.0 * each, LAW_POPULATION, pairs, log_widths)
    assert found.shape == (3, 2, 2)
    naive = np.zeros(found.shape)
    for c, p, u in itertools.product(range(3), range(2), range(2)):
        (apart, share), width = pairs[p], np.exp(log_widths[u])
        mean = np.linspace(-6.0, 6.0, 2401)[:, None] - (1.0 - share) * apart
        density = np.zeros((len(mean), FRAMES))
        for place, part in ((mean, share), (mean + apart, 1.0 - share)):
            low, high = ((error[c] + side * step - place) / width for side in (-0.5, 0.5))
            density += 0.9 * part * (norm.cdf(high) - norm.cdf(low)) / step
        logs = np.log(density + 0.1 / 32.0).sum(axis=1)
        naive[c, p, u] = logs.max() + np.log(np.exp(logs - logs.max()).sum())
    # Up to a number of the cluster; fifteen places and tables of the distribution are exact to 0.15 nat.
    np.testing.assert_allclose(found - found[:, :1, :1], naive - naive[:, :1, :1], atol=0.15)
