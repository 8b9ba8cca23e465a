"""What learning sees: clusters, spreads, backgrounds, jumps, and the mixture of a pixel as it is drawn."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, LOW_MM, SIGMA_MM, TOP_MM, camera_with, flat, pixel_noise, surfaces

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.background import MOST_CELLS, cell_edges, cells_of_surface, smooth_density
from tofmix.estimation.learnt.clusters import ClusterFits, find_clusters, fit_clusters
from tofmix.estimation.learnt.folds import whole_fold
from tofmix.estimation.learnt.learning import learn_pixel_noise
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import PARTS, beta_prior, freed, shrunken, width_scale, with_part, without_part
from tofmix.estimation.learnt.sigma_curve import FREE_WIDTH
from tofmix.estimation.noise.isolated_clusters import Clusters
from tofmix.estimation.noise.training_pixels import Pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.layers import Layers
from tofmix.noise_shape import BackgroundDensity
from tofmix.sensor import NoiseCurve


@pytest.mark.parametrize("scale", [0.1, 0.3])
@pytest.mark.parametrize("variance", [1e-4, 0.01])
def test_spread_of_widths_is_found_beyond_the_variance_of_fits(
    scale: float, variance: float, rng: np.random.Generator
) -> None:
    chance = np.full(3000, variance)
    seen = scale * rng.standard_t(4.0, 3000) + np.sqrt(chance) * rng.standard_normal(3000)
    assert width_scale(seen, chance) == pytest.approx(scale, rel=0.15)  # the scales that are tried are 14 % apart
    assert (width_scale(np.sqrt(chance) * rng.standard_normal(3000), chance) or 0.0) < 0.3 * np.sqrt(variance)


@pytest.mark.parametrize("square", [0.0, 1.0])
def test_shrunken_values_have_the_mean_square_of_the_true_ones(square: float, rng: np.random.Generator) -> None:
    variance = rng.uniform(0.5, 2.0, 4000)
    value = np.sqrt(square + variance) * rng.standard_normal(4000)
    assert np.mean(shrunken(value, variance) ** 2) == pytest.approx(square, abs=0.1)


@pytest.mark.parametrize(("near", "far"), [(0.5, 4.0), (2.0, 2.0), (8.0, 30.0)])
def test_prior_of_background_is_the_beta_density_that_shares_were_drawn_from(
    near: float, far: float, rng: np.random.Generator
) -> None:
    n = np.full(4000, 200.0)
    share = rng.binomial(200, rng.beta(near, far, 4000)) / 200.0
    np.testing.assert_allclose(beta_prior(share, n), [near, far], rtol=0.1)
    share[:100], n[:100] = 0.9, 0.0  # pixels without a surface tell nothing
    np.testing.assert_allclose(beta_prior(share, n), [near, far], rtol=0.1)


@pytest.mark.parametrize("part", PARTS)
def test_noise_without_a_part_keeps_all_others(part: str) -> None:
    whole = pixel_noise("skewed", background=(1.0, 9.0), width_spread=0.2, drift_mm=(5.0, 1.0, 0.5), memory=0.2)
    density = BackgroundDensity(np.array([0.0, 1000.0]), np.array([2.0, 1.0]))
    whole = replace(whole, curve=replace(whole.curve, background_density=density))

    def there(noise: PixelNoise) -> set[str]:
        found = {
            "background": noise.background is not None,
            "density": noise.curve.background_density is not None,
            "drift": bool(noise.drift_mm.any()),
            "widths": noise.curve.width_spread > 0.0,
            "shape": noise.curve.shape is not None,
        }
        return {name for name, has in found.items() if has}

    assert there(whole) == set(PARTS)
    gone = (
        {"background", "density"} if part == "background" else {part}
    )  # a share that pixels have none of has no density
    assert there(without_part(whole, part)) == set(PARTS) - gone
    assert without_part(whole, part).memory == whole.memory


PIXELS, FRAMES = 200, 100
BEAM = beam_of(camera_with(pixel_noise()))


def _rows(samples: FloatArray) -> Float32Array:
    """Samples (frame, pixel) as the kernels take them."""
    return np.ascontiguousarray(samples.T, dtype=np.float32)


def _of_pixels(clusters: Clusters) -> IntArray:
    return np.bincount(clusters.pixel, minlength=PIXELS).astype(np.int64)


@pytest.mark.parametrize("background", [0.0, 0.5, 0.8])
def test_one_surface_is_one_cluster_about_it_on_any_background(background: float, rng: np.random.Generator) -> None:
    clusters = find_clusters(_rows(surfaces(rng, (FRAMES, PIXELS), (2000.0,), background=background)), BEAM)
    # Among 80 samples of background, some lie together too: a pixel says so rather than be taken for single.
    assert (_of_pixels(clusters) == 1).mean() > (0.95 if background < 0.8 else 0.8)
    assert (np.abs(0.5 * (clusters.low + clusters.high) - 2000.0) < SIGMA_MM).mean() > 0.98


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


def test_freed_log_widths_are_those_of_the_samples_alone(rng: np.random.Generator) -> None:
    frames = 25
    width = np.exp(0.3 * rng.standard_normal(PIXELS))
    samples = surfaces(rng, (frames, PIXELS), (2000.0,), width=width)
    clusters, fits = _fits(samples, pixel_noise(width_spread=FREE_WIDTH))
    alone = np.log(samples.std(axis=0)[clusters.pixel])  # the most likely width of a Gaussian
    found = freed(fits.log_width, 0.5 / fits.support)
    assert np.polyfit(alone, found, 1)[0] == pytest.approx(1.0, abs=0.03)


def test_spread_of_widths_is_found_in_few_frames(rng: np.random.Generator) -> None:
    # The prior under which widths are measured takes a tenth of each away: the spread was a fifth too small.
    samples = surfaces(rng, (25, 1500), (2000.0,), width=np.exp(0.3 * rng.standard_normal(1500)))
    learnt = with_part(whole_fold(Pixels(samples=of_pixels(samples)), CAMERA), pixel_noise(), "widths")
    assert learnt is not None
    assert learnt.curve.width_spread == pytest.approx(0.3, rel=0.15)  # the scales that are tried are 14 % apart


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


@pytest.mark.compiled("learns the noise of 300 pixels")
def test_clutter_in_a_narrow_part_of_the_range_is_background_though_a_uniform_one_gains_nothing(
    rng: np.random.Generator,
) -> None:
    pixels, frames = 300, 100
    samples = np.linspace(3000.0, 5000.0, pixels) + SIGMA_MM * rng.standard_normal((frames, pixels))
    clutter = rng.random(samples.shape) < 0.08
    samples[clutter] = 700.0 + 6.0 * SIGMA_MM * rng.standard_normal(int(clutter.sum()))
    noise = learn_pixel_noise(Pixels(samples=of_pixels(samples)), CAMERA, None).noise
    assert noise.background is not None
    assert noise.background[0] / sum(noise.background) == pytest.approx(0.08, abs=0.01)
    assert noise.curve.background_density is not None
    found = layer_pixels(samples, camera_with(noise, flat()))
    assert (found.n_modes == 1).mean() > 0.98


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


FRAMES_JUMPS, PIXELS_JUMPS = 150, 120
TIME = np.linspace(-1.0, 1.0, FRAMES_JUMPS)[:, np.newaxis]
DRIFTING = pixel_noise(drift_mm=(2.0 * SIGMA_MM, 0.5 * SIGMA_MM, 0.3 * SIGMA_MM))
RANGE_MM = 2000.0


def _layers(path_sigmas: FloatArray, rng: np.random.Generator) -> Layers:
    """Layers of pixels whose range follows a path (frame, 1), in sigmas."""
    samples = RANGE_MM + SIGMA_MM * (path_sigmas + rng.standard_normal((FRAMES_JUMPS, PIXELS_JUMPS)))
    return layer_pixels(samples, camera_with(DRIFTING, flat(8.0)))


@pytest.mark.parametrize(
    "path",
    [
        0.0 * TIME,
        1.5 * TIME,
        3.0 * TIME,
        -3.0 * TIME,
        2.0 * TIME**2,
        1.5 * np.sin(2.0 * TIME),
        2.0 * TIME + 1.0 * (2.5 * TIME**3 - 1.5 * TIME),
    ],
    ids=["none", "slow", "fast", "backward", "there and back", "slowing", "of third degree"],
)
def test_smooth_drift_is_one_surface(path: FloatArray, rng: np.random.Generator) -> None:
    layers = _layers(path, rng)
    assert (layers.n_modes == 1).mean() >= 0.97
    # What is stated is the place that the drift goes through on average.
    one = layers.n_modes == 1
    assert float(np.median(layers.range[one, 0])) == pytest.approx(RANGE_MM + SIGMA_MM * path.mean(), abs=6.0)


@pytest.mark.parametrize("at", [0.25, 0.5, 0.75])
@pytest.mark.parametrize("height", [4.0, -6.0, 12.0, 60.0])
def test_a_jump_is_two_surfaces(height: float, at: float, rng: np.random.Generator) -> None:
    layers = _layers(np.where(np.arange(FRAMES_JUMPS)[:, np.newaxis] < at * FRAMES_JUMPS, 0.0, height), rng)
    assert (layers.n_modes == 2).mean() >= 0.95
    two = layers.n_modes == 2
    np.testing.assert_allclose(
        np.median(layers.range[two, :2], axis=0),
        np.sort([RANGE_MM, RANGE_MM + height * SIGMA_MM]),
        atol=0.3 * SIGMA_MM,
    )


def test_two_surfaces_that_drift_together_are_two(rng: np.random.Generator) -> None:
    both = 12.0 * (rng.random((FRAMES_JUMPS, PIXELS_JUMPS)) < 0.5) + 2.0 * TIME
    samples = RANGE_MM + SIGMA_MM * (both + rng.standard_normal((FRAMES_JUMPS, PIXELS_JUMPS)))
    layers = layer_pixels(samples, camera_with(DRIFTING, flat(8.0)))
    assert (layers.n_modes == 2).mean() >= 0.95


def test_order_of_frames_matters_only_where_noise_drifts(rng: np.random.Generator) -> None:
    ramp = np.repeat(3.0 * TIME, PIXELS_JUMPS, axis=1)
    samples = (RANGE_MM + SIGMA_MM * (ramp + rng.standard_normal((FRAMES_JUMPS, PIXELS_JUMPS)))).astype(np.float32)
    mixed = samples[rng.permutation(FRAMES_JUMPS)]
    still = pixel_noise("skewed", background=(1.0, 9.0), width_spread=0.3, memory=0.2)
    one, other = (layer_pixels(block, camera_with(still)) for block in (samples, mixed))
    for a, b in zip(one.arrays(), other.arrays(), strict=True):
        assert a.tobytes() == b.tobytes()
    one, other = (layer_pixels(block, camera_with(DRIFTING)) for block in (samples, mixed))
    assert (one.n_modes == 1).mean() >= 0.97
    assert (other.n_modes > 1).mean() >= 0.9  # a ramp of 6 sigma in any order is wider than one surface


def test_no_pixel_drifts_on_a_circle(rng: np.random.Generator) -> None:
    samples = RANGE_MM + SIGMA_MM * (2.0 * TIME + rng.standard_normal((FRAMES_JUMPS, 20)))
    still = pixel_noise()
    on_circle = EstimateOptions(unambiguous_range_mm=8000.0)
    one, other = (layer_pixels(samples, camera_with(noise, flat(8.0)), on_circle) for noise in (DRIFTING, still))
    for a, b in zip(one.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(a, b)
