"""Steps 1 and 2: compare a recording with a model by normal scores, and find where they disagree most.

Step 1: compare a recording with a model by normal scores, and sum them up in a panel of statistics.

The score of a sample is its probability integral transform under the predicted distribution of its pixel, mapped to a
standard normal. If the model is right, scores are standard normal. `tofmix.reconciliation.comparison.panel` computes
the statistics of the scores.

Step 2: find the interval of an axis in which a statistic deviates most.

Each curve of the panel is scanned over all intervals of its bins. The p-value of the best interval is corrected for all
intervals and curves (Bonferroni), so it is conservative.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import norm

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconciliation.comparison.information import gain, information_of
from tofmix.reconciliation.comparison.panel import Curve, discreteness, invalid, neighbours, panel_axes, shapes, widths
from tofmix.reconciliation.comparison.panel_parts import bridging, burst_share, in_time, lines
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import memory_of, one_surface, whitened
from tofmix.reconciliation.likelihood.mixture import Mixture

FARTHEST_SCORE = np.float32(4.0)
"""Largest score in the statistics: one sample must not determine a fourth power."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """The statistics of a part's scores."""

    curves: tuple[Curve, ...]
    pattern: FloatArray  # (recording, pixel) mean score, NaN outside the part
    part: Part

    @property
    def gap(self) -> float:
        """Root mean square of the panel's distances; noise alone gives 1."""
        return float(np.sqrt(np.mean([c.distance**2 for c in self.curves])))


def compare(
    likelihood: Likelihood, state: ModelState, part: Part, *, seed: int, mixture: Mixture | None = None
) -> Compared:
    """Compare a part of a recording with a state.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        Samples to compare. They must be held out of every fit, or the gap is too small. Each recording has separate
        curves.
    seed : int
        For the draws within cells of whole mm.
    mixture : Mixture, optional
        That of the state, if it was computed before.
    """
    m = likelihood.mixture(state) if mixture is None else mixture
    memory = memory_of(state)
    scored = (np.arange(likelihood.evidence.shape[0]), part[1]) if memory else part
    z = likelihood.scores(state, scored, seed, m)
    curves: list[Curve] = []
    pattern = np.full((len(likelihood.evidence.starts), likelihood.evidence.shape[1]), np.nan)
    for view in views(likelihood, m, part):
        own = z[view.frames] if not memory else whitened(z[view.frames], view.mixture, memory)
        own = np.clip(own[view.part[0]][:, view.part[1]], -FARTHEST_SCORE, FARTHEST_SCORE)
        gains = information_of(own, view.evidence, view.mixture, view.part)
        crossed = any(e.links_neighbours for e in (*view.scene.effects, *state.effects))
        apart = _apart(own, view) if crossed else own
        curves += [
            replace(c.varying, recording=view.number, information=gains.get((c.statistic, c.axis)))
            for c in _curves(own, apart, view, state)
        ]
        with np.errstate(invalid="ignore"):
            pattern[view.number, part[1]] = np.nansum(own, axis=0) / np.maximum(np.isfinite(own).sum(axis=0), 1)
    return Compared(curves=tuple(curves), pattern=pattern, part=part)


def _apart(z: Float32Array, view: RecordingView) -> Float32Array:
    """Scores without pixels that see several surfaces, or that have such a neighbour.

    With crosstalk, neighbouring scores are correlated, because they show which surface was drawn.
    """
    alone = one_surface(view.mixture).reshape(view.evidence.image)
    framed = np.pad(alone, 1, mode="edge")
    alone = alone & framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return np.where(alone.ravel()[view.part[1]], z, np.float32(np.nan))


def _curves(z: Float32Array, apart: Float32Array, view: RecordingView, state: ModelState) -> Iterator[Curve]:
    """The panel of one recording's scores (frame, pixel); `apart` are the scores for correlations."""
    evidence, m, part = view.evidence, view.mixture, view.part
    axes = list(panel_axes(evidence, m, part, measured=state.errors is not None))
    yield from shapes(z, axes, m, state, part, view.number)
    yield from widths(state, view.scene.model.sensor.noise.width_spread, view.number)
    together = 0.0 if state.errors is None else state.errors.frame_noise**2
    yield from in_time(apart, evidence, part, m, together)
    if state.bursts is not None and not state.bursts.period_frames:
        yield from burst_share(state.disturbed[view.frames], state.bursts)
    yield from invalid(evidence, m, state, axes, part)
    yield from neighbours(apart, evidence, part)
    yield from lines(apart, evidence, part)
    yield from bridging(evidence, m, state, axes, part)
    yield from discreteness(evidence, part, m, state)


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
