"""Candidates for the noise model, compared by the likelihood of held-out pixels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.robust import MAD_TO_SIGMA
from tofmix.estimation.learnt.folds import Fold
from tofmix.estimation.learnt.model import PixelNoise

_CLIP_DEVIATIONS = 10.0
"""Differences of pixels are clipped at so many median absolute deviations, so that no single pixel decides."""


@dataclass(frozen=True, slots=True)
class NoiseCandidate:
    """A model by fold, and its scores.

    Parameters
    ----------
    noises : tuple of PixelNoise
        The model that each fold has learnt from its training pixels.
    scores : (pixel,) float64
        Log likelihood of the held-out pixels of all folds, nat.
    """

    noises: tuple[PixelNoise, ...]
    scores: FloatArray


def candidate_of(folds: Sequence[Fold], noises: Sequence[PixelNoise | None]) -> NoiseCandidate | None:
    """Judge the models of the folds; None where a fold has none."""
    known = tuple(noise for noise in noises if noise is not None)
    if len(known) < len(folds):
        return None
    return NoiseCandidate(known, np.concatenate([fold.scores(noise) for fold, noise in zip(folds, known, strict=True)]))


def held_out_gain(
    one: NoiseCandidate,
    other: NoiseCandidate,
    *,
    standard_errors: float = 3.0,
    least_gain: float = 0.1,
    false_choice: float = 1.0e-3,
) -> float:
    """Gain of the first over the second, nat a pixel; 0 where noise alone may give it, or it changes no count.

    One of two tests must pass. Most pixels gain: the mean is some standard errors above 0. Or a few pixels gain much:
    if the second model were true, the product of the likelihood ratios of held-out pixels would exceed e^g with
    probability e^-g at most, however the first was learnt. The pixel that gains most is left out.

    Parameters
    ----------
    one, other : Candidate
        The models, judged by the same pixels.
    standard_errors : float
        Least mean gain of the first test, in its standard errors.
    least_gain : float
        Least mean gain of both tests, nat a pixel: less changes no count.
    false_choice : float
        Largest probability e^-g of a wrong choice by the second test.

    References
    ----------
    Vovk and Wang, Annals of Statistics 49(3), 2021, doi:10.1214/20-AOS2020: e-values.
    """
    gain, error = mean_difference(one.scores, other.scores)
    if gain > max(standard_errors * error, least_gain):
        return gain
    difference = one.scores - other.scores
    difference = np.sort(difference[np.isfinite(difference)])[:-1]
    if difference.size and difference.sum() > max(math.log(1.0 / false_choice), least_gain * difference.size):
        return float(difference.mean())
    return 0.0


def mean_difference(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Mean of one - other over the pixels (pixel,) that both know, and its standard error; outliers are clipped.

    Fewer than three pixels give 0, with an infinite error.
    """
    difference = one - other
    difference = difference[np.isfinite(difference)]
    if difference.size < 3:  # noqa: PLR2004  two numbers have no robust spread
        return 0.0, math.inf
    middle = float(np.median(difference))
    reach = _CLIP_DEVIATIONS * MAD_TO_SIGMA * float(np.median(np.abs(difference - middle))) + 1e-9
    difference = np.clip(difference, middle - reach, middle + reach)
    return float(difference.mean()), float(difference.std() / math.sqrt(difference.size)) + 1e-12
