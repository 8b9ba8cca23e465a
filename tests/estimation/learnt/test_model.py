"""The noise model: what a sensor carries of it, and comes back from one, is the same to the last digit."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import CAMERA, camera_with, flat, pixel_noise

from tofmix.estimation.learnt.law import SCALE_OF_SPREAD
from tofmix.estimation.learnt.model import SURE_SAMPLES, PixelNoise, thresholds_of

FULL = pixel_noise("skewed", background=(1.0, 9.0), width_spread=0.3, drift_mm=(5.0, 0.0, 2.0), memory=0.4)


def test_pixel_noise_round_trips_through_the_sensor() -> None:
    back = PixelNoise.of(camera_with(FULL))
    assert back.curve is FULL.curve
    assert (back.background, back.memory, back.p_outlier) == (FULL.background, FULL.memory, FULL.p_outlier)
    np.testing.assert_array_equal(back.drift_mm, FULL.drift_mm)
    for one, other in zip(back.laws(), FULL.laws(), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_gains_come_back_as_the_kernels_read_them() -> None:
    gains = flat(6.5, 4.5)._replace(log_n=np.log([30.0]))
    back = thresholds_of(FULL.learnt_with(gains))
    for name in ("background", "more", "first"):
        np.testing.assert_array_equal(getattr(back, name), getattr(gains, name))
    np.testing.assert_allclose(back.log_n, gains.log_n, rtol=1e-14)


@pytest.mark.parametrize(
    ("noise", "gaussian"),
    [
        (pixel_noise(), True),
        (pixel_noise("skewed"), False),
        (pixel_noise(width_spread=0.1), False),
        (pixel_noise(background=(1.0, 2.0)), False),
        (pixel_noise(memory=0.1), False),
        (pixel_noise(drift_mm=(0.0, 0.0, 1.0)), False),
    ],
)
def test_any_part_beside_the_curve_makes_the_noise_more_than_a_gaussian(noise: PixelNoise, gaussian: bool) -> None:
    assert noise.is_gaussian is gaussian


def test_second_law_differs_by_its_drift_alone() -> None:
    law, plain = FULL.laws()
    np.testing.assert_array_equal(law.drift_mm, [5.0, 0.0, 2.0])
    np.testing.assert_array_equal(plain.drift_mm, np.zeros(3))
    np.testing.assert_array_equal(law.density, plain.density)
    assert law.width_spread == plain.width_spread == SCALE_OF_SPREAD * 0.3


def test_known_background_is_as_sure_as_a_thousand_samples() -> None:
    law, _ = pixel_noise(p_outlier=0.02).laws()
    assert law.background_near / (law.background_near + law.background_far) == pytest.approx(0.02)
    assert law.background_near + law.background_far == pytest.approx(SURE_SAMPLES)


def test_a_sensor_follows_drift_where_one_was_learnt() -> None:
    assert camera_with(FULL).follows_drift
    assert not camera_with(pixel_noise("skewed")).follows_drift
    assert not CAMERA.follows_drift


def test_sensor_without_learnt_noise_has_its_curves_gaussian_and_one_without_a_curve_none() -> None:
    noise = PixelNoise.of(replace(CAMERA, noise=FULL.curve, outlier_probability=0.01))
    assert noise.background is None
    assert noise.p_outlier == 0.01
    assert noise.curve.shape is FULL.curve.shape
    with pytest.raises(ValueError, match="no noise curve"):
        PixelNoise.of(CAMERA)
