"""How often a single surface is split whose noise is not Gaussian, though its standard deviation is the curve's.

Run as ``python tests/benchmarks/not_gaussian.py``; it prints the tables of docs/results/limits.md. `--pixels` sets the
pixels of a cell.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from support.cameras import camera_of

from tofmix.circle import fold
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions
from tofmix.sensor import Sensor

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int, int], Array]

SIGMA = 25.0
PLACE = 3000.0
CAMERA = camera_of([PLACE], [SIGMA], reach_mm=(300.0, 7500.0))
SAMPLES = (30, 100, 300)
SEED = 41


def _scaled(values: Array, mean: float, variance: float) -> Array:
    return np.asarray((values - mean) / np.sqrt(variance))


def _gamma(shape: float) -> Draw:
    """Skewness 2 / sqrt(shape)."""
    return lambda rng, n, pixels: _scaled(rng.gamma(shape, size=(n, pixels)), shape, shape)


def _student(nu: float) -> Draw:
    return lambda rng, n, pixels: _scaled(rng.standard_t(nu, size=(n, pixels)), 0.0, nu / (nu - 2))


def _quantised(step: float) -> Draw:
    """Gaussian noise, rounded to steps (in sigma) with a surface anywhere between two steps."""

    def draw(rng: np.random.Generator, n: int, pixels: int) -> Array:
        place = rng.uniform(0, step, pixels)
        spread = np.sqrt(max(1.0 - step**2 / 12, 0.0))
        return np.asarray(step * np.rint((place + spread * rng.standard_normal((n, pixels))) / step) - place)

    return draw


def _rounded_on_top(step: float) -> Draw:
    """Noise of the curve's sigma, rounded on top of that: the curve does not know of the rounding."""

    def draw(rng: np.random.Generator, n: int, pixels: int) -> Array:
        place = rng.uniform(0, step, pixels)
        return np.asarray(step * np.rint((place + rng.standard_normal((n, pixels))) / step) - place)

    return draw


def _drifting(length: float) -> Draw:
    """A straight drift of `length` (in sigma) from the first frame to the last, and less noise."""

    def draw(rng: np.random.Generator, n: int, pixels: int) -> Array:
        drift = length * (np.arange(n) / (n - 1) - 0.5)
        spread = np.sqrt(1.0 - length**2 / 12)
        return np.asarray(drift[:, None] + spread * rng.standard_normal((n, pixels)))

    return draw


def _drift_on_top(length: float) -> Draw:
    """A drift on top of noise of the curve's sigma."""

    def draw(rng: np.random.Generator, n: int, pixels: int) -> Array:
        return np.asarray(length * (np.arange(n) / (n - 1) - 0.5)[:, None] + rng.standard_normal((n, pixels)))

    return draw


def _correlated(coefficient: float) -> Draw:
    """AR(1) noise from frame to frame."""

    def draw(rng: np.random.Generator, n: int, pixels: int) -> Array:
        out = rng.standard_normal((n, pixels))
        for frame in range(1, n):
            out[frame] = coefficient * out[frame - 1] + np.sqrt(1 - coefficient**2) * out[frame]
        return out

    return draw


NOISES: dict[str, Draw] = {
    "Gaussian": lambda rng, n, pixels: rng.standard_normal((n, pixels)),
    "skewed, gamma of skewness 0.5": _gamma(16.0),
    "skewed, gamma of skewness 1": _gamma(4.0),
    "heavy-tailed, Student t, nu = 10": _student(10.0),
    "heavy-tailed, Student t, nu = 5": _student(5.0),
    "steps of 0.5 sigma": _quantised(0.5),
    "steps of 1 sigma": _quantised(1.0),
    "steps of 2 sigma": _quantised(2.0),
    "drift of 1 sigma over the window": _drifting(1.0),
    "drift of 2 sigma over the window": _drifting(2.0),
    "correlated from frame to frame, 0.8": _correlated(0.8),
}
"""Every one has mean 0 and standard deviation 1."""

