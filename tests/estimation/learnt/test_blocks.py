"""Layers under the learnt noise: which estimates count, their errors, thresholds from drawn noise, and the count."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import interpolate
from support.learnt_pixels import CAMERA, KNOWN, LOW_MM, SIGMA_MM, TOP_MM, camera_with, flat, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.blocks import layers_with_learnt
from tofmix.estimation.learnt.bootstrap import SAMPLES, SHARES, KnownThresholds, calibrate
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD
from tofmix.estimation.learnt.model import GainThresholds, PixelNoise, read_gains
from tofmix.estimation.mixture.counting import FALSE_ALARMS, gain_table
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode, counts_with_learnt
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.noise_shape import DRIFTS
from tofmix.sensor import NoiseCurve, Sensor

WIDE = camera_with(pixel_noise(width_spread=0.4))
PLAIN = Sensor(name="plain", range_max_mm=6000.0, noise=NoiseCurve(np.array([1000.0]), np.array([SIGMA_MM])))


@pytest.mark.parametrize(
    ("options", "counts"),
    [
        ({}, True),
        ({"sigma": SigmaMode.TIED}, True),
        ({"sigma": SigmaMode.FREE}, False),
        ({"refine": Refine.NONE}, False),
        ({"paper": True}, False),
    ],
)
def test_paper_options_use_a_gaussian_alone(options: dict[str, Any], counts: bool) -> None:
    assert counts_with_learnt(WIDE, EstimateOptions(**options)) is counts
    assert not counts_with_learnt(PLAIN, EstimateOptions(**options))


def test_tied_sigmas_give_no_pixel_a_width(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 20), (2000.0,), width=1.3)
    free = layer_pixels(samples, WIDE)
    tied = layer_pixels(samples, WIDE, EstimateOptions(sigma=SigmaMode.TIED))
    assert free.noise_width is not None
    assert tied.noise_width is not None
    assert float(np.median(free.noise_width)) == pytest.approx(1.3, rel=0.05)
    np.testing.assert_array_equal(tied.noise_width, 1.0)


@pytest.mark.parametrize("memory", [0.2, 0.5, 0.9])
def test_memory_widens_errors_of_range_by_that_of_a_mean_of_ar1_noise(memory: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 20), (2000.0,))
    without, with_it = (layer_pixels(samples, camera_with(pixel_noise("skewed", memory=m))) for m in (0.0, memory))
    # The variance of the mean of n samples of AR(1), over sigma^2 / n, for large n.
    lags = np.arange(1, 3000)
    inflation = 1.0 + 2.0 * float((memory**lags).sum())
    np.testing.assert_allclose(with_it.range_stderr[:, 0], np.sqrt(inflation) * without.range_stderr[:, 0], rtol=1e-5)
    np.testing.assert_array_equal(with_it.range, without.range)


def test_probability_is_the_chance_that_noise_gains_as_little(rng: np.random.Generator) -> None:
    # A ladder of gains, of which chance reaches the last once in 10^4.
    ladder = np.linspace(1.0, 12.0, len(FALSE_ALARMS))
    gains = flat()._replace(more=ladder[np.newaxis, np.newaxis], first=ladder[np.newaxis])
    samples = surfaces(rng, (60, 400), (2000.0, 2000.0 + 3.0 * SIGMA_MM), (0.9, 0.1))
    layers = layer_pixels(samples, camera_with(pixel_noise("skewed"), gains), EstimateOptions(false_alarm=0.02))
    found = np.isfinite(layers.range)
    assert (layers.probability[found] >= 1.0 - 0.02).all()
    assert (layers.probability[found] <= 1.0).all()
    strict = layer_pixels(samples, camera_with(pixel_noise("skewed"), gains), EstimateOptions(false_alarm=0.0001))
    assert (strict.n_modes <= layers.n_modes).all()
    assert (strict.n_modes < layers.n_modes).any()


def test_without_learnt_noise_the_kernel_is_not_called() -> None:
    with pytest.raises(ValueError, match="carries no learnt noise"):
        layers_with_learnt(
            np.zeros((1, 5), dtype=np.float32), beam_of(PLAIN), PLAIN, EstimateOptions(), Layers.empty((1,), 6)
        )


NEAR_MM = 2000.0


def _found(samples: FloatArray, noise: PixelNoise, count: int) -> tuple[Layers, FloatArray]:
    """Layers, and which pixels have the right number of them."""
    layers = layer_pixels(samples, camera_with(noise))
    return layers, layers.n_modes == count


def _held(errors: FloatArray, stated: FloatArray, margin: float) -> None:
    """The scatter, by its central 95 %, is what is stated, and so is that of the errors over their own."""
    low, high = np.quantile(errors, [0.025, 0.975])
    assert (high - low) / (2 * 1.95996) == pytest.approx(float(np.sqrt(np.mean(stated**2))), rel=margin)
    low, high = np.quantile(errors / stated, [0.025, 0.975])
    assert (high - low) / (2 * 1.95996) == pytest.approx(1.0, rel=margin)


@pytest.mark.compiled("thousands of pixels")
@pytest.mark.parametrize("name", KNOWN)
def test_error_of_one_surface_is_its_scatter(name: str, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (60, 1500), (NEAR_MM,), errors=KNOWN[name].draw)
    layers, right = _found(samples, pixel_noise(name), 1)
    assert right.mean() > 0.98
    # Fisher's information is a sample of 60's only in the limit: a sharp peak is farther from it.
    _held(layers.range[right, 0] - NEAR_MM, layers.range_stderr[right, 0], 0.2 if name == "laplace" else 0.1)


CASES: dict[str, tuple[dict[str, Any], str]] = {
    "Gaussian": ({}, "gaussian"),
    "skewed": ({}, "skewed"),
    "on background": ({"background": (2.0, 6.0)}, "gaussian"),
}


@pytest.mark.slow
@pytest.mark.compiled("thousands of pixels")
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("distance", [3.5, 8.0])
def test_errors_of_two_surfaces_are_their_scatter(name: str, distance: float, rng: np.random.Generator) -> None:
    parts, shape = CASES[name]
    background = 0.25 if parts else 0.0
    truth = NEAR_MM, NEAR_MM + distance * SIGMA_MM
    samples = surfaces(rng, (150, 1000), truth, (0.4, 0.6), errors=KNOWN[shape].draw, background=background)
    layers, right = _found(samples, pixel_noise(shape, **parts), 2)
    assert right.mean() > 0.95
    for i in range(2):
        _held(layers.range[right, i] - truth[i], layers.range_stderr[right, i], 0.15)
    shares = (1.0 - background) * np.array([0.4, 0.6])
    if not parts:  # a prior pulls the shares of background, and so of surfaces, towards its mean
        for i in range(2):
            _held(layers.weight[right, i] - shares[i], layers.weight_stderr[right, i], 0.15)


@pytest.mark.compiled("thousands of pixels")
def test_error_knows_of_the_pixels_own_width_and_drift(rng: np.random.Generator) -> None:
    pixels, time = 1500, np.linspace(-1.0, 1.0, 80)
    width = np.exp(0.3 * rng.standard_normal(pixels))
    drift = rng.normal(0.0, 15.0, pixels) * time[:, np.newaxis]
    samples = surfaces(rng, (80, pixels), (NEAR_MM,), width=width, drift_mm=drift)
    noise = pixel_noise(width_spread=0.3, drift_mm=(15.0, *(0.0,) * (DRIFTS - 1)))
    layers, right = _found(samples, noise, 1)
    assert right.mean() > 0.97
    away = layers.range[right, 0] - NEAR_MM
    _held(away, layers.range_stderr[right, 0], 0.1)
    # A pixel's error goes with its own width: half of the pixels are wide, half are narrow.
    assert layers.noise_width is not None
    wide = layers.noise_width[right] > 1.0
    ratio = layers.range_stderr[right, 0][wide].mean() / layers.range_stderr[right, 0][~wide].mean()
    assert ratio == pytest.approx(away[wide].std() / away[~wide].std(), rel=0.15)


@pytest.mark.compiled("thousands of pixels")
def test_errors_of_samples_that_remember_are_their_scatter(rng: np.random.Generator) -> None:
    frames, pixels, memory = 200, 1500, 0.5
    fresh = rng.standard_normal((frames, pixels))
    z = fresh.copy()
    for j in range(1, frames):
        z[j] = memory * z[j - 1] + np.sqrt(1.0 - memory**2) * fresh[j]
    layers, right = _found(NEAR_MM + SIGMA_MM * z, pixel_noise(memory=memory), 1)
    assert right.mean() > 0.8
    _held(layers.range[right, 0] - NEAR_MM, layers.range_stderr[right, 0], 0.1)


def test_one_surface_alone_has_the_error_of_fishers_information() -> None:
    for name in KNOWN:
        noise = pixel_noise(name)
        law = noise.laws()[0]
        z = KNOWN[name].law.ppf((np.arange(100) + 0.5) / 100)
        samples = NEAR_MM + SIGMA_MM * (z - KNOWN[name].middle) / KNOWN[name].half
        layers = layer_pixels(samples[:, np.newaxis], camera_with(noise))
        assert layers.n_modes[0] == 1
        # p(c_r) of 10^-4 takes next to nothing of any sample.
        assert layers.range_stderr[0, 0] == pytest.approx(SIGMA_MM / np.sqrt(100 * law.information), rel=0.02)


RANGES_MM = np.array([1500.0, 2500.0, 4000.0])


def _calibrated(
    noise: PixelNoise, samples: tuple[int, int], draws: int, workers: int = 1, told: list[tuple[int, int]] | None = None
) -> GainThresholds:
    def progress(done: int, of: int) -> None:
        if told is not None:
            told.append((done, of))

    beam = beam_of(camera_with(noise))
    return calibrate(noise, beam, RANGES_MM, samples=samples, draws=draws, workers=workers, progress=progress)


FULL = pixel_noise("skewed", background=(1.0, 5.0), width_spread=0.2, drift_mm=(10.0, 0.0, 0.0), memory=0.3)


def test_same_noise_gives_the_same_gains_for_any_workers() -> None:
    told: list[tuple[int, int]] = []
    one = _calibrated(FULL, (10, 40), 120, told=told)
    for other in (_calibrated(FULL, (10, 40), 120), _calibrated(FULL, (10, 40), 120, workers=3)):
        for a, b in zip(one, other, strict=True):
            assert a.tobytes() == b.tobytes()
    cells = 4 * (len(SHARES) + 1)  # 10, 12, 25 and 40 samples
    assert told == [(done + 1, cells) for done in range(cells)]


@pytest.mark.parametrize(
    ("samples", "numbers"),
    [
        ((10, 40), [10, 12, 25, 40]),
        ((100, 100), [100]),
        ((1, 2), [3]),
        ((3, 5000), list(SAMPLES)),
        ((30, 10), [10]),
    ],
)
def test_gains_are_drawn_for_the_numbers_of_samples_that_pixels_have(
    samples: tuple[int, int], numbers: list[int]
) -> None:
    found = _calibrated(pixel_noise("skewed"), samples, 2)
    np.testing.assert_allclose(np.exp(found.log_n), numbers, rtol=1e-12)
    assert found.more.shape == (len(numbers), 1, len(FALSE_ALARMS))
    assert found.first.shape == (len(numbers), len(FALSE_ALARMS))


@pytest.mark.slow
def test_gains_of_a_gaussian_are_those_of_the_gaussian_counts_own_table() -> None:
    found = _calibrated(pixel_noise(), (30, 200), 6000)
    table = gain_table(200)
    for n, row in zip(np.exp(found.log_n), found.more[:, 0], strict=True):
        # From one chance in a hundred to one in a thousand: 60 draws, and a fitted tail.
        np.testing.assert_allclose(row[3:7], table[round(n), 3:7], atol=0.6)


HELD = {
    "skewed": pixel_noise("skewed"),
    "long-tailed": pixel_noise("student"),
    "Gaussian on background": pixel_noise(background=(1.0, 4.0)),
    "the same share in all pixels": pixel_noise(background=(11.0, 39.0)),
    "widths and background": pixel_noise("skewed", background=(1.0, 4.0), width_spread=0.2),
}


def _background(noise: PixelNoise, pixels: int, rng: np.random.Generator) -> FloatArray:
    if noise.background is None:
        return np.full(pixels, noise.p_outlier)
    return np.asarray(rng.beta(*noise.background, pixels), dtype=np.float64)


def test_pixels_as_they_are_set_the_gains_and_not_the_long_tails_of_priors() -> None:
    noise, chance = pixel_noise(drift_mm=(1.3 * SIGMA_MM, 0.0, 0.0), width_spread=0.3), FALSE_ALARMS.index(0.001)
    beam = beam_of(camera_with(noise))
    own = np.zeros((40, 4))
    own[:, 1] = np.where(np.arange(40) % 2, 1.5, -1.5) * SIGMA_MM  # all drift by as much, and none is wide
    by_prior = calibrate(noise, beam, RANGES_MM, samples=(15, 15), draws=3000).more[0, 0, chance]
    as_they_are = calibrate(noise, beam, RANGES_MM, samples=(15, 15), pixel_effects=own, draws=3000).more[0, 0, chance]
    assert as_they_are < by_prior - 1.0


def test_neither_background_nor_a_jump_makes_surfaces_dear() -> None:
    found = _calibrated(pixel_noise(background=(5.0, 40.0)), (30, 30), 600)
    # Three or four of 30 samples within a sigma or two are what chance brings together: 10 nat.
    assert found.first[0, FALSE_ALARMS.index(0.01)] < 8.0
    chance = FALSE_ALARMS.index(0.01)
    still = _calibrated(pixel_noise(), (100, 100), 1500).more[0, 0, chance]
    moves = _calibrated(pixel_noise(drift_mm=(1.5 * SIGMA_MM, 0.0, 0.0)), (100, 100), 1500).more[0, 0, chance]
    assert moves < still + 1.0


@pytest.mark.slow
@pytest.mark.compiled("tens of thousands of pixels")
@pytest.mark.parametrize("name", HELD)
def test_false_alarms_on_fresh_pixels_have_the_requested_rate(name: str, rng: np.random.Generator) -> None:
    noise, pixels = HELD[name], 12000
    sensor = camera_with(noise, _calibrated(noise, (60, 100), 4000))
    shape = name if name in KNOWN else ("gaussian" if noise.curve.shape is None else "skewed")
    errors = KNOWN["student" if name == "long-tailed" else shape].draw
    width = np.exp(SCALE_OF_SPREAD * noise.curve.width_spread * np.clip(rng.standard_t(4.0, pixels), -4.0, 4.0))
    share = _background(noise, pixels, rng)
    samples = surfaces(rng, (80, pixels), (2000.0,), errors=errors, width=width, background=share)
    for promised in (0.01, 0.001):
        layers = layer_pixels(samples, sensor, EstimateOptions(false_alarm=promised, max_layers=3))
        found = float((layers.n_modes > 1).mean())
        # Poisson's bounds of the counts that 0.5 to 2 times the promise let expect.
        assert 0.5 * promised * pixels - 3.0 * np.sqrt(0.5 * promised * pixels) <= found * pixels
        assert found * pixels <= 2.0 * promised * pixels + 3.0 * np.sqrt(2.0 * promised * pixels)
    enough = share < 0.8
    assert (layers.n_modes[enough] >= 1).mean() > 0.999


NOISE = pixel_noise("skewed", drift_mm=(10.0, 0.0, 0.0))


class Asked:
    """Tables of few draws, known to one test; and how many were drawn."""

    def __init__(self, most: int = 32) -> None:
        self.drawn = 0
        self._known = KnownThresholds(self._few, most=most)

    def _few(self, *given: object, **named: object) -> GainThresholds:
        self.drawn += 1
        return calibrate(*given, draws=40, **named)  # type: ignore[arg-type]

    def table(
        self, noise: PixelNoise = NOISE, ranges_mm: FloatArray = RANGES_MM, *, workers: int = 1
    ) -> GainThresholds:
        return self._known(noise, beam_of(camera_with(noise)), ranges_mm.copy(), samples=(20, 20), workers=workers)


def test_the_same_noise_is_drawn_once_whatever_the_workers() -> None:
    asked = Asked()
    first, again = asked.table(), asked.table(replace(NOISE), workers=2)
    assert asked.drawn == 1
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("other", ["drift", "ranges"])
def test_other_noise_or_other_ranges_are_drawn_anew(other: str) -> None:
    asked = Asked()
    first = asked.table()
    if other == "drift":
        then = asked.table(replace(NOISE, drift_mm=np.array([30.0, 0.0, 0.0])))
    else:
        then = asked.table(ranges_mm=RANGES_MM + 700.0)
    assert asked.drawn == 2
    assert not np.array_equal(first.more, then.more)


@pytest.fixture
def gains() -> GainThresholds:
    rng = np.random.default_rng(8)
    chances = len(FALSE_ALARMS)
    return GainThresholds(
        log_n=np.log([5.0, 20.0, 300.0]),
        background=np.array([0.0, 0.1, 0.5, 0.8]),
        more=rng.uniform(1.0, 9.0, (3, 4, chances)),
        first=rng.uniform(1.0, 9.0, (3, chances)),
    )


@pytest.mark.parametrize("n", [5.0, 12.0, 20.0, 299.0])
@pytest.mark.parametrize("background", [0.0, 0.05, 0.1, 0.33, 0.8])
def test_gains_are_interpolated_as_scipy_does(gains: GainThresholds, n: float, background: float) -> None:
    out = np.zeros(len(FALSE_ALARMS))
    read_gains(n, background, False, gains, out)  # noqa: FBT003  a kernel's flag
    wanted = interpolate.RegularGridInterpolator((gains.log_n, gains.background), gains.more)((np.log(n), background))
    np.testing.assert_allclose(out, wanted, rtol=1e-12)
    read_gains(n, background, True, gains, out)  # noqa: FBT003  likewise
    for c in range(len(out)):
        assert out[c] == pytest.approx(np.interp(np.log(n), gains.log_n, gains.first[:, c]), rel=1e-12)


PLACES = 1500.0, 1500.0 + 6 * SIGMA_MM, 3000.0
SHARES_COUNTING = {1: (1.0,), 2: (0.4, 0.6), 3: (0.3, 0.3, 0.4)}
ON_BACKGROUND = (2.0, 6.0)


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("name", KNOWN)
def test_surfaces_six_sigma_apart_are_counted_for_any_shape(name: str, count: int, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (120, 200), PLACES[:count], SHARES_COUNTING[count], errors=KNOWN[name].draw)
    layers = layer_pixels(samples, camera_with(pixel_noise(name), flat(8.0)))
    assert (layers.n_modes == count).mean() >= 0.985
    right = layers.n_modes == count
    np.testing.assert_allclose(np.median(layers.range[right, :count], axis=0), PLACES[:count], atol=0.1 * SIGMA_MM)
    np.testing.assert_allclose(layers.weight[right, :count].mean(axis=0), SHARES_COUNTING[count], atol=0.01)
    assert np.isin(layers.status[right], [Status.OK, Status.NOT_CONVERGED]).mean() >= 0.99  # corners are slow


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("background", [0.0, 0.3, 0.6, 0.85])
def test_background_of_each_pixel_is_found_and_its_surface_too(background: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (200, 200), (2000.0,), background=background)
    layers = layer_pixels(samples, camera_with(pixel_noise(background=ON_BACKGROUND), flat(9.0, 9.0)))
    assert (layers.n_modes == 1).mean() >= 0.98
    near, far = ON_BACKGROUND
    with_prior = (200 * background + near) / (200 + near + far)
    assert layers.weight_outlier.mean() == pytest.approx(with_prior, abs=0.01)
    one = layers.n_modes == 1
    total = layers.weight[one, 0] + layers.weight_outlier[one] + layers.weight_no_return[one]
    np.testing.assert_allclose(total, 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["gaussian", "skewed"])
def test_background_alone_has_no_surface(name: str, rng: np.random.Generator) -> None:
    samples = rng.uniform(LOW_MM, TOP_MM, (100, 150))
    layers = layer_pixels(samples, camera_with(pixel_noise(name, background=ON_BACKGROUND), flat(9.0, 16.0)))
    assert (layers.n_modes == 0).mean() >= 0.97
    none = layers.n_modes == 0
    assert (layers.status[none] == Status.NO_SURFACE).all()
    # Where a sample lies near r_max, it may be c_0's.
    np.testing.assert_allclose(layers.weight_outlier[none] + layers.weight_no_return[none], 1.0, atol=1e-5)
    assert (layers.weight_outlier[none] > 0.9).all()
    assert np.isnan(layers.range[none]).all()


@pytest.mark.compiled("hundreds of pixels")
@pytest.mark.parametrize("distance", [4.0, 6.0, 12.0])
def test_two_surfaces_are_not_one_wide_one_where_widths_are_free(distance: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (120, 200), (2000.0, 2000.0 + distance * SIGMA_MM), (0.5, 0.5))
    layers = layer_pixels(samples, camera_with(pixel_noise(width_spread=0.2)))
    assert (layers.n_modes == 2).mean() >= 0.97


@pytest.mark.compiled("hundreds of pixels")
def test_a_wide_pixel_is_one_surface_and_its_width_is_stated(rng: np.random.Generator) -> None:
    width = np.repeat([0.6, 1.0, 1.6], 100)
    samples = surfaces(rng, (150, 300), (2000.0,), width=width)
    layers = layer_pixels(samples, camera_with(pixel_noise(width_spread=0.3)))
    assert (layers.n_modes == 1).mean() >= 0.98
    assert layers.noise_width is not None
    for wide in (0.6, 1.0, 1.6):
        found = layers.noise_width[width == wide]
        assert float(np.median(found)) == pytest.approx(wide, rel=0.05)
        np.testing.assert_allclose(layers.sigma[width == wide, 0], SIGMA_MM * found, rtol=1e-5)


def test_samples_at_the_end_of_range_are_no_return_and_no_surface(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (150, 30), (2000.0, TOP_MM), (0.7, 0.3))
    layers = layer_pixels(samples, camera_with(pixel_noise(background=ON_BACKGROUND)))
    np.testing.assert_array_equal(layers.n_modes, 1)
    np.testing.assert_allclose(layers.weight_no_return.mean(), 0.3, atol=0.03)


def _with_fewest(samples: FloatArray) -> FloatArray:
    out = np.full((10, 3), np.nan)
    out[: samples.size, 0] = samples
    out[:2, 1] = 2000.0, 2010.0
    return out


@pytest.mark.parametrize("background", [None, ON_BACKGROUND])
def test_three_samples_together_are_a_surface_and_fewer_are_too_few(background: tuple[float, float] | None) -> None:
    samples = _with_fewest(np.array([1990.0, 2000.0, 2015.0]))
    layers = layer_pixels(samples, camera_with(pixel_noise("skewed", background=background)))
    assert layers.n_modes.tolist() == [1, 0, 0]
    assert layers.status.tolist() == [Status.OK, Status.TOO_FEW_SAMPLES, Status.TOO_FEW_SAMPLES]
    assert abs(layers.range[0, 0] - 2000.0) < SIGMA_MM


@pytest.mark.parametrize("samples", ["constant", "steps of two sigma", "two constants"])
def test_equal_and_coarse_samples_are_fitted_without_trouble(samples: str, rng: np.random.Generator) -> None:
    block = {
        "constant": np.full((60, 5), 2000.0),
        "steps of two sigma": 2 * SIGMA_MM * np.rint(rng.normal(2010.0, SIGMA_MM, (60, 5)) / (2 * SIGMA_MM)),
        "two constants": np.where(np.arange(60)[:, np.newaxis] % 2 == 0, 2000.0, 3000.0) * np.ones(5),
    }[samples]
    for noise in (pixel_noise("skewed"), pixel_noise(width_spread=0.3, background=ON_BACKGROUND, drift_mm=(9.0,) * 3)):
        layers = layer_pixels(block, camera_with(noise))
        assert (layers.n_modes >= 1).all()
        if samples != "steps of two sigma":  # they are wider than the curve says
            assert (layers.n_modes == (2 if samples == "two constants" else 1)).all()
        found = np.isfinite(layers.range)
        for name in ("range_stderr", "weight_stderr", "probability", "sigma", "weight"):
            assert np.isfinite(getattr(layers, name)[found]).all()
    assert CAMERA.learnt is None
