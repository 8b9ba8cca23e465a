"""The best set of a search as the verdict, the aliases and the report need it.

The numbers are fitted once more, to the fitting frames alone, so that the check of the verdict uses frames that no fit
has seen. A member that leaves a statistic open in which it must show is taken out. Of sets that cannot be told apart,
one with a contradicted member gives way to the next, and one that leaves a deviation to one that leaves none.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.comparison.compare import Compared, compare
from tofmix.reconciliation.found import ALIAS_NATS, Added, Ledger, Named, TriedEffect, WeighedSet, name_of_effect
from tofmix.reconciliation.likelihood import hidden_fits
from tofmix.reconciliation.likelihood.hidden_states import SLACK, latent_states, without
from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import memory_gain
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.pixel_pattern import marginal_pattern, pixel_biases
from tofmix.reconciliation.one.expansion import WIDTH_NUDGE
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.proposals import About, Columns, Proposal, by_trial
from tofmix.reconciliation.one.recordings import UNIFORM, SearchTask
from tofmix.reconciliation.one.search import FoundSets, begun, extend
from tofmix.reconciliation.one.static_errors import LEAST_INFORMATION, StaticErrors
from tofmix.reconciliation.one.ways import steadied
from tofmix.reconciliation.parameters.fits import Fitted, Numbers
from tofmix.reconciliation.parameters.polish import settle
from tofmix.reconciliation.settings import Settings, fit_part, held_out
from tofmix.reconciliation.verification.considered import OTHERS, refusal
from tofmix.reconciliation.verification.verify import Verified, verify
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import Basic, Latent
from tofmix.simulation.effects.hidden import PixelBias, PixelValue, RememberedNoise
from tofmix.simulation.model import Model

_COVERED = 0.999  # share of the beam that surfaces fill


def named(
    likelihood: Likelihood,
    settings: Settings,
    tick: Callable[[float], None] = lambda _: None,
    ledger: Ledger | None = None,
) -> tuple[Added, Verified]:
    """Search, and judge the best set. A model with effects may be right, so it is judged before the search.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    tick, ledger
        As of `tofmix.reconciliation.one.search.search`.
    """
    found = begun(likelihood, settings, tick, ledger)
    if likelihood.scene.effects:  # else predictions do not approximate
        given = as_added(found, found.best_named)
        verified = verify(likelihood, given, settings)
        if verified.verdict == "agree":
            return given, verified
    extend(found)
    beside_law = _standing(found, found.beside_law)
    if beside_law is not None:
        return beside_law
    best = found.answer
    added = as_added(found, best)
    verified = verify(likelihood, added, settings)
    if verified.verdict != "unexplained" or found.law is not None:
        return added, verified
    why, forms = refusal(added, verified), [s for s in found.table.values() if s.names == best.names]
    enough = ("explained", "partly_explained") if verified.against else ("explained",)
    for alias in found.aliases(best):
        other = as_added(found, alias)
        judged = verify(likelihood, other, settings)
        if judged.verdict in enough:
            _refuse(forms, why)
            return replace(other, considered=considered(found, alias)), judged
    if verified.against:
        _refuse(forms, why)
    bad = (added.chosen[k].name for k in (*verified.findings.refused, *(c.number for c in verified.against)))
    parts = (part for part in found.most_of(best, frozenset(bad)) if part.names != best.names)
    return _standing(found, parts) or (added, verified)


def _standing(found: FoundSets, parts: Iterable[FittedSet]) -> tuple[Added, Verified] | None:
    """The first of some parts of a set that explains a part of the recording by itself; None without one."""
    for part in parts:
        added = as_added(found, part)
        verified = verify(found.task.likelihood, added, found.task.settings)
        if verified.verdict != "unexplained":
            return added, verified
    return None


def _refuse(forms: Sequence[FittedSet], why: str) -> None:
    """Give all forms of a set up."""
    for s in forms:
        s.refused, s.score = why, -math.inf


def better_own_effect(recordings: Sequence[Recording], added: Added, settings: Settings) -> Effect | None:
    """The model's own effect with numbers that are clearly better than all added effects; None without one.

    Such an effect with wrong numbers may be imitated by others. It stands as an unnamed law does.

    Parameters
    ----------
    recordings : sequence of (Model, Evidence)
        As given.
    added : Added
        The outcome of the search.
    """
    best, top = None, added.score + ALIAS_NATS
    given = joint_likelihood(recordings).scene.effects
    searched = (e for e in given if e.latent is Latent.NONE and e.kind in EFFECTS)
    for effect in dict.fromkeys(searched):  # recorded amplitudes are among the effects, but are no registered kind
        less = joint_likelihood([(_without(model, effect), evidence) for model, evidence in recordings])
        task = SearchTask(less, replace(settings, kinds=(effect.kind,)))
        nothing = FittedSet.without_effects(task).fit()
        # the amplitudes that other numbers change are no part of the score of the effect as given
        as_given = sum(side.log_density(effect) for side in less.side_information)
        for p in chain(About(Columns.of(task), nothing).sets(1), by_trial(nothing)):
            s = _fitted(p) if p.names == {name_of_effect(effect)} else None
            if s is None or s.refused:
                continue
            score = s.score + task.price_nats(s.keys) - as_given  # it takes the place of one, so it has no price
            if score > top:
                best, top = s.members()[0], score
    return best


def _fitted(proposal: Proposal) -> FittedSet | None:
    """A proposed set, fitted; None if it cannot be."""
    try:
        return proposal.build().fit()
    except ValueError:
        return None


def _without(model: Model, effect: Effect) -> Model:
    return replace(model, effects=tuple(e for e in model.effects if e != effect))


def as_added(found: FoundSets, best: FittedSet) -> Added:
    """A fitted set as the outcome of a search, with numbers from the fitting frames."""
    state, chosen = refitted(best)
    return Added(
        state=state,
        chosen=chosen,
        first=_singles(found),
        panel=_panel(best, state),
        considered=considered(found, best),
        law=found.law,
        faint_law=best in found.beside_law,
        score=best.score,
    )


def refitted(s: FittedSet) -> tuple[ModelState, tuple[TriedEffect, ...]]:
    """The state of a set by the fitting frames alone, and its effects with their held-out gains."""
    task = s.task
    like, part = task.likelihood, fit_part(task.likelihood, task.settings)
    pattern: tuple[Effect, ...] = ()
    if s.pattern is not None:
        kind, spreads = s.pattern
        if not isinstance(kind.hidden, PixelBias):
            raise TypeError(f"{kind.kind} has no bias of a pixel")
        pattern = (kind.hidden.made(kind, spreads),)
    bare = replace(s.state(), log_width=task.null.log_width, shifts=None)  # the model's own errors are no part of it
    members = s.members()
    state = replace(steadied(task, bare), effects=(*members, *s.linked, *pattern))
    if not state.effects:
        return latent_states(like, replace(state, effects=()), part[0]), ()
    fits = {
        k: Fitted(effect=effect, vector=x, problem=law.problem)
        for k, (effect, law, x) in enumerate(zip(members, s.laws, s.parts(s.x), strict=True))
    }
    state = latent_states(like, state, part[0])
    searched = {k: f for k, f in fits.items() if f.problem.steps}
    last = settle(Numbers(likelihood=like, state=state, fits=searched, part=part))
    fits |= last.fits
    chosen = tuple(
        TriedEffect(
            effect=effect,
            gain=_gain(s, last.state, number),
            parameters=_parameters(effect, fits.get(number)),
            fitted=fits.get(number),
        )
        for number, effect in enumerate(last.state.effects)
    )
    return last.state, chosen


def _parameters(effect: Effect, fitted: Fitted | None) -> int:
    if fitted is not None:
        return fitted.problem.parameters
    hidden = effect.hidden
    return max(len(hidden.numbers), 1) if hidden is not None else 1


def _gain(s: FittedSet, state: ModelState, number: int) -> float:
    """What an effect gains on held-out data, nats, in the presence of the others."""
    like, settings = s.task.likelihood, s.task.settings
    test = like.evidence.part(fit=False, split=settings.split)
    effect, rest = state.effects[number], without(state, number)
    hidden = effect.hidden
    if isinstance(hidden, PixelValue):
        out = np.flatnonzero(np.isfinite(state.stuck_mm))
        part = test[0], np.intersect1d(test[1], out) if np.intersect1d(test[1], out).size else out
        freed = replace(rest, stuck_mm=np.full_like(rest.stuck_mm, np.nan))
        before = like.sums(like.mixture(freed), freed, part).total
        return float(-before - hidden_fits.VALUE_NATS * part[1].size)
    if isinstance(hidden, PixelBias):
        nothing = np.zeros_like(state.pixel_bias)
        bare = replace(rest, pixel_bias=nothing, pixel_variance=nothing)
        biases = pixel_biases(like, like.mixture(bare), bare, test)
        return marginal_pattern(biases, like.evidence.image, hidden.spreads(effect))[0]
    if isinstance(hidden, RememberedNoise):
        mixture = like.mixture(state)
        z = like.scores(state, s.task.part, settings.seed, mixture)
        return memory_gain(like, z, mixture, test, hidden.coefficient(effect))
    return like.value(state, test) - like.value(rest, test)


def _panel(best: FittedSet, state: ModelState) -> Compared:
    """Panel of the model, moved within its tolerance to where it fits the held-out frames best.

    It tests whether any model within the tolerance agrees with these frames. A model moved to other frames would have
    their noise.
    """
    like, settings = best.task.likelihood, best.task.settings
    held = held_out(like, settings)
    near, mixture = _moved(best.task, state, held)
    return compare(like, near, _covered(like, state, held), seed=settings.seed, mixture=mixture)


def _moved(task: SearchTask, state: ModelState, held: Part) -> tuple[ModelState, Mixture]:
    """The state with the model's own errors of widths, and its prediction with the errors of surfaces too.

    Both are found from the held-out frames, and no error is larger than the tolerance, times `SLACK`. Where pixels have
    widths of their own, the state has them.
    """
    like, most = task.likelihood, SLACK / UNIFORM
    mixture = like.mixture(state)
    bias, known = np.zeros(task.lit.shape), np.zeros(task.lit.shape)
    for view in views(like, mixture, held):
        found = pixel_biases(like, mixture, state, view.part_of_all)
        bias[view.number], known[view.number] = found.bias, np.where(task.lit[view.number], found.information, 0.0)
    own = state.pixel_variance if state.errors is None else np.zeros_like(state.pixel_variance)  # taken off already
    errors = StaticErrors.of(task.low, known, like.evidence.image, more_variance=own)
    moved = errors.mean_of_model(bias, most)
    predicted = like.predicted(state)
    state = replace(state, shifts=task.likely_shifts(errors.coordinates_of_model(bias, most), state, predicted))
    if task.width_variance.any():
        return state, _with_biases(task, like.mixture(state), moved)
    wider = _log_width(task, state, _with_biases(task, like.mixture(state), moved), held, most * math.sqrt(0.5))
    near = replace(state, log_width=state.log_width + wider)
    return near, _with_biases(task, like.mixture(near), moved)


def _log_width(task: SearchTask, state: ModelState, mixture: Mixture, held: Part, most: float) -> FloatArray:
    """The model's own errors of log widths (recording, pixel), each of at most so many standard deviations."""
    rise, told = np.zeros(task.lit.shape), np.zeros(task.lit.shape)
    for view in views(task.likelihood, mixture, held):
        below, here, above = (
            task.likelihood.sums(mixture.widened(np.array(step)), state, view.part_of_all).by_pixel[:, 0]
            for step in (-WIDTH_NUDGE, 0.0, WIDTH_NUDGE)
        )
        curve = (2 * here - below - above) / WIDTH_NUDGE**2
        told[view.number] = np.where(task.lit[view.number], np.maximum(curve, 0.0), 0.0)
        rise[view.number] = (above - below) / (2 * WIDTH_NUDGE)
    step = np.where(told > 0, rise / np.maximum(told, LEAST_INFORMATION), 0.0)
    return task.width_errors(told).mean_of_model(step.reshape(1, -1), most).reshape(step.shape)


