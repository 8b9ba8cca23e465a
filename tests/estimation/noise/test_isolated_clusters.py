"""Clusters and Gaussian fits of all pixels at once: the same as the kernels' of one cluster after the other."""

import numpy as np
import pytest
from scipy import optimize, stats
from support.learnt_pixels import SIGMA_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, PixelCurves, beam_of, sigma_at
from tofmix.estimation.learnt import clusters as kernels
from tofmix.estimation.learnt.law import law_of
from tofmix.estimation.noise.curve_check import _quantile_of_t
from tofmix.estimation.noise.isolated_clusters import (
    WEAK_PRIOR,
    WINDOW,
    Clusters,
    FlatSamples,
    GaussianFits,
    PixelSigmas,
    find_clusters,
    fit_clusters,
)

FRAMES, PIXELS = 60, 150
BEAM = beam_of(camera_with(pixel_noise()))
SCALE = 0.5


def _found(samples: FloatArray, beam: Beam = BEAM) -> tuple[FlatSamples, Clusters]:
    flat = FlatSamples.of(np.ascontiguousarray(samples.T, dtype=np.float32))
    return flat, find_clusters(flat, samples.shape[1], PixelSigmas(beam))


def _mixed(rng: np.random.Generator) -> FloatArray:
    """One surface, two far apart, two close, and background."""
    size = FRAMES, PIXELS
    samples = np.hstack(
        [
            surfaces(rng, size, (2000.0,), background=0.1),
            surfaces(rng, size, (1500.0, 2500.0), (0.4, 0.6)),
            surfaces(rng, size, (2000.0, 2000.0 + 7.0 * SIGMA_MM), (0.5, 0.5)),
            surfaces(rng, size, (2000.0,), background=0.8),
        ]
    )
    samples[rng.random(samples.shape) < 0.1] = np.nan
    return samples


def test_clusters_are_those_of_the_kernel(rng: np.random.Generator) -> None:
    samples = _mixed(rng)
    _, found = _found(samples)
    expected = kernels.find_clusters(np.ascontiguousarray(samples.T, dtype=np.float32), BEAM)
    np.testing.assert_array_equal(np.sort(found.pixel), expected.pixel)
    order = np.lexsort((expected.low, expected.pixel))
    mine = np.lexsort((found.low, found.pixel))
    np.testing.assert_allclose(found.low[mine], expected.low[order], atol=1e-6)
    np.testing.assert_allclose(found.high[mine], expected.high[order], atol=1e-6)


@pytest.mark.parametrize("drift_mm", [0.0, 3.0 * SIGMA_MM])
def test_fits_are_those_of_the_kernel(drift_mm: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (FRAMES, PIXELS), (2000.0,), width=1.2, background=0.1)
    samples += drift_mm * np.linspace(-1.0, 1.0, FRAMES)[:, np.newaxis] * rng.standard_normal(PIXELS)
    flat, clusters = _found(samples)
    found = fit_clusters(flat, clusters, PixelSigmas(BEAM), width_scale=SCALE, drift_mm=drift_mm)
    law = law_of(None, background=WEAK_PRIOR, width_spread=SCALE, drift_mm=np.full(3, drift_mm))
    rows = np.ascontiguousarray(samples.T, dtype=np.float32)
    expected = kernels.fit_clusters(rows, clusters, law, BEAM, False)  # noqa: FBT003  a kernel's flag
    np.testing.assert_allclose(found.place, expected.place, atol=0.02 * SIGMA_MM)
    np.testing.assert_allclose(found.log_width, expected.log_width, atol=0.02)
    np.testing.assert_allclose(found.drift, expected.drift, atol=0.05 * SIGMA_MM)
    np.testing.assert_allclose(found.support, expected.support, atol=0.1)
    errors = np.sort(expected.error[np.isfinite(expected.error)])
    np.testing.assert_allclose(np.sort(found.error), errors, atol=0.05)


def test_a_fit_has_the_largest_posterior_density(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (FRAMES, 1), (2000.0,), width=1.3, background=0.2)
    flat, clusters = _found(samples)
    found = fit_clusters(flat, clusters, PixelSigmas(BEAM), width_scale=SCALE)
    inside = flat.value[(flat.value >= clusters.low[0]) & (flat.value <= clusters.high[0])]

    def loss(x: FloatArray) -> float:
        place, log_width, share = x[0], x[1], 1.0 / (1.0 + np.exp(-x[2]))
        density = stats.norm.pdf(inside, place, SIGMA_MM * np.exp(log_width))
        likelihood = np.log((1.0 - share) * density + share / (2.0 * WINDOW * SIGMA_MM)).sum()
        prior = stats.t.logpdf(log_width, 4.0, scale=SCALE)
        return -float(likelihood + prior + WEAK_PRIOR[0] * np.log(share) + WEAK_PRIOR[1] * np.log1p(-share))

    best = optimize.minimize(loss, [2000.0, 0.0, -2.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    assert found.place[0] == pytest.approx(best.x[0], abs=0.01 * SIGMA_MM)
    assert found.log_width[0] == pytest.approx(best.x[1], abs=0.01)


def test_without_a_cluster_there_is_nothing_to_fit(rng: np.random.Generator) -> None:
    for samples in (np.full((FRAMES, 4), np.nan), rng.uniform(0.0, 6000.0, (FRAMES, 4))):
        flat, clusters = _found(samples)
        assert clusters.pixel.size == 0
        assert fit_clusters(flat, clusters, PixelSigmas(BEAM), width_scale=SCALE).error.size == 0


def test_pixels_with_curves_of_their_own_have_their_own_sigma(rng: np.random.Generator) -> None:
    size = np.array([3, 1, 0])
    ranges, sigmas = np.sort(rng.uniform(500.0, 4000.0, (3, 3)), axis=1), rng.uniform(5.0, 20.0, (3, 3))
    own = PixelSigmas(BEAM._replace(pixel_curves=PixelCurves(ranges, sigmas, size)))
    places = np.concatenate([rng.uniform(0.0, 5000.0, 50), ranges[0], ranges[1]])
    for pixel in range(3):
        n = size[pixel]
        curve = (ranges[pixel, :n], sigmas[pixel, :n]) if n else (BEAM.curve_range, BEAM.curve_sigma)
        expected = [sigma_at(float(place), *curve) for place in places]
        np.testing.assert_allclose(own(np.full(len(places), pixel), places), expected, rtol=1e-12)


@pytest.mark.parametrize("degrees", [1.0, 2.5, 7.0, 96.0, 5000.0])
def test_quantiles_of_student_t_are_scipys(degrees: float) -> None:
    assert _quantile_of_t(0.875, degrees) == pytest.approx(stats.t.ppf(0.875, degrees), rel=1e-9)


def test_fits_hold_one_value_a_cluster(rng: np.random.Generator) -> None:
    flat, clusters = _found(_mixed(rng))
    fits = fit_clusters(flat, clusters, PixelSigmas(BEAM), width_scale=SCALE)
    assert isinstance(fits, GaussianFits)
    assert {len(values) for values in fits[:5]} == {len(clusters.pixel)}
