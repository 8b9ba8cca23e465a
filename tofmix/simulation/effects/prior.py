"""Prior densities of the numbers of effects: the magnitudes that real cameras and scenes have.

Each effect declares them in its own file, beside the sentence (`Effect.typical`) and the source (`Effect.basis`) of
these magnitudes. `simulate` ignores them. `reconcile` adds their log density to the log-likelihood of its fits, takes
the scale of linear coefficients from them, and names no effect with a number that lies beyond `FARTHEST` standard
deviations.

References
----------
Gelman, Carlin, Stern, Dunson, Vehtari and Rubin, Bayesian Data Analysis, 3rd ed. 2013, section 2.9: weakly informative
priors.
"""

import math
from dataclasses import dataclass

from scipy.special import log_ndtr, ndtri_exp, stdtr, stdtrit

FARTHEST = 3.0
"""Normal deviate of the largest magnitude that real cameras have: 1 of 370 draws of the prior lies beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StudentPrior:
    """Student's t density of a number or of its logarithm; a Gaussian for infinite degrees of freedom.

    Use few degrees of freedom for magnitudes that people set, such as the place of a board, and none for magnitudes
    that physics limits.

    Parameters
    ----------
    scale : float
        Scale, in the unit of the number, or of its natural logarithm.
    center : float
        Centre in the same unit.
    dof : float
        Degrees of freedom.
    log : bool
        Whether it is the density of the logarithm.
    half : bool
        Whether the number is never below the centre.
    """

    scale: float
    center: float = 0.0
    dof: float = math.inf
    log: bool = False
    half: bool = False

    def log_density(self, value: float) -> float:
        """Log density of a value, per unit of the number; minus infinity where it cannot be."""
        if self.log and value <= 0:
            return -math.inf
        away = self._away(value)
        if self.half and away < 0:
            return -math.inf
        jacobian = math.log(value) if self.log else 0.0
        return self._log_standard(away) - math.log(self.scale) - jacobian + (math.log(2) if self.half else 0.0)

    def deviate(self, value: float) -> float:
        """Normal deviate of a value: a Gaussian number is as rarely beyond it as the number is beyond the value."""
        if self.log and value <= 0:
            return math.inf
        away = abs(self._away(value))
        if math.isinf(self.dof):
            return away
        below = float(stdtr(self.dof, -away))
        return float(-ndtri_exp(math.log(below))) if below > 0 else math.inf

    @property
    def spread(self) -> float:
        """Standard deviation of the Gaussian that stands for it in linear fits, of the logarithm if `log`."""
        return self.scale

    @property
    def farthest(self) -> tuple[float, float]:
        """The smallest and the largest value that is not beyond `FARTHEST`."""
        reach = self.scale * self._quantile()
        low, high = self.center - (0.0 if self.half else reach), self.center + reach
        return (math.exp(low), math.exp(high)) if self.log else (low, high)

    def words(self, unit: str) -> str:
        """The density in words, with the interval of possible magnitudes."""
        family = "normal" if math.isinf(self.dof) else f"Student's t of {self.dof:g} degrees of freedom"
        of = "its logarithm is " if self.log else ""
        unit_word = "" if unit in ("", "1") else f" {unit}"
        middle = math.exp(self.center) if self.log else self.center
        center = "" if self.half and not self.center else f" about {'log ' if self.log else ''}{middle:.4g}"
        half = ", positive half" if self.half else ""
        low, high = self.farthest
        interval = f"{low:.3g} to {high:.3g}{unit_word}"
        return f"{of}{family}{center} with scale {self.scale:.3g}{'' if self.log else unit_word}{half} ({interval})"

    def _away(self, value: float) -> float:
        return ((math.log(value) if self.log else value) - self.center) / self.scale

    def _log_standard(self, x: float) -> float:
        if math.isinf(self.dof):
            return -0.5 * x * x - 0.5 * math.log(2 * math.pi)
        n = self.dof
        norm = math.lgamma((n + 1) / 2) - math.lgamma(n / 2) - 0.5 * math.log(n * math.pi)
        return norm - (n + 1) / 2 * math.log1p(x * x / n)

    def _quantile(self) -> float:
        """The value of `FARTHEST`, in scales."""
        if math.isinf(self.dof):
            return FARTHEST
        return float(-stdtrit(self.dof, math.exp(log_ndtr(-FARTHEST))))


@dataclass(frozen=True, slots=True, kw_only=True)
class UniformPrior:
    """A number, or its logarithm, that is anywhere between two limits.

    Parameters
    ----------
    low, high : float
        Limits, in the unit of the number.
    log : bool
        Whether the logarithm is uniform.
    """

    low: float
    high: float
    log: bool = False

    def log_density(self, value: float) -> float:
        """Log density of a value, per unit of the number; minus infinity outside the limits."""
        if not self.low <= value <= self.high:
            return -math.inf
        if self.log:
            return -math.log(math.log(self.high / self.low)) - math.log(value)
        return -math.log(self.high - self.low)

    def deviate(self, value: float) -> float:
        """0 within the limits, else infinite."""
        return 0.0 if self.low <= value <= self.high else math.inf

    @property
    def spread(self) -> float:
        """Standard deviation of the Gaussian that stands for it in linear fits: half of the largest magnitude."""
        return 0.5 * (math.log(self.high) if self.log else self.high)

    @property
    def farthest(self) -> tuple[float, float]:
        """The limits."""
        return self.low, self.high

    def words(self, unit: str) -> str:
        """The density in words."""
        unit_word = "" if unit in ("", "1") else f" {unit}"
        of = "its logarithm is " if self.log else ""
        return f"{of}uniform ({self.low:.3g} to {self.high:.3g}{unit_word})"


Prior = StudentPrior | UniformPrior
"""The density of a number of an effect before a recording is seen."""


def about(median: float, factor: float) -> StudentPrior:
    """Lognormal: two thirds of all magnitudes are within this factor of the median.

    Raises
    ------
    ValueError
        If the median is not positive or the factor is not above 1.
    """
    if median <= 0 or factor <= 1:
        raise ValueError(
            f"a lognormal prior needs a median above 0 and a factor above 1, not {median:g} and {factor:g}"
        )
    return StudentPrior(center=math.log(median), scale=math.log(factor), log=True)
