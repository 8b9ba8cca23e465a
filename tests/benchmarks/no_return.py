"""Surfaces near the end of the working range, and pixels without a return: how often each is found as it is.

    python tests/benchmarks/no_return.py [--pixels 2000] [--both-pixels 400]

An SR-3000 at three integration times. First, walls at 0.70 to 0.98 of r_max: the share of pixels with exactly one
surface, and the wall's distance from r_max in standard errors of its mean. Then pixels without any return: the share
with no surface. Then walls with 30 % no return: the share of pixels with one surface and c_0, beside a likelihood-ratio
test by brute force on the same samples. That test finds both where equation (1) with a surface and c_0 beats c_0 alone,
and a surface alone, by the gains that `estimate` asks for at its chance of a false alarm.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.mixture.counting import gain_table, least_gain
from tofmix.estimation.settings import no_return_gain
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.sensors import load_profile

TAUS_MS = (0.2, 0.4, 1.2)
SAMPLES = (25, 100)
PLACES = (0.70, 0.74, 0.78, 0.82, 0.86, 0.90, 0.94, 0.98)
FALSE_ALARM = 1e-3


def sensor_at(tau_ms: float) -> Sensor:
    """An SR-3000 at an integration time."""
    profile = load_profile("sr3000")
    return Sensor(
        name=profile.name,
        range_min_mm=profile.range_min_mm,
        range_max_mm=profile.range_max_mm,
        noise=profile.noise_at(tau_ms),
    )


def draw(
    rng: np.random.Generator, sensor: Sensor, place_mm: float, no_return: float, n: int, pixels: int
) -> NDArray[np.float32]:
    """Samples (frame, pixel), mm, by equation (1)."""
    top = sensor.range_max_mm or 0.0
    truth = np.where(rng.random((n, pixels)) < no_return, top, place_mm)
    sigma = sensor.noise.sigma(truth) if sensor.noise is not None else truth
    samples = truth + sigma * rng.standard_normal(truth.shape)
    random = rng.random(truth.shape) < sensor.outlier_probability
    samples[random] = rng.uniform(sensor.range_min_mm or 0.0, top, random.sum())
    return np.maximum(np.rint(samples), 1.0).astype(np.float32)


def brute_force(samples: NDArray[np.float32], sensor: Sensor) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Largest log likelihood (pixel,), nat, of c_0 alone, of a surface alone, and of both; by grids, three times finer.

    Of a surface: its range up to r_max; of both: also its share.
    """
    values, top = samples.astype(np.float64), float(sensor.range_max_mm or 0.0)
    pixels = values.shape[1]
    none = _density(values, np.full(pixels, top), sensor)
    empty = _log_likelihood(none, sensor)
    alone, both = np.full(pixels, -np.inf), empty.copy()
    at, at_both, share_both = np.full(pixels, top), np.full(pixels, top), np.zeros(pixels)
    step_mm, step_share = 60.0, 0.1
    places = np.arange(float(sensor.range_min_mm or 0.0), top, step_mm)
    every = [np.full(pixels, part) for part in np.linspace(0.0, 1.0, 11)]
    grids = [(np.full(pixels, mm), np.full(pixels, mm), every) for mm in places]
    for _ in range(3):
        for mm, mm_both, shares in grids:
            found = _log_likelihood(_density(values, mm, sensor), sensor)
            at, alone = np.where(found > alone, mm, at), np.maximum(found, alone)
            surface = _density(values, mm_both, sensor)
            for part in shares:
                w = np.clip(part, 0.0, 1.0)
                found = _log_likelihood(w * surface + (1.0 - w) * none, sensor)
                better = found > both
                at_both, share_both = np.where(better, mm_both, at_both), np.where(better, w, share_both)
                both = np.maximum(found, both)
        step_mm, step_share = step_mm / 4.0, step_share / 4.0
        shifts, parts = np.arange(-4, 5), [share_both + k * step_share for k in range(-4, 5)]
        grids = [(np.minimum(at + k * step_mm, top), np.minimum(at_both + k * step_mm, top), parts) for k in shifts]
    return empty, alone, np.maximum(both, alone)


