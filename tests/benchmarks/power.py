"""How often two surfaces are told from one, beside a slow likelihood-ratio test on the same pixels.

Usage: python tests/benchmarks/power.py [grid|alarms|frames ...] [--pixels 5000] [--calibration 200000]
           [--one-surface 40000] [--workers 2]

Prints Markdown tables; docs/results/limits.md has them in short. Asserts nothing.

The test fits one and two surfaces of known noise, with the p(c_r) term of equation (1), by EM from 14 starts a
pixel. It shares no code with the package. Its threshold is the 99 % quantile of its gains on its own draws of one
surface. A second form of the test wants 1.5 samples' worth of responsibility for each of the two, as tofmix does.

- grid: both over distance and share. alarms: false alarms by number of samples.
- frames: tofmix by number of frames, at its default false-alarm rate.
"""

import argparse
import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from support.cameras import camera_of

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions

# sigma(r) = 4 mm + 0.011 r: nothing like the built-in camera, nor the tests'.
LOW_MM, TOP_MM, BASE_MM, SLOPE = 150.0, 6500.0, 4.0, 0.011
CAMERA = camera_of([LOW_MM, TOP_MM], BASE_MM + SLOPE * np.array([LOW_MM, TOP_MM]), reach_mm=(LOW_MM, TOP_MM))
CENTRE_MM = 2200.0
UNIT_MM = BASE_MM + SLOPE * CENTRE_MM
"""Where the nearer surface stands, and the noise there: the reference works in units of it."""

OUTLIERS = CAMERA.outlier_probability
OUTLIER_DENSITY = OUTLIERS * UNIT_MM / (TOP_MM - LOW_MM)

SAMPLES = 100
FALSE_ALARM = 0.01
APART = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0)
SHARES = (0.5, 0.2, 0.1, 0.05)
NUMBERS = (15, 30, 100, 300, 1000)
FRAMES = (3, 5, 7, 10, 15, 20, 25, 50, 100)
FRAME_CELLS = ((0.5, 3.0), (0.5, 4.0), (0.5, 5.0), (0.2, 3.0), (0.2, 4.0), (0.2, 5.0))
"""Share of the nearer surface and distance, sigma, of the table by number of frames."""

NEAR_MM = (500.0, 5000.0)
SEED = 71

TABLES = ("grid", "alarms", "frames")

SPLITS = (0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.94, 0.97)
FIRST_CYCLES, MOST_CYCLES = 6, 80
SETTLED = 1.0e-4
LONGEST_JUMP = 64.0
LEAST_SUPPORT = 1.5
CHUNK = 1000
BLOCK_SAMPLES = 500_000

Values = NDArray[np.floating[Any]]


class Step(NamedTuple):
    """One iteration of EM: the new parameters, and of the old ones the log likelihood and the least support."""

    parameters: Values
    likelihood: Values
    least_support: Values


def em_step(x: Values, parameters: Values) -> Step:
    """Iterate once on pixels (pixel, sample), in units; parameters (3, pixel): two means and the first one's share."""
    sigma = 1.0 + SLOPE * parameters[:2]
    shares = np.stack([parameters[2], 1.0 - parameters[2]])
    z = (x - parameters[:2, :, None]) / sigma[:, :, None]
    height = shares * (1.0 - OUTLIERS) / (sigma * math.sqrt(2.0 * math.pi))
    terms = np.exp(-0.5 * z * z) * height[:, :, None]
    total = terms.sum(axis=0) + x.dtype.type(OUTLIER_DENSITY)
    terms /= total
    support = terms.sum(axis=2)
    known = np.maximum(support, 1.0e-30)
    mean = np.where(support > 1.0e-9, (terms * x).sum(axis=2) / known, parameters[:2])
    share = support[0] / np.maximum(support.sum(axis=0), 1.0e-9)
    new = np.concatenate([mean, share[None]]).astype(x.dtype)
    return Step(new, np.log(total).sum(axis=1), support.min(axis=0))


