"""Step 1: hold a recording against a model, by normal scores, and sum them up in a panel of statistics.

A sample's probability integral transform under the model's own predictive distribution of its pixel gives a
standard normal score if the model is right; what the scores are summed up to is in `tofmix.reconcile.panel`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconcile.joint import View, views
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.memory import memory_of, whitened
from tofmix.reconcile.mixture import Mixture
from tofmix.reconcile.panel import Curve, discreteness, invalid, neighbours, panel_axes, shapes
from tofmix.reconcile.panel_lines import lines
from tofmix.reconcile.panel_time import in_time
from tofmix.reconcile.telling import telling_of

_FAR = np.float32(4.0)  # scores beyond count as this: fourth powers must not hang on one sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """Scores of a part and what they sum up to."""

    curves: tuple[Curve, ...]
    pattern: FloatArray  # (recording, pixel) mean score, NaN outside the part
    part: Part

    @property
    def gap(self) -> float:
        """Root mean square of the panel's distances: 1 by chance."""
        return float(np.sqrt(np.mean([c.distance**2 for c in self.curves])))


def compare(likelihood: Likelihood, state: State, part: Part, *, seed: int, mixture: Mixture | None = None) -> Compared:
    """Compare a part of a recording with a state.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    state : State
        The model as it stands.
    part : (frames, pixels)
        What to compare; held out of every fit, for an honest gap. Each recording has curves of its own.
    seed : int
        For the draws within cells of whole mm.
    mixture : Mixture, optional
        The state's, if it is at hand.
    """
    m = likelihood.scene.mixture(state.effects) if mixture is None else mixture
    memory = memory_of(state)
    scored = (np.arange(likelihood.evidence.shape[0]), part[1]) if memory else part
    z = likelihood.scores(state, scored, seed, m)
    curves: list[Curve] = []
    pattern = np.full((len(likelihood.evidence.starts), likelihood.evidence.shape[1]), np.nan)
    for view in views(likelihood, m, part):
        own = z[view.frames] if not memory else whitened(z[view.frames], view.mixture, memory)
        own = np.clip(own[view.part[0]][:, view.part[1]], -_FAR, _FAR)
        gains = telling_of(own, view.evidence, view.mixture, view.part)
        curves += [
            replace(c, recording=view.number, telling=gains.get((c.statistic, c.axis)))
            for c in _curves(own, view, state)
        ]
        with np.errstate(invalid="ignore"):
            pattern[view.number, part[1]] = np.nansum(own, axis=0) / np.maximum(np.isfinite(own).sum(axis=0), 1)
    return Compared(curves=tuple(curves), pattern=pattern, part=part)


def _curves(z: Float32Array, view: View, state: State) -> Iterator[Curve]:
    """The panel of one recording's scores (frame, pixel) of its part."""
    evidence, m, part = view.evidence, view.mixture, view.part
    axes = list(panel_axes(evidence, m, part))
    yield from shapes(z, axes, m, state, part)
    yield from in_time(z, evidence, part, m)
    yield from invalid(evidence, m, state, axes, part)
    yield from neighbours(z, evidence, part)
    yield from lines(z, evidence, part)
    yield from discreteness(evidence, part, m, state)
