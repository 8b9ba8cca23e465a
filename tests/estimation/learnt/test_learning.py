"""Each part of the noise is learnt where it is there, and dropped where it is not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal
from support.learnt_pixels import CAMERA, KNOWN, LOW_MM, SIGMA_MM, TOP_MM, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.folds import whole_fold
from tofmix.estimation.learnt.learning import LearntModel, learn_pixel_noise
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import with_part
from tofmix.estimation.learnt.sigma_curve import with_sigma
from tofmix.estimation.noise.training_pixels import Pixels
from tofmix.sensor import NoiseCurve, Sensor

FRAMES, PIXELS = 60, 300
TIME = np.linspace(-1.0, 1.0, FRAMES)[:, np.newaxis]


def _learnt(samples: FloatArray, **choices: Any) -> LearntModel:  # noqa: ANN401  those of learn_pixel_noise
    """Learn from samples (frame, pixel)."""
    pixels = Pixels(samples=np.ascontiguousarray(samples.T, dtype=np.float32))
    return learn_pixel_noise(pixels, CAMERA, None, **choices)


def _parts(model: LearntModel) -> set[str]:
    noise = model.noise
    there = {
        "shape": noise.curve.shape is not None,
        "widths": noise.curve.width_spread > 0,
        "background": noise.background is not None,
        "drift": bool(noise.drift_mm.any()),
        "memory": noise.memory > 0,
    }
    return {name for name, found in there.items() if found}


@pytest.mark.slow
def test_gaussian_noise_teaches_sigma_alone(rng: np.random.Generator) -> None:
    model = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,)))
    assert model.noise.is_gaussian
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.03)
    assert model.pixels == PIXELS
    assert np.median(model.ranges_mm) == pytest.approx(2000.0, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["skewed", "student", "laplace"])
def test_shape_is_learnt_and_nothing_else(name: str, rng: np.random.Generator) -> None:
    model = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,), errors=KNOWN[name].draw))
    assert _parts(model) == {"shape"}
    shape = model.noise.curve.shape
    assert shape is not None
    # The mean of a pixel takes a part of its errors: what is learnt is a little nearer to the Gaussian.
    at = np.linspace(-4.0, 4.0, 81)
    assert np.abs(shape.cdf(at) - KNOWN[name].cdf(at)).max() < 0.03
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_shape_is_not_made_steeper_by_surfaces_located_under_it() -> None:
    """With these samples a shape whose surfaces are located again under it has a peak that is 10 % too high."""
    samples = surfaces(np.random.default_rng(3), (FRAMES, 500), (2000.0,), errors=KNOWN["skewed"].draw)
    pixels = Pixels(samples=np.ascontiguousarray(samples.T, dtype=np.float32))
    gaussian = NoiseCurve(np.array([500.0, 5000.0]), np.full(2, SIGMA_MM))
    found = with_part(whole_fold(pixels, CAMERA), PixelNoise.of(replace(CAMERA, noise=gaussian)), "shape")
    assert found is not None
    assert found.curve.shape is not None
    at = np.linspace(-4.0, 4.0, 1601)
    peak = np.gradient(KNOWN["skewed"].cdf(at), at).max()
    assert found.curve.shape.density.max() == pytest.approx(peak, rel=0.06)


@pytest.mark.slow
def test_widths_are_learnt_and_nothing_else(rng: np.random.Generator) -> None:
    width = np.exp(0.3 * rng.standard_normal(PIXELS))
    model = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,), width=width))
    assert _parts(model) == {"widths"}
    assert model.noise.curve.width_spread == pytest.approx(0.3, abs=0.08)
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM * np.median(width), rel=0.05)


@pytest.mark.slow
def test_wide_pixels_that_seem_two_surfaces_count_in_the_spread_of_widths(rng: np.random.Generator) -> None:
    frames = 200  # with so many, the count under one width splits a third of the pixels
    width = np.exp(0.3 * rng.standard_normal(PIXELS))
    model = _learnt(surfaces(rng, (frames, PIXELS), (2000.0,), width=width))
    assert model.noise.curve.width_spread == pytest.approx(0.3, abs=0.06)


@pytest.mark.slow
def test_background_of_each_pixel_is_learnt_and_nothing_else(rng: np.random.Generator) -> None:
    share = rng.uniform(0.0, 0.9, PIXELS)
    model = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,), background=share))
    assert _parts(model) == {"background"}
    assert model.noise.background is not None
    near, far = model.noise.background
    assert near / (near + far) == pytest.approx(share.mean(), abs=0.05)
    variance = near * far / ((near + far) ** 2 * (near + far + 1.0))
    assert np.sqrt(variance) == pytest.approx(share.std(), rel=0.2)
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_drift_is_learnt_and_sigma_is_that_without_it(rng: np.random.Generator) -> None:
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], PIXELS) * TIME
    model = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,), drift_mm=drift))
    assert _parts(model) == {"drift"}
    assert model.noise.drift_mm[0] == pytest.approx(1.5 * SIGMA_MM, rel=0.15)
    assert (model.noise.drift_mm[1:] < 0.2 * SIGMA_MM).all()
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_memory_is_the_correlation_of_neighbouring_frames(rng: np.random.Generator) -> None:
    z = signal.lfilter([np.sqrt(0.75)], [1.0, -0.5], rng.standard_normal((FRAMES + 40, PIXELS)), axis=0)[40:]
    model = _learnt(2000.0 + SIGMA_MM * z, drift=False)
    assert model.noise.memory == pytest.approx(0.5, abs=0.06)
    assert "shape" not in _parts(model)


@pytest.mark.slow
def test_sigma_is_that_of_all_errors_where_drifts_follow_errors_that_remember(rng: np.random.Generator) -> None:
    z = signal.lfilter([np.sqrt(0.75)], [1.0, -0.5], rng.standard_normal((FRAMES + 40, 900)), axis=0)[40:]
    model = _learnt(2000.0 + SIGMA_MM * z)
    assert model.noise.drift_mm.any()
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.04)


@pytest.mark.slow
def test_pixels_of_background_alone_teach_background_and_not_one_wide_surface(rng: np.random.Generator) -> None:
    model = _learnt(rng.uniform(LOW_MM, TOP_MM, (FRAMES, PIXELS)))
    assert model.noise.background is not None


@pytest.mark.slow
def test_what_pixels_have_of_their_own_is_drawn_with_the_spread_and_the_tails_that_it_has(
    rng: np.random.Generator,
) -> None:
    drift = np.where(rng.random(PIXELS) < 0.5, 1.5, -1.5) * SIGMA_MM
    own = _learnt(surfaces(rng, (FRAMES, PIXELS), (2000.0,), drift_mm=drift * TIME)).pixel_effects
    assert len(own) > 0.9 * PIXELS
    assert not own[:, 0].any()  # widths are alike
    np.testing.assert_allclose(np.std(own[:, 1]), 1.5 * SIGMA_MM, rtol=0.08)
    assert np.abs(own[:, 1]).max() < 2.5 * SIGMA_MM  # a Student t of this spread has some at 6


@pytest.mark.slow
@pytest.mark.long
def test_all_parts_together_are_all_learnt(rng: np.random.Generator) -> None:
    frames, pixels = 80, PIXELS
    drift = 1.5 * SIGMA_MM * rng.choice([-1.0, 1.0], pixels) * np.linspace(-1.0, 1.0, frames)[:, np.newaxis]
    samples = surfaces(
        rng,
        (frames, pixels),
        (2000.0,),
        errors=KNOWN["skewed"].draw,
        width=np.exp(0.3 * rng.standard_normal(pixels)),
        background=rng.uniform(0.0, 0.9, pixels),
        drift_mm=drift,
    )
    model = _learnt(samples)
    assert _parts(model) - {"memory"} == {"shape", "widths", "background", "drift"}
    assert model.noise.curve.sigma(2000.0) == pytest.approx(SIGMA_MM, rel=0.1)


@pytest.mark.slow
def test_sigma_is_right_where_every_pixel_sees_two_surfaces(rng: np.random.Generator) -> None:
    near = rng.uniform(800.0, 3000.0, PIXELS)
    second = rng.random((FRAMES, PIXELS)) < rng.uniform(0.2, 0.8, PIXELS)
    samples = near + np.where(second, 600.0, 0.0) + SIGMA_MM * rng.standard_normal((FRAMES, PIXELS))
    model = _learnt(samples)
    assert _parts(model) <= {"drift"}
    sigmas = model.noise.curve.sigma_mm
    assert np.median(sigmas) == pytest.approx(SIGMA_MM, rel=0.05)
    np.testing.assert_allclose(sigmas, SIGMA_MM, rtol=0.12)  # each of twenty or so pixels


@pytest.mark.slow
@pytest.mark.parametrize("places", [(0.0, 5.0), (0.0, 4.0, 8.0)], ids=["two", "three"])
def test_sigma_is_right_where_no_cluster_stands_clear_in_any_pixel(
    places: tuple[float, ...], rng: np.random.Generator
) -> None:
    pixels, frames = 150, 100
    shares = np.cumsum(0.2 + (1.0 - 0.2 * len(places)) * rng.dirichlet(np.ones(len(places)), pixels), axis=1)
    which = (rng.random((frames, pixels, 1)) > shares[:, :-1]).sum(axis=2)
    near = rng.uniform(800.0, 3000.0, pixels)
    samples = near + SIGMA_MM * (np.array(places)[which] + rng.standard_normal((frames, pixels)))
    sigmas = _learnt(samples).noise.curve.sigma_mm
    assert np.median(sigmas) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.parametrize("name", ["gaussian", "skewed"])
def test_few_pixels_give_one_sigma_and_a_gaussian(name: str, rng: np.random.Generator) -> None:
    model = _learnt(surfaces(rng, (30, 12), (2000.0,), errors=KNOWN[name].draw))
    assert model.noise.is_gaussian
    assert len(model.noise.curve.sigma_mm) == 1
    # 360 samples tell a sigma to 4 %; by differences, and with a skewed shape, less exactly.
    assert model.noise.curve.sigma_mm[0] == pytest.approx(SIGMA_MM, rel=0.15)


def test_forbidden_parts_are_skipped_and_required_parts_are_learnt(rng: np.random.Generator) -> None:
    width = np.exp(0.3 * rng.standard_normal(90))
    samples = surfaces(rng, (40, 90), (2000.0,), errors=KNOWN["skewed"].draw, width=width)
    assert _parts(_learnt(samples, shape=False, widths=False, drift=False)) <= {"background", "memory"}
    plain = surfaces(rng, (40, 90), (2000.0,))
    insisted = _learnt(plain, shape=False, widths=True, drift=False)
    assert _parts(insisted) <= {"widths", "background"}


def test_same_pixels_give_the_same_noise(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (40, 60), (2000.0,), background=0.2)
    one, other = _learnt(samples, shape=False), _learnt(samples.copy(), shape=False)
    np.testing.assert_array_equal(one.noise.curve.sigma_mm, other.noise.curve.sigma_mm)
    assert (one.noise.background, one.noise.memory) == (other.noise.background, other.noise.memory)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "holds"), [(SIGMA_MM, True), (2.0 * SIGMA_MM, False), (0.5 * SIGMA_MM, False)])
def test_a_given_curve_holds_where_nothing_predicts_better(sigma: float, holds: bool, rng: np.random.Generator) -> None:
    given = NoiseCurve(np.array([2000.0]), np.array([sigma]))
    model = _learnt(surfaces(rng, (40, 90), (2000.0,)), instead_of=given)
    assert model.given_holds is holds


@pytest.mark.parametrize("samples", [np.full((40, 30), 2000.0), np.full((40, 30), np.nan)], ids=["constant", "none"])
def test_samples_without_a_spread_give_no_noise(samples: FloatArray) -> None:
    with pytest.raises(ValueError, match="no two samples of a pixel differ, or none is valid"):
        _learnt(samples)


def test_clusters_of_few_samples_are_none_because_only_narrow_pixels_have_some() -> None:
    samples = np.random.default_rng(1).normal(2000.0, 6.0, (300, 8)).astype(np.float32)
    curve = NoiseCurve(np.array([2000.0]), np.array([6.0]))
    noise = PixelNoise.gaussian(curve, 0.0)
    sensor = Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0)
    few = whole_fold(Pixels(samples=samples), sensor)
    assert len(few.clusters(noise).pixel) == 0
    assert with_sigma(few, noise).curve.sigma_mm == pytest.approx(6.0, rel=0.1)  # from clusters, it is 0.7 times that
    many = whole_fold(Pixels(samples=np.hstack([samples, samples[::-1]])), sensor)
    assert len(many.clusters(noise).pixel) > 0.95 * len(samples)
