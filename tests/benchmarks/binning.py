"""What binning a long window does to ranges and shares, in units of their standard errors.

Usage: python tests/benchmarks/binning.py [--pixels 100] [--seed 74]

Prints a Markdown table; docs/results/performance.md has it in short. Asserts nothing;
tests/estimation/test_samples.py does.

Noise of an SR-3000 at 1.2 ms, samples that are no whole mm. Each pixel is fitted twice from its true surfaces, to the
end (tol 1e-9): from every sample, and from the binned values that windows of 1000 samples and more are fitted from.
"""

import argparse
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.mixture.em import MEAN, WEIGHT, maximise_likelihood, new_components, new_scratch, start_at
from tofmix.estimation.mixture.uncertainty import standard_errors
from tofmix.estimation.samples import Readings, gather, padded, readings_of
from tofmix.estimation.settings import MODE_TIED
from tofmix.sensor import NoiseCurve, Sensor

NOISE = NoiseCurve(
    np.array([500.0, 1000, 2000, 3000, 5000, 7500]), np.array([3.0, 6, 13, 24, 67, 150]) * (10.0 / 1.2) ** 0.5
)
CAMERA = Sensor(name="SR-3000 at 1.2 ms", range_min_mm=650.0, range_max_mm=7500.0, noise=NOISE)
APART = 3.0
"""Distance of neighbouring surfaces in sigmas."""


class Fit(NamedTuple):
    """Means (k,) in mm and shares, with their standard errors."""

    mean: FloatArray
    weight: FloatArray
    mean_error: FloatArray
    weight_error: FloatArray


def fitted(data: Readings, start: FloatArray, beam: Beam) -> Fit:
    """Fit with tied sigmas, until nothing moves."""
    k = len(start)
    fit, scratch = new_components(k), new_scratch(k, len(data.value))
    start_at(start, np.ones(k), k, 0.0, fit, beam)
    maximise_likelihood(data, k, fit, beam, MODE_TIED, 20_000, 1e-9, scratch)
    mean_error, weight_error = np.zeros(k), np.zeros(k)
    standard_errors(data, k, fit, beam, MODE_TIED, scratch, mean_error, weight_error)
    return Fit(fit[MEAN, :k].copy(), fit[WEIGHT, :k].copy(), mean_error, weight_error)


def errors(samples: int, surfaces: int, pixels: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, float]:
    """Binned less exact means and shares (pixel, k), over the standard error, and how many values are left of a window.

    The error of a share is 0, and so is its part, where a pixel has one surface only.
    """
    beam = beam_of(CAMERA)
    of_means: list[FloatArray] = []
    of_shares: list[FloatArray] = []
    left = 0
    for _ in range(pixels):
        first = float(rng.uniform(1000.0, 3500.0))
        mean = [first]
        while len(mean) < surfaces:
            mean.append(mean[-1] + APART * float(NOISE.sigma(mean[-1])))
        seen = np.array(mean)[rng.integers(0, surfaces, samples)]
        exact = readings_of(seen + NOISE.sigma(seen) * rng.standard_normal(samples))
        scratch = np.empty(padded(samples)), np.empty(padded(samples))
        binned = gather(exact.value, samples, beam.curve_range, beam.curve_sigma, *scratch)
        left += int(np.count_nonzero(binned.times))
        one, other = fitted(exact, np.array(mean), beam), fitted(binned, np.array(mean), beam)
        of_means.append((other.mean - one.mean) / one.mean_error)
        if surfaces > 1:
            of_shares.append((other.weight - one.weight) / one.weight_error)
    return np.array(of_means), np.array(of_shares) if of_shares else np.zeros((pixels, 1)), left / pixels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=100)
    parser.add_argument("--seed", type=int, default=74)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print("| samples | surfaces | values left | range, rms | range, largest | share, rms | share, largest |")
    print("|---|---|---|---|---|---|---|")
    for samples in (1000, 3000, 10_000, 100_000):
        for surfaces in (1, 2, 3):
            means, shares, left = errors(samples, surfaces, arguments.pixels, rng)
            cells = [f"{np.sqrt(np.mean(e**2)):.2%} | {np.abs(e).max():.2%}" for e in (means, shares)]
            print(f"| {samples:,} | {surfaces} | {left:.0f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
