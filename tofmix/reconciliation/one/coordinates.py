"""An effect as a vector with a prior: the vectors of its declared search, the prior density of its declared numbers.

A kind declares searches (`Problem`), linear forms and priors in its own file (`tofmix.simulation.effects.search`). A
`Law` is one search of one kind and surface, with the linear forms that begin it. The evidence of a law does not depend
on the vector: with u the numbers that have a prior (their logarithms, if the prior is one of logarithms) and J = du/dx,
the prior is a Gaussian of precision J' S^-2 J, times the density over its height, where S makes each number's Gaussian
as high as its prior, and as wide as the tail where it falls by a power.

Smooth laws without a name (`Unnamed`), polynomials over the image or over range, are members of sets like effects: the
nearest effect imitates most of an unknown law. They compete at the same price, and where one is clearly better than
every named set, no effect is named.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import least_squares

from tofmix.arrays import FloatArray
from tofmix.reconciliation.found import Named
from tofmix.reconciliation.parameters.searches import problems_from
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import Context, Level, Target, refuse_without_phase
from tofmix.simulation.effects.parameter import Prior, StudentPrior, number
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    forms_of,
    has_form,
)

_SPREAD_MM = 25.0  # of a coefficient: as large as an offset of a camera
_MIDDLE_MM, _UNIT_MM = 2500.0, 1000.0  # of range, so that coefficients are biases within a room
PLACE, RANGE = "place in the image", "range"
LAWS = ((PLACE, 3), (PLACE, 6), (RANGE, 3))
"""Axes, each with a number of coefficients: over the image a plane, or a curved surface."""

_PRIOR = StudentPrior(scale=_SPREAD_MM)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unnamed(Effect):
    """A smooth bias that is no known effect. No model file can have it."""

    kind: ClassVar[str] = "unnamed"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias"
    typical: ClassVar[str] = "any"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")

    over_range: float = number("1 over range, 0 over the image.", unit="1", default=0)
    c0_mm: float = number("Constant.", unit="mm", default=0, prior=_PRIOR)
    c1_mm: float = number("By column, or by range.", unit="mm", default=0, prior=_PRIOR)
    c2_mm: float = number("By row, or by the square of range.", unit="mm", default=0, prior=_PRIOR)
    c3_mm: float = number("By the square of the column.", unit="mm", default=0, prior=_PRIOR)
    c4_mm: float = number("By column times row.", unit="mm", default=0, prior=_PRIOR)
    c5_mm: float = number("By the square of the row.", unit="mm", default=0, prior=_PRIOR)

    def explain(self) -> str:
        """One sentence."""
        return f"the bias is a smooth function of {RANGE if self.over_range else PLACE}"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias."""
        if self.over_range:
            r = (echoes.true_range_mm - _MIDDLE_MM) / _UNIT_MM
            echoes.add_bias(self.c0_mm + self.c1_mm * r + self.c2_mm * r * r)
            return
        rows, cols = context.sensor.rows, context.sensor.cols
        row, col = np.divmod(np.arange(rows * cols), cols)
        v, u = 2 * row / max(rows - 1, 1) - 1, 2 * col / max(cols - 1, 1) - 1
        plane = self.c0_mm + self.c1_mm * u + self.c2_mm * v
        echoes.add_bias(plane + self.c3_mm * u * u + self.c4_mm * u * v + self.c5_mm * v * v)


def _made(axis: str, unit_mm: float, x: FloatArray) -> Unnamed:
    return Unnamed(over_range=float(axis == RANGE), **{f"c{k}_mm": float(v) * unit_mm for k, v in enumerate(x)})


def unnamed_laws(sigma_mm: float) -> Iterator[tuple[str, Problem, LinearForm]]:
    """Each axis with its search, in sigma, and its linear form."""
    for axis, size in LAWS:
        problem = Problem(make=partial(_made, axis, sigma_mm), starts=((0.0,) * size,), steps=(0.3,) * size)
        small = (partial(_made, axis, 1.0)(sigma_mm * row) for row in np.eye(size))
        coefficients = tuple(Coefficient(effect=e, size=sigma_mm, spread=_SPREAD_MM) for e in small)
        yield axis, problem, LinearForm(coefficients=coefficients, make=partial(_made, axis, 1.0), surface=axis)


Key = tuple[str, str, int]
"""Kind, surface, and number of the search among those of both, or of the form of a hidden state."""


def key_of_state(effect: Effect) -> Key:
    """The identity of an effect with a hidden state that has a fit of its own."""
    return effect.kind, "", 0 if effect.hidden is None else effect.hidden.form(effect)


UNPRIORED = 3.0
"""Standard deviation of a number without a prior, in the units of its search, in which a step of 1 is reasonable."""

