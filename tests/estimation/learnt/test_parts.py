"""Spreads of widths, drifts and backgrounds: those that values were drawn with, without the variance of fits."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import pixel_noise

from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import PARTS, beta_prior, shrunken, width_scale, without_part
from tofmix.noise_shape import BackgroundDensity


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
