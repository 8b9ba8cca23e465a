"""The surfaces of a mixture under fit, and scratch arrays for the fit.

Both are plain arrays with a row for each quantity, because fits are copied, sorted and
extrapolated as wholes. A structure of four arrays would be as fast: 0.34 and 0.33 us a
round of EM (`tests/benchmarks/fit_layout.py`).

`Components` (ROWS, capacity + 1): rows MEAN and SIGMA in mm, WEIGHT, SUPPORT (the sum of a surface's responsibilities,
in samples), GAIN (loss of likelihood without the surface, nat), and scratch rows. The last column is that of c_0: its
WEIGHT is p(c_0).

`Scratch` (rows, values): TOTAL is p(r_j), SHARE the count of r_j by p(r_j), SPARE and OTHER are free for any loop.
RANDOM is p(c_r) times the density of random values, 1/mm, where these are not uniform (`fill_random`). From DENSITY on
follow the normal densities of the surfaces, in 1/mm, and `no_return_row` is that of c_0. From `gradient_row` on there
is room for three rows more for each surface.
"""

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, is_uniform, outlier_density_at

MEAN, SIGMA, WEIGHT, SUPPORT, GAIN, MOMENT_1, MOMENT_2, UNIT = range(8)
STEPS = 8
"""From this row on: three vectors of an acceleration, three rows each."""

ROWS = STEPS + 9

TOTAL, SHARE, SPARE, OTHER, MEAN_SCORE, SHARE_SCORE, RANDOM, DENSITY = range(8)

Components = FloatArray
Scratch = FloatArray


@jit
def new_components(capacity: int) -> Components:
    """Room for `capacity` surfaces and c_0."""
    return np.zeros((ROWS, capacity + 1))


@jit
def new_scratch(capacity: int, values: int) -> Scratch:
    """Room for pixels of up to `values` different values and `capacity` surfaces."""
    return np.empty((DENSITY + 4 * capacity + 1, values))


@borrowing
def fill_random(values: FloatArray, beam: Beam, scratch: Scratch) -> None:
    """Fill row RANDOM at values, mm; `em.mix` reads it where random values are not uniform."""
    if not is_uniform(beam):
        for j in range(len(values)):
            scratch[RANDOM, j] = outlier_density_at(values[j], beam)


@borrowing
def capacity_of(fit: Components) -> int:
    """Most surfaces that fit."""
    return len(fit[MEAN]) - 1


@borrowing
def no_return_row(fit: Components) -> int:
    """Row of the densities of c_0."""
    return DENSITY + capacity_of(fit)


@borrowing
def gradient_row(fit: Components) -> int:
    """First row of the gradient."""
    return DENSITY + capacity_of(fit) + 1


@borrowing
def copy_components(k: int, source: Components, target: Components) -> None:
    """Copy the state of `k` surfaces and of c_0."""
    for row in (MEAN, SIGMA, WEIGHT, SUPPORT):
        for i in range(k):
            target[row, i] = source[row, i]
        target[row, -1] = source[row, -1]


@borrowing
def remove_surface(k: int, index: int, fit: Components) -> int:
    """Close the gap that surface `index` leaves; return k - 1."""
    for row in (MEAN, SIGMA, WEIGHT, SUPPORT):
        for i in range(index, k - 1):
            fit[row, i] = fit[row, i + 1]
    return k - 1


@borrowing
def sort_surfaces(k: int, fit: Components, rows: int) -> None:
    """Put the surfaces in order, near to far, in the first `rows` rows: EM may have moved one past another."""
    for i in range(1, k):
        for j in range(i, 0, -1):
            if fit[MEAN, j - 1] <= fit[MEAN, j]:
                break
            for row in range(rows):
                fit[row, j - 1], fit[row, j] = fit[row, j], fit[row, j - 1]