_NUDGE = 1e-3  # of a step of the search, for derivatives
_FAR = 1e6  # residual of a vector out of bounds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """One search of one kind and surface.

    Parameters
    ----------
    kind : type of Effect
        Of the registry, or an unnamed law.
    surface : str
        Empty for an effect of the camera. Of an unnamed law, its axis.
    variant : int
        Number of the search among those of the kind and surface.
    problem : Problem
        The search: an effect from a vector.
    forms : tuple of LinearForm
        What it does for small numbers, for each of some values of its other numbers; empty where summaries do not show
        it. Then the starts of the search are tried on the samples.
    price_nats : float
        Price of an optional part, and of the choice among the searches.
    """

    kind: type[Effect]
    surface: str
    variant: int
    problem: Problem
    forms: tuple[LinearForm, ...]
    price_nats: float

    @property
    def name(self) -> Named:
        """Kind and surface."""
        return self.kind.kind, self.surface

    @property
    def key(self) -> Key:
        """Its identity."""
        return self.kind.kind, self.surface, self.variant

    @property
    def named(self) -> bool:
        """Whether it is an effect that can be named."""
        return self.kind is not Unnamed

    @property
    def size(self) -> int:
        """Length of its vector."""
        return self.problem.parameters

    def make(self, x: FloatArray) -> Effect:
        """The effect of a vector; ValueError out of bounds."""
        return self.problem.make(x)

    def at_a_bound(self, x: FloatArray) -> str:
        """Why no camera has the effect of a vector, as a predicate; empty if one may have it."""
        try:
            effect = self.make(x)
        except ValueError:
            return "is out of its bounds"
        beyond = [
            f"{name} {effect.numbers()[name]:.3g}"
            for name, prior in effect.priors().items()
            if not prior.farthest[0] <= effect.numbers()[name] <= prior.farthest[1]
        ]
        if not effect.plausible():
            return f"would need {' and '.join(beyond) or 'numbers'} beyond that of real cameras and scenes"
        if self.problem.other is not None and self.problem.other(x):
            return "ends at numbers at which it is another effect"
        return ""

    def is_implausible(self, x: FloatArray) -> bool:
        """Whether the effect of a vector has numbers beyond those of real cameras and scenes."""
        try:
            return not self.make(x).plausible()
        except ValueError:
            return False

    def log_density(self, x: FloatArray) -> float:
        """Log density of the numbers, each per unit of itself or of its logarithm; minus infinity out of bounds."""
        try:
            effect = self.make(x)
        except ValueError:
            return -math.inf
        return sum(_log_density(prior, effect.numbers()[name]) for name, prior in effect.priors().items())

    def prior_at(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Precision (n, n) of the Gaussian that stands for the prior here, and the log density over its height.

        Raises
        ------
        ValueError
            If the vector is out of bounds.
        """
        effect = self.make(x)
        priors, numbers = effect.priors(), effect.numbers()
        slopes = self._slopes(x, priors)
        moving = [name for name in priors if slopes[name].any()]
        widths = np.array([_width(priors[n], numbers[n]) for n in moving])
        height = float(np.log(widths * math.sqrt(2 * math.pi)).sum())
        relative = sum(_log_density(priors[n], numbers[n]) for n in moving) + height
        jacobian = np.array([slopes[n] for n in moving]).reshape(len(moving), self.size)
        precision = (jacobian / widths[:, None]).T @ (jacobian / widths[:, None])
        if len(moving) < self.size:
            precision = precision + np.eye(self.size) / UNPRIORED**2
        return relative, np.asarray(precision)

    def _slopes(self, x: FloatArray, priors: dict[str, Prior]) -> dict[str, FloatArray]:
        """Derivatives (n,) of each number, or of its logarithm, by the vector; the smaller one-sided ones: no jump."""
        out = {name: np.zeros(self.size) for name in priors}
        here = _numbers(self.make(x), priors)
        for k, step in enumerate(self.problem.steps):
            sides = []
            for sign in (1.0, -1.0):
                moved = np.array(x, dtype=np.float64)
                moved[k] += sign * _NUDGE * step
                try:
                    there = _numbers(self.make(moved), priors)
                except ValueError:
                    continue
                sides.append({n: (there[n] - here[n]) / (sign * _NUDGE * step) for n in priors if n in there})
            for name in priors:
                both = [s[name] for s in sides if name in s]
                out[name][k] = min(both, key=abs) if both else 0.0
        return out

    def vector_of(self, effect: Effect) -> FloatArray:
        """The vector whose effect has numbers nearest to those of an effect of the same kind."""
        priors, wanted = effect.priors(), effect.numbers()
        declared = {name: p for name, p in effect.parameters().items() if name in wanted and p.prior is None}
        sizes = {name: p.typical[0] for name, p in declared.items() if p.typical[0] > 0}

        def residual(x: FloatArray) -> FloatArray:
            try:
                found = self.make(x).numbers()
            except (ValueError, OverflowError):
                return np.full(len(priors) + len(sizes) + 1, _FAR)
            away = [_away(prior, wanted[n], found.get(n, 0.0), angle=n.endswith("_rad")) for n, prior in priors.items()]
            return np.array([*away, *((found.get(n, 0.0) - wanted[n]) / size for n, size in sizes.items()), 0.0])

        starts = sorted((np.array(s) for s in self.problem.starts), key=lambda s: float((residual(s) ** 2).sum()))
        if not self.size:
            return np.zeros(0)
        ends: list[Any] = [
            least_squares(residual, start, x_scale=np.array(self.problem.steps), max_nfev=40) for start in starts[:2]
        ]
        return np.asarray(min(ends, key=lambda end: end.cost).x)


