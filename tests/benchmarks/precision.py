"""Range errors of two close surfaces, beside maximum likelihood, the Cramer-Rao bound and scikit-learn.

Usage: python tests/benchmarks/precision.py [--pixels 4000] [--mixture-pixels 150] [--workers 2]

Prints Markdown tables; docs/results/limits.md holds a copy. Asserts nothing.

Errors are those of both surfaces, near and far in order, without a matching cut: however far off, they count. They
are taken in pixels in which tofmix finds two surfaces, and those of maximum likelihood, which is told that there are
two, in the same pixels. Maximum likelihood is the slow EM of power.py from 14 starts. The bound is that of an
unbiased estimator over all pixels, means and share jointly, with the noise curve known.
"""

import argparse
import importlib
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import trapezoid

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.power import (
    BASE_MM,
    CAMERA,
    CENTRE_MM,
    OUTLIERS,
    SAMPLES,
    SLOPE,
    UNIT_MM,
    drawn,
    reference,
)

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions, SigmaMode
from tofmix.layers import Layers

APART = (2.0, 3.0, 4.0, 6.0)
SHARES = (0.5, 0.2, 0.1)
SEED = 72
NORMAL_95 = 1.959964
TWO = 2
MOST_COMPONENTS = 4
RESTARTS = 3


