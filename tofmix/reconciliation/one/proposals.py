"""Which sets are worth a fit: linear evidence of all sets of a size about a fitted one, and single effects by trial.

About a fitted set, summaries of the samples (`FittedSet.summary`) are nearly linear in the numbers of small effects and
nearly Gaussian. So the evidence of a set that keeps some members and has up to two others is a matter of a small
matrix, and thousands of sets take a second. Kinds that summaries do not show are tried on the samples, from the starts
of their searches.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.found import Named
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.beats import FrameNoise, fit_beat
from tofmix.reconciliation.likelihood.memory import fit_memory
from tofmix.reconciliation.one.coordinates import Key, Law, key_of_state
from tofmix.reconciliation.one.expansion import pixel_sums
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.recordings import SearchTask, observed
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION, StaticErrors
from tofmix.reconciliation.one.summary import spreads_of_biases
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.hidden import (
    DisturbedFrames,
    PatternSpreads,
    PixelBias,
    PixelValue,
    RangeStep,
    RememberedNoise,
)
from tofmix.simulation.effects.search import EFFECT_NATS, LinearForm

if TYPE_CHECKING:
    from tofmix.reconciliation.one.columns import Column

INEXACT = 0.02
"""Possible relative error of a predicted gain."""

_HIDDEN_INEXACT = 0.2  # likewise, of a hidden state whose numbers are not fitted yet
_NEW = 2  # most new members of a set
_BURST_SIZES = (1.0, 3.0, 8.0)  # sigma
_OCCAM = 3.0  # nats, typical, of a number that is tried on samples
_UNSEEN = 100.0  # curvature of a number that the linear model does not have, over that of its prior
_NUDGE = 0.05  # of the prior's standard deviation, for derivatives
_FAR_SCORE = 4.0  # beyond, a sample is no noise
_FIFTH = 5  # pixels whose scores show a memory


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A set that may be worth a fit.

    Parameters
    ----------
    keys : frozenset of Key
        Its members.
    predicted : float
        Its score, by the linear model.
    build : callable
        Makes it, with its start; ValueError if it cannot be.
    slack : float
        By how much the score may be better than predicted, nats.
    near : (int, float)
        Members that it shares with the set about which it is predicted, and the prediction: of predictions of one set,
        the highest counts.
    """

    keys: frozenset[Key]
    predicted: float
    build: Callable[[], FittedSet]
    slack: float
    near: tuple[int, float]

    @property
    def names(self) -> frozenset[Named]:
        """Kinds and surfaces of its members."""
        return frozenset(key[:2] for key in self.keys)


