"""The changes that effects make to the biases and widths of pixels, by a unit of each coefficient of a linear form."""

import math
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.biases import biases_of_recordings
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.search import Coefficient, FormFacts
from tofmix.simulation.surface import Surface

TENTHS = 10
"""Parts of the time in which summaries of samples have a bias each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """The change that one unit of a coefficient makes to each recording.

    Parameters
    ----------
    bias_mm : tuple of (pixel,) float64
        Change of the mean, for each summary.
    profile : tuple of (tenth,) float64
        Factor on this change in each tenth of the time.
    width : tuple of (pixel,) float64
        Change of the logarithm of the width.
    prior : float
        Standard deviation of the prior of the coefficient.
    """

    bias_mm: tuple[FloatArray, ...]
    profile: tuple[FloatArray, ...]
    width: tuple[FloatArray, ...]
    prior: float = 1.0


class ColumnMaker:
    """Makes columns from the predicted changes of a small effect.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    state : ModelState
        The model as given.
    part : (frames, pixels)
        The samples.
    """

    def __init__(self, likelihood: Likelihood, state: ModelState, part: Part) -> None:
        self.likelihood, self.state = likelihood, state
        self.seen = seen = biases_of_recordings(likelihood, state, part)
        frames = [[f for f in np.array_split(s.view.part_of_all[0], TENTHS) if f.size] for s in seen]
        self.elapsed_s = [np.array([float(likelihood.evidence.time_s[f].mean()) for f in own]) for own in frames]
        self.base = likelihood.mixture(state)
        used = [s.view.mixture.of_main(s.view.mixture.sigma)[s.used] for s in seen]
        lit = [s.view.mixture.of_main(s.view.mixture.amplitude)[s.used] for s in seen]
        amplitude = np.concatenate(lit)
        amplitude = amplitude[amplitude > 0]
        turn = likelihood.scene.model.sensor.modulation_frequency_hz
        surfaces = dict.fromkeys(name for s in seen for name, _ in s.surfaces)
        self.facts = FormFacts(
            sigma_mm=float(np.median(np.concatenate(used))) if any(u.size for u in used) else 1.0,
            duration_s=max(float(likelihood.evidence.time_s.max()), 1e-3),
            turn_mm=math.nan if turn is None else likelihood.scene.model.sensor.turn_mm("reconcile"),
            amplitude=float(np.exp(np.log(amplitude).mean())) if amplitude.size else 1.0,
            surfaces=tuple(self._surface(name) for name in surfaces),
            gain=self._gain,
        )

    def _surface(self, name: str) -> Surface:
        """The surface of this name in the model of the first recording that has it."""
        return next(s for seen in self.seen for s in seen.view.scene.model.surfaces if s.name == name)

    def _gain(self, effect: Effect) -> float:
        """As `FormFacts.gain`."""
        column = self.column(Coefficient(effect=effect, size=1.0, spread=1.0))
        size, pull = 0.0, 0.0
        for s, bias in zip(self.seen, column.bias_mm, strict=True):
            size += float((s.information * bias**2).sum())
            pull += float((s.information * s.bias_mm * bias).sum())
        return 0.5 * pull**2 / size if pull > 0 and size > 0 else 0.0

    def column(self, of: Coefficient) -> Column:
        """The change that a unit of a coefficient makes.

        Raises
        ------
        ValueError
            If the camera or the scene cannot have its effect.
        """
        of.effect.check(self.likelihood.scene.model.sensor, self.likelihood.scene.names)
        changed = self.likelihood.mixture(_with(self.state, of.effect))
        bias, width, times = [], [], []
        for s, elapsed_s in zip(self.seen, self.elapsed_s, strict=True):
            before, after = self.base.of_frames(s.view.frames), changed.of_frames(s.view.frames)
            place = after.main_of(before)
            seen = s.used & (place >= 0)  # if the surface is out of the pixel, nothing is known
            moved = _of(after, "mean", place) - before.of_main(before.mean)
            wider = np.log(_of(after, "sigma", place) / before.of_main(before.sigma))
            bias.append(np.where(seen, moved, 0.0) / of.size)
            width.append(np.where(seen, wider, 0.0) / of.size)
            times.append(np.ones(elapsed_s.size) if of.course is None else of.course(elapsed_s))
        return Column(bias_mm=tuple(bias), profile=tuple(times), width=tuple(width), prior=of.spread)


def _of(m: Mixture, name: str, component: IntArray) -> FloatArray:
    values: FloatArray = getattr(m, name)[0]
    return np.asarray(np.take_along_axis(values, np.maximum(component, 0)[None], axis=0)[0])


def _with(state: ModelState, effect: Effect) -> ModelState:
    return replace(state, effects=(*state.effects, effect))