def _density(values: FloatArray, mm: FloatArray, sensor: Sensor) -> FloatArray:
    sigma = sensor.noise.sigma(mm) if sensor.noise is not None else mm
    z = (values - mm) / sigma
    return np.asarray(np.exp(-0.5 * z * z) / (sigma * np.sqrt(2.0 * np.pi)))


def _log_likelihood(density: FloatArray, sensor: Sensor) -> FloatArray:
    p, span = sensor.outlier_probability, (sensor.range_max_mm or 0.0) - (sensor.range_min_mm or 0.0)
    return np.asarray(np.log((1.0 - p) * density + p / span).sum(axis=0))


def both_by_brute_force(samples: NDArray[np.float32], sensor: Sensor) -> float:
    """Share of the pixels in which a surface and c_0 gain enough over c_0 alone, and over a surface alone."""
    empty, alone, both = brute_force(samples, sensor)
    surface = least_gain(FALSE_ALARM, gain_table(len(samples))[len(samples)])
    return float(((both - empty >= surface) & (both - alone >= no_return_gain(FALSE_ALARM))).mean())


def both_found(layers: Layers) -> float:
    """Share of the pixels with one surface and c_0."""
    return float(((layers.n_modes == 1) & (layers.weight_no_return > 0.0)).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--pixels", type=int, default=2000, help="pixels of each cell of the first two tables")
    parser.add_argument("--both-pixels", type=int, default=400, help="pixels of each cell of the third")
    options = parser.parse_args()
    print("Walls: share of pixels with exactly one surface (distance from r_max in standard errors)\n")
    print("| tau (ms) | samples | " + " | ".join(f"{place:.2f}" for place in PLACES) + " | no return: no surface |")
    print("|---|---|" + "---|" * (len(PLACES) + 1))
    for tau_ms in TAUS_MS:
        sensor = sensor_at(tau_ms)
        top = float(sensor.range_max_mm or 0.0)
        for n in SAMPLES:
            rng, cells = np.random.default_rng(1), []
            for place in PLACES:
                layers = layer_pixels(draw(rng, sensor, place * top, 0.0, n, options.pixels), sensor)
                sigma = float(sensor.noise.sigma(place * top)) if sensor.noise is not None else 1.0
                errors = (1.0 - place) * top / sigma * np.sqrt(n)
                cells.append(f"{(layers.n_modes == 1).mean():.4f} ({errors:.1f})")
            empty = layer_pixels(draw(rng, sensor, 0.0, 1.0, n, options.pixels), sensor)
            print(f"| {tau_ms:g} | {n} | {' | '.join(cells)} | {(empty.n_modes == 0).mean():.4f} |", flush=True)
    print("\nWalls with 30 % no return: share with one surface and c_0 / brute force (sigma(r_max) apart)\n")
    print("| tau (ms) | samples | " + " | ".join(f"{place:.2f}" for place in PLACES) + " |")
    print("|---|---|" + "---|" * len(PLACES))
    for tau_ms in TAUS_MS:
        sensor = sensor_at(tau_ms)
        top = float(sensor.range_max_mm or 0.0)
        for n in SAMPLES:
            rng, cells = np.random.default_rng(2), []
            for place in PLACES:
                samples = draw(rng, sensor, place * top, 0.3, n, options.both_pixels)
                apart = (1.0 - place) * top / float(sensor.noise.sigma(top)) if sensor.noise is not None else 0.0
                share = both_by_brute_force(samples, sensor)
                cells.append(f"{both_found(layer_pixels(samples, sensor)):.3f} / {share:.3f} ({apart:.1f})")
            print(f"| {tau_ms:g} | {n} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
