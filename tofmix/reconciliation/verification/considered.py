"""The sets of effects beside the answer, on one scale of evidence, each with the reason why it is not the answer.

The search has all sets on one scale: the log evidence of all samples over that of the model as given. Here the verdict
adds why a set that it does not name is refused; of an interrupted search, the sets are those that it had weighed.
`aliases` lists what the samples do not separate, with a recording that does.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.found import ALIAS_NATS, Added, Ledger, Named, WeighedSet, set_text
from tofmix.reconciliation.verification.verify import Verified
from tofmix.simulation.effects import EFFECTS
from tofmix.wording import number

MOST_ALIASES = 3
"""Most aliases that are listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alias:
    """Explanations with nearly the same evidence.

    Parameters
    ----------
    sets : tuple of tuple of (str, str)
        For each explanation, its effects (kind, surface) that the others do not have; the found one stands first.
    gains : tuple of float
        Log evidence of each, nats, as in `considered`; only differences count.
    """

    sets: tuple[tuple[Named, ...], ...]
    gains: tuple[float, ...]

    @property
    def kinds(self) -> list[str]:
        """Each explanation in one string, such as ``range_offset + excess_noise``."""
        plain = [set_text((kind, "") for kind, _ in named) for named in self.sets]
        return plain if len(set(plain)) == len(plain) else [set_text(named) for named in self.sets]

    @property
    def separate_by(self) -> str:
        """A recording that separates the first from the others."""
        first = [kind for kind, _ in self.sets[0]]
        return separate_by(first, [kind for other in self.sets[1:] for kind, _ in other if kind not in first])


def separate_by(found: Iterable[str], others: Iterable[str]) -> str:
    """A recording that separates effects of some kinds from those of others."""
    pairs = [{one, other} for one in found for other in others]
    wanted = dict.fromkeys(words for kinds in pairs for words in _recordings(kinds))
    whole = [words for words in wanted if not any(words != other and words in other for other in wanted)]
    return "; and ".join(whole) or "another scene, with other distances and reflectivities"


def _recordings(kinds: set[str]) -> list[str]:
    """The recordings that two kinds declare to tell them apart."""
    known = [EFFECTS[kind] for kind in sorted(kinds & EFFECTS.keys())]
    return [
        words for effect in known for other, words in effect.separated_from.items() if {effect.kind, other} == kinds
    ]


def aliases(considered: Sequence[WeighedSet], *, named: bool) -> tuple[Alias, ...]:
    """Explanations that the recording cannot separate: within `ALIAS_NATS` of each other.

    Parameters
    ----------
    considered : sequence of WeighedSet
        The answer and its rivals, on one scale of evidence.
    named : bool
        Whether the answer is named. If not, the result is the best explanations that cannot be separated.
    """
    if not considered:
        return ()
    first, *others = considered
    if not named:
        return _of_nothing([w for w in others if w.names])
    own = frozenset(first.names)
    groups: dict[tuple[Named, ...], list[tuple[tuple[Named, ...], float]]] = {}
    for other in [w for w in others if w.is_alias][:MOST_ALIASES]:
        names = frozenset(other.names)
        groups.setdefault(tuple(sorted(own - names)), []).append((tuple(sorted(names - own)), other.evidence_nats))
    return tuple(
        Alias(sets=(mine, *(s for s, _ in rest)), gains=(first.evidence_nats, *(g for _, g in rest)))
        for mine, rest in groups.items()
    )


def _of_nothing(sets: Sequence[WeighedSet]) -> tuple[Alias, ...]:
    """The best explanations that cannot be separated, without their common effects."""
    top = max((s.evidence_nats for s in sets), default=0.0)
    if top < ALIAS_NATS:
        return ()
    near = [s for s in sets if s.evidence_nats > top - ALIAS_NATS]
    near = [s for s in near if not any({*o.names} < {*s.names} for o in near)][: MOST_ALIASES + 1]
    if len(near) < 2:  # noqa: PLR2004  one is separated from all others
        return ()
    common = frozenset.intersection(*(frozenset(s.names) for s in near))
    apart = tuple(tuple(sorted(frozenset(s.names) - common)) for s in near)
    return (Alias(sets=apart, gains=tuple(s.evidence_nats for s in near)),)


