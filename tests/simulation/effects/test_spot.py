"""Light on a part of the image: its law, its refusals, and the fit that begins a search."""

import math
from typing import Any

import numpy as np
import pytest

from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.search import image_places
from tofmix.simulation.effects.spot import NAMES, light_of, measured

SPOT = {"spot_across": 0.2, "spot_down": -0.3, "spot_radius_across": 0.4, "spot_radius_down": 0.25}
MAKE: dict[str, Any] = dict(EFFECTS)


class _Facts:
    """Measured and predicted noise of an image."""

    def __init__(self, measured_mm: np.ndarray, noise_mm: np.ndarray, place: np.ndarray) -> None:
        self.measured_noise_mm, self.noise_mm, self.place = measured_mm, noise_mm, place


def test_light_is_one_in_the_middle_and_falls_by_half_a_nat_at_each_radius() -> None:
    spot = tuple(SPOT.values())
    x, y, wide, high = spot
    places = np.array([[x, y], [x + wide, y], [x, y - high], [x + wide, y + high]])
    assert np.log(light_of(spot, places)) == pytest.approx([0.0, -0.5, -0.5, -1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["interference", "excess_noise"])
@pytest.mark.parametrize("missing", NAMES)
def test_spot_with_a_missing_number_is_refused_by_its_name(kind: str, missing: str) -> None:
    own = {"sigma_mm": 10.0, "probability": 1.0} if kind == "interference" else {"factor": 2.0}
    part = {name: value for name, value in SPOT.items() if name != missing}
    with pytest.raises(ValueError, match=f"{missing}: it is missing"):
        MAKE[kind](**own, **part)


@pytest.mark.parametrize("factor", [1.0, 1.4], ids=["as predicted", "all noise larger"])
def test_spot_is_found_where_the_noise_is_larger(factor: float) -> None:
    """Each number within a tenth: the noise of a pixel is known to 7 %, as from some 100 frames."""
    rng = np.random.default_rng(5)
    place = image_places((40, 50))
    sigma = np.where(place[:, 0] > 0, 12.0, 6.0)
    x, y, wide, high = SPOT.values()
    light = np.exp(-0.5 * (((place[:, 0] - x) / wide) ** 2 + ((place[:, 1] - y) / high) ** 2))
    true = np.sqrt((factor * sigma) ** 2 + 20.0**2 * light)
    facts: Any = _Facts(true * np.exp(0.07 * rng.standard_normal(sigma.size)), sigma, place)
    size, vector = measured(facts, sigma**-2.0)[0]
    found = [math.sqrt(size), vector[0], vector[1], math.exp(vector[2]), math.exp(vector[3])]
    assert found == pytest.approx([20.0, x, y, wide, high], rel=0.1, abs=0.02)


def test_noise_as_predicted_has_no_large_spot() -> None:
    place = image_places((40, 50))
    sigma = np.full(2000, 8.0)
    facts: Any = _Facts(sigma * np.exp(0.07 * np.random.default_rng(6).standard_normal(2000)), sigma, place)
    peaks = [
        size * float(light_of((v[0], v[1], math.exp(v[2]), math.exp(v[3])), place).mean())
        for size, v in measured(facts, np.ones(2000))
    ]
    assert all(peak < 0.1 for peak in peaks)
