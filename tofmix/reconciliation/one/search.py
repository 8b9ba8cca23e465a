"""One search over sets of effects by size: summaries propose, samples confirm, one score decides.

For each size, about the best sets of the size before, all sets with at most two new members are ranked by linear
evidence, those with a bias of each pixel apart from the others: it can imitate any static effect, and would crowd the
others out. The best are fitted. At the end, every neighbour of the winner (one member fewer, exchanged, or more,
unnamed laws among them) that may be as good is fitted too, until none is better. Within a level, effects act in the
order of their list, so the order is a part of the model, and is searched too.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, permutations

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.found import ALIAS_NATS, Ledger, Named
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.one.coordinates import Key
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.proposals import INEXACT, About, Columns, Proposal, by_trial
from tofmix.reconciliation.one.recordings import SearchTask, observed
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verdict import MOSTLY
from tofmix.reconciliation.verification.considered import MOST_ALIASES
from tofmix.reconciliation.verification.contradictions import FAINT_SHARE
from tofmix.simulation.effects.hidden import PixelBias

BASES, PLAIN, PATTERNED, LARGEST = 3, 8, 4, 3
"""Effort: sets of the size before about which sets are proposed; fits of a size without and with a bias of each pixel;
largest size of which all sets are compared."""

EVEN_NATS = 0.1
"""Difference of scores below which neither set is better: the evidence by Laplace is no more exact."""


@dataclass(eq=False)
class FoundSets:
    """All sets that were fitted.

    Parameters
    ----------
    task : SearchTask
        What they share.
    tick : callable
        Called with the share of the work that is done, of each step.
    ledger : Ledger
        Gets each set that is fitted, and may end the search before the next one.
    table : dict
        The sets by their members.
    """

    task: SearchTask
    tick: Callable[[float], None]
    ledger: Ledger
    table: dict[frozenset[Key], FittedSet] = field(default_factory=dict)

    @property
    def best(self) -> FittedSet:
        """The set of the highest score."""
        return max(self.table.values(), key=lambda s: s.score)

    @property
    def best_named(self) -> FittedSet:
        """The set of the highest score of those without an unnamed law; of even ones, that of the fewest numbers."""
        own = [s for s in self.table.values() if s.named]
        top = max(s.score for s in own)
        return min((s for s in own if s.score >= top - EVEN_NATS), key=lambda s: (s.x.size, -s.score))

    @property
    def answer(self) -> FittedSet:
        """The best named set, or one of no more members that is clearly more likely, and that no camera has.

        What samples ask for beyond all bounds has a cause that no effect stands for. The next best set would only be
        what is left of those that can be.
        """
        best = self.best_named
        clearly = best.score + ALIAS_NATS + FAINT_SHARE * max(best.evidence - self.table[frozenset()].evidence, 0.0)
        beyond = (s for s in self.table.values() if s.named and s.refused and math.isfinite(s.evidence))
        likely = [s for s in beyond if len(s.keys) <= len(best.keys) and s.score_anyhow > clearly]
        return max((s for s in likely if s.is_implausible), key=lambda s: s.score_anyhow, default=best)

    @property
    def law(self) -> str | None:
        """Axis of an unnamed law of a set that is clearly better than all named ones; None without one."""
        best = self.best
        if best.named or best.score <= self.best_named.score + ALIAS_NATS:
            return None
        return next(law.surface for law in best.laws if not law.named)

    @property
    def beside_law(self) -> tuple[FittedSet, ...]:
        """The named parts of the best set that have nearly all of its evidence beside the law that has no name.

        No camera follows the laws of the effects exactly, so that a faint law is what a strong effect leaves.
        """
        if self.law is None:
            return ()
        return self.most_of(self.best, frozenset(law.name for law in self.best.laws if not law.named))

    def most_of(self, of: FittedSet, without: frozenset[Named]) -> tuple[FittedSet, ...]:
        """The sets of members of another one, without some, that have nearly all of its evidence; the best first."""
        parts = (s for s in self.table.values() if s.names and s.names <= of.names - without and s.named)
        nothing = self.table[frozenset()].evidence
        least = nothing + MOSTLY * (of.evidence - nothing)
        nearly = (s for s in parts if math.isfinite(s.score) and s.evidence > least)
        return tuple(sorted(nearly, key=lambda s: -s.score))

    def fit_best(self, proposals: Iterable[Proposal], keep: Callable[[Proposal], bool]) -> None:
        """Fit the proposals of the highest predicted scores, the best one at its start first: others may end early."""
        pool: dict[frozenset[Key], Proposal] = {}
        for p in proposals:  # of one set, the prediction from the nearest base
            if p.keys not in self.table and (p.keys not in pool or p.near > pool[p.keys].near):
                pool[p.keys] = p
        ranked = sorted((p for p in pool.values() if keep(p)), key=lambda p: -p.predicted)
        patterned = {k.kind for k in self.task.hidden if isinstance(k.hidden, PixelBias)}
        with_pattern = [bool(patterned & {kind for kind, _ in p.names}) for p in ranked]
        begun: list[tuple[float, Proposal, FittedSet]] = []
        for wanted, most in ((False, PLAIN), (True, PATTERNED)):
            own = (p for p, has in zip(ranked, with_pattern, strict=True) if has is wanted)
            begun += self._begun(own, most)
        share = 1.0 / max(len(begun), 1)
        for _, p, s in sorted(begun, key=lambda b: -b[0]):
            if self.ledger.ends():
                return
            s.fit(hopeless=self._least(s))
            self.table[p.keys] = s
            self.weigh(s)
            self.tick(share)

    def _least(self, s: FittedSet) -> float:
        """The least score of a set that is worth a fit: that of the best set, or of an alias, which may be larger."""
        best = self.best
        if s.names >= best.names or s.names < best.names:  # of the same effects, a part or an extension: no alias
            return best.score
        dearer = self.task.price_nats(s.keys) - self.task.price_nats(best.keys)
        return best.score - ALIAS_NATS - max(dearer, 0.0)

    def weigh(self, s: FittedSet) -> None:
        """Enter a set of named effects into the ledger."""
        if s.named and math.isfinite(s.evidence):
            nothing = self.table[frozenset()].evidence
            self.ledger.weigh(tuple(s.names), s.evidence - nothing, s.refused or None)

    def _begun(self, ranked: Iterable[Proposal], most: int) -> list[tuple[float, Proposal, FittedSet]]:
        """The first proposals that can be, with their scores at the start.

        One that is predicted better than the best set, and is worse at its start, does not count as one of the first:
        where samples lie far from the model, linear evidence ranks nothing.
        """
        out: list[tuple[float, Proposal, FittedSet]] = []
        top, counted = self.best.score, 0
        for p in ranked:
            if counted == most:
                break
            try:
                s = in_best_order(p.build())
                start = s.at_start
            except ValueError:  # numbers of the other sign, for instance
                start = -math.inf
            if math.isfinite(start):
                out.append((start, p, s))
                counted += not start < top < p.predicted - p.slack
        return sorted(out, key=lambda b: -b[0])[:most]

    def aliases(self, best: FittedSet) -> list[FittedSet]:
        """Sets within `ALIAS_NATS` of the evidence of the best one, none a part or extension of another, best first.

        Of one kind's forms the best stands for all.
        """
        least = best.evidence - ALIAS_NATS
        near = [s for s in self.table.values() if s.named and math.isfinite(s.score) and s.evidence > least]
        near = [s for s in near if s is not best and not s.names <= best.names and not s.names > best.names]
        near = [s for s in near if not any(o.names < s.names for o in near)]
        of_names = {s.names: s for s in sorted(near, key=lambda s: s.evidence)}
        return sorted(of_names.values(), key=lambda s: -s.evidence)[:MOST_ALIASES]


def begun(
    likelihood: Likelihood,
    settings: Settings,
    tick: Callable[[float], None] = lambda _: None,
    ledger: Ledger | None = None,
) -> FoundSets:
    """The sets of a search before it runs: the empty one.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    tick : callable
        Called with shares of a step that are done; a step is a size, or a round of the closing step.
    ledger : Ledger, optional
        Gets each set that is fitted, and may end the search between two sets.
    """
    task = SearchTask(likelihood, settings)
    null = FittedSet.without_effects(task).fit()
    if any(wander := null.wanders()):
        task.recordings = tuple(r.wandering if w else r for r, w in zip(task.recordings, wander, strict=True))
        null = FittedSet.without_effects(task).fit()
    return FoundSets(task, tick, Ledger() if ledger is None else ledger, {frozenset(): null})


def search(
    likelihood: Likelihood,
    settings: Settings,
    tick: Callable[[float], None] = lambda _: None,
    ledger: Ledger | None = None,
) -> FoundSets:
    """Find the most likely set of effects; parameters as of `begun`."""
    found = begun(likelihood, settings, tick, ledger)
    extend(found)
    return found


def extend(found: FoundSets) -> None:
    """Find the most likely set of effects, from the sets of `begun`; all sets that are fitted are added to them."""
    task, null = found.task, found.best
    settings = task.settings
    if settings.max_effects == 0:
        return
    known = Proposers(Columns.of(task))
    bases = [null]

    def linear(b: FittedSet, size: int) -> Iterator[Proposal]:
        around = known.about(b)
        with_parts = _from_fitted(found, chain(around.sets(size - 1), around.sets(size)))
        return (p for p in with_parts if len(p.keys) == size)

    for size in range(1, min(LARGEST, settings.max_effects) + 1):
        top = found.best.score
        proposals = chain.from_iterable(
            chain(linear(b, size), known.trials(b) if len(b.keys) == size - 1 else ()) for b in bases
        )
        found.fit_best(proposals, lambda p, least=top - ALIAS_NATS: p.predicted + p.slack > least)  # type: ignore[misc]
        _without_members_at_a_bound(found, size)
        of_size = [s for s in found.table.values() if len(s.keys) == size and math.isfinite(s.score)]
        level = sorted(of_size, key=lambda s: -s.score)
        if not level or found.best.score > level[0].score or found.ledger.ends():
            break
        bases = [*level[:BASES], *([null] if size == 1 else [])]
    closed(found, known)


@dataclass(frozen=True, eq=False)
class Proposers:
    """The proposals about each fitted set, made once: the closing step needs those of the last sets again.

    Parameters
    ----------
    columns : Columns
        Changes by each form.
    """

    columns: Columns
    _about: dict[frozenset[Key], About] = field(default_factory=dict)
    _trials: dict[frozenset[Key], list[Proposal]] = field(default_factory=dict)

    def about(self, s: FittedSet) -> About:
        """The linear model about a set."""
        if s.keys not in self._about:
            self._about[s.keys] = About(self.columns, s)
        return self._about[s.keys]

    def trials(self, s: FittedSet) -> list[Proposal]:
        """The set with one more member that only samples show."""
        if s.keys not in self._trials:
            self._trials[s.keys] = list(by_trial(s))
        return self._trials[s.keys]


def _without_members_at_a_bound(found: FoundSets, size: int) -> None:
    """Fit what is left of sets that cannot be, from where their other members are."""
    for s in [s for s in found.table.values() if len(s.keys) == size and s.refused and math.isfinite(s.evidence)]:
        bad = [law for law, part in zip(s.laws, s.parts(s.x), strict=True) if law.at_a_bound(part)]
        for law in bad:
            rest = s.keys - {law.key}
            if not rest or rest in found.table:
                continue
            keep = [k for k, other in enumerate(s.laws) if other is not law]
            found.table[rest] = _with_laws(s, keep).fit()
            found.weigh(found.table[rest])


def _with_laws(s: FittedSet, keep: list[int]) -> FittedSet:
    """The set with some of its laws, at its numbers."""
    parts = s.parts(s.x)
    return replace(
        s,
        laws=tuple(s.laws[k] for k in keep),
        x=np.concatenate([*(parts[k] for k in keep), np.zeros(0)]),
        hessian=None,
        started=None,
        refused="",
    )


def closed(found: FoundSets, known: Proposers) -> None:
    """Fit all neighbours of the best set that may be as good, until none is better."""
    task = found.task
    most = task.settings.max_effects
    unnamed = {law.key for law in task.laws if not law.named}
    while True:
        best = found.best
        size = len(best.keys)
        around = known.about(best)
        sizes = (k for k in (size - 1, size, size + 1) if 0 < k <= most)
        linear = chain.from_iterable(around.sets(k, unnamed=True) for k in sizes)
        proposals = chain(_from_fitted(found, linear), known.trials(best) if size < most else ())

        def as_good(p: Proposal, best: FittedSet = best) -> bool:
            if p.names > best.names and not p.keys > best.keys:  # other forms as good were extended about themselves
                return False
            if p.names >= best.names or p.names < best.names or any(key in unnamed for key in p.keys):  # no alias
                return p.predicted + p.slack > best.score
            return p.predicted + p.slack + task.price_nats(p.keys) > best.evidence - ALIAS_NATS

        found.fit_best(proposals, as_good)
        if found.best is best or found.ledger.ends():
            return


def _from_fitted(found: FoundSets, proposals: Iterable[Proposal]) -> Iterator[Proposal]:
    """Proposals about one set, none higher than a fitted set of one member fewer lets it be.

    What a member changes is predicted better than what a whole set does.
    """
    nearest: dict[frozenset[Key], Proposal] = {}
    for p in proposals:
        if p.keys not in nearest or p.near > nearest[p.keys].near:
            nearest[p.keys] = p
    for p in nearest.values():
        told = [p]
        for t in (p.keys - {key} for key in p.keys):
            s = found.table.get(t)
            if s is not None and t in nearest and math.isfinite(s.evidence):
                gain, top = p.predicted - nearest[t].predicted, s.score_anyhow
                off = max(nearest[t].predicted - top, 0.0)  # what was predicted too high another member may bring
                slack = INEXACT * abs(gain) + s.below_top_nats + off
                told.append(replace(p, predicted=top + gain, slack=slack, near=(p.near[0], top + gain)))
        yield min(told, key=lambda one: one.predicted + one.slack)


_SAME_NATS = 0.1  # change of the samples' log-likelihood below which two orders of effects predict the same


def in_best_order(s: FittedSet) -> FittedSet:
    """The set with its laws in the order of the highest score at the start.

    Effects of one level act in the order of their list, such as a lens that dims a reflection or one behind which the
    reflection is. Only orders that predict something else are begun.
    """
    level = [law.kind.level for law in s.laws]
    if len(set(level)) == len(level):
        return s
    begun, orders = [(s, _predicted(s))], {tuple(sorted(range(len(level)), key=lambda k: level[k]))}
    for order in permutations(range(len(level))):
        acting = tuple(sorted(order, key=lambda k: level[k]))
        if acting in orders:
            continue
        orders.add(acting)
        other = _in_order(s, acting)
        predicted = _predicted(other)
        if all(_change_nats(s.task, predicted, known) > _SAME_NATS for _, known in begun):
            begun.append((other, predicted))
    return s if len(begun) == 1 else max((one for one, _ in begun), key=lambda one: one.at_start)


def _in_order(s: FittedSet, order: Sequence[int]) -> FittedSet:
    """The set, not begun, with its laws in another order."""
    numbers = np.split(np.arange(s.x.size), np.cumsum([law.size for law in s.laws]))
    at = np.concatenate([numbers[k] for k in order])
    hessian = None if s.hessian is None else s.hessian[np.ix_(at, at)]
    return replace(s, laws=tuple(s.laws[k] for k in order), x=s.x[at], hessian=hessian, started=None, refused="")


def _predicted(s: FittedSet) -> tuple[FloatArray, FloatArray, float]:
    """Mean, mm, and log width (tenth, recording, pixel) of main surfaces, and the log density of side information."""
    state, like = s.state(), s.task.likelihood
    return *observed(s.task, like.mixture(state)), like.side_log_density(state)


def _change_nats(
    task: SearchTask, a: tuple[FloatArray, FloatArray, float], b: tuple[FloatArray, FloatArray, float]
) -> float:
    """By how much samples of one prediction are less likely under another one, nats."""
    by_sample = 0.5 * ((a[0] - b[0]) ** 2 * np.exp(-2 * a[1])) + (a[1] - b[1]) ** 2
    frames = np.zeros(by_sample.shape[:2])
    for number, recording in enumerate(task.recordings):
        frames[: len(recording.tenths), number] = [own.size for own in recording.tenths]
    return float(np.nansum(frames[..., None] * by_sample)) + abs(a[2] - b[2])
