"""Clusters that stand clear: found where one surface crowds, not where two are close; their fits are the truth's."""

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, SIGMA_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.learnt.clusters import ClusterFits, find_clusters, fit_clusters
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.noise.isolated_clusters import Clusters

PIXELS, FRAMES = 200, 100
BEAM = beam_of(camera_with(pixel_noise()))


def _rows(samples: FloatArray) -> Float32Array:
    """Samples (frame, pixel) as the kernels take them."""
    return np.ascontiguousarray(samples.T, dtype=np.float32)


def _of_pixels(clusters: Clusters) -> IntArray:
    """Clusters of each pixel."""
    return np.bincount(clusters.pixel, minlength=PIXELS).astype(np.int64)


@pytest.mark.parametrize("background", [0.0, 0.5, 0.8])
def test_one_surface_is_one_cluster_about_it_on_any_background(background: float, rng: np.random.Generator) -> None:
    clusters = find_clusters(_rows(surfaces(rng, (FRAMES, PIXELS), (2000.0,), background=background)), BEAM)
    # Among 80 samples of background, some lie together too: a pixel says so rather than be taken for single.
    assert (_of_pixels(clusters) == 1).mean() > (0.95 if background < 0.8 else 0.8)
    assert (np.abs(0.5 * (clusters.low + clusters.high) - 2000.0) < SIGMA_MM).mean() > 0.98


def test_surfaces_far_apart_are_a_cluster_each(rng: np.random.Generator) -> None:
    clusters = find_clusters(_rows(surfaces(rng, (FRAMES, PIXELS), (1500.0, 2500.0), (0.4, 0.6))), BEAM)
    np.testing.assert_array_equal(_of_pixels(clusters), 2)


def test_surfaces_in_one_window_are_no_clear_cluster(rng: np.random.Generator) -> None:
    apart = 7.0 * SIGMA_MM
    clusters = find_clusters(_rows(surfaces(rng, (FRAMES, PIXELS), (2000.0, 2000.0 + apart), (0.5, 0.5))), BEAM)
    assert (_of_pixels(clusters) == 0).mean() > 0.99


def test_background_alone_has_no_cluster(rng: np.random.Generator) -> None:
    clusters = find_clusters(_rows(rng.uniform(300.0, 6000.0, (FRAMES, PIXELS))), BEAM)
    assert (_of_pixels(clusters) == 0).mean() > 0.99


def _fits(
    samples: FloatArray, noise: PixelNoise, *, second: bool = False, beam: Beam = BEAM
) -> tuple[Clusters, ClusterFits]:
    block = _rows(samples)
    clusters = find_clusters(block, beam)
    return clusters, fit_clusters(block, clusters, noise.laws()[0], beam, second)


def test_fit_of_a_cluster_has_its_place_its_errors_and_its_samples(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (FRAMES, PIXELS), (2000.0,), background=0.3)
    samples[5, :] = np.nan
    clusters, fits = _fits(samples, pixel_noise(background=(1.0, 4.0)))
    stderr = SIGMA_MM / np.sqrt(0.7 * FRAMES)
    assert fits.place.std() == pytest.approx(stderr, rel=0.2)
    assert abs(fits.place.mean() - 2000.0) < 4 * stderr / np.sqrt(len(fits.place))
    assert fits.support.mean() == pytest.approx(0.7 * (FRAMES - 1), rel=0.03)
    # Each error stands at its own frame, is what is left of the sample, and NaN out of the window.
    expected = (samples.T[clusters.pixel] - fits.place[:, np.newaxis]) / SIGMA_MM
    inside = (samples.T[clusters.pixel] >= clusters.low[:, np.newaxis]) & (
        samples.T[clusters.pixel] <= clusters.high[:, np.newaxis]
    )
    np.testing.assert_array_equal(np.isfinite(fits.error), inside)
    np.testing.assert_allclose(fits.error[inside], expected[inside], atol=1e-4)


def test_widths_and_drifts_of_clusters_are_those_that_were_drawn(rng: np.random.Generator) -> None:
    width = np.exp(rng.uniform(-0.5, 0.5, PIXELS))
    slope = rng.uniform(-40.0, 40.0, PIXELS)
    drift = slope * np.linspace(-1.0, 1.0, FRAMES)[:, np.newaxis]
    samples = surfaces(rng, (FRAMES, PIXELS), (2000.0,), width=width, drift_mm=drift)
    noise = pixel_noise(background=(0.5, 5.0), width_spread=0.5, drift_mm=(60.0, 0.0, 0.0))
    clusters, fits = _fits(samples, noise)
    away = fits.log_width - np.log(width[clusters.pixel])
    assert np.std(away) == pytest.approx(1.0 / np.sqrt(2.0 * FRAMES), rel=0.25)
    assert abs(np.median(away)) < 0.03
    error = fits.drift[:, 0] - slope[clusters.pixel]
    assert np.std(error / width[clusters.pixel]) == pytest.approx(SIGMA_MM * np.sqrt(3.0 / FRAMES), rel=0.25)
    np.testing.assert_allclose(fits.drift[:, 1:], 0.0, atol=1e-12)


def test_a_second_surface_gains_where_there_is_one(rng: np.random.Generator) -> None:
    two = rng.random(PIXELS) < 0.5
    near = surfaces(rng, (FRAMES, PIXELS), (2000.0,))
    far = surfaces(rng, (FRAMES, PIXELS), (2000.0 + 3.5 * SIGMA_MM,))
    samples = np.where(two & (rng.random((FRAMES, PIXELS)) < 0.3), far, near)
    clusters, fits = _fits(samples, pixel_noise(background=(0.5, 5.0)), second=True)
    gains = fits.gain[two[clusters.pixel]], fits.gain[~two[clusters.pixel]]
    assert np.median(gains[0]) > 15.0
    assert np.quantile(gains[1], 0.95) < 7.0
    assert CAMERA.noise is None
