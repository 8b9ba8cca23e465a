"""Gains that noise reaches by chance: drawn the same each time, and kept by pixels that no draw has seen."""

import numpy as np
import pytest
from support.learnt_pixels import KNOWN, LOW_MM, SIGMA_MM, TOP_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.bootstrap import SAMPLES, SHARES, calibrate
from tofmix.estimation.learnt.law import SCALE_OF_SPREAD
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.thresholds import GainThresholds
from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS, gain_table
from tofmix.estimation.settings import EstimateOptions

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


def test_gains_ascend_as_chances_fall() -> None:
    found = _calibrated(FULL, (12, 25), 200)
    assert (np.diff(found.more, axis=-1) > 0).all()
    assert (np.diff(found.first, axis=-1) > 0).all()
    assert (found.more >= 0).all()
    np.testing.assert_array_equal(found.background, SHARES)


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


def test_a_strong_prior_of_background_makes_no_first_surface_dear() -> None:
    found = _calibrated(pixel_noise(background=(5.0, 40.0)), (30, 30), 600)
    # Three or four of 30 samples within a sigma or two are what chance brings together: 10 nat.
    assert found.first[0, FALSE_ALARMS.index(0.01)] < 8.0


def test_a_jump_alone_makes_no_further_surface_dear() -> None:
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


@pytest.mark.slow
@pytest.mark.compiled("thousands of pixels")
def test_background_alone_gives_surfaces_at_most_at_the_requested_rate(rng: np.random.Generator) -> None:
    noise = pixel_noise(background=(1.0, 4.0))
    sensor = camera_with(noise, _calibrated(noise, (60, 100), 4000))
    layers = layer_pixels(rng.uniform(LOW_MM, TOP_MM, (80, 8000)), sensor)
    assert (layers.n_modes > 0).mean() <= 0.003