@dataclass(frozen=True, slots=True, eq=False)
class _Option:
    """A member that a set may have: its columns, and the vector or the form at coefficients 0."""

    law: Law
    at: IntArray
    prior: FloatArray
    price_nats: float
    form: LinearForm | None = None
    x: FloatArray | None = None

    def start(self, coefficients: FloatArray) -> FloatArray:
        """The vector for some coefficients; ValueError out of bounds."""
        if self.form is not None:
            return self.law.vector_of(self.form.make(coefficients))
        if self.x is None:
            raise TypeError("an option has a form or a vector")
        return self.x + coefficients


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Changes of biases and widths by a unit of each coefficient of all forms, about the model as given.

    Parameters
    ----------
    options : list of (Law, LinearForm, (n,) int64)
        Each form with its columns.
    prior : (column,) float64
        Standard deviations of the coefficients.
    bias_mm : (column, recording, pixel) float64
        Change of the bias.
    course : (column, tenth, recording) float64
        Factor on it in time.
    width : (column, recording, pixel) float64
        Change of the log width.
    """

    options: list[tuple[Law, LinearForm, IntArray]]
    prior: FloatArray
    bias_mm: FloatArray
    course: FloatArray
    width: FloatArray

    @classmethod
    def of(cls, task: SearchTask) -> "Columns":
        """Those of all laws of a task that summaries show."""
        number: dict[int, int] = {}
        made: list[Column] = []
        options: list[tuple[Law, LinearForm, IntArray]] = []
        kept = []
        for law in task.laws:
            for form in law.forms:
                try:
                    for c in form.coefficients:
                        if id(c) not in number:
                            column = task.columns.column(c)
                            number[id(c)] = len(made)
                            made.append(column)
                            kept.append(c)  # so that no other coefficient gets its number
                except ValueError:
                    continue
                options.append((law, form, np.array([number[id(c)] for c in form.coefficients])))
        shape = task.lit.shape
        most = max(len(r.tenths) for r in task.recordings)
        course = np.zeros((len(made), most, shape[0]))
        for k, column in enumerate(made):
            for r, profile in enumerate(column.profile):
                course[k, : profile.size, r] = profile
        nothing = np.zeros((0, *shape))
        return cls(
            options=options,
            prior=np.array([c.prior for c in made]),
            bias_mm=np.stack([np.stack(c.bias_mm) for c in made]) if made else nothing,
            course=course,
            width=np.stack([np.stack(c.width) for c in made]) if made else nothing,
        )

    @property
    def moving(self) -> FloatArray:
        """Which columns change in time (column,)."""
        return np.asarray((np.ptp(self.course, axis=1) > 0).any(axis=1) & self.bias_mm.any(axis=(1, 2)))


class About:
    """The linear evidence of sets about a fitted one.

    Parameters
    ----------
    columns : Columns
        Of all laws.
    base : FittedSet
        The fitted set.
    """

    def __init__(self, columns: Columns, base: FittedSet) -> None:
        self.base, task = base, base.task
        summary = base.summary()
        here = observed(task, task.likelihood.mixture(base.state()))
        bias, width = [summary.bias_mm], [summary.width]
        self.whole: dict[Key, int] = {}
        self.own: list[_Option] = []
        place = 0
        for number, (law, x) in enumerate(zip(base.laws, base.parts(base.x), strict=True)):
            self.whole[law.key] = len(bias)
            change = self._change(here, self._observed_without(number))
            bias.append(change[0])
            width.append(change[1])
            at = len(bias) + np.arange(law.size)
            for k in range(law.size):
                step = max(_at(base.hessian, place + k), 1e-12) ** -0.5
                step = min(step, 10 * law.problem.steps[k])
                change = self._change(self._observed_moved(place + k, step), here)
                bias.append(change[0] / step)
                width.append(change[1] / step)
            _, precision = law.prior_at(x)
            prior = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-12))
            self.own.append(_Option(law=law, at=at, prior=prior, price_nats=law.price_nats, x=x))
            place += law.size
        first = len(bias)
        self.new = [
            _Option(
                law=law,
                at=first + at,
                prior=columns.prior[at],
                price_nats=math.log(form.choices) + law.price_nats * bool(law.problem.price_nats),
                form=form,
            )
            for law, form, at in columns.options
        ]
        self._products(columns, np.stack(bias), np.stack(width), summary.bias_information, summary.width_information)
        total = summary.bias_information.sum(axis=0)
        self.pattern: tuple[type[Effect], PatternSpreads] | None = base.pattern or self._pattern(summary.mean_mm, total)
        self.gram, self.logdet = {}, {}
        static, rest = self._static, self._gram
        for patterned in (False, True) if self.pattern is not None else (False,):
            spreads = self.pattern[1] if patterned and self.pattern is not None else task.given
            image = task.likelihood.evidence.image
            errors = StaticErrors.of(task.low, total, image, spreads, task.null.pixel_variance)
            self.gram[patterned], self.logdet[patterned] = rest + errors.products(static), errors.logdet
            if patterned:
                self.logdet[True] += sum(math.log(2 * count) for count in (task.part[1].size, *image))

    def _products(
        self, columns: Columns, bias: FloatArray, width: FloatArray, told: FloatArray, width_told: FloatArray
    ) -> None:
        """Static parts of all columns, and products of what is not static: changes in time, and widths.

        Errors of widths are integrated out of the products.
        """
        first = len(bias)
        moving = columns.moving
        in_time = np.concatenate([bias, columns.bias_mm[moving][:, None] * columns.course[moving][..., None]])
        total = told.sum(axis=0)
        mean = (in_time * told).sum(axis=1) / np.maximum(total, LEAST_INFORMATION)
        static = np.concatenate([mean[:first], columns.bias_mm])
        at = np.concatenate([np.arange(first), first + np.flatnonzero(moving)])
        static[at] = mean
        left = ((in_time - mean[:, None]) * np.sqrt(told)).reshape(len(in_time), in_time[0].size)
        wide = np.concatenate([width, columns.width])
        widening = np.flatnonzero(wide.any(axis=(1, 2)))
        gram = np.zeros((len(static), len(static)))
        errors = self.base.task.width_errors(width_told)
        gram[np.ix_(widening, widening)] = errors.products(wide[widening].reshape(widening.size, 1, wide[0].size))
        gram[np.ix_(at, at)] += left @ left.T
        self._static, self._gram = static, gram

    def _observed_without(self, number: int) -> tuple[FloatArray, FloatArray]:
        base = self.base
        keep = [k for k in range(len(base.laws)) if k != number]
        parts = base.parts(base.x)
        other = replace(
            base,
            laws=tuple(base.laws[k] for k in keep),
            x=np.concatenate([*(parts[k] for k in keep), np.zeros(0)]),
        )
        return observed(base.task, base.task.likelihood.mixture(other.state()))

    def _observed_moved(self, number: int, step: float) -> tuple[FloatArray, FloatArray]:
        base = self.base
        for sign in (1.0, -1.0):
            x = base.x.copy()
            x[number] += sign * step
            try:
                moved = observed(base.task, base.task.likelihood.mixture(base.state(x)))
            except (ValueError, OverflowError):
                continue
            if sign > 0:
                return moved
            here = observed(base.task, base.task.likelihood.mixture(base.state()))
            return 2 * here[0] - moved[0], 2 * here[1] - moved[1]
        return observed(base.task, base.task.likelihood.mixture(base.state()))

    @staticmethod
    def _change(
        after: tuple[FloatArray, FloatArray], before: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Change of the mean (tenth, recording, pixel), and of the log width, a mean over the tenths."""
        wider = after[1] - before[1]
        known = np.maximum(np.isfinite(wider).sum(axis=0), 1)
        return np.nan_to_num(after[0] - before[0]), np.nan_to_num(wider).sum(axis=0) / known

    def _pattern(self, mean: FloatArray, told: FloatArray) -> tuple[type[Effect], PatternSpreads] | None:
        """The pattern that the biases show, if a kind can be one."""
        task = self.base.task
        kind = next((k for k in task.hidden if isinstance(k.hidden, PixelBias)), None)
        if kind is None or kind.kind in task.given_kinds or PixelBias in self.base.sorts:
            return None
        spreads = spreads_of_biases(task, mean, told)
        return None if spreads is None else (kind, spreads)

    def evidence(self, many: Sequence[Sequence[_Option]], kept: set[Key], *, patterned: bool) -> FloatArray:
        """Log evidence (set,) of sets that keep the same members of the base, up to a constant.

        References
        ----------
        MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28: the evidence of a linear model.
        """
        gram, data = self.gram[patterned], self._data(kept)
        pull = gram @ data
        out = np.full(len(many), -0.5 * (float(data @ pull) + self.logdet[patterned]))
        columns = [np.concatenate([np.zeros(0, dtype=np.int64), *(o.at for o in options)]) for options in many]
        sizes = np.array([c.size for c in columns])
        for size in np.unique(sizes[sizes > 0]):
            of = np.flatnonzero(sizes == size)
            at = np.stack([columns[int(k)] for k in of])
            prior = np.stack([np.concatenate([o.prior for o in many[int(k)]]) for k in of])
            inner = gram[at[:, :, None], at[:, None, :]] * prior[:, :, None] * prior[:, None, :] + np.eye(size)
            root = np.linalg.cholesky(inner)
            half = np.linalg.solve(root, (pull[at] * prior)[:, :, None])[:, :, 0]
            out[of] += 0.5 * (half**2).sum(axis=1) - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        return np.asarray(out - np.array([sum(o.price_nats for o in options) for options in many]))

    def _data(self, kept: set[Key]) -> FloatArray:
        data = np.zeros(len(self._gram))
        data[0] = 1.0
        data[[at for key, at in self.whole.items() if key not in kept]] = 1.0
        return data

    def coefficients(self, options: Sequence[_Option], kept: set[Key], *, patterned: bool) -> list[FloatArray]:
        """Posterior means of the coefficients of each option."""
        if not options:
            return []
        gram = self.gram[patterned]
        at, prior = np.concatenate([o.at for o in options]), np.concatenate([o.prior for o in options])
        inner = gram[np.ix_(at, at)] * prior[:, None] * prior + np.eye(at.size)
        found = np.linalg.solve(inner, (gram[at] @ self._data(kept)) * prior) * prior
        return np.split(found, np.cumsum([o.at.size for o in options]))[: len(options)]

    def sets(self, size: int, *, unnamed: bool = False) -> Iterator[Proposal]:
        """Sets of a size: some members of the base, with at most two others; all hidden states but a pattern stay."""
        base = self.base
        always = [o for o in self.own if not o.law.forms]
        own = [o for o in self.own if o.law.forms]
        linked = {key_of_state(e) for e in base.linked}
        everything = {o.law.key for o in self.own}
        others = [o for o in self.new if (o.law.named or unnamed) and o.law.key not in everything]
        whole = float(self.evidence([self.own], everything, patterned=base.pattern is not None)[0])
        anchor = base.evidence - whole - sum(o.price_nats for o in self.own)
        for patterned in self.gram:
            wanted = size - len(linked) - len(always) - patterned
            for number in range(max(wanted - _NEW, 0), min(wanted, len(own)) + 1) if wanted >= 0 else ():
                for kept in combinations(own, number):
                    yield from self._with(kept, always, others, wanted - number, anchor, linked, patterned=patterned)

    def _with(
        self,
        kept: Sequence[_Option],
        always: Sequence[_Option],
        others: Sequence[_Option],
        more: int,
        anchor: float,
        linked: set[Key],
        *,
        patterned: bool,
    ) -> Iterator[Proposal]:
        """Sets of some members of the base, and so many others."""
        names = {o.law.name for o in (*kept, *always)}
        keys = {o.law.key for o in (*kept, *always)}
        news = [
            new
            for new in combinations(others, more)
            if len({o.law.name for o in new} - names) == more and len({o.law.name for o in new}) == more
        ]
        if not news:
            return
        many = [[*always, *kept, *new] for new in news]
        base = self.base
        bare = float(self.evidence([[*always, *kept]], keys, patterned=patterned and base.pattern is not None)[0])
        pattern = {(self.pattern[0].kind, "", 0)} if patterned and self.pattern is not None else set()
        for options, value in zip(many, self.evidence(many, keys, patterned=patterned), strict=True):
            members = frozenset({o.law.key for o in options} | linked | pattern)
            predicted = float(value) + anchor - base.task.price_nats(members)
            yield Proposal(
                keys=members,
                predicted=predicted,
                build=lambda o=options: self._built(o, keys, patterned=patterned),  # type: ignore[misc]
                slack=INEXACT * max(float(value) - bare, 0.0),
                near=(len(members & base.keys), predicted),
            )

    def _built(self, options: Sequence[_Option], kept: set[Key], *, patterned: bool) -> FittedSet:
        """The set at its linear start; for a law with a start that the recording shows, at that one if it is better."""
        found = self.coefficients(options, kept, patterned=patterned)
        x = [o.start(c) for o, c in zip(options, found, strict=True)]
        by_number = [_derivatives(o, c, own) for o, c, own in zip(options, found, x, strict=True)]
        made = [self._at(options, x, by_number, patterned=patterned)]
        for k, option in enumerate(options):
            if option.form is not None and _measured(option.law):
                other = [*x[:k], np.array(option.law.problem.starts[0]), *x[k + 1 :]]
                made.append(self._at(options, other, by_number, patterned=patterned))
        return made[0] if len(made) == 1 else max(made, key=lambda s: s.at_start)

    def _at(
        self, options: Sequence[_Option], x: Sequence[FloatArray], by_number: Sequence[FloatArray], *, patterned: bool
    ) -> FittedSet:
        out = replace(
            self.base,
            laws=tuple(o.law for o in options),
            x=np.concatenate([*x, np.zeros(0)]),
            pattern=self.pattern if patterned else None,
            started=None,
            refused="",
        )
        out.hessian = self._guess(out, options, by_number, patterned=patterned)
        return out

    def _guess(
        self, made: FittedSet, options: Sequence[_Option], by_number: Sequence[FloatArray], *, patterned: bool
    ) -> FloatArray:
        """Curvature over the vectors by the linear model; of numbers that it does not have, that of their priors."""
        gram, size = self.gram[patterned], made.x.size
        jacobian, hessian, start = np.zeros((size, len(gram))), np.zeros((size, size)), 0
        for option, part, slopes in zip(options, made.parts(made.x), by_number, strict=True):
            own = slice(start, start + option.law.size)
            jacobian[own, option.at] = slopes
            _, precision = option.law.prior_at(part)
            unseen = ~slopes.any(axis=1)
            hessian[own, own] = np.diag(np.where(unseen, _UNSEEN * np.diag(precision), 0.0))
            start += option.law.size
        return np.asarray(hessian + jacobian @ gram @ jacobian.T)


