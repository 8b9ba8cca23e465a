"""The gain in likelihood that a surface must have: a table by number of samples and share of background.

`bootstrap` draws the table for the learnt noise of a recording. The likelihood ratio between mixtures of different
numbers of surfaces has no known distribution, so that no formula gives these gains.
"""

import math
from typing import NamedTuple

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


class GainThresholds(NamedTuple):
    """Gains, nat, that noise alone exceeds with each probability of `mixture.false_alarms.FALSE_ALARMS`.

    `log_n` (samples,) are logarithms of numbers of samples, ascending, and `background` (background,) shares of
    background, ascending. `more` (samples, background, probability) are the gains of a further surface, and `first`
    (samples, probability) those of the first surface over background alone.
    """

    log_n: FloatArray
    background: FloatArray
    more: FloatArray
    first: FloatArray


@borrowing
def _place_in(x: float, known: FloatArray) -> tuple[int, float]:
    """Find the interval of ascending `known` that holds x, and the place in it, 0 to 1; beyond the ends, the end."""
    last = len(known) - 1
    if last == 0 or x <= known[0]:
        return 0, 0.0
    if x >= known[last]:
        return last - 1, 1.0
    at = 0
    while known[at + 1] < x:
        at += 1
    return at, (x - known[at]) / (known[at + 1] - known[at])


@borrowing
def read_gains(n: float, background: float, first: bool, thresholds: GainThresholds, out: FloatArray) -> None:
    """Interpolate the gains for `n` samples and a share of background, nat, into `out` (probability,).

    `first` asks for the gains of the first surface. Linear in log n and in the share; beyond the table, its ends hold.
    """
    a, s = _place_in(math.log(n), thresholds.log_n)
    above = min(a + 1, len(thresholds.log_n) - 1)
    if first:
        for c in range(len(out)):
            out[c] = (1.0 - s) * thresholds.first[a, c] + s * thresholds.first[above, c]
        return
    b, t = _place_in(background, thresholds.background)
    right = min(b + 1, len(thresholds.background) - 1)
    for c in range(len(out)):
        low = (1.0 - t) * thresholds.more[a, b, c] + t * thresholds.more[a, right, c]
        high = (1.0 - t) * thresholds.more[above, b, c] + t * thresholds.more[above, right, c]
        out[c] = (1.0 - s) * low + s * high