def _with_biases(task: SearchTask, mixture: Mixture, bias_mm: FloatArray) -> Mixture:
    """The prediction with biases (recording, pixel), mm, of all that has light."""
    mean = mixture.mean.copy()
    for number, recording in enumerate(task.recordings):
        keys = mixture.key[recording.view.frames]
        times = slice(int(keys.min()), int(keys.max()) + 1)
        mean[times] += np.where(mixture.lit[times], bias_mm[number], 0.0)
    return replace(mixture, mean=mean)


def _covered(likelihood: Likelihood, state: ModelState, part: Part) -> Part:
    """The part without pixels that see open space, if more noise was added.

    Its law does not change samples without a return; ambient light does. Such samples would test the law and not the
    name.
    """
    if not any(e.is_basic(Basic.NOISE) for e in state.effects):
        return part
    lit = np.ones(likelihood.evidence.shape[1], dtype=bool)
    for view in views(likelihood, likelihood.scene.mixture(), part):
        lit &= (view.mixture.weight[0] * view.mixture.lit[0]).sum(axis=0) > _COVERED
    pixels = part[1][lit[part[1]]]
    return (part[0], pixels) if pixels.size else part


def _singles(found: FoundSets) -> tuple[TriedEffect, ...]:
    """The fitted sets of one named effect, the largest gain first: its gain on held-out data over the model as given.

    Of a hidden state it is the evidence, times the share of the samples that are held out.
    """
    nothing, task = found.table[frozenset()], found.task
    like = task.likelihood
    test = like.evidence.part(fit=False, split=task.settings.split)
    share = test[0].size * test[1].size / (task.part[0].size * task.part[1].size)
    given = like.value(nothing.state(), test)
    out = []
    for s in found.table.values():
        if len(s.keys) != 1 or not s.named or not np.isfinite(s.evidence):
            continue
        if s.laws:
            (effect,), gain = s.members(), like.value(s.state(), test) - given
        else:
            effect, gain = _only_hidden(s), share * (s.evidence - nothing.evidence)
        out.append(TriedEffect(effect=effect, gain=gain, parameters=max(s.x.size, 1)))
    return tuple(sorted(out, key=lambda c: -c.gain))


