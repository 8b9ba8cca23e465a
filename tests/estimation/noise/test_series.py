"""Sigma from differences of samples: right where every pixel sees two surfaces, or background, or a slow drift."""

import numpy as np
import pytest
from support.learnt_pixels import KNOWN, LOW_MM, TOP_MM, surfaces

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.noise.series import sigma_from_differences


def _sigma(samples: FloatArray) -> float:
    """Typical sigma, mm, of samples (frame, pixel)."""
    found = sigma_from_differences(np.ascontiguousarray(samples.T, dtype=np.float32))
    assert found is not None
    return float(np.median(found[1]))


@pytest.mark.slow
@pytest.mark.parametrize("background", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("places", [(2000.0,), (1800.0, 2400.0), (1500.0, 1900.0, 3000.0)])
def test_sigma_is_right_for_any_number_of_surfaces_in_all_pixels(
    places: tuple[float, ...], background: float, rng: np.random.Generator
) -> None:
    shares = tuple(np.full(len(places), 1.0 / len(places)))
    samples = surfaces(rng, (100, 400), places, shares, background=background)
    assert _sigma(samples) == pytest.approx(20.0, rel=0.05)


def test_sigma_follows_range_where_every_pixel_sees_two_surfaces(rng: np.random.Generator) -> None:
    near = rng.uniform(600.0, 2500.0, 1500)
    place = np.where(rng.random((80, 1500)) < 0.5, near, near + 2500.0)
    samples = place + (5.0 + 0.01 * place) * rng.standard_normal(place.shape)
    found = sigma_from_differences(np.ascontiguousarray(samples.T, dtype=np.float32))
    assert found is not None
    ranges, sigmas = found
    assert len(ranges) >= 4
    assert (np.diff(ranges) > 0).all()
    # A bin is a quarter of its range wide, and sigma is the median over it.
    np.testing.assert_allclose(sigmas, 5.0 + 0.01 * ranges, rtol=0.08)


def test_slow_drift_does_not_widen_the_differences(rng: np.random.Generator) -> None:
    drift = 100.0 * np.linspace(-1.0, 1.0, 400)[:, np.newaxis]
    assert _sigma(surfaces(rng, (400, 100), (2000.0,), drift_mm=drift)) == pytest.approx(20.0, rel=0.05)


def test_invalid_samples_are_left_out(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 300), (1800.0, 2400.0), (0.5, 0.5))
    samples[rng.random(samples.shape) < 0.5] = np.nan
    assert _sigma(samples) == pytest.approx(20.0, rel=0.05)


@pytest.mark.parametrize("name", KNOWN)
def test_sigma_of_any_shape_is_that_of_its_differences(name: str, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 400), (1800.0, 2400.0), (0.5, 0.5), errors=KNOWN[name].draw)
    pair = KNOWN[name].draw(rng, (2, 200000))
    wanted = 20.0 * float(np.median(np.abs(pair[0] - pair[1]))) / 0.9539
    assert _sigma(samples) == pytest.approx(wanted, rel=0.05)


@pytest.mark.parametrize(
    "samples",
    [
        np.full((50, 30), np.nan),
        np.full((50, 30), 2000.0),
        np.where(np.arange(30) == 0, 2000.0, np.nan) * np.ones((50, 1)),
        np.full((50, 1), 2000.0),
    ],
    ids=["no sample", "a constant", "one sample a pixel", "one frame"],
)
def test_equal_samples_give_no_sigma(samples: Float32Array) -> None:
    assert sigma_from_differences(np.ascontiguousarray(samples, dtype=np.float32)) is None


def test_background_alone_gives_no_sigma(rng: np.random.Generator) -> None:
    for _ in range(5):
        samples = rng.uniform(LOW_MM, TOP_MM, (200, 80)).astype(np.float32)
        assert sigma_from_differences(samples) is None