def _derivatives(option: _Option, coefficients: FloatArray, x: FloatArray) -> FloatArray:
    """Derivatives (number, coefficient) of coefficients by the vector; zeros for numbers that a form fixes."""
    if option.form is None:
        return np.eye(option.law.size)
    columns = []
    for k, spread in enumerate(option.prior):
        step = _NUDGE * spread
        for sign in (1.0, -1.0):
            moved = coefficients.copy()
            moved[k] += sign * step
            try:
                columns.append(sign * (option.law.vector_of(option.form.make(moved)) - x) / step)
            except ValueError:
                continue
            break
        else:
            columns.append(np.zeros(x.size))
    return np.asarray(np.linalg.pinv(np.stack(columns, axis=1), rcond=1e-6).T)


def _at(hessian: FloatArray | None, number: int) -> float:
    return 1.0 if hessian is None else float(hessian[number, number])


def _measured(law: Law) -> bool:
    """Whether the search of a law has one start: where the recording shows it to be."""
    return len(law.problem.starts) == 1 and law.named and bool(law.surface)


def by_trial(base: FittedSet) -> Iterator[Proposal]:
    """The base with one more effect that summaries do not show.

    The model's own errors may have taken the place of the effect, so it is also tried without them.
    """
    task = base.task
    if base.about is None:
        raise TypeError("samples are not expanded yet")
    about, cost = base.about.without_model_errors()
    bases = [(base, 0.0), *([(replace(base, about=about), cost)] if cost > _OCCAM else [])]
    yield from _laws_by_trial(base, bases)
    rest = _total(base, base.linked, base.x, base.beta)
    for kind in task.hidden:
        if (kind.kind, "") not in base.names | {(k, "") for k in task.given_kinds} and type(
            kind.hidden
        ) not in base.sorts:
            best: dict[frozenset[Key], Proposal] = {}
            for p in (p for own, cost in bases for p in _of_hidden(own, kind, rest - cost)):
                if p.keys not in best or p.predicted > best[p.keys].predicted:
                    best[p.keys] = p
            yield from best.values()


