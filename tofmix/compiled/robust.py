"""From a median absolute deviation to a standard deviation."""

from statistics import NormalDist

MAD_TO_SIGMA = round(1.0 / NormalDist().inv_cdf(0.75), 4)
"""Sigma of Gaussian samples by their median absolute deviation, 1 / Phi^-1(3/4), to four decimals.

References
----------
Rousseeuw and Croux, Journal of the American Statistical Association 88, 1993, doi:10.1080/01621459.1993.10476408.
"""
