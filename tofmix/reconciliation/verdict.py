"""The verdict. No other module decides it.

`tofmix.reconciliation.verification.verify` collects the findings; `judge` makes a verdict of them.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from scipy.stats import norm

from tofmix.reconciliation.comparison.compare import LEAST_SIZE, Compared, disagreements
from tofmix.reconciliation.comparison.panel import SHAPES, Curve
from tofmix.reconciliation.found import TriedEffect
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.hidden import PixelBias, RememberedNoise

LAW = 0.1
"""Possible error of an effect's law, as a part of its change of a statistic: no camera follows a law exactly."""

MOSTLY = 0.9
"""If a statistic stands out: least share of the gain in the sum of gain and largest remaining evidence."""

CLOSED = 0.8
"""Least share of the gap that must then be closed."""

FRAMES = 4.0
"""Independent frames, at least, that a recording must be worth for a name or for `agree`: two to fit, two to judge."""

SIGMAS = 0.5
"""Bias of all samples, in sigma, that a recording must be able to show for the verdict `agree`."""

_POWER = round(NormalDist().inv_cdf(0.95), 3)
"""Standard errors beyond the limit, to three decimals: such a bias is seen in 95 of 100 recordings."""

_WITHIN_CHANCE = 0.15  # of a gap
_SANE = 1.5  # largest gap of the refined model's own simulation, if that of the recording is no larger
_SETTLED, _UNTOUCHED = 0.97, 0.7  # least share that is removed of the largest deviation; that is left of others
_OPEN = 0.03  # share of an effect's gain that may remain in the statistics in which it must show
_FEW = 0.1  # weight of third and fourth powers of single pixels, which depend on few samples
_HIGHER = ("spread", "skew", "tails")  # orders that a bias moves too
_TAILED = ("skew", "tails")  # a law that is inexact in one of these is inexact in the other


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerdictData:
    """The data of a verdict.

    Parameters
    ----------
    chosen : tuple of TriedEffect
        The found effects.
    before, after, floor : Compared
        Panels on held-out frames: of the model as given, of the refined model, and of a simulation of the refined
        model.
    nulls : tuple of Compared
        Panels of several simulations, including `floor`, if they show the deviations of the recording too.
    near : Compared
        Panel of the refined model moved within its tolerance to where it fits these frames best.
    alpha : float
        Level of the tests, corrected for all curves.
    samples : int
        Valid samples that were held out.
    frames : int
        Frames of the recordings.
    independent : float
        Number of independent samples that have the information of a pixel's samples, over their number.
    judged : float
        Number of judged samples over the number of samples on which gains were scored.
    law : str or None
        Axis of a smooth law that fits better than the found effects.
    faint_law : bool
        Whether the effects have nearly all of the evidence of the set with that law.
    own : Effect or None
        The model's own effect with other numbers, if it fits better than the found effects.
    contradicted : bool
        Whether something speaks against an effect by itself
        (`tofmix.reconciliation.verification.contradictions`).
    bound, echo, shaped, in_time : bool
        Whether an effect has numbers at which it is another effect; whether another memory remains after a memory;
        whether a pattern of pixels is a smooth law; whether frames still change in time.
    changed : bool
        Whether parts of a measured scene have changed and were left out.
    """

    chosen: tuple[TriedEffect, ...]
    before: Compared
    after: Compared
    floor: Compared
    near: Compared
    alpha: float
    samples: int
    frames: int = 100
    independent: float = 1.0
    nulls: tuple[Compared, ...] = ()
    judged: float = 1.0
    law: str | None = None
    faint_law: bool = False
    own: Effect | None = None
    contradicted: bool = False
    bound: bool = False
    echo: bool = False
    shaped: bool = False
    in_time: bool = False
    changed: bool = False

    @property
    def smallest_sigma(self) -> float:
        """The smallest bias of all samples, in sigma, that these frames show in 95 of 100 recordings."""
        limit = float(norm.isf(self.alpha / max(len(self.near.curves), 1)))
        return (limit + _POWER) / math.sqrt(max(self.samples * self.independent, 1))

    @property
    def few(self) -> bool:
        """Whether there are too few independent samples to see half a sigma, or too few independent frames."""
        return self.missing_frames > 0

    @property
    def no_name(self) -> bool:
        """Whether there are too few independent frames for a name, whatever stands out."""
        return FRAMES / self.independent > self.frames

    @property
    def missing_frames(self) -> int:
        """Frames that a recording needs beyond those that it has: to see half a sigma, and to be worth `FRAMES`."""
        needed = max(self.frames * (self.smallest_sigma / SIGMAS) ** 2, FRAMES / self.independent)
        return max(math.ceil(needed) - self.frames, 0)

    @property
    def open(self) -> list[Curve]:
        """Curves that stand out beyond noise and tolerance, largest evidence first."""
        return [c for c in disagreements(self.near, self.alpha) if self._beyond(c)]

    def left(self, curve: Curve) -> float:
        """The evidence of a curve, nats, minus that of the model's own simulations."""
        few = curve.statistic in ("skew_pattern", "tails_pattern")
        own = [c.excess_nats for c in self._simulated(curve)]
        seen = curve.excess_nats - max(float(np.mean(own)) if own else 0.0, 0.0)
        return max(seen, 0.0) * (_FEW if few else 1.0)

    @property
    def unsigned(self) -> tuple[int, ...]:
        """Numbers of the effects that leave a deviation in the statistics in which they must show."""
        loud = disagreements(self.near, self.alpha)
        out = []
        for number, candidate in enumerate(self.chosen):
            own = candidate.effect.shows_in
            open_ = max((self.left(c) for c in loud if c.statistic in own and not c.of_lines), default=0.0)
            if open_ > _OPEN * self.judged * candidate.gain:
                out.append(number)
        return tuple(out)

    @property
    def signed(self) -> bool:
        """Whether no effect leaves a deviation in the statistics in which it must show."""
        return not self.unsigned

    @property
    def refused(self) -> tuple[int, ...]:
        """Numbers of the effects against which a finding speaks, besides evidence against single ones."""
        sorts = (*([RememberedNoise] if self.echo else []), *([PixelBias] if self.shaped else []))
        own = {k for k, c in enumerate(self.chosen) if isinstance(c.effect.hidden, sorts) or c.at_a_bound}
        return tuple(sorted(own | set(self.unsigned)))

    @property
    def sound(self) -> bool:
        """Whether nothing speaks against the effects, whatever else remains."""
        other = (self.law is not None and not self.faint_law) or self.own is not None
        sane = self.floor.gap <= max(self.before.gap, _SANE)
        return self.signed and sane and not (other or self.contradicted or self.bound or self.echo or self.shaped)

    @property
    def settled(self) -> bool:
        """Whether the remaining deviations are on other curves than the explained ones, and were there before."""
        if any(c.exact for c in self.chosen):
            return True
        was, now = _named(self.before), _named(self.near)
        top = max(was.values(), key=lambda c: c.excess_nats)
        rest = now[top.name].excess_nats if top.name in now else 0.0
        if rest >= (1 - _SETTLED) * top.excess_nats:
            return False
        before = {name: c.excess_nats for name, c in was.items()}
        return all(c.excess_nats > _UNTOUCHED * before.get(c.name, 0.0) for c in self.open[:3])

    def _beyond(self, curve: Curve) -> bool:
        """Whether a curve exceeds the model's own simulations and the remainder of an inexact law."""
        if not self.stands_out_of_simulations(curve):
            return False
        return not self.chosen or curve.size > inexact(curve, self.before)

    def stands_out_of_simulations(self, curve: Curve) -> bool:
        """Whether a curve exceeds the model's own simulations, if they also show a deviation.

        Predictions are approximate, and hidden states have errors. Both show in simulations as in a recording. So the
        chi-square of n bins is noncentral: with the mean n + l its variance is 2 (n + 2 l), and larger if hidden states
        differ.
        """
        own = self._simulated(curve)
        if not self.is_simulated(curve):
            return True
        seen = np.array([c.chi2 for c in own])
        mean = float(seen.mean())
        variance = 2 * (curve.dof + 2 * max(mean - curve.dof, 0.0))
        if len(own) > 1:
            variance = max(variance, float(seen.var(ddof=1)))
        limit = float(norm.isf(self.alpha / max(len(self.near.curves), 1)))
        return curve.chi2 - mean > limit * math.sqrt(variance * (1 + 1 / len(own)))

    def is_simulated(self, curve: Curve) -> bool:
        """Whether simulations of the model also show a deviation of a curve."""
        shown = 2.0  # normal deviate from which the model's own simulation also shows a deviation
        return max((c.z for c in self._simulated(curve)), default=0.0) >= shown

    def _simulated(self, curve: Curve) -> list[Curve]:
        panels = (_named(panel) for panel in self.nulls or (self.floor,))
        return [panel[curve.name] for panel in panels if curve.name in panel]

    @property
    def mostly(self) -> bool:
        """Whether the gain of the effects is far larger than the remaining evidence, and they close most of the gap.

        Gains of effects that lose samples are compared with lost samples, the others with ranges. Gains of exact laws
        do not count.
        """
        loud = disagreements(self.near, self.alpha)
        for lost in (True, False):
            left = max((self.left(c) for c in loud if (c.statistic == "invalid") == lost), default=0.0)
            told = (c.gain for c in self.chosen if not c.exact and (lost or not c.loses))
            gain = self.judged * sum(told)
            if left and gain < MOSTLY * (gain + left):
                return False
        chance = max(self.floor.gap, 1.0)
        room = max(self.before.gap - chance, _WITHIN_CHANCE)
        return min(self.after.gap, self.near.gap) - chance <= (1 - CLOSED) * room


