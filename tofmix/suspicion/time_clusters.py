"""Chance that the samples of a layer come as close in time as they do.

Of n frames, m show the layer. If each set of m frames is as probable as any other, the chance that they lie within some
l frames is a number of sets; where a few of them lie outside, Bonferroni's inequality bounds it.
"""

import math

from tofmix.compiled.jit import borrowing


@borrowing
def log_choose(n: float, k: float) -> float:
    """Log of the binomial coefficient, for real numbers; minus infinity where k is not within 0 and n."""
    if k < 0.0 or k > n:
        return -math.inf
    return math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)


@borrowing
def log_chance(frames: float, samples: float, outside: float, length: float) -> float:
    """Log of (a bound of) the chance that all but `outside` of the samples lie within some `length` frames.

    Parameters
    ----------
    frames, samples : float
        n and m; numbers of independent ones where frames have a memory.
    outside : float
        Samples outside the interval.
    length : float
        Length of the interval, frames.

    Returns
    -------
    float
        At most 0. The bounds for 0, 1, 2, ... samples outside are weighted by 1/2, 1/4, 1/8, ...: over all of them the
        chance of a false alarm is no larger than that of one.
    """
    weight = (outside + 1.0) * math.log(2.0)
    whole = log_choose(frames, samples)
    if outside <= 0.0:
        # Sets within the first l frames, and those that end at a later one.
        first = log_choose(length, samples) - whole
        later = log_choose(length - 1.0, samples - 1.0) - whole
        chance = math.exp(first) + max(frames - length, 0.0) * math.exp(later)
        return min(0.0, weight + math.log(chance)) if chance > 0.0 else -700.0
    total, missing = 0.0, outside
    while missing >= 0.0:
        inside = log_choose(length, samples - missing) + log_choose(frames - length, missing) - whole
        total += math.exp(inside)
        missing -= 1.0
    total *= frames - length + 1.0
    return min(0.0, weight + math.log(total)) if total > 0.0 else -700.0
