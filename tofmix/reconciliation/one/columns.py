"""The changes that effects make to the biases and widths of pixels, by a unit of each coefficient of a linear form."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import biases_of_recordings
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
        Change of the logarithm of the width, a mean over the tenths.
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
        self.tenths = [[f for f in np.array_split(s.view.part_of_all[0], TENTHS) if f.size] for s in seen]
        self.elapsed_s = [np.array([float(likelihood.evidence.time_s[f].mean()) for f in own]) for own in self.tenths]
        self.surface = [s.view.mixture.of_main(s.view.mixture.surface) for s in seen]
        self.before = self._by_tenth(likelihood.mixture(state))
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
        after = self._by_tenth(self.likelihood.mixture(_with(self.state, of.effect)))
        bias, width, times = [], [], []
        for s, elapsed_s, now, before in zip(self.seen, self.elapsed_s, after, self.before, strict=True):
            moved, wider = (
                np.where(s.used, np.nan_to_num(new - old), 0.0) / of.size for new, old in zip(now, before, strict=True)
            )
            shape, course = _static(moved)
            bias.append(shape)
            width.append(wider.mean(axis=0))
            times.append(course if of.course is None else of.course(elapsed_s))
        return Column(bias_mm=tuple(bias), profile=tuple(times), width=tuple(width), prior=of.spread)

    def _by_tenth(self, mixture: Mixture) -> list[tuple[FloatArray, FloatArray]]:
        """As `by_tenth`, for each recording."""
        return [by_tenth(mixture, own, s) for own, s in zip(self.tenths, self.surface, strict=True)]


def by_tenth(mixture: Mixture, tenths: Sequence[IntArray], surface: IntArray) -> tuple[FloatArray, FloatArray]:
    """Mean, mm, and log width (tenth, pixel) of one surface of each pixel; NaN where it is out of the pixel.

    Parameters
    ----------
    mixture : Mixture
        The prediction of all recordings.
    tenths : sequence of (n,) int64
        Frames of each tenth of one recording.
    surface : (pixel,) int64
        Number of the surface.
    """
    at = np.arange(surface.size)
    found: dict[int, tuple[FloatArray, ...]] = {}
    mean, width = np.zeros((2, len(tenths), surface.size))
    for tenth, frames in enumerate(tenths):
        f = int(frames[frames.size // 2])
        t = int(mixture.key[f])
        if t not in found:
            own = (mixture.surface[t] == surface) & (mixture.weight[t] > 0)
            place = np.where(own, mixture.weight[t], -1.0).argmax(axis=0)
            known = np.where(own.any(axis=0), mixture.mean[t][place, at], np.nan)
            wide = np.where(own.any(axis=0), np.log(mixture.sigma[t][place, at]), np.nan)
            found[t] = known, mixture.rate[t][place, at], wide
        middle, rate, width[tenth] = found[t]
        mean[tenth] = middle + rate * mixture.since[f] + mixture.frame_bias[f]
    return mean, width


def _static(change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A change (tenth, pixel) as that of the tenth in which it is largest, and its size in each tenth over this one."""
    largest = change[int((change**2).sum(axis=1).argmax())]
    square = float((largest**2).sum())
    return largest, change @ largest / square if square else np.ones(len(change))


def _with(state: ModelState, effect: Effect) -> ModelState:
    return replace(state, effects=(*state.effects, effect))