def _laws_by_trial(base: FittedSet, bases: Sequence[tuple[FittedSet, float]]) -> Iterator[Proposal]:
    """The base with one more law that summaries do not show, or whose linear form does not lead to far samples.

    `bases` are with the model's own errors, and without, with what their priors cost.
    """
    task = base.task
    rest = _total(base, base.linked, base.x, base.beta, ranks=True)
    for law in task.laws:
        if (law.forms and not law.problem.shown) or law.name in base.names or not law.named:
            continue
        tried = [
            (found[1] + cost - rest, found[0], own) for own, cost in bases if (found := _climbed(own, law)) is not None
        ]
        gain, x, own = max(tried, key=lambda one: one[0], default=(0.0, base.x, base))
        if gain > 0:
            predicted = base.score + gain - _OCCAM * law.size - task.price_nats([law.key]) - law.price_nats
            yield Proposal(
                keys=base.keys | {law.key},
                predicted=predicted,
                build=lambda w=law, x=x, own=own: _with_law(own, w, x),  # type: ignore[misc]
                slack=INEXACT * gain,
                near=(len(base.keys), predicted),
            )


def _of_hidden(base: FittedSet, kind: type[Effect], rest: float) -> Iterator[Proposal]:
    """The base with an effect of a hidden state; none where the recordings show none."""
    task, hidden, found = base.task, kind.hidden, None
    if isinstance(hidden, DisturbedFrames):
        state = base.state()
        yield from _disturbed(base, kind, rest + base.frame_gain(state, task.likelihood.mixture(state)))
    elif isinstance(hidden, RangeStep) and task.step_mm is not None:
        effect = hidden.made(kind, (task.step_mm,))
        gain = _total(base, (*base.linked, effect), base.x, base.beta) - rest
        found = _linked(base, effect, gain, lambda: _with_linked(base, effect), INEXACT)
    elif isinstance(hidden, PixelValue):
        found = _stuck(base, kind)
    elif isinstance(hidden, RememberedNoise):
        found = _memory(base, kind)
    yield from () if found is None else (found,)


