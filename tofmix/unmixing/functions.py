"""Functions of statistics that unmixing needs, in NumPy.

SciPy has them all. But its modules take longer to import than a usual recording takes to estimate, and nothing else in
an estimate needs them. `tests/unmixing/test_planes.py` holds each against SciPy.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray, IntArray

_ERF = (  # Cephes' erf below 1: coefficients of numerator and denominator, largest power first
    (
        9.60497373987051638749e0,
        9.00260197203842689217e1,
        2.23200534594684319226e3,
        7.00332514112805075473e3,
        5.55923013010394962768e4,
    ),
    (
        1.0,
        3.35617141647503099647e1,
        5.21357949780152679795e2,
        4.59432382970980127987e3,
        2.26290000613890934246e4,
        4.92673942608635921086e4,
    ),
)
_ERFC = (  # its erfc below 8
    (
        2.46196981473530512524e-10,
        5.64189564831068821977e-1,
        7.46321056442269912687e0,
        4.86371970985681366614e1,
        1.96520832956077098242e2,
        5.26445194995477358631e2,
        9.34528527171957607540e2,
        1.02755188689515710272e3,
        5.57535335369399327526e2,
    ),
    (
        1.0,
        1.32281951154744992508e1,
        8.67072140885989742329e1,
        3.54937778887819891062e2,
        9.75708501743205489753e2,
        1.82390916687909736289e3,
        2.24633760818710981792e3,
        1.65666309194161350182e3,
        5.57535340817727675546e2,
    ),
)
_ERFC_FAR = (  # its erfc from there on
    (
        5.64189583547755073984e-1,
        1.27536670759978104416e0,
        5.01905042251180477414e0,
        6.16021097993053585195e0,
        7.40974269950448939160e0,
        2.97886665372100240670e0,
    ),
    (
        1.0,
        2.26052863220117276590e0,
        9.39603524938001434673e0,
        1.20489539808096656605e1,
        1.70814450747565897222e1,
        9.60896809063285878198e0,
        3.36907645100081516050e0,
    ),
)


def ndtr(values: FloatArray) -> FloatArray:
    """Probability that a standard Gaussian number is below each value; NaN for NaN.

    References
    ----------
    S. L. Moshier, Methods and Programs for Mathematical Functions, 1989 (Cephes), ndtr.c.
    """
    x = np.asarray(values, dtype=np.float64) * math.sqrt(0.5)
    far = np.abs(x)
    near = np.minimum(far, 1.0)
    square = near * near
    below_1 = 0.5 + 0.5 * np.copysign(near * np.polyval(_ERF[0], square) / np.polyval(_ERF[1], square), x)
    clipped = np.minimum(far, 30.0)  # erfc is 0 there
    ratio = np.where(
        clipped < 8.0,  # noqa: PLR2004  the bound of the coefficients
        np.polyval(_ERFC[0], np.minimum(clipped, 8.0)) / np.polyval(_ERFC[1], np.minimum(clipped, 8.0)),
        np.polyval(_ERFC_FAR[0], clipped) / np.polyval(_ERFC_FAR[1], clipped),
    )
    tail = 0.5 * np.exp(-clipped * clipped) * ratio
    return np.where(far < 1.0, below_1, np.where(x > 0, 1.0 - tail, tail))


def logsumexp(values: FloatArray) -> FloatArray:
    """Logarithm of the sum of exponentials along the first axis (m, ...); minus infinity where all terms are."""
    largest = values.max(axis=0)
    shift = np.where(np.isfinite(largest), largest, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.exp(values - shift).sum(axis=0)) + shift)


def chi_square_6(probability: float) -> float:
    """Value that a chi-square number of 6 degrees of freedom exceeds with a probability, above 0 and below 1.

    The probability of more than x is exp(-x / 2) (1 + x / 2 + x^2 / 8).
    """
    low, high = 0.0, 1.0
    while _exceeds(high) > probability:
        high *= 2.0
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        low, high = (middle, high) if _exceeds(middle) > probability else (low, middle)


def _exceeds(x: float) -> float:
    return math.exp(-0.5 * x) * (1.0 + 0.5 * x + 0.125 * x * x)


def binomial_most(probability: float, trials: IntArray, share: float) -> IntArray:
    """Least number of successes that so many trials exceed with at most 1 - `probability`.

    `share`, from 0 on and below 1, is the probability of a success.
    """
    numbers, place = np.unique(trials, return_inverse=True)
    least = np.zeros(len(numbers), dtype=np.int64)
    for i, n in enumerate(numbers.tolist()):
        k, log_chance = 0, n * math.log1p(-share)
        total = math.exp(log_chance)
        while total < probability and k < n:
            log_chance += math.log((n - k) / (k + 1) * share / (1.0 - share))
            k, total = k + 1, total + math.exp(log_chance)
        least[i] = k
    return least[place].reshape(np.shape(trials))