def cycle(x: Values, parameters: Values) -> tuple[Values, Values]:
    """Two iterations and a jump ahead, taken back where it lowers the likelihood; and the distance left to go."""
    first, second, jump = accelerate(x, parameters)
    step = first.parameters - parameters
    bend = second.parameters - first.parameters - step
    ahead = parameters + 2.0 * jump * step + jump**2 * bend
    ahead[:2] = np.clip(ahead[:2], x.min(axis=1) - 1.0, x.max(axis=1) + 1.0)
    ahead[2] = np.clip(ahead[2], 1.0e-6, 1.0 - 1.0e-6)
    third = em_step(x, ahead.astype(x.dtype))
    better = third.likelihood >= second.likelihood
    left = np.abs(second.parameters - first.parameters).max(axis=0) * jump
    return np.where(better, third.parameters, second.parameters), left


def accelerate(x: Values, parameters: Values) -> tuple[Step, Step, Values]:
    """Two iterations, and how far to jump along them (squared extrapolation: Varadhan and Roland, 2008)."""
    first = em_step(x, parameters)
    second = em_step(x, first.parameters)
    step = first.parameters - parameters
    bend = second.parameters - first.parameters - step
    ratio = np.sqrt((step**2).sum(axis=0) / np.maximum((bend**2).sum(axis=0), 1.0e-20))
    return first, second, np.clip(ratio, 1.0, LONGEST_JUMP)


def starts(x: Values) -> Iterator[Values]:
    """Starts for sorted samples: cut at a share, one sample alone at either end, one surface split in two."""
    n = x.shape[1]
    cuts = sorted({1, n - 1} | {min(max(round(q * n), 2), n - 2) for q in SPLITS})
    for cut in cuts:
        means = x[:, :cut].mean(axis=1), x[:, cut:].mean(axis=1)
        yield np.stack([*means, np.full(len(x), cut / n)]).astype(x.dtype)
    middle = np.median(x, axis=1)
    yield np.stack([middle - 0.8, middle + 0.8, np.full(len(x), 0.5)]).astype(x.dtype)


def finish(x: Values, parameters: Values) -> Values:
    """Iterate until nothing moves any more."""
    out = parameters.copy()
    active = np.arange(len(x))
    for _ in range(MOST_CYCLES):
        out[:, active], left = cycle(x[active], out[:, active])
        active = active[left > SETTLED]
        if active.size == 0:
            break
    return out


def one_surface(x: Values) -> Values:
    """Log likelihood of the best single surface."""
    parameters = np.stack([np.median(x, axis=1), np.zeros(len(x)), np.ones(len(x))])
    for _ in range(20):
        parameters = em_step(x, parameters).parameters
    return em_step(x, parameters).likelihood


class Reference(NamedTuple):
    """What the slow fit of two surfaces finds: its gain over one, nat; that with the rule of support; the fit."""

    gain: FloatArray
    supported_gain: FloatArray
    parameters: FloatArray


def best_starts(x: Values) -> tuple[FloatArray, FloatArray]:
    """The best parameters after a few cycles from every start, and the best of those with support."""
    coarse = x.astype(np.float32)
    best = np.full((2, len(x)), -np.inf)
    kept = np.zeros((2, 3, len(x)))
    for start in starts(coarse):
        parameters = start
        for _ in range(FIRST_CYCLES):
            parameters, _ = cycle(coarse, parameters)
        end = em_step(coarse, parameters)
        for which, allowed in enumerate((np.ones(len(x), dtype=bool), end.least_support >= LEAST_SUPPORT)):
            better = allowed & (end.likelihood > best[which])
            best[which, better] = end.likelihood[better]
            kept[which][:, better] = parameters[:, better]
    kept[1][:, ~np.isfinite(best[1])] = kept[0][:, ~np.isfinite(best[1])]
    return kept[0], kept[1]