def _total(
    base: FittedSet,
    linked: tuple[Effect, ...],
    x: FloatArray,
    beta: FloatArray,
    laws: tuple[Law, ...] | None = None,
    *,
    ranks: bool = False,
) -> float:
    """Log-likelihood of the samples about static errors, with other members; minus infinity out of bounds.

    If it only `ranks` effects, the prediction has few times, and slow passes take every third frame.
    """
    other = replace(base, linked=linked, x=x, laws=base.laws if laws is None else laws)
    try:
        state = other.state()
    except (ValueError, OverflowError):
        return -math.inf
    mixture = base.task.likelihood.mixture(state, coarse=ranks)
    return float(pixel_sums(base.task, state, mixture, beta, thin=ranks and base.thin)[0].sum())


def _climbed(base: FittedSet, law: Law) -> tuple[FloatArray, float] | None:
    """The best start of a law's search on the samples, after a step along each number, and its log-likelihood."""

    def value(x: FloatArray) -> float:
        whole = np.concatenate([base.x, x])
        return _total(base, base.linked, whole, base.beta, (*base.laws, law), ranks=True)

    tried = [(np.array(start, dtype=np.float64), value(np.array(start))) for start in law.problem.starts]
    best = max(tried, key=lambda pair: pair[1], default=None)
    if best is None or not math.isfinite(best[1]):
        return None
    for k, step in enumerate(law.problem.steps):
        move = np.zeros(law.size)
        move[k] = 2 * step
        x, here = best
        above, below = value(x + move), value(x - move)
        curve = 2 * here - above - below
        to = x + move * float(np.clip(0.5 * (above - below) / curve, -3, 3)) if curve > 0 else x
        ends = [best, (x + move, above), (x - move, below), (to, value(to))]
        best = max((end for end in ends if math.isfinite(end[1])), key=lambda pair: pair[1])
    return best


