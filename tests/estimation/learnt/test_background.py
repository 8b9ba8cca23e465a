"""The density of background over range: uniform where nothing speaks against it, and fog without its surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, LOW_MM, SIGMA_MM, TOP_MM, camera_with, flat, pixel_noise

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.background import MOST_CELLS, cell_edges, cells_of_surface, smooth_density
from tofmix.estimation.learnt.folds import whole_fold
from tofmix.estimation.learnt.learning import learn_pixel_noise
from tofmix.estimation.learnt.parts import with_part
from tofmix.estimation.noise.training_pixels import Pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.noise_shape import BackgroundDensity
from tofmix.sensor import NoiseCurve

AT_MM = np.linspace(LOW_MM, TOP_MM, 400)
FOG = BackgroundDensity(AT_MM, np.exp(-(((AT_MM - 700.0) / 500.0) ** 2)) + 1e-3)
"""Most of it within half a metre of 0.7 m."""

NET_MM, WALL_MM = 2500.0, 5000.0


def in_fog(rng: np.random.Generator, pixels: int, frames: int, share: float) -> FloatArray:
    """Samples (frame, pixel), mm: a net of 30 %, a wall behind it, and fog."""
    samples = np.where(rng.random((frames, pixels)) < 0.3, NET_MM, WALL_MM)
    samples = samples + SIGMA_MM * rng.standard_normal(samples.shape)
    fog = rng.random(samples.shape) < share
    samples[fog] = FOG.quantile(rng.random(int(fog.sum())))
    return np.asarray(samples)


def of_pixels(samples: FloatArray) -> Float32Array:
    """Samples (pixel, frame) in the order in which the package holds them: kernels are compiled for no other."""
    return np.ascontiguousarray(samples.T, dtype=np.float32)


def test_cells_have_equal_numbers_of_sigmas_and_are_not_too_many() -> None:
    curve = NoiseCurve(np.array([LOW_MM, TOP_MM]), np.array([5.0, 50.0]))
    edges = cell_edges(curve, LOW_MM, TOP_MM, 8.0)
    sigmas = np.diff(edges) / curve.sigma(0.5 * (edges[1:] + edges[:-1]))
    assert edges[0] == LOW_MM
    assert edges[-1] == pytest.approx(TOP_MM)
    assert 8.0 <= sigmas.min() <= sigmas.max() < 1.1 * sigmas.min()
    fine = NoiseCurve(np.array([1000.0]), np.array([1.0]))
    assert len(cell_edges(fine, LOW_MM, TOP_MM, 8.0)) == MOST_CELLS + 1


def test_even_counts_give_a_density_within_their_noise_of_the_uniform_one(rng: np.random.Generator) -> None:
    edges = np.linspace(LOW_MM, TOP_MM, 61)
    away = []
    for _ in range(20):
        density = smooth_density(rng.poisson(50.0, 60).astype(np.float64), edges)
        away.append(np.abs(density.at(AT_MM) * (TOP_MM - LOW_MM) - 1.0).max())
    assert np.median(away) < 0.05  # one cell alone is off by 14 %
    assert max(away) < 0.3


def test_counts_of_fog_give_its_density(rng: np.random.Generator) -> None:
    edges = np.linspace(LOW_MM, TOP_MM, 61)
    counts = np.histogram(FOG.quantile(rng.random(20_000)), edges)[0].astype(np.float64)
    density = smooth_density(counts, edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    dense = FOG.at(middle) > 0.1 * FOG.density.max()
    np.testing.assert_allclose(density.at(middle)[dense], FOG.at(middle)[dense], rtol=0.12)
    assert density.at(4000.0) < 0.01 * density.at(700.0)


def test_no_counts_give_the_uniform_density() -> None:
    assert smooth_density(np.zeros(10), np.linspace(0.0, 1000.0, 11)).same_as(BackgroundDensity.uniform(0.0, 1000.0))


def test_a_peak_as_narrow_as_a_surface_leaves_the_density_and_a_wider_one_stays(rng: np.random.Generator) -> None:
    curve = NoiseCurve(np.array([LOW_MM, TOP_MM]), np.array([SIGMA_MM, SIGMA_MM]))
    edges = cell_edges(curve, LOW_MM, TOP_MM, 8.0)
    cells = cells_of_surface(curve, edges, pixel_noise().laws()[1])
    even = rng.uniform(LOW_MM, TOP_MM, 20_000)
    for at_mm in NET_MM + SIGMA_MM * np.arange(8):  # wherever the surface stands in its cells
        faint = at_mm + SIGMA_MM * rng.standard_normal(2_000)
        wide = at_mm + 4.0 * cells * SIGMA_MM * rng.uniform(-4.0, 4.0, 10_000)
        for more, least, most in ((faint, 0.8, 1.2), (wide, 1.5, 9.0)):
            counts = np.histogram(np.concatenate([even, more]), edges)[0].astype(np.float64)
            density = smooth_density(counts, edges, cells)
            ratio = density.at(at_mm) / density.at(TOP_MM - 500.0)
            assert least < ratio < most
        with_peak = smooth_density(np.histogram(np.concatenate([even, faint]), edges)[0].astype(np.float64), edges)
        assert with_peak.at(at_mm) / with_peak.at(TOP_MM - 500.0) > 1.5


@pytest.mark.compiled("counts the surfaces of 400 pixels")
def test_a_wall_that_all_pixels_see_faintly_hides_no_pixel_that_sees_more_of_it(rng: np.random.Generator) -> None:
    pixels, frames = 400, 100
    samples = NET_MM + SIGMA_MM * rng.standard_normal((frames, pixels))
    random = rng.random(samples.shape) < 0.1
    samples[random] = rng.uniform(LOW_MM, TOP_MM, int(random.sum()))
    share = np.where(np.arange(pixels) % 8 == 0, 0.08, 0.02)
    wall = rng.random(samples.shape) < share
    samples[wall] = WALL_MM + SIGMA_MM * rng.standard_normal(int(wall.sum()))
    held = (wall & (np.abs(samples - WALL_MM) < 3.0 * SIGMA_MM)).sum(axis=0)
    noise = with_part(
        whole_fold(Pixels(samples=of_pixels(samples)), CAMERA), pixel_noise(background=(1.0, 9.0)), "density"
    )
    assert noise is not None
    found = layer_pixels(samples, camera_with(noise, flat()))
    seen = (np.abs(found.range - WALL_MM) < 4.0 * SIGMA_MM).any(axis=1)
    assert seen[held >= 6].mean() > 0.95


@pytest.mark.compiled("counts the surfaces of 80 pixels thrice")
def test_a_net_and_a_wall_at_one_range_in_all_pixels_leave_the_density(rng: np.random.Generator) -> None:
    samples = of_pixels(in_fog(rng, 80, 60, 0.5))
    noise = replace(pixel_noise(background=(5.0, 5.0)))
    found = with_part(whole_fold(Pixels(samples=samples), CAMERA), noise, "density")
    assert found is not None
    density = found.curve.background_density
    assert density is not None
    for low, high in ((NET_MM - 150.0, NET_MM + 150.0), (WALL_MM - 150.0, WALL_MM + 150.0)):
        at = np.linspace(low, high, 50)
        assert np.trapezoid(density.at(at), at) < 0.01  # 0.27 and 0.63 of the samples that are no fog
    assert density.quantile(0.5) == pytest.approx(float(FOG.quantile(0.5)), abs=30.0)
    prior = found.background
    assert prior is not None
    assert prior[0] / sum(prior) == pytest.approx(0.5, abs=0.02)


def test_the_density_needs_pixels_with_shares_of_background(rng: np.random.Generator) -> None:
    samples = of_pixels(in_fog(rng, 10, 20, 0.5))
    assert with_part(whole_fold(Pixels(samples=samples), CAMERA), pixel_noise(), "density") is None


@pytest.mark.compiled("counts the surfaces of 600 pixels")
def test_chance_clumps_of_fog_are_no_surfaces_and_a_thing_in_the_fog_is_one(rng: np.random.Generator) -> None:
    samples = in_fog(rng, 300, 100, 0.6)
    thing = rng.random(samples.shape) < 0.2
    thing[:, ::2] = False
    samples[thing] = 900.0 + SIGMA_MM * rng.standard_normal(int(thing.sum()))
    noise = pixel_noise(background=(6.0, 4.0))
    uniform = layer_pixels(samples, camera_with(noise, flat()))
    noise = replace(noise, curve=replace(noise.curve, background_density=FOG))
    found = layer_pixels(samples, camera_with(noise, flat()))
    known = np.array([NET_MM, WALL_MM, 900.0])
    near = np.abs(found.range[..., None] - known) < 4.0 * SIGMA_MM
    assert near[..., :2].any(axis=1).mean() > 0.99
    assert near[1::2, :, 2].any(axis=1).mean() > 0.9
    false = np.isfinite(found.range) & ~near.any(axis=-1)
    assert false[::2].sum() <= 4  # 0.15 expected at 7 nat, in each of some ten places
    assert (uniform.n_modes[::2] > 2).mean() > 0.9


@pytest.mark.parametrize("sigma", [SigmaMode.FREE, SigmaMode.PRIOR, SigmaMode.TIED])
def test_a_uniform_density_written_out_gives_the_layers_of_none(sigma: SigmaMode, rng: np.random.Generator) -> None:
    samples = in_fog(rng, 40, 60, 0.05)
    noise = pixel_noise(background=(1.0, 9.0), p_outlier=0.05)
    written = replace(noise.curve, background_density=BackgroundDensity.uniform(LOW_MM, TOP_MM))
    for learnt in (False, True):
        plain, other = camera_with(noise, flat()), camera_with(replace(noise, curve=written), flat())
        if not learnt:
            plain, other = replace(plain, learnt=None), replace(other, learnt=None)
        one, two = (layer_pixels(samples, camera, EstimateOptions(sigma=sigma)) for camera in (plain, other))
        same = one.n_modes == two.n_modes
        assert same.mean() > 0.9  # a trial starts at another place: its end may differ
        np.testing.assert_allclose(one.range[same], two.range[same], atol=0.05 * SIGMA_MM)
        np.testing.assert_allclose(one.weight_outlier[same], two.weight_outlier[same], atol=2e-3)
        np.testing.assert_allclose(one.log_likelihood[same], two.log_likelihood[same], atol=0.05)


@pytest.mark.compiled("counts the surfaces of 200 pixels")
def test_gaussian_noise_reads_the_density_too(rng: np.random.Generator) -> None:
    samples = in_fog(rng, 100, 100, 0.5)
    curve = NoiseCurve(np.array([1000.0]), np.array([SIGMA_MM]))
    camera = replace(CAMERA, noise=curve, outlier_probability=0.5)
    uniform = layer_pixels(samples, camera)
    found = layer_pixels(samples, replace(camera, noise=replace(curve, background_density=FOG)))
    assert (uniform.n_modes > 2).mean() > 0.3
    assert (found.n_modes == 2).mean() > 0.95
    assert found.log_likelihood.sum() > uniform.log_likelihood.sum()


@pytest.mark.slow
def test_fog_in_most_samples_does_not_pass_for_a_surface_of_a_wide_sigma(rng: np.random.Generator) -> None:
    samples = of_pixels(in_fog(rng, 90, 150, 0.65))
    wide = NoiseCurve(np.array([500.0, 5000.0]), np.array([700.0, 2000.0]))
    model = learn_pixel_noise(Pixels(samples=samples), CAMERA, wide)
    assert not model.kept_start
    assert model.noise.curve.sigma(WALL_MM) == pytest.approx(SIGMA_MM, rel=0.1)
    assert model.noise.curve.background_density is not None
