"""The table of `tofmix.estimation.mixture.counting`: how much likelihood a second surface gains where there is one.

Usage: python tests/benchmarks/calibrate.py [--pixels 100000] [--seed 1]

Draws pixels of one surface with unit sigma, tries one more surface with the package's own search, and prints, for
each number of samples, the gain that is exceeded with each false-alarm probability. Beyond the reach of the draws,
the tail is continued as it falls between 1 and 0.1 %.
"""

import argparse

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.mixture.counting import FALSE_ALARMS, SAMPLES, Rules, new_workspace, try_one_more
from tofmix.estimation.mixture.em import MEAN, SIGMA, WEIGHT, expectation_maximisation
from tofmix.estimation.samples import Readings
from tofmix.estimation.settings import MODE_TIED
from tofmix.sensor import NoiseCurve, Sensor

LEAST_GAIN = 0.5
CAMERA = Sensor(name="unit", range_min_mm=0.0, noise=NoiseCurve(np.array([10000.0]), np.array([1.0])))


@jit
def _gains(samples: FloatArray, beam: Beam, out: FloatArray) -> None:
    work = new_workspace(8, samples.shape[1])
    fit, rules = work.fit, Rules(LEAST_GAIN, 1.0, 8, 0.0)
    once = np.ones(samples.shape[1])
    for pixel in range(samples.shape[0]):
        data = Readings(samples[pixel], once, float(samples.shape[1]))
        fit[MEAN, 0], fit[SIGMA, 0] = samples[pixel].mean(), 1.0
        fit[WEIGHT, 0], fit[WEIGHT, -1] = 1.0 - beam.p_outlier, 0.0
        expectation_maximisation(data, 1, fit, beam, MODE_TIED, 100, 1.0e-9, work.scratch)
        out[pixel] = try_one_more(data, 1, work, beam, rules)


def quantiles(n: int, pixels: int, rng: np.random.Generator) -> FloatArray:
    """Gains exceeded with each of `FALSE_ALARMS`."""
    gains = np.zeros(pixels)
    _gains(np.sort(5000.0 + rng.standard_normal((pixels, n)), axis=1), beam_of(CAMERA), gains)
    reached = np.quantile(gains, 1 - np.array(FALSE_ALARMS))
    # ln P falls nearly linearly with the gain.
    low, high = np.quantile(gains, [0.99, 0.999])
    slope = np.log(10.0) / (high - low)
    continued = high + np.log(0.001 / np.array(FALSE_ALARMS)) / slope
    return np.asarray(np.where(np.array(FALSE_ALARMS) < 0.0005, continued, reached), dtype=np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    for n in SAMPLES:
        row = quantiles(n, arguments.pixels, rng)
        print(f"    ({', '.join(f'{value:.2f}' for value in row)}),  # {n}", flush=True)


if __name__ == "__main__":
    main()
