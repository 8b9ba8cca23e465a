"""Where one more surface would help a mixture, and by how much at most.

D(theta) = sum_j p(r_j | surface at theta) / p(r_j) - N is the slope of the log
likelihood as share moves to a surface at theta. No mixture of the same kind, with
however many surfaces, gains more than max D: where that is below what a surface
must gain, none needs to be tried. Its place is also where to try one.

References
----------
Lindsay, The geometry of mixture likelihoods, Annals of Statistics 11(1), 1983, doi:10.1214/aos/1176346059.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam, is_no_return
from tofmix.estimation.density import sigma_at, within_reach
from tofmix.estimation.mixture import Components, gaussian, sample_densities
from tofmix.jit import jit

_STEP = 0.25
"""Step of the search in sigmas."""

_REACH = 5.0
"""A surface lends samples farther away than this, in sigmas, less than 4e-6 of its peak."""

_NEWTON_STEPS = 6
_LARGEST_SHARE = 0.9


@jit
def steepest_place(
    samples: FloatArray, k: int, fit: Components, beam: Beam, densities: FloatArray
) -> tuple[float, float]:
    """Largest D(theta), nat, and its place, mm. `densities` is room for p(r_j); it is filled."""
    n = len(samples)
    outliers = 0.0
    for j in range(n):
        densities[j] = sample_densities(samples[j], k, fit, beam)[0]
        outliers += beam.outlier_density / densities[j]
    most, place = -float(n), samples[0]
    first, stop = 0, 0
    theta = samples[0] - sigma_at(samples[0], beam.curve_range, beam.curve_sigma)
    end = samples[n - 1] + sigma_at(samples[n - 1], beam.curve_range, beam.curve_sigma)
    if math.isinf(beam.no_return_to):
        end = min(end, beam.no_return_from)
    while theta <= end:
        sigma = sigma_at(theta, beam.curve_range, beam.curve_sigma)
        first, stop = within_reach(samples, first, stop, theta - _REACH * sigma, theta + _REACH * sigma)
        next_theta = theta + _STEP * sigma
        total = 0.0
        for j in range(first, stop):
            total += gaussian(samples[j], theta, sigma) / densities[j]
        if first == stop and first < n:
            next_theta = max(next_theta, samples[first] - sigma)  # nothing near: go to the next sample
        slope = (1.0 - beam.p_outlier) * total + outliers - n
        if slope > most and not is_no_return(theta, beam):
            most, place = slope, theta
        theta = next_theta
    return most, place


@jit
def best_share(samples: FloatArray, place: float, beam: Beam, densities: FloatArray) -> float:
    """Share of a new surface at `place` that raises the likelihood most, all else scaled down; by Newton's steps."""
    sigma = sigma_at(place, beam.curve_range, beam.curve_sigma)
    share = 1.0 / len(samples)
    for _ in range(_NEWTON_STEPS):
        slope, bend = 0.0, 1.0e-12
        for j in range(len(samples)):
            new = gaussian(samples[j], place, sigma) + beam.outlier_density
            ratio = (new - densities[j]) / ((1.0 - share) * densities[j] + share * new)
            slope += ratio
            bend += ratio * ratio
        share = min(max(share + slope / bend, 0.5 * share), 0.5 * (share + _LARGEST_SHARE))
    return share