def judge(found: VerdictData) -> str:
    """The verdict.

    Parameters
    ----------
    found : Findings
        The findings.

    Returns
    -------
    str
        With too few independent frames always ``unexplained``. ``agree``: no effect was added and nothing stands out.
        ``explained``: effects were added and nothing stands out. ``partly_explained``: a deviation remains, but it is
        small compared with the gain of the effects, or it was there before and the effects do not change it, or it is
        a change in time, or a faint law that no effect has; or too few samples could show one. ``unexplained``: all
        other cases.
    """
    if not found.chosen:
        return "unexplained" if found.open or found.few or found.changed else "agree"
    if found.no_name or not found.sound:
        return "unexplained"
    if not found.open:
        rest = found.in_time or found.few or found.changed or found.law is not None
        return "partly_explained" if rest else "explained"
    return "partly_explained" if found.settled or found.mostly else "unexplained"


def inexact(curve: Curve, before: Compared) -> float:
    """Size of a curve up to which it may be the remainder of an inexact law.

    A law that is wrong by a tenth leaves a tenth of a bias. A spread is quadratic in the bias of its samples, and tails
    in a spread. So of the part that comes from lower orders, the law leaves a hundredth.

    Parameters
    ----------
    curve : Curve
        A curve of a model with effects.
    before : Compared
        Panel of the model without them.

    Returns
    -------
    float
        At least the size that does not count as a deviation. Skew and tails are treated together.
    """
    was = _named(before)
    pattern = "_pattern" if curve.statistic.endswith("_pattern") else ""
    tailed = curve.statistic.removesuffix(pattern) in _TAILED
    alike = tuple(f"{name}{pattern}" for name in _TAILED) if tailed else (curve.statistic,)
    moved = [was[name] for name in ((name, curve.axis, curve.recording) for name in alike) if name in was]
    own, all_ = max(map(_own_size, moved), default=0.0), max((c.size for c in moved), default=0.0)
    return max(LAW * own + LAW**2 * (all_ - own), LEAST_SIZE if curve.statistic in (*SHAPES, "pattern") else 0.0)


def _own_size(curve: Curve) -> float:
    """Size of a curve without the part that comes from curves of lower order."""
    if curve.information is None or curve.statistic.removesuffix("_pattern") not in _HIGHER:
        return curve.size
    if not curve.dof:  # too few samples for any bin
        return 0.0
    return min(curve.size, math.sqrt(2 * curve.information / float((1 / curve.variance).sum())))


def share_closed(before: Compared, after: Compared, floor: Compared) -> float | None:
    """Share of the gap that is closed; None if there is no gap beyond noise."""
    room = before.gap - floor.gap
    return None if room < _WITHIN_CHANCE else (before.gap - after.gap) / room


def _named(panel: Compared) -> dict[tuple[str, str, int], Curve]:
    return {c.name: c for c in panel.curves}
