"""How many surfaces the samples of one pixel show under the learnt noise: each must gain its threshold.

A count starts without surfaces: background, and c_0 where samples lie near r_max. Surfaces are added while one more
gains its threshold (`GainThresholds`) in a trial (`trials`). A pair of surfaces must not pass for one wide surface; so,
where a pixel has a width of its own, trials start from this width and from the common one. At the end, c_0 and surfaces
that the samples do not need are removed, the least needed first.
"""

import math
from typing import NamedTuple

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, near_no_return
from tofmix.estimation.learnt.acceleration import value_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    GAIN,
    MEAN,
    OWN,
    SUPPORT,
    WEIGHT,
    Samples,
    copy_fit,
    remove_surface,
    start_without_surface,
)
from tofmix.estimation.learnt.em import mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.model import GainThresholds, read_gains
from tofmix.estimation.learnt.trials import (
    LearntWorkspace,
    first_surface,
    gain_of_jump,
    gain_of_surface,
    settle,
    surely_needed,
    try_one_more,
)
from tofmix.estimation.mixture.counting import MIN_SUPPORT, least_gain

LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN = 1.0e-3, 4.0
"""Rules of the counts that noise is learnt from: false alarms, and c_0's gain in nat, which noise alone gives it with a
probability of 0.002."""


class LearntRules(NamedTuple):
    """Rules for a surface: the requested false-alarm probability, and the most layers.

    `no_return_gain`, nat, is the gain that c_0 needs in the presence of a surface.
    """

    false_alarm: float
    no_return_gain: float
    max_layers: int


@borrowing
def _wanted_gain(
    n: float, k: int, fit: FloatArray, work: LearntWorkspace, thresholds: GainThresholds, rules: LearntRules
) -> float:
    """Threshold, nat, of a surface beside `k` others in `n` samples; `fit` has the share of background."""
    read_gains(n, fit[OWN, BACKGROUND], k == 0, thresholds, work.gains)
    least = least_gain(rules.false_alarm, work.gains)
    # Gain, nat, that no fit of a trial tells from 0. Where noise gains nothing, as on steps of ten sigma, it is needed.
    inexact_gain = 1.0e-3
    return max(least, inexact_gain) if k > 0 else least  # the first surface may be wanted for any gain


@borrowing
def _remove_no_return(data: Samples, k: int, work: LearntWorkspace, law: Law, beam: Beam, rules: LearntRules) -> None:
    """Remove c_0 from work.fit if a surface is near it and the samples do not need both."""
    fit, trial, _, scratch, _ = work
    near = False
    for i in range(k):
        # sigmas within which c_0 and a surface may stand for the same samples
        near = near or near_no_return(fit[MEAN, i], 5.0, beam)
    if fit[WEIGHT, -1] == 0.0 or not near:
        return
    copy_fit(fit, trial)
    left = 1.0 - fit[WEIGHT, -1]
    trial[WEIGHT, -1] = 0.0
    for i in range(k):
        trial[WEIGHT, i] /= left
    trial[OWN, BACKGROUND] /= left
    full = value_of(data, k, fit, law, beam, scratch)
    if full - settle(data, k, trial, law, beam, scratch) < rules.no_return_gain:
        copy_fit(trial, fit)


@borrowing
def _remove_spare(
    data: Samples, k: int, work: LearntWorkspace, law: Law, beam: Beam, thresholds: GainThresholds, rules: LearntRules
) -> int:
    """Remove surfaces from work.fit while one of several gains less than its threshold; return how many are left.

    Fills row GAIN: the gain of each surface, nat; infinite where it is certain.
    """
    fit, _, best, scratch, _ = work
    n = float(len(data.value))
    while k > 1:
        full = value_of(data, k, fit, law, beam, scratch)
        least, weakest = math.inf, -1
        for i in range(k):
            fit[GAIN, i] = math.inf
        for i in range(k):
            mix(data, k, fit, law, beam, scratch)
            if surely_needed(data, k, i, fit, beam, scratch):
                continue
            fit[GAIN, i] = gain_of_surface(data, k, i, full, work, law, beam)
            if fit[GAIN, i] < least:
                least, weakest = fit[GAIN, i], i
                copy_fit(work.trial, best)
        if weakest < 0 or least >= _wanted_gain(n, k - 1, best, work, thresholds, rules):
            break
        k -= 1
        copy_fit(best, fit)
    return k


@jit
def count_surfaces(
    data: Samples,
    work: LearntWorkspace,
    laws: tuple[Law, Law],
    beam: Beam,
    thresholds: GainThresholds,
    rules: LearntRules,
) -> tuple[int, Law]:
    """Count the surfaces of a pixel; return how many there are, with their fit in work.fit, and the law of the pixel.

    The fit is as exact as counting needs it; its row GAIN holds the gain of each surface, nat, infinite where it is
    certain. Of the two laws the second has no drift: it is the pixel's where a jump gains as much as a further surface
    must. `fill_times` has been called.
    """
    fit, best, scratch = work.fit, work.best, work.scratch
    law = laws[0]
    n = float(len(data.value))
    start_without_surface(data.value, fit, beam)
    gain, empty = first_surface(data, work, law, beam)
    if gain_of_jump(data, best, law, beam, scratch) > _wanted_gain(n, 1, best, work, thresholds, rules):
        law = laws[1]
        start_without_surface(data.value, fit, beam)
        gain, empty = first_surface(data, work, law, beam)
    wanted = _wanted_gain(n, 0, fit, work, thresholds, rules)
    copy_fit(best, fit)
    k = 1
    if gain < wanted:
        # Where background is rare, one surface may gain nothing, as other samples stay unexplained, and two may gain.
        more = _wanted_gain(n, 1, fit, work, thresholds, rules)
        pair = -math.inf
        if fit[SUPPORT, 0] >= MIN_SUPPORT:
            pair = gain + try_one_more(data, 1, work, law, beam, more)
        if pair < wanted + more:
            start_without_surface(data.value, fit, beam)
            settle(data, 0, fit, law, beam, scratch)
            return 0, law
        copy_fit(best, fit)
        if rules.max_layers == 1:
            # The weaker of the two is removed; the stronger one counts by the gain of both.
            remove_surface(2, 0 if fit[WEIGHT, 0] < fit[WEIGHT, 1] else 1, fit)
            settle(data, 1, fit, law, beam, scratch)
            fit[GAIN, 0] = pair - more
            return 1, law
        k = 2
    while k < rules.max_layers:
        wanted = _wanted_gain(n, k, fit, work, thresholds, rules)
        gain = try_one_more(data, k, work, law, beam, wanted)
        if gain < wanted:
            break
        k += 1
        copy_fit(best, fit)
    _remove_no_return(data, k, work, law, beam, rules)
    k = _remove_spare(data, k, work, law, beam, thresholds, rules)
    if k == 1:
        fit[GAIN, 0] = value_of(data, 1, fit, law, beam, scratch) - empty
    return k, law