def _only_hidden(s: FittedSet) -> Effect:
    """The one effect of a set, which has a hidden state."""
    if s.pattern is None:
        return s.linked[0]
    kind, spreads = s.pattern
    return kind.hidden.made(kind, spreads) if kind.hidden is not None else kind()


def considered(found: FoundSets, best: FittedSet) -> tuple[WeighedSet, ...]:
    """The best set, its aliases, and the best others, each with the reason why it is not the answer."""
    nothing = found.table[frozenset()].evidence
    near = found.aliases(best)

    def of(s: FittedSet, why_not: str | None, *, is_alias: bool = False) -> WeighedSet:
        nats = s.evidence - nothing
        return WeighedSet(names=tuple(sorted(s.names)), evidence_nats=nats, why_not=why_not, is_alias=is_alias)

    seen = {best.names, *(s.names for s in near)}
    of_names: dict[frozenset[Named], FittedSet] = {}  # of one kind's forms the best that can be
    fitted = (s for s in found.table.values() if s.named and np.isfinite(s.evidence))
    for s in sorted(fitted, key=lambda s: (bool(s.refused), -s.evidence)):
        if s.names not in seen and not s.names > best.names:
            of_names.setdefault(s.names, s)
    others = sorted(of_names.values(), key=lambda s: -s.evidence)
    alike = "cannot be told apart"
    return (
        of(best, None),
        *(of(s, f"{alike}: {_why(s, best)}", is_alias=True) for s in near),
        *(of(s, s.refused or _why(s, best)) for s in others[:OTHERS]),
    )


def _why(s: FittedSet, best: FittedSet) -> str:
    """How much more or less likely a set is than the best one, and what its further effects cost."""
    nats, more = s.evidence - best.evidence, len(s.keys) - len(best.keys)
    dearer = s.task.price_nats(s.keys) - s.task.price_nats(best.keys)
    size = f"{abs(nats):.1f}" if abs(nats) < 10 else f"{abs(nats):,.0f}"  # noqa: PLR2004  two digits are enough
    price = f", by {more} more, at a price of {dearer:.0f}" if nats > 0 and more > 0 else ""
    return f"{size} nats {'more' if nats > 0 else 'less'} likely{price}"
