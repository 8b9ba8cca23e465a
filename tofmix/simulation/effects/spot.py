"""Light that falls on a part of the image: a spot with soft edges. `interference` and `excess_noise` share it.

The lobe of a lamp is bright in its middle and falls off smoothly, and is longer in one direction where it falls on a
slanted surface. A Gaussian of the pixel's place stands for it: 1 in the middle, exp(-1/2) at its radii. A spot whose
middle lies beside the image lights one side of it.
"""

import math
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.parameter import StudentPrior, about, number
from tofmix.simulation.effects.search import SearchFacts, bounded

Spot = tuple[float, float, float, float]
"""Middle, right and down of the image's centre, and radii along rows and columns, in half diagonals of the image."""

NAMES = ("spot_across", "spot_down", "spot_radius_across", "spot_radius_down")
"""Parameters of an effect that has a spot."""

_FARTHEST = 3.0  # half diagonals: a wider spot, or one so far beside the image, is the same everywhere in it
_SMALLEST = 0.02  # half diagonals: about a pixel
_GRID = np.linspace(-0.9, 0.9, 7)  # middles with which a fit begins
_RADII = (0.15, 0.3, 0.6)  # likewise
_LEAST_PIXELS, _MOST_PIXELS = 30, 1000  # with which the six numbers of a fit are known; more take longer
STEPS = (0.1, 0.1, 0.2, 0.2)  # of a search: two places, and the logarithms of the radii


def place(words: str) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field of a coordinate of the middle; `words` say on which side of the centre it is above 0."""
    return number(
        f"Middle of the part of the image with the noise, {words} the image's centre; all of the image without it.",
        unit="half diagonal",
        low=-_FARTHEST,
        high=_FARTHEST,
        required=False,
        prior=StudentPrior(scale=0.5),
    )


def radius(words: str) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field of a radius; `words` say along what."""
    return number(
        f"Radius of this part along {words}: there, its light is exp(-1/2) of that in the middle.",
        unit="half diagonal",
        low=_SMALLEST,
        high=_FARTHEST,
        required=False,
        typical=(0.1, 1.0),
        prior=about(0.4, 2),
    )


def of(effect: Any) -> Spot | None:  # noqa: ANN401  any effect that declares `NAMES`
    """The spot of an effect; None for the whole image.

    Raises
    ------
    ValueError
        If it has some of the four numbers, but not all.
    """
    values = [getattr(effect, name) for name in NAMES]
    missing = [name for name, value in zip(NAMES, values, strict=True) if value is None]
    if missing and len(missing) < len(NAMES):
        raise ValueError(f"{missing[0]}: it is missing; give all of {', '.join(NAMES)}, or none")
    return None if missing else (values[0], values[1], values[2], values[3])


def light_of(spot: Spot, place: FloatArray) -> FloatArray:
    """Light (pixel,) at some places (pixel, 2), in half diagonals; 1 in the middle of the spot."""
    away = (place - np.array(spot[:2])) / np.array(spot[2:])
    return np.asarray(np.exp(-0.5 * (away**2).sum(axis=1)))


def words_of(spot: Spot) -> str:
    """The spot in words."""
    across = f"{abs(spot[0]):.2g} {'right' if spot[0] >= 0 else 'left'} of"
    down = f"{abs(spot[1]):.2g} {'below' if spot[1] >= 0 else 'above'}"
    radii = f"radii {spot[2]:.2g} and {spot[3]:.2g}"
    return f"in a spot of {radii}, {across} and {down} the image's centre (in half diagonals)"


def from_vector(x: FloatArray) -> dict[str, Any]:
    """The numbers of a spot from a vector of a search: its middle, and the logarithms of its radii."""
    radii = (math.exp(bounded(v, math.log(_SMALLEST), math.log(_FARTHEST))) for v in x[2:])
    return {
        NAMES[0]: bounded(x[0], -_FARTHEST, _FARTHEST),
        NAMES[1]: bounded(x[1], -_FARTHEST, _FARTHEST),
        **dict(zip(NAMES[2:], radii, strict=True)),
    }


def measured(facts: SearchFacts, added: FloatArray) -> list[tuple[float, FloatArray]]:
    """The spot that widens the noise as it is measured, and its size: (size, vector of `from_vector`).

    Noise of variance sigma^2 (factor + size x added x light) is fitted to the measured noise by least squares of the
    logarithms, once with a free factor and once with a factor of 1. Sizes are above 0; none without enough pixels.

    Parameters
    ----------
    facts : SearchFacts
        Measured noise, predicted noise, and place of pixels.
    added : (lit pixel,) float64
        Variance, over the predicted one, that the effect adds for a size of 1.
    """
    known = np.flatnonzero(np.isfinite(facts.measured_noise_mm) & (facts.measured_noise_mm > 0))
    if known.size < _LEAST_PIXELS:
        return []
    known = known[np.linspace(0, known.size - 1, min(known.size, _MOST_PIXELS)).astype(np.int64)]
    places, added = facts.place[known], added[known]
    wider = 2 * np.log(facts.measured_noise_mm[known] / facts.noise_mm[known])
    found = []
    for free in (True, False):
        begun = _begun(places, added, np.exp(wider), free=free)
        if begun is None:
            continue

        def residual(x: FloatArray, free: bool = free) -> FloatArray:
            factor = math.exp(x[5]) if free else 1.0
            light = light_of((x[1], x[2], math.exp(x[3]), math.exp(x[4])), places)
            return np.asarray(np.log(factor + math.exp(x[0]) * added * light) - wider)

        least, most = math.log(_SMALLEST), math.log(_FARTHEST / 2)  # within the bounds of a search
        lows = [-25.0, -_FARTHEST, -_FARTHEST, least, least, -3.0][: len(begun)]
        highs = [25.0, _FARTHEST, _FARTHEST, most, most, 3.0][: len(begun)]
        start = np.clip(begun, np.nextafter(lows, 0), np.nextafter(highs, 0))  # least squares ask for it
        end = least_squares(residual, start, bounds=(lows, highs), loss="soft_l1", max_nfev=60)
        found.append((math.exp(end.x[0]), np.asarray(end.x[1:5])))
    return found


def _begun(place: FloatArray, added: FloatArray, ratio: FloatArray, *, free: bool) -> FloatArray | None:
    """Log size, middle, log radii, and log factor where it is free, of the best of a grid of spots."""
    best: tuple[float, FloatArray] | None = None
    weight = 1.0 / np.maximum(ratio, 1e-6)  # a measured variance is known in proportion to itself
    for across in _GRID:
        for down in _GRID:
            for radius in _RADII:
                light = added * light_of((float(across), float(down), radius, radius), place)
                columns = np.stack([light, np.ones(light.size)][: 1 + free], axis=1) * weight[:, None]
                wanted = np.ones(light.size) if free else 1.0 - weight
                size, *rest = np.linalg.lstsq(columns, wanted, rcond=1e-9)[0]
                factor = rest[0] if free else 1.0
                cost = float(((columns @ np.array([size, *rest]) - wanted) ** 2).sum())
                if size > 0 and factor > 0 and (best is None or cost < best[0]):
                    own = [math.log(size), float(across), float(down), math.log(radius), math.log(radius)]
                    best = cost, np.array(own + ([math.log(factor)] if free else []))
    return None if best is None else best[1]