OTHERS = 3
"""Most sets beside the answer and its aliases."""

NAMED = ("explained", "partly_explained")
"""Verdicts with names."""

AT_A_BOUND = "a number is at its bound, where another effect does the same"

_STILL = {
    "bias": "the mean",
    "spread": "the width",
    "skew": "the skew",
    "tails": "the shape of the tails",
    "pattern": "the mean of single pixels",
    "spread_pattern": "the width of single pixels",
    "invalid": "the share of lost samples",
    "common_mode": "the mean of frames",
    "bursts": "the width of frames",
    "trend": "the change in time",
    "memory": "the memory",
    "bridging": "the share of samples between two surfaces",
    "neighbour_correlation": "the correlation of neighbours",
    "discreteness": "the steps of the ranges",
}


def considered(added: Added, verified: Verified, ledger: Ledger) -> tuple[WeighedSet, ...]:
    """The answer, its aliases, and the best others.

    Parameters
    ----------
    added, verified
        The outcome of the search, and its verdict.
    ledger : Ledger
        The sets of the search.

    Returns
    -------
    tuple of WeighedSet
        First the named set, or that without any effect; then sets that the recording cannot separate from it; then at
        most `OTHERS` others, most evidence first. Sets that contain the answer are left out: it explains the recording
        without the rest.
    """
    if ledger.ends():
        return _unfinished(added, verified, ledger)
    if not added.considered:
        return (WeighedSet(names=(), evidence_nats=0.0),)
    best, *others = added.considered
    if verified.verdict in NAMED or not best.names:
        return added.considered
    others = [replace(w, is_alias=False) for w in others if w.names]
    refused = replace(best, why_not=refusal(added, verified))
    return (WeighedSet(names=(), evidence_nats=0.0), refused, *others[:OTHERS])


def _unfinished(added: Added, verified: Verified, ledger: Ledger) -> tuple[WeighedSet, ...]:
    """The answer of an interrupted search, and the best others that it had weighed."""
    names = tuple(sorted(c.name for c in added.chosen)) if verified.verdict in NAMED else ()
    nats = [w.evidence_nats for w in ledger.sets if w.names == names and w.why_not is None]
    first = WeighedSet(names=names, evidence_nats=nats[-1] if nats else 0.0)
    return (first, *_others_of_search(first, ledger, "but not tried to the end"))


def _others_of_search(first: WeighedSet, ledger: Ledger, more: str) -> Iterator[WeighedSet]:
    """The best sets of the search that do not contain the answer; `more` says why those with more evidence lost."""
    others = [w for w in ledger.best() if not set(w.names) >= set(first.names) or not first.names]
    for other in [w for w in others if w.names != first.names][:OTHERS]:
        yield replace(other, why_not=_by_evidence(other, first, more))


def _by_evidence(other: WeighedSet, first: WeighedSet, more: str) -> str:
    """How much more or less likely one set is than another, in words; `more` ends those of a more likely one."""
    less = first.evidence_nats - other.evidence_nats
    if less >= 0:
        return f"{number(less, ',.0f')} nats less likely"
    return f"{number(-less, ',.0f')} nats more likely, {more}"


def still(curve: Curve) -> str:
    """What still differs, in words."""
    what = _STILL.get(curve.statistic, curve.statistic.replace("_", " "))
    over = "" if curve.axis == "all" else f" over {curve.axis.replace('_', ' ')}"
    return f"{what} still differs{over}"


def refusal(added: Added, verified: Verified) -> str:
    """Why the effects of a search are not named."""
    found = verified.findings
    said = [f"{set_text([added.chosen[c.number].name])} {c.reason}" for c in verified.against]
    said += ["there are too few samples"] if found.few else []
    said += [f"a smooth function of {found.law} fits better"] if found.law else []
    said += [f"the model's own {found.own.kind} fits better with other numbers"] if found.own is not None else []
    said += [AT_A_BOUND] if found.bound else []
    said += ["another memory than of one frame is left"] if found.echo else []
    said += ["its pattern is a smooth function of place"] if found.shaped else []
    said += [still(curve) for curve in found.open[:1]]
    said += ["ranges change in time" if found.contradicted else "its effects leave the statistics in which they show"]
    return said[0]