def density(at_mm: FloatArray, near: float, far: float, share: float) -> FloatArray:
    """Equation (1) for two surfaces, without its constant term."""
    out = np.zeros_like(at_mm)
    for mean, weight in ((near, share), (far, 1.0 - share)):
        sigma = BASE_MM + SLOPE * mean
        out += weight * np.exp(-0.5 * ((at_mm - mean) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    return (1.0 - OUTLIERS) * out


def bound(apart: float, share: float) -> FloatArray:
    """Least standard errors of near mean, far mean, mm, and share, of `SAMPLES` samples: by quadrature."""
    at = np.linspace(CENTRE_MM - 10.0 * UNIT_MM, CENTRE_MM + (apart + 10.0) * UNIT_MM, 20001)
    truth = np.array([CENTRE_MM, CENTRE_MM + apart * UNIT_MM, share])
    steps = np.diag([1.0e-3 * UNIT_MM, 1.0e-3 * UNIT_MM, 1.0e-4])
    slopes = [(density(at, *(truth + h)) - density(at, *(truth - h))) / (2.0 * h.sum()) for h in steps]
    lowest, top = CAMERA.range_min_mm or 0.0, CAMERA.range_max_mm or 1.0
    total = density(at, *truth) + OUTLIERS / (top - lowest)
    terms = np.array([[a * b / total for a in slopes] for b in slopes])
    information = SAMPLES * trapezoid(terms, at, axis=2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def root_mean_square(errors: FloatArray) -> float:
    """Of all errors; NaN where there is none."""
    return float(np.sqrt(np.mean(errors**2))) if errors.size else math.nan


def likeliest(samples: Float32Array) -> FloatArray:
    """Means (pixel, 2) of maximum likelihood with two surfaces, near to far, mm."""
    means = CENTRE_MM + UNIT_MM * reference(samples).parameters[:TWO]
    return np.sort(means.T, axis=1)


def covered(layers: Layers, right: BoolArray, true_mm: FloatArray, share: float) -> tuple[float, float]:
    """Share of 95 % intervals that hold the true range, and the true weight."""
    away = np.abs(layers.range[right, :TWO] - true_mm) <= NORMAL_95 * layers.range_stderr[right, :TWO]
    true = (1.0 - OUTLIERS) * np.array([share, 1.0 - share])
    off = np.abs(layers.weight[right, :TWO] - true) <= NORMAL_95 * layers.weight_stderr[right, :TWO]
    return float(away.mean()), float(off.mean())


def draw_cell(number: int, pixels: int, apart: float, share: float) -> tuple[Float32Array, FloatArray]:
    """Samples of one cell, and its true ranges, mm."""
    samples = drawn([SEED, number], pixels, apart=apart, share=share)
    return samples, np.array([CENTRE_MM, CENTRE_MM + apart * UNIT_MM])


def errors_row(job: tuple[int, float, float], pixels: int) -> str:
    """One row of the table of errors."""
    number, apart, share = job
    samples, true = draw_cell(number, pixels, apart, share)
    layers = layer_pixels(samples, CAMERA)
    tied = layer_pixels(samples, CAMERA, EstimateOptions(sigma=SigmaMode.TIED))
    both = (layers.n_modes == TWO) & (tied.n_modes == TWO)
    slow = likeliest(samples) - true
    test = root_mean_square(slow[both])
    ours, held = (root_mean_square(found.range[both, :TWO] - true) for found in (layers, tied))
    least = root_mean_square(bound(apart, share)[:TWO])
    intervals = *covered(layers, both, true, share), *covered(tied, both, true, share)
    return (
        f"| {share} | {apart:g} | {both.mean():.3f} | {ours:.2f} | {held:.2f} | {test:.2f} | {ours / test:.3f}"
        f" | {held / test:.3f} | {ours / least:.3f} | {held / least:.3f} | {root_mean_square(slow) / least:.3f}"
        f" | {' / '.join(f'{100 * value:.1f}' for value in intervals[:TWO])}"
        f" | {' / '.join(f'{100 * value:.1f}' for value in intervals[TWO:])} |"
    )


def errors(pixels: int, pool: ProcessPoolExecutor) -> None:
    """Print errors against maximum likelihood and the bound, and the coverage of intervals."""
    columns = (
        "share of the nearer",
        "sigmas apart",
        "two found",
        "tofmix, mm",
        "tied, mm",
        "likelihood, mm",
        "tofmix / likelihood",
        "tied / likelihood",
        "tofmix / bound",
        "tied / bound",
        "likelihood, all pixels / bound",
        "covered, range / weight, %",
        "tied: covered, %",
    )
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    jobs = [(k, apart, share) for k, (share, apart) in enumerate(product(SHARES, APART))]
    for row in pool.map(partial(errors_row, pixels=pixels), jobs):
        print(row, flush=True)


class Scored(NamedTuple):
    """Which pixels have the right count, and their squared errors, mm^2; NaN elsewhere."""

    right: BoolArray
    square: FloatArray


def scored(found: list[FloatArray], true: FloatArray) -> Scored:
    """Score sorted means."""
    right = np.array([len(means) == len(true) for means in found])
    square = [np.mean((m - true) ** 2) if ok else math.nan for m, ok in zip(found, right, strict=True)]
    return Scored(right, np.array(square))


def by_bic(samples: Float32Array, mixture: Any) -> list[FloatArray]:  # noqa: ANN401
    """Sorted means of the mixture of least BIC in each pixel."""
    out = []
    for pixel in samples.T:
        column = pixel.astype(np.float64)[:, None]
        fits = [mixture(k, n_init=RESTARTS, random_state=0).fit(column) for k in range(1, MOST_COMPONENTS + 1)]
        best = min(fits, key=lambda fit: float(fit.bic(column)))
        out.append(np.sort(best.means_.ravel()))
    return out


def difference(ours: Scored, theirs: Scored) -> str:
    """Mean difference of the squared errors in standard errors, where both counts are right."""
    both = ours.right & theirs.right
    if both.sum() < TWO:
        return "-"
    gap = (ours.square - theirs.square)[both]
    return f"{gap.mean() / (gap.std(ddof=1) / math.sqrt(gap.size)):+.1f}"


def mixture_row(job: tuple[int, float, float], pixels: int) -> str:
    """One row of the table beside scikit-learn."""
    mixture = importlib.import_module("sklearn.mixture").GaussianMixture
    number, apart, share = job
    samples, true = draw_cell(number, pixels, apart, share)
    true = true if share < 1.0 else true[:1]
    layers = layer_pixels(samples, CAMERA)
    found = [ranges[:n].astype(np.float64) for ranges, n in zip(layers.range, layers.n_modes, strict=True)]
    ours, theirs = scored(found, true), scored(by_bic(samples, mixture), true)
    both = ours.right & theirs.right
    figures = [f"{math.sqrt(np.mean(s.square[both])):.2f}" if both.any() else "-" for s in (ours, theirs)]
    name = "one surface |" if share == 1.0 else f"{share} | {apart:g}"
    return (
        f"| {name} | {ours.right.mean():.3f} | {theirs.right.mean():.3f} | {both.sum()}"
        f" | {figures[0]} | {figures[1]} | {difference(ours, theirs)} |"
    )


def beside_mixture(pixels: int, pool: ProcessPoolExecutor) -> None:
    """Print counts and errors beside scikit-learn's."""
    try:
        importlib.import_module("sklearn.mixture")
    except ImportError:
        print("\nscikit-learn is not installed: its table is left out")
        return
    columns = (
        "share of the nearer",
        "sigmas apart",
        "tofmix: count right",
        "scikit-learn",
        "pixels, both right",
        "tofmix: error, mm",
        "scikit-learn, mm",
        "difference of squares, standard errors",
    )
    print(f"\n| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    jobs = [(100, 0.0, 1.0)]
    jobs += [(101 + k, apart, share) for k, (share, apart) in enumerate(product(SHARES, APART))]
    for row in pool.map(partial(mixture_row, pixels=pixels), jobs):
        print(row, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=4000, help="pixels a cell")
    parser.add_argument("--mixture-pixels", type=int, default=150, help="pixels a cell for scikit-learn")
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    layer_pixels(drawn([SEED], 2), CAMERA)  # compile before the processes part
    with ProcessPoolExecutor(chosen.workers) as pool:
        errors(chosen.pixels, pool)
        beside_mixture(chosen.mixture_pixels, pool)


if __name__ == "__main__":
    main()