ON_TOP: dict[str, Draw] = {
    "steps of 0.5 sigma": _rounded_on_top(0.5),
    "steps of 1 sigma": _rounded_on_top(1.0),
    "steps of 2 sigma": _rounded_on_top(2.0),
    "drift of 1 sigma over the window": _drift_on_top(1.0),
    "drift of 2 sigma over the window": _drift_on_top(2.0),
}
"""What the curve does not know: the standard deviation is larger than its sigma."""


def split_share(draw: Draw, n: int, pixels: int, curve_factor: float = 1.0) -> tuple[float, float]:
    """Shares of pixels of one surface in which more than one is found, and in which none is."""
    rng = np.random.default_rng(SEED)
    camera = replace(CAMERA, noise=CAMERA.noise and CAMERA.noise.scaled(curve_factor))
    layers = layer_pixels(PLACE + SIGMA * draw(rng, n, pixels), camera)
    return float((layers.n_modes > 1).mean()), float((layers.n_modes == 0).mean())


def _table(noises: dict[str, Draw], pixels: int) -> None:
    print("| noise | " + " | ".join(f"{n} samples" for n in SAMPLES) + " |")
    print("|---" * (len(SAMPLES) + 1) + "|")
    for name, draw in noises.items():
        cells = [f"{100 * split_share(draw, n, pixels)[0]:.2f} %" for n in SAMPLES]
        print(f"| {name} | " + " | ".join(cells) + " |")


def between_two(pixels: int) -> None:
    """Layers between two surfaces 20 sigma apart, more than 3 sigma from both."""
    print("| noise | " + " | ".join(f"{n} samples" for n in SAMPLES) + " |")
    print("|---" * (len(SAMPLES) + 1) + "|")
    for name, draw in NOISES.items():
        cells = []
        for n in SAMPLES:
            rng = np.random.default_rng(SEED)
            far = rng.random((n, pixels)) < 0.5
            layers = layer_pixels(PLACE + SIGMA * (draw(rng, n, pixels) + 20.0 * far), CAMERA)
            away = (layers.range.astype(np.float64) - PLACE) / SIGMA
            cells.append(f"{1000 * ((away > 3) & (away < 17)).sum() / layers.n_modes.sum():.2f}")
        print(f"| {name} | " + " | ".join(cells) + " |")


def at_the_fold(pixels: int) -> None:
    """One surface at the fold of a circle, beside the same one elsewhere on it."""
    length = 7495.0
    options = EstimateOptions(unambiguous_range_mm=length)
    camera = Sensor(name="circle", noise=CAMERA.noise)
    print("| samples | found as one at the fold | elsewhere | with ranges on a line |")
    print("|---|---|---|---|")
    for n in SAMPLES:
        draws = SIGMA * np.random.default_rng(SEED).standard_normal((n, pixels))
        cells = []
        for place, chosen in ((0.0, options), (PLACE, options), (0.0, EstimateOptions())):
            found = layer_pixels(fold(place + draws, length), camera, chosen).n_modes
            cells.append(f"{100 * (found == 1).mean():.2f} %")
        print(f"| {n} | " + " | ".join(cells) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pixels", type=int, default=4000)
    pixels = parser.parse_args().pixels
    print("One surface, found as more than one; the standard deviation is the curve's sigma:\n")
    _table(NOISES, pixels)
    print("\nThe same, but what spreads the samples comes on top of the curve's sigma:\n")
    _table(ON_TOP, pixels)
    print("\nSteps on top, with sigma^2 + step^2 / 12 as the curve's variance:\n")
    print("| noise | " + " | ".join(f"{n} samples" for n in SAMPLES) + " |")
    print("|---" * (len(SAMPLES) + 1) + "|")
    for step in (0.5, 1.0, 2.0):
        factor = float(np.sqrt(1 + step**2 / 12))
        cells = [f"{100 * split_share(_rounded_on_top(step), n, pixels, factor)[0]:.2f} %" for n in SAMPLES]
        print(f"| steps of {step:g} sigma | " + " | ".join(cells) + " |")
    print("\nTwo surfaces 20 sigma apart: layers between them, more than 3 sigma from both, per 1000 layers:\n")
    between_two(pixels // 5)
    print("\nOne surface at the fold of a circle of 7495 mm:\n")
    at_the_fold(pixels)


if __name__ == "__main__":
    main()
