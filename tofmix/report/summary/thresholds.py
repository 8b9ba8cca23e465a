"""Thresholds of the warnings about a layers file."""

import math
from dataclasses import dataclass

from tofmix.bounds import Count, FactorThreshold, NotNegative, Share, Threshold, check_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """From where on a finding is made. They draw attention; they are no tests, and nothing is refused by them."""

    sigma_tolerance: Threshold = 0.10  # relative difference of the median sigma and the noise curve
    # Factor by which samples scatter more or less than the curve, at least 1. Two surfaces 3 sigma apart that samples
    # do not separate scatter sqrt(1 + 3^2 / 4) = 1.8 times as much.
    scatter_factor: FactorThreshold = 2.0
    # Share of the pixels with one unwelcome status, with every layer in use, with close layers, 0 to 1.
    status_share: Share = 0.05
    full_share: Share = 0.05
    close_share: Share = 0.05
    close_sigmas: NotNegative = 5.0  # distance of two layers of a pixel, in sigmas, below which they are close
    least_components: Count = 30  # fewest components for a statement about the curve
    # Components above this share, 0 to 1, test the noise curve; weak ones depend on the fit.
    dominant_weight: Share = 0.5
    # Iterations to advise where fits do not converge: four times the default of ``--max-iter``.
    more_iterations: Count = 200

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def drift_sigmas(self) -> float:
        """Drift over a window, sigmas: a steady change of D sigmas adds D^2 / 12 sigma^2 to a variance.

        Sigma then is larger by `sigma_tolerance`.
        """
        return math.sqrt(12.0 * ((1.0 + self.sigma_tolerance) ** 2 - 1.0))


DEFAULT_THRESHOLDS = Thresholds()
