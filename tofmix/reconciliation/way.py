"""What a way of adding effects knows as it goes: the settings, what may be fitted, the model as it stands."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tofmix.bounds import Positive, Probability, WholeNumber, check_bounds, check_one_of
from tofmix.reconciliation.compare import Compared
from tofmix.reconciliation.likelihood import Likelihood, Part, State
from tofmix.reconciliation.name import Candidate

FAINT_SHARE = 0.01
"""An effect is faint if it gains less than this share of the others' gain: no law of theirs is exact."""

SPLITS = ("frames,pixels", "frames", "pixels")
"""Parts of the recording that may be held out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How reconciliation goes about.

    Parameters
    ----------
    kinds : tuple of str
        Effects that are tried.
    max_effects : int
        Most effects that are added.
    alpha : float
        Level of all tests, after correction.
    tolerance : float
        Error of the model that is taken as right: of a pose in sigma, of the noise's scale in tenths.
    split : str
        What is held out: ``frames``, ``pixels`` or ``frames,pixels``.
    seed : int
        Seed of every draw.
    """

    kinds: tuple[str, ...]
    max_effects: WholeNumber = 3
    alpha: Probability = 0.01
    tolerance: Positive = 0.1
    split: str = "frames,pixels"
    seed: WholeNumber = 1

    def __post_init__(self) -> None:
        check_bounds(self)
        check_one_of(self, "split", SPLITS)


@dataclass(slots=True, eq=False)
class Way:
    """One way of adding effects, as it stands.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    settings : Settings
        How.
    tick : callable
        Told of each kind that was tried.
    state : State
        The model with what was added so far.
    chosen : list of Candidate
        What was added, in that order.
    rivals : list of tuple of Candidate
        The other candidates of the round in which each of `chosen` was added, best first.
    first : tuple of Candidate
        All candidates of the first round, best first.
    aliases : list of tuple of Candidate
        Candidates that the recording cannot tell from a chosen one, which stands first.
    begun : Candidate, optional
        What was added first, whether or not it was dropped since.
    before : Compared, optional
        Panel of the model as given.
    missed : set of str
        Kinds that were added while a statistic in which they must show stood out.
    """

    likelihood: Likelihood
    settings: Settings
    tick: Callable[[str], None]
    state: State
    chosen: list[Candidate] = field(default_factory=list)
    rivals: list[tuple[Candidate, ...]] = field(default_factory=list)
    first: tuple[Candidate, ...] = ()
    aliases: list[tuple[Candidate, ...]] = field(default_factory=list)
    begun: Candidate | None = None
    before: Compared | None = None
    missed: set[str] = field(default_factory=set)


def held_out(likelihood: Likelihood, settings: Settings) -> Part:
    """Frames that no fit has seen, all pixels; the held-out pixels where frames are not split."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=False, split=settings.split)
    return np.flatnonzero(~likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def fit_part(likelihood: Likelihood, settings: Settings) -> Part:
    """What joint fits see: the rest of `held_out`."""
    if "frames" not in settings.split:
        return likelihood.evidence.part(fit=True, split=settings.split)
    return np.flatnonzero(likelihood.evidence.fit_frames), np.arange(likelihood.evidence.shape[1])


def name_of(candidate: Candidate) -> tuple[str, str]:
    """What names a candidate: its kind, and the surface that it acts on, if it is of one."""
    return candidate.kind, getattr(candidate.effect, "surface", "")
