"""EM under the learnt noise: where it ends is the maximum of the objective, written out anew in NumPy."""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from scipy import optimize, stats
from support.learnt_pixels import KNOWN, LOW_MM, SIGMA_MM, TOP_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.layering import layer_pixels
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
    fill_cells,
    fill_times,
    new_fit,
    new_scratch,
)
from tofmix.estimation.learnt.em import em_step
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD, Law
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.settings import EstimateOptions
from tofmix.learnt_noise import DRIFTS, TAIL_DEGREES

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


@pytest.mark.slow
@pytest.mark.parametrize("name", NOISES)
def test_accelerated_steps_end_where_many_plain_ones_do(name: str, rng: np.random.Generator) -> None:
    pixel = Pixel(_two_surfaces(rng), NOISES[name])
    k = pixel.begin((1990.0, 2080.0))
    for _ in range(3000):
        em_step(pixel.data, k, pixel.fit, pixel.law, pixel.beam, pixel.scratch)
    plain, value = pixel.fitted(k), pixel.value(k)
    pixel.begin((1990.0, 2080.0))
    assert 0 < pixel.maximise(k) < 1000
    fast = pixel.fitted(k)
    np.testing.assert_allclose(fast.means, plain.means, atol=0.02)
    np.testing.assert_allclose(fast.shares, plain.shares, atol=1e-3)
    assert pixel.value(k) == pytest.approx(value, abs=1e-3)


@pytest.mark.slow
def test_shares_of_a_fit_add_up_to_1(rng: np.random.Generator) -> None:
    samples = _two_surfaces(rng)
    samples[1::9] = TOP_MM + SIGMA_MM * rng.standard_normal(14)
    pixel = Pixel(samples, NOISES["skewed on background"])
    k = pixel.begin((1990.0, 2080.0), no_return=0.05)
    pixel.maximise(k)
    found = pixel.fitted(k)
    assert found.shares.sum() + found.no_return + found.background == pytest.approx(1.0, abs=1e-12)
    assert found.no_return == pytest.approx(14 / 120, abs=0.02)


@pytest.mark.slow
def test_nothing_but_background_is_a_fit_without_iterations(rng: np.random.Generator) -> None:
    pixel = Pixel(rng.uniform(LOW_MM, TOP_MM - 200.0, 50), NOISES["Gaussian on background"])
    k = pixel.begin((), background=0.3)
    assert pixel.maximise(k) == 0
    assert pixel.fit[OWN, BACKGROUND] == 1.0
    assert pixel.value(k) == pytest.approx(50 * math.log(1.0 / SPAN_MM), abs=1e-6)


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


@pytest.mark.slow
def test_the_prior_of_background_is_that_of_pixels_with_a_surface(rng: np.random.Generator) -> None:
    samples = rng.uniform(LOW_MM, TOP_MM, 40)
    samples[0] = TOP_MM - 1.0  # it may be c_0's
    values = []
    for strength in (1.0, 30.0):
        pixel = Pixel(samples, pixel_noise(background=(strength, 9.0 * strength)))
        pixel.begin((), background=0.9, no_return=0.1)
        pixel.maximise(0)
        values.append(pixel.value(0))
        assert pixel.fit[OWN, BACKGROUND] > 0.95  # and not a tenth, as of pixels with a surface
    assert values[0] == pytest.approx(values[1], abs=1e-9)


@pytest.mark.slow
def test_a_prior_that_a_pixel_agrees_with_costs_its_surface_nothing(rng: np.random.Generator) -> None:
    samples = np.concatenate([rng.uniform(LOW_MM, TOP_MM, 10), 2000.0 + SIGMA_MM * rng.standard_normal(90)])
    gains = []
    for strength in (1.0, 10.0, 100.0):
        pixel = Pixel(samples, pixel_noise(background=(strength, 9.0 * strength)))
        pixel.maximise(pixel.begin((2000.0,)))
        gains.append(pixel.value(1))
    np.testing.assert_allclose(gains, gains[0], atol=0.5)
