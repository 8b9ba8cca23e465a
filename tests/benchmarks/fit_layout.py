"""EM iterations over one pixel whose fit is rows of an array, as `mixture.components` has it, or a struct of arrays.

    NUMBA_CACHE_DIR=DIR python tests/benchmarks/fit_layout.py

DIR is empty: the time of the first call is that of compiling. "As a part" is a kernel that others call, with
references to arrays not counted (`tofmix.compiled.jit.borrowing`); "by itself" is one of plain `jit`.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import exp_minus, product_of, total_of
from tofmix.estimation.mixture.em import MEAN, SIGMA, SUPPORT, WEIGHT, new_components

SURFACES, SAMPLES, ROUNDS, REPEATS = 2, 64, 20_000, 7
HEIGHT = 1.0 / np.sqrt(2.0 * np.pi)
BACKGROUND = 1.0e-6  # 1/mm


class Fit(NamedTuple):
    """The first four rows of `Components`."""

    mean: FloatArray
    sigma: FloatArray
    weight: FloatArray
    support: FloatArray


def _density(value: FloatArray, mean: float, sigma: float, out: FloatArray) -> None:
    scale, height = 1.0 / sigma, HEIGHT / sigma
    for j in range(len(value)):
        z = (value[j] - mean) * scale
        out[j] = height * exp_minus(0.5 * z * z)


density = borrowing(_density)


def _expect_rows(value: FloatArray, k: int, fit: FloatArray, rows: FloatArray, total: FloatArray) -> None:
    for j in range(len(value)):
        total[j] = BACKGROUND
    for i in range(k):
        density(value, fit[MEAN, i], fit[SIGMA, i], rows[i])
        for j in range(len(value)):
            total[j] += fit[WEIGHT, i] * rows[i, j]
    for i in range(k):
        for j in range(len(value)):
            rows[i, j] *= fit[WEIGHT, i] / total[j]
        fit[SUPPORT, i] = total_of(rows[i])


def _expect_struct(value: FloatArray, k: int, fit: Fit, rows: FloatArray, total: FloatArray) -> None:
    for j in range(len(value)):
        total[j] = BACKGROUND
    for i in range(k):
        density(value, fit.mean[i], fit.sigma[i], rows[i])
        for j in range(len(value)):
            total[j] += fit.weight[i] * rows[i, j]
    for i in range(k):
        for j in range(len(value)):
            rows[i, j] *= fit.weight[i] / total[j]
        fit.support[i] = total_of(rows[i])


def _kernels(decorator: Callable[[Any], Any]) -> tuple[Callable[..., None], Callable[..., None]]:
    expect_rows, expect_struct = decorator(_expect_rows), decorator(_expect_struct)

    def of_rows(value: FloatArray, k: int, fit: FloatArray, rows: FloatArray, total: FloatArray, rounds: int) -> None:
        for _ in range(rounds):
            expect_rows(value, k, fit, rows, total)
            for i in range(k):
                fit[MEAN, i] = product_of(rows[i], value) / fit[SUPPORT, i]
                fit[WEIGHT, i] = fit[SUPPORT, i] / len(value)

    def of_struct(value: FloatArray, k: int, fit: Fit, rows: FloatArray, total: FloatArray, rounds: int) -> None:
        for _ in range(rounds):
            expect_struct(value, k, fit, rows, total)
            for i in range(k):
                fit.mean[i] = product_of(rows[i], value) / fit.support[i]
                fit.weight[i] = fit.support[i] / len(value)

    return jit(of_rows), jit(of_struct)


def _start(kernel: str) -> FloatArray | Fit:
    fit = new_components(8)
    fit[MEAN, :SURFACES], fit[SIGMA, :SURFACES], fit[WEIGHT, :SURFACES] = (990.0, 1070.0), 10.0, 0.5
    return fit if kernel == "rows" else Fit(*(fit[row].copy() for row in (MEAN, SIGMA, WEIGHT, SUPPORT)))


def main() -> None:
    rng = np.random.default_rng(20260925)
    value = np.sort(np.concatenate([rng.normal(1000.0, 10.0, SAMPLES // 2), rng.normal(1060.0, 10.0, SAMPLES // 2)]))
    rows, total = np.zeros((8, SAMPLES)), np.zeros(SAMPLES)
    density(value, 1000.0, 10.0, rows[0])  # numba's own first compile is none of either
    for calls, decorator in (("as a part", borrowing), ("by itself", jit)):
        kernels = dict(zip(("rows", "struct"), _kernels(decorator), strict=True))
        compiling, best = {}, dict.fromkeys(kernels, np.inf)
        for name, kernel in kernels.items():
            start = time.perf_counter()
            kernel(value, SURFACES, _start(name), rows, total, 1)
            compiling[name] = time.perf_counter() - start
        for _ in range(REPEATS):
            for name, kernel in kernels.items():
                fit, start = _start(name), time.process_time()
                kernel(value, SURFACES, fit, rows, total, ROUNDS)
                best[name] = min(best[name], (time.process_time() - start) / ROUNDS)
        for name in kernels:
            print(f"{calls}, {name}: {compiling[name]:.2f} s to compile, {1e6 * best[name]:.3f} us a round")


if __name__ == "__main__":
    main()
