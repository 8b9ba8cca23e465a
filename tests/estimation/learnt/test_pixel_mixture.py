"""The learnt mixture of a pixel, as it is drawn: its density, its parts, and the drift that its samples show."""

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support.learnt_noises import ALL, SIGMA_MM, SPAN_MM, Parts, camera, made

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.law import log_prior_t
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.pixel_mixture import PixelMixture, legendre, pixel_mixture, times

DRIFTING = Parts(drift_mm=(60.0, 20.0, 10.0))


def mixture(
    parts: Parts,
    samples: FloatArray | None = None,
    *,
    ranges: tuple[float, ...] = (2000.0,),
    circle: float | None = None,
) -> PixelMixture:
    """A pixel with surfaces of equal shares, and 10 % of background."""
    count = len(ranges)
    return pixel_mixture(
        camera(parts, (1, 1)),
        range_mm=np.array(ranges),
        sigma_mm=np.full(count, SIGMA_MM),
        weight=np.full(count, 0.9 / count),
        width=1.0,
        background=0.1,
        no_return=0.0,
        samples_mm=samples,
        unambiguous_range_mm=circle,
    )


@pytest.mark.parametrize("parts", [Parts(), ALL])
def test_the_density_has_the_area_one(parts: Parts) -> None:
    rng = np.random.default_rng(3)
    shown = mixture(parts, 2000.0 + 40.0 * np.linspace(-1, 1, 80) + SIGMA_MM * rng.standard_normal(80))
    range_mm = np.linspace(SPAN_MM[0] - 1.0, SPAN_MM[1] + 1.0, 200_001)
    assert trapezoid(shown.total(range_mm), range_mm) == pytest.approx(1.0, abs=2e-4)
    assert trapezoid(shown.component(0, range_mm), range_mm) == pytest.approx(0.9, abs=2e-4)


def test_component_and_background_are_the_sensors() -> None:
    shown = mixture(Parts(shape=ALL.shape))
    z = np.array([-1.5, 0.0, 1.0, 4.0])
    assert ALL.shape is not None
    expected = 0.9 * ALL.shape.pdf(z) / SIGMA_MM
    np.testing.assert_allclose(shown.component(0, 2000.0 + SIGMA_MM * z), expected, rtol=0.02)
    floor = mixture(Parts()).floor(np.array([SPAN_MM[0] - 1.0, 1000.0, 4000.0, SPAN_MM[1] + 1.0]))
    np.testing.assert_allclose(floor, [0.0, 0.1 / 5000.0, 0.1 / 5000.0, 0.0])


def test_share_without_a_return_lies_at_the_end_of_the_range() -> None:
    shown = pixel_mixture(
        camera(Parts(), (1, 1)),
        range_mm=np.zeros(0),
        sigma_mm=np.zeros(0),
        weight=np.zeros(0),
        width=np.nan,
        background=np.nan,
        no_return=1.0,
        samples_mm=None,
    )
    range_mm = np.linspace(5000.0, 5600.0, 6001)
    density = shown.total(range_mm)
    assert range_mm[density.argmax()] == pytest.approx(SPAN_MM[1])
    assert trapezoid(density, range_mm) == pytest.approx(1.0, abs=1e-6)
    assert (shown.width, shown.background) == (1.0, 0.0)


@pytest.mark.parametrize("size", [1.0, 8.0])
def test_the_drift_of_a_pixel_is_found_from_its_samples(size: float) -> None:
    rng = np.random.default_rng(4)
    true = size * np.array([18.0, -8.0, 3.0])
    samples = 2000.0 + true @ legendre(times(400)) + SIGMA_MM * rng.standard_normal(400)
    samples[rng.random(400) < 0.1] = np.nan
    found = mixture(DRIFTING, samples)
    np.testing.assert_allclose(found.drift_mm[0], true, atol=4.5 * SIGMA_MM / np.sqrt(360 / 7))
    np.testing.assert_allclose(found.drift_mm[0], true, atol=7.0)
    extent = float(np.ptp(true @ legendre(times(400))))
    assert found.drift_extent_mm()[0] == pytest.approx(extent, rel=0.1, abs=6.0)


def test_drifts_are_each_surfaces_own_or_none() -> None:
    rng = np.random.default_rng(5)
    first = rng.random(600) < 0.5
    moves = np.where(first, 40.0, -30.0) * times(600)
    samples = np.where(first, 2000.0, 2600.0) + moves + SIGMA_MM * rng.standard_normal(600)
    found = mixture(DRIFTING, samples, ranges=(2000.0, 2600.0))
    np.testing.assert_allclose(found.drift_mm[:, 0], [40.0, -30.0], atol=6.0)
    samples = 2000.0 + 40.0 * times(50)
    for shown, drifts in (
        (mixture(DRIFTING), True),
        (mixture(DRIFTING, samples, circle=5300.0), False),
        (mixture(Parts(), samples), False),
    ):
        assert not shown.drift_mm.any()
        assert shown.drifts == drifts


@pytest.mark.slow  # compiles the estimator
def test_the_drift_is_that_of_the_estimator() -> None:
    """Its log likelihood holds it: at any other drift the samples of a pixel of one layer have less."""
    case = made(Parts(drift_mm=(40.0, 10.0, 5.0)), frames=60, image=(4, 6))
    layers, sensor = case.layers(), case.sensor
    law, _ = PixelNoise.of(sensor).laws()
    for row, col in np.ndindex(4, 6):
        assert layers.n_modes[row, col] == 1
        samples = case.samples_mm[:, row, col].astype(np.float32).astype(np.float64)
        first = {name: getattr(layers, name)[row, col, :1].astype(float) for name in ("range", "sigma", "weight")}
        shown = pixel_mixture(
            sensor,
            range_mm=first["range"],
            sigma_mm=first["sigma"],
            weight=first["weight"],
            width=1.0,
            background=float(layers.weight_outlier[row, col]),
            no_return=0.0,
            samples_mm=samples,
        )
        still = samples - shown.drift_mm[0] @ legendre(times(60))
        z = (still - shown.range_mm[0]) / shown.sigma_mm[0]
        density = shown.weight[0] * np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * shown.sigma_mm[0])
        value = np.log(density + shown.floor(samples)).sum()
        value += sum(log_prior_t(c, s) for c, s in zip(shown.drift_mm[0], law.drift_mm, strict=True))
        b, near, far = shown.background, law.background_near, law.background_far
        peak = near / (near + far)
        value += near * np.log(b / peak) + far * np.log((1.0 - b) / (1.0 - peak))
        assert value == pytest.approx(float(layers.log_likelihood[row, col]), abs=0.02)
