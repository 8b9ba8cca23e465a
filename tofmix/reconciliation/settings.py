"""Options of a reconciliation, and the samples that fits and checks may see."""

from dataclasses import dataclass

import numpy as np

from tofmix.errors import UsageError
from tofmix.options import RECONCILE, check_options
from tofmix.reconciliation.likelihood.likelihood import Likelihood, Part
from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.measured_scene import OWN_ERROR

KINDS = tuple(EFFECTS)
"""All kinds that are tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Options of a reconciliation.

    Parameters
    ----------
    kinds : tuple of str
        Kinds of effects to try.
    max_effects, alpha, tolerance, split, seed
        See `tofmix.options.RECONCILE`; the tolerance is read with `accepted`.

    Raises
    ------
    UsageError
        If a value is out of its bounds.
    """

    kinds: tuple[str, ...]
    max_effects: int = RECONCILE["max_effects"].default
    alpha: float = RECONCILE["alpha"].default
    tolerance: float | None = RECONCILE["tolerance"].default
    split: str = RECONCILE["split"].default
    seed: int = RECONCILE["seed"].default

    def __post_init__(self) -> None:
        try:
            check_options(self, RECONCILE)
        except ValueError as error:
            raise UsageError(str(error)) from error

    def accepted(self, likelihood: Likelihood) -> float:
        """Accepted error of the scene, in sigma. What a recording saw is known as well as a camera stays the same."""
        if self.tolerance is not None:
            return self.tolerance
        of_rectangles = 0.1  # that somebody measured
        return of_rectangles if likelihood.scene.model.scene is None else OWN_ERROR


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
