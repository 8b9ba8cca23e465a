"""Explanations that a recording cannot separate, and a recording that separates them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tofmix.reconciliation.search.add import Added
from tofmix.reconciliation.search.alternatives import ALIAS_NATS, MOST_ALIASES, Explained
from tofmix.reconciliation.search.columns import summed_up
from tofmix.reconciliation.weighed import SetOfNames
from tofmix.simulation.effects import EFFECTS

NOTHING = "no effect"
"""Name of an explanation without any effect."""

_AND = " + "

Named = tuple[str, str]
"""An effect's kind and surface; the surface is empty for an effect of the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alias:
    """Explanations with nearly the same evidence.

    Parameters
    ----------
    sets : tuple of tuple of (str, str)
        For each explanation, its effects (kind, surface) that the others do not have; the found one stands first.
    gains : tuple of float
        Gain of each, nats; only differences count.
    """

    sets: tuple[tuple[Named, ...], ...]
    gains: tuple[float, ...]

    @property
    def kinds(self) -> list[str]:
        """Each explanation in one string, such as ``range_offset + excess_noise``."""
        plain = [_AND.join(kind for kind, _ in named) or NOTHING for named in self.sets]
        if len(set(plain)) == len(plain):
            return plain
        return [_AND.join(f'{kind} "{surface}"' if surface else kind for kind, surface in s) for s in self.sets]

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


def aliases(added: Added, *, named: bool) -> tuple[Alias, ...]:
    """Explanations that the recording cannot separate.

    Parameters
    ----------
    added : Added
        The outcome of the search.
    named : bool
        Whether its effects are named. If not, the result is the best explanations that cannot be separated.
    """
    sets = added.sets if added.weighed is None else added.weighed
    if sets is None:
        return ()
    if not named:
        return _of_nothing(sets.sets)
    found = sets.found
    groups: dict[tuple[Named, ...], list[tuple[tuple[Named, ...], float]]] = {}
    for other in sets.aliases:
        mine, theirs = tuple(sorted(found.names - other.names)), tuple(sorted(other.names - found.names))
        groups.setdefault(mine, []).append((theirs, other.evidence))
    out = [
        Alias(sets=(mine, *(s for s, _ in others)), gains=(found.evidence, *(g for _, g in others)))
        for mine, others in groups.items()
    ]
    for head, *rest in added.aliases:  # kinds that summaries do not show
        if not summed_up(head.kind):
            each = tuple(((c.kind, getattr(c.effect, "surface", "")),) for c in (head, *rest))[: MOST_ALIASES + 1]
            out.append(Alias(sets=each, gains=tuple(c.gain for c in (head, *rest))[: MOST_ALIASES + 1]))
    return tuple(out)


def _of_nothing(sets: Sequence[Explained | SetOfNames]) -> tuple[Alias, ...]:
    """The best explanations that cannot be separated, without their common effects."""
    if not sets or sets[0].evidence < ALIAS_NATS:
        return ()
    near = [s for s in sets if s.evidence > sets[0].evidence - ALIAS_NATS]
    near = [s for s in near if not any(o.names < s.names for o in near)][: MOST_ALIASES + 1]
    if len(near) < 2:  # noqa: PLR2004  one is separated from all others
        return ()
    common = frozenset.intersection(*(s.names for s in near))
    return (Alias(sets=tuple(tuple(sorted(s.names - common)) for s in near), gains=tuple(s.evidence for s in near)),)
