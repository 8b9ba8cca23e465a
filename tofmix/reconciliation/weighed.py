"""Sets of effects with their evidence, as they are listed: aliases, and what else was considered."""

from dataclasses import dataclass

Name = tuple[str, str]
"""Kind and surface; the surface is empty for an effect of the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WeighedSet:
    """A set of effects, its evidence, and why it is not the answer.

    Parameters
    ----------
    names : tuple of (str, str)
        Kind and surface of each effect.
    evidence_nats : float
        Log evidence over that without any effect.
    why_not : str or None
        Why it is not the answer; None for the answer.
    """

    names: tuple[Name, ...]
    evidence_nats: float
    why_not: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetOfNames:
    """Names of effects, and log evidence over that without any effect, nats."""

    names: frozenset[Name]
    evidence: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WeighedSets:
    """The named set and others, with the interface of `tofmix.reconciliation.search.alternatives.Alternatives`.

    Parameters
    ----------
    found : SetOfNames
        The named set.
    aliases : tuple of SetOfNames
        Sets that the recording does not separate from it.
    sets : tuple of SetOfNames
        All other sets, best first.
    """

    found: SetOfNames
    aliases: tuple[SetOfNames, ...]
    sets: tuple[SetOfNames, ...]
