"""The changes that effects make to summaries, with each effect's numbers as linear coefficients with a prior.

A `Term` is an effect of one kind (and surface). Each of its coefficients has a column: the change of the pixels' biases
and widths. If a law is not linear in a parameter (the time constant of a drift, the exponent of a walk), it has one
term for each of a few values of this parameter.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.search.summaries import PixelSummary, surfaces_of
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.search import Coefficient, FormFacts, forms_of, has_form
from tofmix.simulation.surface import Surface


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Term:
    """An effect as coefficients.

    Parameters
    ----------
    kind, surface : str
        Kind and surface of the effect; the surface is empty for an effect of the camera.
    columns : tuple of Column
        One for each coefficient.
    make : callable
        Makes the effect from coefficients (coefficient,); ValueError if they are out of bounds.
    choices : int
        Number of values of a nonlinear parameter among which this one is chosen.
    searched : int
        Free parameters of the search for the same law.
    form : str
        Form of the kind that this search fits.
    price_nats : float
        Price of numbers that are no columns.
    """

    kind: str
    surface: str
    columns: tuple[Column, ...]
    make: Callable[[FloatArray], Effect]
    choices: int = 1
    searched: int = 0
    form: str = ""
    price_nats: float = 0.0

    @property
    def name(self) -> tuple[str, str]:
        """Kind and surface."""
        return self.kind, self.surface


def terms(likelihood: Likelihood, state: ModelState, seen: Sequence[PixelSummary], kinds: Sequence[str]) -> list[Term]:
    """The terms of some kinds: effects that are possible in the recordings and that summaries show.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    state : ModelState
        The state of the summaries.
    seen : sequence of Summary
        Its summaries.
    kinds : sequence of str
        Kinds of the registry. Kinds that neither move nor widen samples by a law have no term.
    """
    make = ColumnMaker(likelihood, state, seen)
    return [term for kind in kinds if summed_up(kind) for term in make.terms(EFFECTS[kind])]


def summed_up(kind: str) -> bool:
    """Whether summaries show a kind: it moves or widens samples by a law."""
    return has_form(EFFECTS[kind])


class ColumnMaker:
    """Makes columns from the predicted changes of a small effect."""

    def __init__(self, likelihood: Likelihood, state: ModelState, seen: Sequence[PixelSummary]) -> None:
        self.likelihood, self.state, self.seen = likelihood, state, seen
        self.base = likelihood.mixture(state)
        used = [s.view.mixture.of_main(s.view.mixture.sigma)[s.used] for s in seen]
        lit = [s.view.mixture.of_main(s.view.mixture.amplitude)[s.used] for s in seen]
        amplitude = np.concatenate(lit)
        amplitude = amplitude[amplitude > 0]
        turn = likelihood.scene.model.sensor.modulation_frequency_hz
        surfaces = dict.fromkeys(name for s in seen for name, _ in surfaces_of(s))
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
            size += float((s.bias_information * bias**2).sum())
            pull += float((s.bias_information * s.bias_mm * bias).sum())
        return 0.5 * pull**2 / size if pull > 0 and size > 0 else 0.0

    def terms(self, kind: type[Effect]) -> list[Term]:
        """The terms of a kind; none if the camera or the scene cannot have it."""
        made: dict[int, Column] = {}  # a form may share coefficients with another
        try:
            forms = list(forms_of(kind, self.facts))
            for coefficient in (c for form in forms for c in form.coefficients):
                if id(coefficient) not in made:
                    made[id(coefficient)] = self.column(coefficient)
        except ValueError:
            return []
        return [
            Term(
                kind=kind.kind,
                surface=form.surface,
                columns=tuple(made[id(c)] for c in form.coefficients),
                make=form.make,
                choices=form.choices,
                searched=form.searched or len(form.coefficients),
                form=form.form,
                price_nats=form.price_nats,
            )
            for form in forms
        ]

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
        for s in self.seen:
            before, after = self.base.of_frames(s.view.frames), changed.of_frames(s.view.frames)
            place = after.main_of(before)
            seen = s.used & (place >= 0)  # if the surface is out of the pixel, nothing is known
            moved = _of(after, "mean", place) - before.of_main(before.mean)
            wider = np.log(_of(after, "sigma", place) / before.of_main(before.sigma))
            bias.append(np.where(seen, moved, 0.0) / of.size)
            width.append(np.where(seen, wider, 0.0) / of.size)
            times.append(np.ones(s.elapsed_s.size) if of.course is None else of.course(s.elapsed_s))
        return Column(bias_mm=tuple(bias), profile=tuple(times), width=tuple(width), prior=of.spread)


def _of(m: Mixture, name: str, component: IntArray) -> FloatArray:
    values: FloatArray = getattr(m, name)[0]
    return np.asarray(np.take_along_axis(values, np.maximum(component, 0)[None], axis=0)[0])


def _with(state: ModelState, effect: Effect) -> ModelState:
    return replace(state, effects=(*state.effects, effect))
