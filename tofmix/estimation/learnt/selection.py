"""Selection of the parts of the noise: forward by held-out gain, then backward.

Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd edition, 2009, sections 3.3.2 and 7.10.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tofmix.estimation.learnt.candidates import NoiseCandidate, candidate_of, held_out_gain
from tofmix.estimation.learnt.folds import Fold
from tofmix.estimation.learnt.parts import with_part, without_part


def select_parts(
    folds: Sequence[Fold],
    best: NoiseCandidate,
    parts: Sequence[str],
    *,
    required: Sequence[str],
    map_parts: Callable[[Callable[[str], NoiseCandidate | None], Iterable[str]], Iterable[NoiseCandidate | None]],
) -> tuple[NoiseCandidate, list[str]]:
    """Add the part of the largest held-out gain while one gains; then drop parts that the others make needless.

    Parameters
    ----------
    folds : sequence of Fold
        Pixels that teach and pixels that judge.
    best : Candidate
        The model to start from.
    parts : sequence of str
        Names of the parts that may be added; see `parts.PARTS`.
    required : sequence of str
        Parts that are added first, whatever they gain, and kept.
    map_parts : callable
        Applies a function to several parts: `map`, or the `map` of a pool of threads.

    Returns
    -------
    Candidate
        The model with the selected parts.
    list of str
        The selected parts, in the order of their addition.
    """
    selected: list[str] = []

    def one_more(part: str) -> NoiseCandidate | None:
        return candidate_of(folds, [with_part(fold, one, part) for fold, one in zip(folds, best.noises, strict=True)])

    for part in required:
        trial = one_more(part)
        if trial is not None:
            best = trial
            selected.append(part)
    while len(selected) < len(parts) + len(required):
        left = [part for part in parts if part not in selected]
        trials = [(part, trial) for part, trial in zip(left, map_parts(one_more, left), strict=True) if trial]
        gains = [held_out_gain(trial, best) for _, trial in trials]
        if max(gains, default=0.0) <= 0.0:
            break
        part, best = trials[int(np.argmax(gains))]
        selected.append(part)
    for part in tuple(selected):
        if len(selected) > 1 and part not in required:
            trial = candidate_of(folds, [without_part(noise, part) for noise in best.noises])
            if trial is not None and held_out_gain(best, trial) == 0.0:
                best = trial
                selected.remove(part)
    return best, selected
