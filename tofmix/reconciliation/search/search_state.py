"""The state of a search: its settings, the data that fits may see, and the model with the effects added so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tofmix.errors import UsageError
from tofmix.options import RECONCILE, check_options
from tofmix.reconciliation.comparison.compare import Compared
from tofmix.reconciliation.ledger import Ledger, Named, name_of_effect
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.search.name import TriedEffect, of_all_samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Options of a reconciliation.

    Parameters
    ----------
    kinds : tuple of str
        Kinds of effects to try.
    max_effects, alpha, tolerance, split, seed
        See `tofmix.options.RECONCILE`.

    Raises
    ------
    UsageError
        If a value is out of its bounds.
    """

    kinds: tuple[str, ...]
    max_effects: int = RECONCILE["max_effects"].default
    alpha: float = RECONCILE["alpha"].default
    tolerance: float = RECONCILE["tolerance"].default
    split: str = RECONCILE["split"].default
    seed: int = RECONCILE["seed"].default

    def __post_init__(self) -> None:
        try:
            check_options(self, RECONCILE)
        except ValueError as error:
            raise UsageError(str(error)) from error


@dataclass(slots=True, eq=False)
class SearchState:
    """The state of one search.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    settings : Settings
        Options of the search.
    tick : callable
        Called with each kind that was tried.
    state : ModelState
        The model with the effects added so far.
    chosen : list of TriedEffect
        The added effects, in the order in which they were added.
    rivals : list of tuple of TriedEffect
        For each of `chosen`: the other candidates of its round, best first.
    first : tuple of TriedEffect
        All candidates of the first round, best first.
    begun : TriedEffect, optional
        The effect that was added first, even if it was removed later.
    before : Compared, optional
        Panel of the model as given.
    missed : set of str
        Kinds that were added while a statistic in which they must show stood out.
    ledger : Ledger
        Gets each set that is fitted.
    given : float, optional
        Log-likelihood of the model as given, on the held-out samples that score candidates.
    """

    likelihood: Likelihood
    settings: Settings
    tick: Callable[[str], None]
    state: ModelState
    chosen: list[TriedEffect] = field(default_factory=list)
    rivals: list[tuple[TriedEffect, ...]] = field(default_factory=list)
    first: tuple[TriedEffect, ...] = ()
    begun: TriedEffect | None = None
    before: Compared | None = None
    missed: set[str] = field(default_factory=set)
    ledger: Ledger = field(default_factory=Ledger)
    given: float | None = None

    def evidence_nats(self, state: ModelState, chosen: Sequence[TriedEffect]) -> float:
        """Log evidence of fitted effects over that of the model as given, by held-out samples, for all samples."""
        test = self.likelihood.evidence.part(fit=False, split=self.settings.split)
        value = self.likelihood.value(state, test)
        if self.given is None:
            self.given = value if not chosen else self.likelihood.value(self.likelihood.start(), test)
        return of_all_samples(self.likelihood, test, value - self.given) - sum(c.price for c in chosen)

    def weigh(self, state: ModelState, chosen: Sequence[TriedEffect], why_not: str | None = None) -> None:
        """Enter fitted effects into the ledger."""
        self.ledger.weigh([name_of(c) for c in chosen], self.evidence_nats(state, chosen), why_not)


def held_out(likelihood: Likelihood, settings: Settings) -> Part:
    """Held-out frames with all pixels; if frames are not split, the held-out pixels."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=False, split=settings.split)
    return np.flatnonzero(~likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def fit_part(likelihood: Likelihood, settings: Settings) -> Part:
    """The data of fits of all effects together: the rest of `held_out`."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=True, split=settings.split)
    return np.flatnonzero(likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def name_of(candidate: TriedEffect) -> Named:
    """The identity of a candidate: its kind, and the surface on which it acts, if any."""
    return name_of_effect(candidate.effect)
