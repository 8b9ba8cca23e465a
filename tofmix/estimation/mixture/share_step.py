"""One step of Newton's search for the share of a new surface, all else held.

The log likelihood is concave in the share. The step is kept between half of the share and
half of the way to `LARGEST_SHARE`, so that no step leaves (0, 1).

Four kernels have a loop around this step: `gradient` (for the bound of a place, and for the place of a trial),
`gain_bound`, and `gain_bound` of `tofmix.estimation.learnt`. One loop for all would need the ratio of the new density
to p(r_j) in a row, which costs the first a division and a row more for each place. And each forms slope and bend by
other operations: with or without samples outside, from ratios or differences, with or without counts. One loop would
change the last bits of shares and gains, and with them which trials are made.
"""

from tofmix.compiled.jit import borrowing

LARGEST_SHARE = 0.9
"""A new surface is given at most this share: the rest stays with the surfaces that are there."""

LEAST_BEND = 1.0e-12
"""Least negative second derivative, nat: a surface that changes no sample's density has none."""


@borrowing
def next_share(share: float, slope: float, bend: float) -> float:
    """Share after one step, from the likelihood's slope and negative second derivative at `share`, in nat."""
    return min(max(share + slope / bend, 0.5 * share), 0.5 * (share + LARGEST_SHARE))
