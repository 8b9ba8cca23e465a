"""EM for a mixture of surfaces with one learnt shape, on a background whose share is the pixel's own.

The likelihood of sample j, y_j being its range less the pixel's drift, is

    p(y) = sum_i w_i f((y - mu_i) / (u sigma_i)) / (u sigma_i) + w_0 N(y; r_max, sigma_0) + b g(r)

with the learnt shape f, the pixel's width u, c_0's share w_0 and the background's share b and density g: 1 / L over a
working range of length L, or the learnt one. Shares are updated as in any
EM; means, log u and the drift by Fisher's scoring on the samples' responsibilities, which for a Gaussian is EM itself.
On a step, means and log u are scored with the information that stored samples have, which may be far less.
Priors of u, b and the drift are part of the objective (`objective`). `acceleration` takes the steps.

References
----------
McLachlan and Krishnan, The EM Algorithm and Extensions, 2nd edition, 2008, sections 1.5 and 4.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import log_of, product_of, total_of
from tofmix.estimation.beam import Beam, is_uniform, sigma_at
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    CELL,
    DENSITY,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    NEW,
    OWN,
    PLACE,
    RANDOM,
    SHARE,
    SIGMA,
    SUPPORT,
    TERM,
    TIME,
    TOTAL,
    WEIGHT,
    Samples,
    no_return_row,
    slope_row,
    still_row,
)
from tofmix.estimation.learnt.law import (
    REACH,
    STEPS,
    Law,
    fill_edges,
    has_steps,
    lend_cells,
    log_prior_t,
    precision_of_t,
)
from tofmix.estimation.mixture.em import gaussians
from tofmix.estimation.noise.isolated_clusters import LONGEST_STEP
from tofmix.noise_shape import DRIFTS, MOST_LOG_WIDTH, SIGMA_OF_STEP

_LEAST_BACKGROUND = 1.0e-12
"""Least share of background, and of the rest, before its logarithm is taken."""


@borrowing
def drifts(law: Law) -> int:
    """Number of polynomials of a drift: up to the last one whose scale is above 0."""
    count = 0
    for d in range(DRIFTS):
        if law.drift_mm[d] > 0.0:
            count = d + 1
    return count


@borrowing
def detrend(data: Samples, i: int, fit: FloatArray, scratch: FloatArray) -> None:
    """Fill the row of surface `i` from `still_row` on with the samples less its drift, mm."""
    n, y = len(data.value), scratch[still_row(fit) + i]
    for j in range(n):
        y[j] = data.value[j]
    for d in range(DRIFTS):
        coefficient = fit[DRIFT + d, i]
        if coefficient != 0.0:
            basis = scratch[TIME + d]
            for j in range(n):
                y[j] -= coefficient * basis[j]


@borrowing
def lend(y: FloatArray, n: int, mean: float, width: float, law: Law, density: FloatArray, slope: FloatArray) -> None:
    """Fill `density` with f(z) / width, 1/mm, and `slope` with -f'(z) / width, at the first `n` of y."""
    scale = 1.0 / width
    last = float(len(law.density) - 1)
    for j in range(n):
        t = ((y[j] - mean) * scale + REACH) * STEPS
        if 0.0 <= t < last:
            at = int(t)
            part = t - at
            density[j] = scale * (law.density[at] + part * (law.density[at + 1] - law.density[at]))
            slope[j] = scale * (law.slope[at] + part * (law.slope[at + 1] - law.slope[at]))
        else:
            density[j], slope[j] = 0.0, 0.0