def reference_chunk(x: FloatArray) -> Reference:
    """Fit some pixels; `x` is sorted along its samples."""
    plain, supported = best_starts(x)
    other = (plain != supported).any(axis=0)
    fit = finish(x, plain)
    held = fit.copy()
    held[:, other] = finish(x[other], supported[:, other])
    one = one_surface(x)
    end, held_end = em_step(x, fit), em_step(x, held)
    gain = end.likelihood - one
    held_gain = np.where(held_end.least_support >= LEAST_SUPPORT, held_end.likelihood - one, 0.0)
    return Reference(gain, held_gain, np.asarray(fit, dtype=np.float64))


def reference(samples: Float32Array) -> Reference:
    """The slow test on samples (sample, pixel), mm."""
    x = np.sort((samples.T.astype(np.float64) - CENTRE_MM) / UNIT_MM, axis=1)
    parts = [reference_chunk(x[start : start + CHUNK]) for start in range(0, len(x), CHUNK)]
    gain, held, fit = (np.concatenate(values, axis=-1) for values in zip(*parts, strict=True))
    return Reference(gain, held, fit)


def drawn(
    seed: list[int], pixels: int, *, apart: float = 0.0, share: float = 1.0, samples: int = SAMPLES
) -> Float32Array:
    """Samples (sample, pixel) of one surface, or of two `apart` sigma; no random values."""
    rng = np.random.default_rng(seed)
    mean = np.where(rng.random((samples, pixels)) < share, CENTRE_MM, CENTRE_MM + apart * UNIT_MM)
    noise = (BASE_MM + SLOPE * mean) * rng.standard_normal(mean.shape)
    return np.asarray(mean + noise, dtype=np.float32)


def with_outliers(seed: list[int], n: int, pixels: int) -> Float32Array:
    """Samples of one surface at any range, with random values."""
    rng = np.random.default_rng(seed)
    near = rng.uniform(*NEAR_MM, pixels)
    samples = near + (BASE_MM + SLOPE * near) * rng.standard_normal((n, pixels))
    wild = rng.random(samples.shape) < OUTLIERS
    samples[wild] = rng.uniform(LOW_MM, TOP_MM, int(wild.sum()))
    return samples.astype(np.float32)


def several(samples: Float32Array, false_alarm: float) -> BoolArray:
    """Pixels in which tofmix finds more than one surface."""
    options = EstimateOptions(false_alarm=false_alarm)
    return np.asarray(layer_pixels(samples, CAMERA, options).n_modes > 1)


class Found(NamedTuple):
    """Gains of the test on some pixels, and where tofmix finds two."""

    gain: FloatArray
    supported_gain: FloatArray
    tofmix: BoolArray


def cell(job: tuple[int, float, float], pixels: int) -> Found:
    """Run both on one cell of the grid."""
    number, apart, share = job
    samples = drawn([SEED, number], pixels, apart=apart, share=share)
    slow = reference(samples)
    return Found(slow.gain, slow.supported_gain, several(samples, FALSE_ALARM))


def table(title: str, values: FloatArray, form: str) -> None:
    """Print one figure over the grid."""
    print(f"\n{title}\n\n| share of the nearer | {' | '.join(f'{s:g}' for s in APART)} |\n{'|---' * (len(APART) + 1)}|")
    for share, row in zip(SHARES, values, strict=True):
        print(f"| {share} | {' | '.join(format(value, form) for value in row)} |")


def percent(hits: BoolArray) -> str:
    """A share in percent, with its standard error."""
    rate = float(hits.mean())
    return f"{100 * rate:.3f} +- {100 * math.sqrt(rate * (1.0 - rate) / hits.size):.3f} %"


