"""The outcome of a search: the found effects with their numbers and gains, and the sets that were weighed.

The search writes into one `Ledger`: each set that it has fitted, its evidence, and the reason for which it lost. A
caller may follow it line by line, and may end the search between two sets.
`tofmix.reconciliation.verification.considered` chooses the sets that are shown.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from tofmix.reconciliation.comparison.compare import Compared
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.parameters.fits import Fitted
from tofmix.simulation.effects.base import Effect, Target
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.wording import number

Named = tuple[str, str]
"""An effect's kind and surface; the surface is empty for an effect of the camera."""

ALIAS_NATS = 4.0
"""Difference of evidence that does not separate two sets: odds of 55 to 1."""

NOTHING = "no effect"
"""Name of a set without any effect."""

_AND = " + "


def name_of_effect(effect: Effect) -> Named:
    """Kind and surface of an effect."""
    return effect.kind, getattr(effect, "surface", "")


def set_text(names: Iterable[Named]) -> str:
    """A set in words, such as ``range_offset + surface_pose "wall"``."""
    return _AND.join(f'{kind} "{surface}"' if surface else kind for kind, surface in names) or NOTHING


@dataclass(frozen=True, slots=True, kw_only=True)
class WeighedSet:
    """A set of effects that was fitted to samples.

    Parameters
    ----------
    names : tuple of (str, str)
        Kinds and surfaces of its effects.
    evidence_nats : float
        Log evidence over that of the model as given; all sets of one ledger are on this scale.
    why_not : str or None
        Why it is not the answer, in plain words; None for the answer, and for a set that still stands.
    is_alias : bool
        Whether the samples do not separate it from the answer.
    """

    names: tuple[Named, ...]
    evidence_nats: float
    why_not: str | None = None
    is_alias: bool = False

    @property
    def line(self) -> str:
        """The set on one line: its evidence, its effects, and the reason for which it lost."""
        why = f": {self.why_not}" if self.why_not else ""
        return f"{number(self.evidence_nats, '12,.1f')} nats  {set_text(self.names)}{why}"


class Ledger:
    """The weighed sets of one reconciliation.

    Parameters
    ----------
    follow : callable
        Called with each set when it is weighed.
    is_stopped : callable
        Whether the user wants the search to end.
    """

    def __init__(
        self, follow: Callable[[WeighedSet], None] = lambda _: None, is_stopped: Callable[[], bool] = lambda: False
    ) -> None:
        self.sets: list[WeighedSet] = []
        self.is_complete = True
        self._follow, self._is_stopped = follow, is_stopped

    def weigh(self, names: Sequence[Named], evidence_nats: float, why_not: str | None = None) -> WeighedSet:
        """Enter a set.

        Parameters
        ----------
        names : sequence of (str, str)
            Kinds and surfaces of its effects.
        evidence_nats : float
            Log evidence over that of the model as given.
        why_not : str, optional
            Why it is not the answer.
        """
        weighed = WeighedSet(names=tuple(sorted(names)), evidence_nats=evidence_nats, why_not=why_not)
        self.sets.append(weighed)
        self._follow(weighed)
        return weighed

    def ends(self) -> bool:
        """Whether the search must end here, before its next set; from then on the ledger is not complete."""
        if self._is_stopped():
            self.is_complete = False
        return not self.is_complete

    def best(self) -> list[WeighedSet]:
        """The best entry of each set that did not lose by itself, most evidence first."""
        found: dict[tuple[Named, ...], WeighedSet] = {}
        for weighed in self.sets:
            if weighed.why_not is None and weighed.evidence_nats > self._nats(found.get(weighed.names)):
                found[weighed.names] = weighed
        return sorted(found.values(), key=lambda w: -w.evidence_nats)

    @staticmethod
    def _nats(weighed: WeighedSet | None) -> float:
        return float("-inf") if weighed is None else weighed.evidence_nats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriedEffect:
    """An effect that was tried.

    Parameters
    ----------
    effect : Effect
        With its fitted parameters.
    gain : float
        Gain on held-out samples in the presence of the other effects, nats; of an effect that was tried alone, over the
        model as given.
    parameters : int
        Free parameters.
    fitted : Fitted or None
        The end of its search, if it has numbers.
    """

    effect: Effect
    gain: float
    parameters: int
    fitted: Fitted | None = None

    @property
    def kind(self) -> str:
        """Its kind."""
        return self.effect.kind

    @property
    def name(self) -> Named:
        """Its kind, and the surface on which it acts, if any."""
        return name_of_effect(self.effect)

    @property
    def static(self) -> bool:
        """Whether it gives each pixel a constant bias."""
        return self.effect.target is Target.BIAS

    @property
    def patterned(self) -> bool:
        """Whether it gives each pixel a bias of its own, so that it can imitate every static effect."""
        return isinstance(self.effect.hidden, PixelBias)

    @property
    def at_a_bound(self) -> bool:
        """Whether its fit ended at numbers at which it is another effect."""
        return self.fitted is not None and self.fitted.at_a_bound

    @property
    def exact(self) -> bool:
        """Whether its law is exact. Its gain then does not limit the remaining deviation."""
        return self.effect.exact_law

    @property
    def loses(self) -> bool:
        """Whether it loses samples. Its gain, from lost samples, then says nothing about the ranges of the others."""
        return self.effect.target is Target.LOSS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Added:
    """The result of a search.

    Parameters
    ----------
    state : ModelState
        The model with the effects that were added, fitted to the fitting samples alone.
    chosen : tuple of TriedEffect
        The added effects, in the order of the state.
    first : tuple of TriedEffect
        Every effect that was tried alone, best first.
    panel : Compared
        Panel on held-out frames of the refined model, moved within its tolerance to where it fits them best.
    considered : tuple of WeighedSet
        The set, its aliases and the best others, each with the reason why it is not the answer.
    law : str or None
        Axis of a smooth law that is clearly better than every set of effects; None without one.
    faint_law : bool
        Whether the effects have nearly all of the evidence of the set with that law.
    score : float
        Log evidence of all samples, less the price of each effect, nats; minus infinity without a search.
    """

    state: ModelState
    chosen: tuple[TriedEffect, ...]
    first: tuple[TriedEffect, ...]
    panel: Compared
    considered: tuple[WeighedSet, ...] = ()
    law: str | None = None
    faint_law: bool = False
    score: float = -math.inf
