"""Step 1: hold a recording against a model, by normal scores, and sum them up in a panel of statistics.

A sample's probability integral transform under the model's own predictive distribution of its pixel gives a
standard normal score if the model is right; what the scores are summed up to is in `tofmix.reconcile.panel`.
"""

from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.reconcile.likelihood import Likelihood, Part, State
from tofmix.reconcile.links import whitened
from tofmix.reconcile.mixture import Mixture
from tofmix.reconcile.panel import Curve, discreteness, in_time, invalid, neighbours, panel_axes, shapes
from tofmix.reconcile.panel_lines import lines
from tofmix.reconcile.telling import telling_of
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation

_FAR = np.float32(4.0)  # scores beyond count as this: fourth powers must not hang on one sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """Scores of a part and what they sum up to."""

    curves: tuple[Curve, ...]
    pattern: FloatArray  # (pixel,) mean score, NaN outside the part
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
        What to compare; held out of every fit, for an honest gap.
    seed : int
        For the draws within cells of whole mm.
    mixture : Mixture, optional
        The state's, if it is at hand.
    """
    m = likelihood.scene.mixture(state.effects) if mixture is None else mixture
    z = _own_scores(likelihood, state, part, seed, m)
    axes = list(panel_axes(likelihood.evidence, m, part))
    z = np.clip(z, -_FAR, _FAR)
    curves = [*shapes(z, axes, m, state, part), *in_time(z, likelihood.evidence, part, m)]
    curves += invalid(likelihood.evidence, m, state, axes, part)
    curves += neighbours(z, likelihood.evidence, part)
    curves += lines(z, likelihood.evidence, part)
    curves += discreteness(likelihood.evidence, part, m, state)
    gains = telling_of(z, likelihood.evidence, m, part)
    curves = [replace(c, telling=gains.get((c.statistic, c.axis))) for c in curves]
    pattern = np.full(likelihood.evidence.shape[1], np.nan)
    with np.errstate(invalid="ignore"):
        pattern[part[1]] = np.nansum(z, axis=0) / np.maximum(np.isfinite(z).sum(axis=0), 1)
    return Compared(curves=tuple(curves), pattern=pattern, part=part)


def _own_scores(likelihood: Likelihood, state: State, part: Part, seed: int, m: Mixture) -> Float32Array:
    """Scores of a part; given the frame before where the noise has a memory."""
    memory = [e for e in state.effects if isinstance(e, TemporalCorrelation)]
    if not memory:
        return likelihood.scores(state, part, seed, m)[part[0]][:, part[1]]
    everything = np.arange(likelihood.evidence.shape[0]), part[1]
    z = likelihood.scores(state, everything, seed, m)
    return np.asarray(whitened(z, m, memory[0].coefficient)[part[0]][:, part[1]])
