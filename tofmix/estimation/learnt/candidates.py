"""Candidates for the noise model, compared by the likelihood of held-out pixels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.robust import MAD_TO_SIGMA
from tofmix.estimation.learnt.folds import Fold
from tofmix.estimation.learnt.model import PixelNoise

SIGNIFICANT = 3.0
"""Standard errors of its mean by which the likelihood must gain."""

LEAST_GAIN_A_PIXEL = 0.1
"""Least mean gain, nat a pixel: less changes no count."""

LEAST_FALSE_CHOICE = 1.0e-3
"""Probability of a wrong choice where a few pixels have most of the gain."""

_CLIP_DEVIATIONS = 10.0
"""Differences of pixels are clipped at so many median absolute deviations, so that no single pixel decides."""


@dataclass(frozen=True, slots=True)
class Candidate:
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


def candidate_of(folds: Sequence[Fold], noises: Sequence[PixelNoise | None]) -> Candidate | None:
    """Judge the models of the folds; None where a fold has none."""
    known = tuple(noise for noise in noises if noise is not None)
    if len(known) < len(folds):
        return None
    return Candidate(known, np.concatenate([fold.scores(noise) for fold, noise in zip(folds, known, strict=True)]))


def held_out_gain(one: Candidate, other: Candidate) -> float:
    """Gain of the first over the second, nat a pixel; 0 where noise alone may give it, or it changes no count.

    One of two tests must pass. Most pixels gain: the mean is `SIGNIFICANT` standard errors above 0. Or a few pixels
    gain much: if the second model were true, the product of the likelihood ratios of held-out pixels would exceed e^g
    with probability e^-g at most, however the first was learnt. The pixel that gains most is left out.

    References
    ----------
    Vovk and Wang, Annals of Statistics 49(3), 2021, doi:10.1214/20-AOS2020: e-values.
    """
    gain, error = mean_difference(one.scores, other.scores)
    if gain > max(SIGNIFICANT * error, LEAST_GAIN_A_PIXEL):
        return gain
    difference = one.scores - other.scores
    difference = np.sort(difference[np.isfinite(difference)])[:-1]
    if difference.size and difference.sum() > max(
        math.log(1.0 / LEAST_FALSE_CHOICE), LEAST_GAIN_A_PIXEL * difference.size
    ):
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