def _with_law(base: FittedSet, law: Law, x: FloatArray) -> FittedSet:
    _, precision = law.prior_at(x)
    whole, cut = np.concatenate([base.x, x]), base.x.size
    hessian = np.zeros((whole.size, whole.size))
    if base.hessian is not None:
        hessian[:cut, :cut] = base.hessian
    hessian[cut:, cut:] = _UNSEEN * np.diag(np.diag(precision))
    return replace(base, laws=(*base.laws, law), x=whole, hessian=hessian, started=None, refused="")


def _with_linked(base: FittedSet, effect: Effect) -> FittedSet:
    return replace(base, linked=(*base.linked, effect), started=None, refused="", memory_nats=None)


def _linked(
    base: FittedSet, effect: Effect, gain: float, build: Callable[[], FittedSet], inexact: float
) -> Proposal | None:
    if not gain > 0:
        return None
    key = key_of_state(effect)
    predicted = base.score + gain - base.task.price_nats([key]) - EFFECT_NATS * key[2]
    return Proposal(
        keys=base.keys | {key},
        predicted=predicted,
        build=build,
        slack=inexact * gain,
        near=(len(base.keys), predicted),
    )


def _stuck(base: FittedSet, kind: type[Effect]) -> Proposal | None:
    mixture = base.task.likelihood.mixture(base.state())
    values = hidden_fits.find_stuck(base.task.likelihood, mixture)
    if values is None:
        return None
    task, out = base.task, np.isfinite(values)
    state = base.state()
    gain = -float(pixel_sums(task, state, mixture, base.beta)[0][:, out].sum()) - hidden_fits.VALUE_NATS * float(
        out.sum()
    )
    rows, cols = task.likelihood.evidence.image
    hidden = kind.hidden
    if not isinstance(hidden, PixelValue):
        raise TypeError(f"{kind.kind} has no value of a pixel")
    effect = hidden.with_map(kind(), values.reshape(rows, cols).astype(np.float32))
    build = lambda: replace(_with_linked(base, effect), stuck_mm=values)  # noqa: E731
    return _linked(base, effect, gain, build, INEXACT)


