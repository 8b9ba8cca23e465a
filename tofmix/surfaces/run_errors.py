"""Errors of edges of unmixed shares: the common part of the errors along a run.

Shares that are counts are independent of each other. Those of phasor sums are not: a pixel's share depends on the
phasors of its two neighbouring surfaces, and the next pixels depend on nearly the same ones. Fits take shares for
independent, so their variances are too small. A fit cannot show an error that its whole run has in common; it follows
from the windows in which unmixing measures a surface. The scatter of runs beyond their errors is measured. It is of the
edge, which is not as straight or as round as the fit, and so in common too.
"""

import numpy as np
from scipy.spatial import cKDTree

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.surfaces.cuts import Cuts
from tofmix.surfaces.edge_shape import AGREES, AHEAD, ANGLE, BACK, BAR, COLUMNS, KIND, VAR_ANGLE, VAR_THIRD, own_area
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Shares


def widened(fits: FloatArray, cuts: Cuts, shares: Shares, settings: EdgeSettings) -> FloatArray:
    """Fits (cut, FIT_COLUMNS) with larger variances where shares are unmixed; else the same.

    Parameters
    ----------
    fits : (cut, FIT_COLUMNS) float64
        From `fit_edges`.
    cuts, shares
        Of the same window.
    settings : EdgeSettings
        Thresholds.
    """
    if not shares.common or not len(cuts):
        return fits
    length = fits[:, BACK] + fits[:, AHEAD] + 1.0
    # A line of this direction crosses so many pixels on a length of 1.
    crossed = np.abs(np.cos(fits[:, ANGLE])) + np.abs(np.sin(fits[:, ANGLE]))
    # Variance of a mean over the run, of errors that are in common, in units of that of independent ones.
    alike = np.maximum(1.0, crossed * length * _alike(length, settings.alike_distance))
    factor = 1.0 - shares.common + (shares.common + _excess(fits, cuts, shares, settings.longest_run)) * alike
    out = fits.copy()
    out[:, VAR_ANGLE : VAR_THIRD + 1] *= factor[:, np.newaxis]
    return out


def _alike(length: FloatArray, distance: float) -> FloatArray:
    """Mean (...) of exp(-(h / distance)^2) over the distances h of two places on a length."""
    steps = (np.arange(200) + 0.5) / 200
    # The distance of two places on a length has a density that falls linearly to 0 at its end.
    kernel = np.exp(-((length[..., np.newaxis] * steps / distance) ** 2)) * 2.0 * (1.0 - steps)
    return np.asarray(kernel.mean(axis=-1))


def _excess(fits: FloatArray, cuts: Cuts, shares: Shares, reach: int) -> FloatArray:
    """Variance (cut,) that an edge's pixels show beyond their errors and chance, in units of these."""
    row, col = cuts.row, cuts.col
    told = (fits[:, AGREES] > 0) & (fits[:, KIND] != BAR) & (cuts.entry == 0) & (shares.count[row, col] > 1)
    chosen = np.flatnonzero(told)
    out = np.zeros(len(fits))
    if not chosen.size:
        return out
    row, col, near = row[chosen], col[chosen], cuts.near[chosen]
    squares = _squares(fits[chosen], shares.up_to[row, col, 0], shares.samples[row, col], shares.floor[row, col])
    # Surfaces are far apart in the third coordinate, so that edges of one alone are neighbours.
    places = np.column_stack([row, col, near.astype(np.float64) * 4.0 * reach])
    for cut, others in zip(chosen, cKDTree(places).query_ball_point(places, reach), strict=True):
        chance = 1.0 + np.sqrt(2.0 / len(others))  # a mean of squares, and its standard deviation
        out[cut] = max(0.0, float(squares[others].mean() - chance))
    return out


@jit
def _squares(fits: FloatArray, share: FloatArray, samples: FloatArray, floor: FloatArray) -> FloatArray:
    """Squared residuals (cut,) of pixels' own shares in units of their variances."""
    out = np.empty(len(fits))
    pixel, scratch, work = np.empty(COLUMNS), np.empty(7), np.empty((3, 8, 2))
    for i in range(len(fits)):
        area = own_area(fits[i], pixel, scratch, work)
        out[i] = (share[i] - area) ** 2 / ((area * (1.0 - area) + 0.25 / samples[i]) / samples[i] + floor[i])
    return out
