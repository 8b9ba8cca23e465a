"""Explanations that a recording cannot separate, and a recording that separates them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tofmix.reconciliation.found import ALIAS_NATS, Named, WeighedSet, set_text
from tofmix.simulation.effects import EFFECTS

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