def _memory(base: FittedSet, kind: type[Effect]) -> Proposal | None:
    """A memory of the noise, by the correlation of the scores of some pixels."""
    task, hidden = base.task, kind.hidden
    if not isinstance(hidden, RememberedNoise):
        raise TypeError(f"{kind.kind} has no memory")
    state = base.with_errors
    mixture = task.likelihood.mixture(state)
    some = task.part[0], task.part[1][:: min(_FIFTH, max(task.part[1].size // 100, 1))]
    z = task.likelihood.scores(state, some, task.settings.seed, mixture)
    u = z[:, some[1]]
    good = np.abs(np.nan_to_num(u, nan=2 * _FAR_SCORE)) < _FAR_SCORE
    u = np.where(good, u, 0.0)
    u = np.where(good, u - u.sum(axis=0) / np.maximum(good.sum(axis=0), 1), 0.0)
    u = u - u.mean(axis=1, keepdims=True)
    power = float((u**2).sum())
    rho = float((u[1:] * u[:-1]).sum()) / power + 1 / len(u) if power > 0 else 0.0
    share = task.part[1].size / max(some[1].size, 1)
    gain = -0.5 * share * float(good.sum()) * math.log(1 - min(rho**2, 0.99))

    def build() -> FittedSet:
        found = fit_memory(task.likelihood, z, mixture, some)
        return _with_linked(base, hidden.made(kind, (rho if found is None else found,)))

    effect = hidden.made(kind, (float(np.clip(rho, -0.98, 0.98)),))
    return _linked(base, effect, gain, build, _HIDDEN_INEXACT)


def _disturbed(base: FittedSet, kind: type[Effect], rest: float) -> Iterator[Proposal]:
    """Disturbed frames: bursts, by three sizes of the noise that they add; and a beat, where bursts explain anything.

    `rest` is the log-likelihood without them.
    """
    task, hidden = base.task, kind.hidden
    if not isinstance(hidden, DisturbedFrames):
        raise TypeError(f"{kind.kind} disturbs no frames")
    best: tuple[float, Effect | None] = (0.0, None)
    for size in _BURST_SIZES:
        effect = hidden.made(kind, (0.2, size * task.sigma_mm, 5.0))
        other = _with_linked(base, effect)
        state = other.state()
        chain, _ = other.chain(state, task.likelihood.mixture(state))
        best = max(best, (chain - rest, effect), key=lambda pair: pair[0])
    gain, effect_found = best
    if effect_found is None:
        return

    def build() -> FittedSet:
        state = base.with_errors
        found = hidden_fits.fit_bursts(task.likelihood, task.likelihood.mixture(state), state, task.part)
        if found is None:
            raise ValueError("no frames are disturbed")
        made = _with_linked(base, hidden.made(kind, found))
        after = made.state()
        made.disturbed = made.chain(after, task.likelihood.mixture(after))[1]
        return made

    bursts = (
        _linked(base, effect_found, gain, build, _HIDDEN_INEXACT)
        if gain > task.price_nats([key_of_state(effect_found)])
        else None
    )
    beat = _beat(base, kind, hidden, rest) if hidden.period else None
    yield from (p for p in (bursts, beat) if p is not None)


def _beat(base: FittedSet, kind: type[Effect], hidden: DisturbedFrames, rest: float) -> Proposal | None:
    """The most likely beat; None if noise in all frames explains nearly as much."""
    task, state = base.task, base.with_errors
    found = fit_beat(FrameNoise(task.likelihood, task.likelihood.mixture(state), state, task.part))
    if found is None:
        return None
    effect = hidden.made(kind, found[0])
    made = _with_linked(base, effect)
    after = made.state()
    value, made.disturbed = made.chain(after, task.likelihood.mixture(after))
    return _linked(base, effect, value - rest, lambda: made, _HIDDEN_INEXACT)
