"""The outcome of a search: the found effects with their numbers and gains, and the sets that were weighed."""

import math
from dataclasses import dataclass

from tofmix.reconciliation.comparison.compare import Compared
from tofmix.reconciliation.ledger import Named, WeighedSet, name_of_effect
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.parameters.fits import Fitted
from tofmix.simulation.effects.base import Effect, Target
from tofmix.simulation.effects.hidden import PixelBias


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
    score : float
        Log evidence of all samples, less the price of each effect, nats; minus infinity without a search.
    """

    state: ModelState
    chosen: tuple[TriedEffect, ...]
    first: tuple[TriedEffect, ...]
    panel: Compared
    considered: tuple[WeighedSet, ...] = ()
    law: str | None = None
    score: float = -math.inf
