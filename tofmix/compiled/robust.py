"""From a median absolute deviation to a standard deviation."""

MAD_TO_SIGMA = 1.4826
"""Sigma of Gaussian samples by their median absolute deviation, 1 / Phi^-1(3/4), to five digits.

References
----------
Rousseeuw and Croux, Journal of the American Statistical Association 88, 1993, doi:10.1080/01621459.1993.10476408.
"""
