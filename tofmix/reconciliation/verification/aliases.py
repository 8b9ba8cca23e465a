"""Explanations that a recording cannot separate, and a recording that separates them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tofmix.reconciliation.search.add import Added
from tofmix.reconciliation.search.alternatives import ALIAS_NATS, MOST_ALIASES
from tofmix.reconciliation.search.columns import summed_up
from tofmix.reconciliation.search.subsets import Explained

_DARK = "a dark and a bright board at each of two distances, of which nothing else of the scene is near"

_SEPARATE: tuple[tuple[frozenset[str], str], ...] = (
    (frozenset({"range_offset", "surface_pose"}), "a second surface"),
    (frozenset({"range_offset", "temperature_drift"}), "20 minutes from power-on"),
    (frozenset({"temperature_drift", "motion"}), "20 minutes from power-on, or a second surface that stands still"),
    (frozenset({"range_offset", "amplitude_walk"}), "a dark and a bright board at one distance"),
    (frozenset({"range_offset", "wiggling"}), "more distances, spread over a quarter of the unambiguous range"),
    (frozenset({"range_offset", "fixed_pattern"}), "another scene: the pattern stays with its pixels"),
    (frozenset({"range_offset", "multipath"}), "a scene without a surface beside the one that is too far"),
    (frozenset({"range_offset", "scattering"}), "the same scene without its brightest surface"),
    (frozenset({"surface_pose", "multipath"}), "the same surface alone, without others around it"),
    (frozenset({"surface_pose", "motion"}), "a longer recording"),
    (frozenset({"surface_pose", "wiggling"}), "the same surface at a second distance"),
    (frozenset({"surface_pose", "amplitude_walk"}), "the same surface with another reflectivity"),
    (frozenset({"surface_pose", "scattering"}), "the same scene without its brightest surface"),
    (frozenset({"wiggling", "amplitude_walk"}), "a dark and a bright board at one distance"),
    (frozenset({"wiggling", "fixed_pattern"}), "the same image at a second distance"),
    (frozenset({"wiggling", "scattering"}), "the same scene without its brightest surface"),
    (frozenset({"wiggling", "multipath"}), "the same surface at a second distance, without others around it"),
    (frozenset({"scattering", "multipath"}), "the same scene without its brightest surface"),
    (frozenset({"scattering", "amplitude_walk"}), "the same scene without its brightest surface"),
    (frozenset({"internal_reflection", "range_offset"}), _DARK),
    (frozenset({"internal_reflection", "surface_pose"}), _DARK),
    (frozenset({"internal_reflection", "wiggling"}), _DARK),
    (frozenset({"internal_reflection", "amplitude_walk"}), _DARK),
    (frozenset({"internal_reflection", "scattering"}), _DARK),
    (frozenset({"internal_reflection", "multipath"}), _DARK),
    (frozenset({"internal_reflection", "fixed_pattern"}), "another scene: the pattern stays with its pixels"),
    (frozenset({"excess_noise", "multipath"}), "the same surface alone, without others around it"),
    (frozenset({"dropout", "saturation"}), "surfaces of other reflectivities"),
    (frozenset({"excess_noise", "vignetting"}), "a flat wall that fills the image"),
    (frozenset({"flying_pixels", "pixel_crosstalk"}), "edges between surfaces of very different brightness"),
)

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
    wanted = dict.fromkeys(words for kinds in pairs for pair, words in _SEPARATE if pair == kinds)
    whole = [words for words in wanted if not any(words != other and words in other for other in wanted)]
    return "; and ".join(whole) or "another scene, with other distances and reflectivities"


def aliases(added: Added, *, named: bool) -> tuple[Alias, ...]:
    """Explanations that the recording cannot separate.

    Parameters
    ----------
    added : Added
        The outcome of the search.
    named : bool
        Whether its effects are named. If not, the result is the best explanations that cannot be separated.
    """
    sets = added.sets
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


def _of_nothing(sets: Sequence[Explained]) -> tuple[Alias, ...]:
    """The best explanations that cannot be separated, without their common effects."""
    if not sets or sets[0].evidence < ALIAS_NATS:
        return ()
    near = [s for s in sets if s.evidence > sets[0].evidence - ALIAS_NATS]
    near = [s for s in near if not any(o.names < s.names for o in near)][: MOST_ALIASES + 1]
    if len(near) < 2:  # noqa: PLR2004  one is separated from all others
        return ()
    common = frozenset.intersection(*(s.names for s in near))
    return (Alias(sets=tuple(tuple(sorted(s.names - common)) for s in near), gains=tuple(s.evidence for s in near)),)