@borrowing
def mix(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> None:
    """Fill the scratch with p(r_j), and with the densities and slopes of the surfaces and of c_0."""
    n, moving = len(data.value), drifts(law) > 0
    total = scratch[TOTAL]
    background, random = fit[OWN, BACKGROUND], scratch[RANDOM]
    for j in range(n):
        total[j] = background * random[j] + 1.0e-30
    if fit[WEIGHT, -1] > 0.0:
        row, weight = scratch[no_return_row(fit), :n], fit[WEIGHT, -1]
        gaussians(data.value, beam.range_max, beam.sigma_max, row)
        for j in range(n):
            total[j] += weight * row[j]
    width = math.exp(fit[OWN, LOG_WIDTH])
    for i in range(k):
        density, weight = scratch[DENSITY + i], fit[WEIGHT, i]
        if moving:
            detrend(data, i, fit, scratch)
        y = scratch[still_row(fit) + i, :n] if moving else data.value
        if has_steps(beam):
            slope = scratch[slope_row(fit) + i]
            lend_cells(y, scratch[CELL], n, fit[MEAN, i], width * fit[SIGMA, i], law, density, slope)
        else:
            lend(y, n, fit[MEAN, i], width * fit[SIGMA, i], law, density, scratch[slope_row(fit) + i])
        for j in range(n):
            total[j] += weight * density[j]


@borrowing
def background_density(beam: Beam) -> float:
    """Density of random values that are uniform over the working range, 1/mm."""
    return 1.0 / (beam.range_top - beam.range_min)


@borrowing
def objective(data: Samples, k: int, fit: FloatArray, law: Law, scratch: FloatArray) -> float:
    """Log likelihood plus log priors, nat; without surfaces, the log likelihood. `mix` has been called."""
    total, term = scratch[TOTAL], scratch[TERM, : len(data.value)]
    for j in range(len(term)):
        term[j] = log_of(total[j])
    value = float(total_of(term))
    if k == 0:
        return value  # the priors hold for pixels with a surface
    return value + log_priors(k, fit, law)


@borrowing
def log_priors(k: int, fit: FloatArray, law: Law) -> float:
    """Logarithm of the priors of width, drifts and share of background, nat, each 0 at its peak.

    So a pixel that agrees with the priors pays nothing for its first surface, as background alone has no prior.
    """
    value = log_prior_t(fit[OWN, LOG_WIDTH], law.width_spread)
    for d in range(DRIFTS):
        if law.drift_mm[d] > 0.0:
            for i in range(k):
                value += log_prior_t(fit[DRIFT + d, i], law.drift_mm[d])
    near, far = law.background_near, law.background_far
    b = min(max(fit[OWN, BACKGROUND], _LEAST_BACKGROUND), 1.0 - _LEAST_BACKGROUND)
    peak = min(max(near / max(near + far, _LEAST_BACKGROUND), _LEAST_BACKGROUND), 1.0 - _LEAST_BACKGROUND)
    return value + near * math.log(b / peak) + far * math.log((1.0 - b) / (1.0 - peak))


@borrowing
def em_step(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> None:
    """Do one iteration of EM; the scratch then holds densities of the fit before it."""
    mix(data, k, fit, law, beam, scratch)
    step_up(data, k, fit, law, beam, scratch)


@borrowing
def step_up(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> None:
    """Do the second half of an iteration, after `mix`: new means, width, drifts and shares."""
    n, moving = len(data.value), drifts(law) > 0
    total, share = scratch[TOTAL], scratch[SHARE]
    for j in range(n):
        share[j] = 1.0 / total[j]
    sum_share = total_of(share[:n])
    width, slopes, own = math.exp(fit[OWN, LOG_WIDTH]), slope_row(fit), law.width_spread > 0.0
    held, wide, told = 0.0, 0.0, 0.0  # support, and score of log width and its information on steps
    for i in range(k):
        slope, own_width = scratch[slopes + i, :n], width * fit[SIGMA, i]
        support = fit[WEIGHT, i] * product_of(share[:n], scratch[DENSITY + i])
        fit[SUPPORT, i] = support
        held += support
        push = fit[WEIGHT, i] * product_of(share[:n], slope)
        fit[PLACE, i] = push / (law.information * support) if support > 0.0 else 0.0
        if has_steps(beam) and support > 0.0:
            most = law.information * support
            fit[PLACE, i] = push / _seen_information(n, i, slope, most, 1.0, own_width, fit, scratch)
        if own:
            y = scratch[still_row(fit) + i, :n] if moving else data.value
            term = scratch[TERM, :n]
            for j in range(n):
                term[j] = (y[j] - fit[MEAN, i]) * slope[j]
            narrow = support
            if has_steps(beam):
                edge = scratch[NEW, :n]
                fill_edges(y, scratch[CELL], fit[MEAN, i], own_width, law, edge)
                narrow = fit[WEIGHT, i] * product_of(edge, share)
                for j in range(n):
                    edge[j] = term[j] / own_width - edge[j]
                most = law.width_information * support
                told += _seen_information(n, i, edge, most, 2.0, own_width, fit, scratch)
            wide += fit[WEIGHT, i] * product_of(term, share) / own_width - narrow
        if moving:
            _move_drift(n, i, push, fit, law, scratch, own_width)
    for i in range(k):
        step = min(max(fit[PLACE, i], -LONGEST_STEP), LONGEST_STEP)
        fit[MEAN, i] += step * width * fit[SIGMA, i]
        fit[SIGMA, i] = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
    if own and held > 0.0:
        v = fit[OWN, LOG_WIDTH]
        precision = precision_of_t(v, law.width_spread)
        if not has_steps(beam):
            told = law.width_information * held
        v += (wide - precision * v) / (told + precision)
        fit[OWN, LOG_WIDTH] = min(max(v, -MOST_LOG_WIDTH), MOST_LOG_WIDTH)
    _move_shares(n, k, fit, law, beam, scratch, sum_share, held)


@borrowing
def _seen_information(
    n: int, i: int, score: FloatArray, most: float, power: float, own_width: float, fit: FloatArray, scratch: FloatArray
) -> float:
    """Information that the squared scores of stored samples have, at most `most`, that of the law.

    `score` (n,) are derivatives of the density of surface `i`, in units of its width. A step above the width takes away
    most of what the law tells; rounding that is even leaves no less than the variance of both, to the `power`.
    """
    weight, share, density, half = fit[WEIGHT, i], scratch[SHARE], scratch[DENSITY + i], scratch[CELL]
    squares, widest = 0.0, 0.0
    for j in range(n):
        widest = max(widest, half[j])
        if density[j] > 0.0:
            squares += weight * share[j] * score[j] * score[j] / density[j]
    rounding = 2.0 * SIGMA_OF_STEP * widest / own_width
    return float(min(max(squares, most / (1.0 + rounding * rounding) ** power), most))


@borrowing
def _move_shares(
    n: int,
    k: int,
    fit: FloatArray,
    law: Law,
    beam: Beam,
    scratch: FloatArray,
    sum_share: float,
    held: float,
) -> None:
    """Update the shares of surfaces, c_0 and background.

    `sum_share` is the sum of 1 / p(r_j), and `held` the sum of the surfaces' supports.
    """
    no_return = 0.0
    if fit[WEIGHT, -1] > 0.0:
        row, share = scratch[no_return_row(fit)], scratch[SHARE]
        for j in range(n):
            no_return += share[j] * row[j]
        no_return *= fit[WEIGHT, -1]
    held += no_return
    random = fit[OWN, BACKGROUND] * background_density(beam) * sum_share
    if not is_uniform(beam):
        random = fit[OWN, BACKGROUND] * product_of(scratch[SHARE, :n], scratch[RANDOM])
    background = 1.0 if held <= 0.0 else random / n
    if k > 0 and held > 0.0:
        background = (random + law.background_near) / (n + law.background_near + law.background_far)
    scale = (1.0 - background) / held if held > 0.0 else 0.0
    for i in range(k):
        fit[WEIGHT, i] = scale * fit[SUPPORT, i]
    fit[WEIGHT, -1], fit[SUPPORT, -1] = scale * no_return, no_return
    fit[OWN, BACKGROUND] = background


@borrowing
def _move_drift(n: int, i: int, push: float, fit: FloatArray, law: Law, scratch: FloatArray, own_width: float) -> None:  # noqa: PLR0915  sums of one pass
    """Update the drift of a surface, together with its mean, by one step of scoring.

    `push` is the score of the mean, in units of the width.
    """
    support = fit[SUPPORT, i]
    if support <= 0.0:
        return
    weight, share = fit[WEIGHT, i], scratch[SHARE]
    density, slope = scratch[DENSITY + i], scratch[slope_row(fit) + i]
    b0, b1, b2 = scratch[TIME], scratch[TIME + 1], scratch[TIME + 2]
    m00, m01, m02, m11, m12, m22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c0, c1, c2, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        part = share[j] * density[j]
        rise = share[j] * slope[j]
        w0, w1, w2 = part * b0[j], part * b1[j], part * b2[j]
        c0 += w0
        c1 += w1
        c2 += w2
        m00 += w0 * b0[j]
        m01 += w0 * b1[j]
        m02 += w0 * b2[j]
        m11 += w1 * b1[j]
        m12 += w1 * b2[j]
        m22 += w2 * b2[j]
        g0 += rise * b0[j]
        g1 += rise * b1[j]
        g2 += rise * b2[j]
    # In units of the surface's width; the part of a polynomial along the constant is left to the mean.
    info, inverse = law.information * weight, 1.0 / support
    a00 = info * (m00 - weight * c0 * c0 * inverse)
    a01 = info * (m01 - weight * c0 * c1 * inverse)
    a02 = info * (m02 - weight * c0 * c2 * inverse)
    a11 = info * (m11 - weight * c1 * c1 * inverse)
    a12 = info * (m12 - weight * c1 * c2 * inverse)
    a22 = info * (m22 - weight * c2 * c2 * inverse)
    g0 = weight * g0 - push * weight * c0 * inverse
    g1 = weight * g1 - push * weight * c1 * inverse
    g2 = weight * g2 - push * weight * c2 * inverse
    g0, a00 = _with_prior(g0, a00, fit[DRIFT, i], law.drift_mm[0], own_width)
    g1, a11 = _with_prior(g1, a11, fit[DRIFT + 1, i], law.drift_mm[1], own_width)
    g2, a22 = _with_prior(g2, a22, fit[DRIFT + 2, i], law.drift_mm[2], own_width)
    # Cholesky factor of the 3 x 3 matrix; a polynomial without a scale has an infinite precision.
    l00 = math.sqrt(a00)
    l10, l20 = a01 / l00, a02 / l00
    l11 = math.sqrt(max(a11 - l10 * l10, 1.0e-12 * a11))
    l21 = (a12 - l10 * l20) / l11
    l22 = math.sqrt(max(a22 - l20 * l20 - l21 * l21, 1.0e-12 * a22))
    y0 = g0 / l00
    y1 = (g1 - l10 * y0) / l11
    y2 = (g2 - l20 * y0 - l21 * y1) / l22
    s2 = y2 / l22
    s1 = (y1 - l21 * s2) / l11
    s0 = (y0 - l10 * s1 - l20 * s2) / l00
    fit[DRIFT, i] += s0 * own_width
    fit[DRIFT + 1, i] += s1 * own_width
    fit[DRIFT + 2, i] += s2 * own_width
    # The mean moves by its own score less the part of it that the drift now explains.
    fit[PLACE, i] -= (s0 * c0 + s1 * c1 + s2 * c2) * weight * inverse


@borrowing
def _with_prior(slope: float, information: float, value: float, scale: float, own_width: float) -> tuple[float, float]:
    """Add the prior's slope and information, in units of the width; without a scale, no step follows."""
    if scale <= 0.0:
        infinite = 1.0e30  # information of a number that is held fixed
        return 0.0, infinite
    precision = precision_of_t(value, scale) * own_width * own_width
    return slope - precision * value / own_width, information + precision