def grid(pixels: int, calibration: int, pool: ProcessPoolExecutor) -> None:
    """Print power over the grid."""
    part = max(calibration // 8, 1)
    alone = list(pool.map(partial(cell, pixels=part), [(1000 + k, 0.0, 1.0) for k in range(8)]))
    null = Found(*(np.concatenate(parts) for parts in zip(*alone, strict=True)))
    plain, held = (float(np.quantile(gains, 1.0 - FALSE_ALARM)) for gains in null[:2])
    print(
        f"Thresholds on {null.gain.size} pixels of one surface: {plain:.2f} nat; with the rule of support {held:.2f}."
    )
    print(f"On the same pixels tofmix finds more than one in {percent(null.tofmix)}.", flush=True)
    jobs = [(k, apart, share) for k, (share, apart) in enumerate((w, s) for w in SHARES for s in APART)]
    cells = list(pool.map(partial(cell, pixels=pixels), jobs))
    shape = len(SHARES), len(APART)
    ours = np.array([found.tofmix.mean() for found in cells]).reshape(shape)
    test = np.array([(found.gain > plain).mean() for found in cells]).reshape(shape)
    ruled = np.array([(found.supported_gain > held).mean() for found in cells]).reshape(shape)
    table(f"tofmix, {pixels} pixels a cell, columns: sigmas apart", ours, ".3f")
    table("likelihood-ratio test", test, ".3f")
    table("likelihood-ratio test with the rule of support", ruled, ".3f")
    table("tofmix less the test", ours - test, "+.3f")
    table("tofmix less the test with the rule", ours - ruled, "+.3f")


def alarms(job: tuple[int, int, float], pixels: int) -> BoolArray:
    """Pixels of one surface, random values included, in which tofmix finds more than one."""
    number, n, false_alarm = job
    step = max(BLOCK_SAMPLES // n, 1)
    parts = []
    for k, start in enumerate(range(0, pixels, step)):
        parts.append(several(with_outliers([SEED, 5000 + number, k], n, min(step, pixels - start)), false_alarm))
    return np.concatenate(parts)


def false_alarms(pixels: int, pool: ProcessPoolExecutor) -> None:
    """Print measured false-alarm rates."""
    asked = (FALSE_ALARM, EstimateOptions().false_alarm)
    jobs = [(k, n, rate) for k, n in enumerate(NUMBERS) for rate in asked]
    rates = list(pool.map(partial(alarms, pixels=pixels), jobs[::-1]))[::-1]
    print(f"\n| samples | {' | '.join(f'asked: {100 * rate:g} %' for rate in asked)} |\n|---|---|---|")
    for k, n in enumerate(NUMBERS):
        print(f"| {n} | {percent(rates[2 * k])} | {percent(rates[2 * k + 1])} |")


def power(job: tuple[int, int, float, float], pixels: int) -> float:
    """Share of the pixels in which tofmix finds two surfaces, at its default false-alarm rate."""
    number, samples, share, apart = job
    some = drawn([SEED, 9000 + number], pixels, apart=apart, share=share, samples=samples)
    return float(several(some, EstimateOptions().false_alarm).mean())


def by_frames(pixels: int, pool: ProcessPoolExecutor) -> None:
    """Print power by number of frames."""
    cells = [(samples, share, apart) for samples in FRAMES for share, apart in FRAME_CELLS]
    found = list(pool.map(partial(power, pixels=pixels), [(k, *cell) for k, cell in enumerate(cells)]))
    heads = " | ".join(f"{share:g}, {apart:g} sigma" for share, apart in FRAME_CELLS)
    print(f"\n| frames | {heads} |\n{'|---' * (len(FRAME_CELLS) + 1)}|")
    for samples, row in zip(FRAMES, np.array(found).reshape(len(FRAMES), -1), strict=True):
        print(f"| {samples} | {' | '.join(f'{value:.2f}' for value in row)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=[])
    parser.add_argument("--pixels", type=int, default=5000, help="pixels a cell")
    parser.add_argument("--calibration", type=int, default=200000, help="pixels that set the test's threshold")
    parser.add_argument("--one-surface", type=int, default=40000, help="pixels for each false-alarm rate")
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    layer_pixels(drawn([SEED], 2), CAMERA)  # compile before the processes part
    names = set(chosen.tables or TABLES)
    with ProcessPoolExecutor(chosen.workers) as pool:
        if "grid" in names:
            grid(chosen.pixels, chosen.calibration, pool)
        if "alarms" in names:
            false_alarms(chosen.one_surface, pool)
        if "frames" in names:
            by_frames(chosen.pixels, pool)


if __name__ == "__main__":
    main()