def _width(prior: Prior, value: float) -> float:
    """Standard deviation of the Gaussian that stands for a prior near a value, of the logarithm if the prior is of one.

    It is as high as the prior's mode. Far from it, where the tail of a density falls by a power, it is as wide as that.
    """
    width = math.exp(-_log_density(prior, prior.mode)) / math.sqrt(2 * math.pi)
    return max(width, prior.tail_width(value)) if isinstance(prior, StudentPrior) else width


def _log_density(prior: Prior, value: float) -> float:
    """Log density per unit of the number, or of its logarithm if the prior is one of logarithms."""
    density = prior.log_density(value)
    return density + math.log(value) if prior.log and math.isfinite(density) else density


def _numbers(effect: Effect, priors: dict[str, Prior]) -> dict[str, float]:
    own = effect.numbers()
    return {n: math.log(max(own[n], 1e-300)) if prior.log else own[n] for n, prior in priors.items() if n in own}


def _away(prior: Prior, wanted: float, found: float, *, angle: bool) -> float:
    if angle:
        return 2 * math.sin(0.5 * (found - wanted))
    if prior.log:
        return math.log(max(found, 1e-300) / max(wanted, 1e-300))
    return (found - wanted) / max(prior.spread, 1e-12)


def laws(kinds: Sequence[str], search: SearchFacts, form: FormFacts, taken: set[Named], sensor: Any) -> Iterator[Law]:  # noqa: ANN401
    """Every law that may be a member of a set, unnamed ones too.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of the registry that are tried. Those whose hidden state has a fit of its own have laws only for forms
        that hide nothing.
    search, form : SearchFacts, FormFacts
        Data for the searches and for linear forms.
    taken : set of (str, str)
        Effects of the model.
    """
    # tilts may show only beside other effects, so that each surface may be tilted
    surfaces = tuple(
        replace(s, turn_nats=math.inf if s.turn_nats > -math.inf else s.turn_nats) for s in search.surfaces
    )
    search = replace(search, surfaces=surfaces)
    for kind in kinds:
        effect = EFFECTS[kind]
        try:
            if effect.acts_on_phase:
                refuse_without_phase(kind, sensor)
            forms = list(forms_of(effect, form)) if has_form(effect) else []
        except ValueError:
            continue
        problems = [(surface_of(p), p) for p in problems_from(effect, search)]
        yield from _of_kind(effect, [(s, p) for s, p in problems if s is not None and (kind, s) not in taken], forms)
    unnamed = list(unnamed_laws(search.sigma_mm))
    of_axis = Counter(axis for axis, _, _ in unnamed)
    number: Counter[str] = Counter()
    for axis, problem, linear in unnamed:
        price = math.log(of_axis[axis])
        yield Law(kind=Unnamed, surface=axis, variant=number[axis], problem=problem, forms=(linear,), price_nats=price)
        number[axis] += 1


def surface_of(problem: Problem) -> str | None:
    """The surface of a search's effects; None if no start is within bounds."""
    for start in problem.starts:
        try:
            return str(getattr(problem.make(np.array(start)), "surface", ""))
        except ValueError:
            continue
    return None


def _of_kind(kind: type[Effect], problems: list[tuple[str, Problem]], forms: list[LinearForm]) -> Iterator[Law]:
    free = Counter(surface for surface, p in problems if not p.price_nats)
    first = 0 if kind.hidden is None else kind.hidden.forms  # after those of its hidden state
    numbers: Counter[str] = Counter({surface: first for surface, _ in problems})
    for surface, problem in problems:
        own = [
            f for f in forms if f.surface == surface and _begins(f, problem, [p for s, p in problems if s == surface])
        ]
        price = problem.price_nats or math.log(max(free[surface], 1))
        yield Law(
            kind=kind, surface=surface, variant=numbers[surface], problem=problem, forms=tuple(own), price_nats=price
        )
        numbers[surface] += 1


def _begins(form: LinearForm, problem: Problem, of_surface: list[Problem]) -> bool:
    """Whether a form is the beginning of this search, not of another one of the surface; it may have none."""
    searched = form.searched or len(form.coefficients)
    same = (p for p in of_surface if p.form == form.form)
    return problem is min(same, key=lambda p: abs(p.parameters - searched), default=None)
