"""Step 2: find the interval of an axis in which a statistic deviates most.

Each curve of the panel is scanned over all intervals of its bins. The p-value of the best interval is corrected for all
intervals and curves (Bonferroni), so it is conservative.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import norm

from tofmix.reconciliation.comparison.compare import Compared
from tofmix.reconciliation.comparison.information import gain
from tofmix.reconciliation.comparison.panel import Curve

LEAST_SIZE = 0.02
"""Smaller deviations, in sigma, do not count."""

_IN_SIGMA = (
    "bias",
    "spread",
    "skew",
    "tails",
    "pattern",
    "spread_pattern",
    "skew_pattern",
    "tails_pattern",
    "common_mode",
    "bursts",
    "trend",
    "memory",
    "neighbour_correlation",
    "widths",
)
SMALLEST_P = 1.0e-300
"""Smallest p-value, above 0, which some JSON readers take as a missing value."""

_MOST_BINS = 60  # times ten: with more bins, intervals are not scanned


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """An interval in which a statistic disagrees.

    Parameters
    ----------
    axis, statistic : str
        Names as in `gap.json`.
    interval : (float, float)
        In the unit of the axis.
    size : float
        Mean of the statistic in it; mm for a bias, else a ratio, a correlation or a share.
    unit : str
        Unit of the size.
    p_value : float
        Corrected for all intervals and curves.
    z : float
        Deviation in standard errors.
    recording : int
        Number of the recording, from 0.
    """

    axis: str
    statistic: str
    interval: tuple[float, float]
    size: float
    unit: str
    p_value: float
    z: float
    recording: int = 0


def disagreements(compared: Compared, alpha: float) -> list[Curve]:
    """Curves above noise at the corrected level `alpha`, and above `LEAST_SIZE`; largest evidence first."""
    curves = compared.curves
    limit = float(norm.isf(alpha / max(len(curves), 1)))
    loud = [
        c
        for c in curves
        if c.dof and c.z > limit and c.excess_nats > 0 and (c.largest > LEAST_SIZE or c.statistic not in _IN_SIGMA)
    ]
    return sorted(loud, key=lambda c: -c.excess_nats)


def localise(compared: Compared, alpha: float) -> list[Place]:
    """The interval of largest deviation of each curve that stands out; largest evidence first.

    Parameters
    ----------
    compared : Compared
        Panel of a part.
    alpha : float
        Level of the test, after correction.
    """
    curves = disagreements(compared, alpha)
    places = [_strongest(curve, len(compared.curves)) for curve in _by_weight(curves)]
    return [p for p in places if p.p_value <= alpha]


def _by_weight(curves: Iterable[Curve]) -> list[Curve]:
    """Sorted by the information that lower orders do not contain; equal ones in the order of the panel."""
    return sorted(curves, key=lambda c: -(gain(c.chi2, c.dof) if c.information is None else c.information))


def _strongest(curve: Curve, looked_at: int) -> Place:
    weight = 1 / curve.variance
    total, mass = np.concatenate([[0], np.cumsum(curve.value * weight)]), np.concatenate([[0], np.cumsum(weight)])
    best, where = -1.0, (0, curve.dof)
    longest = curve.dof if curve.dof <= _MOST_BINS * 10 else 1
    for length in range(1, longest + 1):
        z = np.abs(total[length:] - total[:-length]) / np.sqrt(mass[length:] - mass[:-length])
        at = int(z.argmax())
        if z[at] > best:
            best, where = float(z[at]), (at, at + length)
    a, b = where
    whole = curve.statistic.endswith("pattern")  # pixels have no order, so no interval of them is a place
    a, b = (0, curve.dof) if whole else where
    value = (total[b] - total[a]) / (mass[b] - mass[a])
    tests = looked_at * curve.dof * (min(longest, curve.dof) + 1) / 2
    # The whole curve may be more significant than its best interval, as for a sine
    log_p = min(log_ndtr(-best) + math.log(2 * tests), log_ndtr(-curve.z) + math.log(looked_at))
    in_mm = curve.statistic in ("bias", "trend", "common_mode", "pattern")
    scale = float(np.average(curve.scale_mm[a:b], weights=weight[a:b])) if in_mm else 1.0
    return Place(
        axis=curve.axis,
        statistic=curve.statistic,
        interval=(0.0, 1.0) if whole else (float(curve.lower[a]), float(curve.upper[b - 1])),
        size=float((curve.size if whole else value) * scale),
        unit="mm" if in_mm else "1",
        p_value=max(min(math.exp(max(min(log_p, 0.0), -690.0)), 1.0), SMALLEST_P),
        z=best,
        recording=curve.recording,
    )
