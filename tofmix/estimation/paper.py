"""The algorithm of the paper, as it is printed: `tofmix estimate --paper`.

Use it to compare: with the paper's numbers, or with the default of `tofmix.estimation.layering`. It has none of that
module's rules. Step 1 evaluates the kernel density (4) at the points of a uniform grid and keeps the points that
pass test (5). Step 2 runs expectation-maximisation on (1) for 50 iterations, with every sigma free.

The paper leaves some things open. They are settled here as follows:

- gamma of (5) has no stated value and no stated unit. It is taken as a share: p(r) must exceed gamma times the peak
  that the density has, on average, at a surface of share 1.
- epsilon of (5) "depends on the grid spacing". It is half a spacing times |d2p/dr2|, the least that lets no maximum
  fall between two points. With differences of neighbouring points for the derivatives, a point passes exactly if it is
  higher than both of its neighbours.
- The spacing is an eighth of the curve's least sigma.
- The shares start equal. After each iteration they are scaled so that all, with p(c_r), sum to 1.
- A peak within 2 sigma of r_max is c_0's.

Standard errors and probabilities of layers are not in the paper. They are those of `uncertainty` and `counting` for the
mixture that was fitted.

References
----------
Pathak, Birk and Poppinga, IROS 2008, equations (1), (4) and (5), and section V.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, beam_of, is_no_return, sigma_at, uniform_background
from tofmix.estimation.mixture.counting import chance_of, gain_table, new_workspace, surface_gains
from tofmix.estimation.mixture.em import GAIN, MEAN, ROOT_TWO_PI, SIGMA, SUPPORT, WEIGHT, log_likelihood, sort_surfaces
from tofmix.estimation.mixture.uncertainty import standard_errors
from tofmix.estimation.peaks.counters import MAX_PEAKS
from tofmix.estimation.peaks.modes import BANDWIDTH, keep_peak
from tofmix.estimation.samples import SortedSamples, gather, padded, within_reach
from tofmix.estimation.settings import MODE_FREE
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.sensor import Sensor

_TOO_FEW_SAMPLES = int(Status.TOO_FEW_SAMPLES)
_NO_SURFACE = int(Status.NO_SURFACE)
_DEGENERATE = int(Status.DEGENERATE)
_OK = int(Status.OK)


@borrowing
def _grid_modes(
    values: FloatArray, beam: Beam, gamma: float, spacing: float, place: FloatArray, height: FloatArray
) -> int:
    """Fill `place` (mm) and `height` (share) with the modes by test (5), ascending; return how many."""
    n, origin = len(values), values[0]
    peak_of_share = 1.0 / math.sqrt(1.0 + 1.0 / BANDWIDTH**2)
    count, first, stop = 0, 0, 0
    p, before, middle, middle_share = 0.0, 0.0, 0.0, 0.0
    kernel_reach = 6.0  # a sample farther than this many h adds less than 2e-8 of a kernel's height, and is left out
    margin = kernel_reach * BANDWIDTH * sigma_at(origin, beam.curve_range, beam.curve_sigma)
    g = -math.ceil(margin / spacing)
    while True:
        r = origin + g * spacing
        h = BANDWIDTH * sigma_at(r, beam.curve_range, beam.curve_sigma)
        first, stop = within_reach(values, first, stop, r - kernel_reach * h, r + kernel_reach * h)
        total = 0.0
        for j in range(first, stop):
            z = (r - values[j]) / h
            total += math.exp(-0.5 * z * z)
        p = total / h  # eq. (4) times N sqrt(2 pi)
        if middle_share > gamma and before < middle >= p:  # test (5)
            count = keep_peak(place, height, count, r - spacing, middle_share)
        before, middle, middle_share = middle, p, total / (n * peak_of_share)
        g += 1
        if first == stop:  # no sample within reach: p is 0 up to the next one
            if first == n:
                return count
            near = BANDWIDTH * sigma_at(values[first], beam.curve_range, beam.curve_sigma)
            g = max(g, math.ceil((values[first] - kernel_reach * near - origin) / spacing))


@borrowing
def _without_lowest(k: int, place: FloatArray, height: FloatArray) -> int:
    """Take out the lowest mode; return k - 1."""
    lowest = int(np.argmin(height[:k]))
    for i in range(lowest, k - 1):
        place[i], height[i] = place[i + 1], height[i + 1]
    return k - 1


@borrowing
def _start(k: int, place: FloatArray, fit: FloatArray, beam: Beam) -> bool:
    """Start EM at the modes, with the curve's sigmas and equal shares; return whether there is a c_0."""
    with_no_return = not math.isinf(beam.range_max)
    share = (1.0 - beam.p_outlier) / (k + (1 if with_no_return else 0))
    for i in range(k):
        fit[MEAN, i], fit[WEIGHT, i] = place[i], share
        fit[SIGMA, i] = sigma_at(place[i], beam.curve_range, beam.curve_sigma)
    fit[MEAN, -1], fit[SIGMA, -1] = beam.range_max, beam.sigma_max
    fit[WEIGHT, -1] = share if with_no_return else 0.0
    return with_no_return


@borrowing
def _iterate(values: FloatArray, n: int, k: int, fit: FloatArray, beam: Beam, sums: FloatArray) -> bool:
    """One iteration of section V; return whether every sigma is still one.

    `sums` (k + 1, 3) is scratch: each event's sums of p(c_i | r_j), of that times r_j - mu_i, and times its square.
    """
    capacity = len(fit[MEAN]) - 1
    sums[:] = 0.0
    for j in range(n):
        total = beam.outlier_density  # p(c_r) / r_max
        for e in range(k + 1):
            i = e if e < k else capacity
            if fit[WEIGHT, i] > 0.0:
                z = (values[j] - fit[MEAN, i]) / fit[SIGMA, i]
                total += fit[WEIGHT, i] / (fit[SIGMA, i] * ROOT_TWO_PI) * math.exp(-0.5 * z * z)
        for e in range(k + 1):
            i = e if e < k else capacity
            if fit[WEIGHT, i] > 0.0:
                away = values[j] - fit[MEAN, i]
                z = away / fit[SIGMA, i]
                share = fit[WEIGHT, i] / (fit[SIGMA, i] * ROOT_TWO_PI) * math.exp(-0.5 * z * z) / total  # p(c_i | r_j)
                sums[e, 0] += share
                sums[e, 1] += share * away
                sums[e, 2] += share * away * away
    known, whole = True, 0.0
    for e in range(k + 1):
        whole += sums[e, 0]
    # A sigma below this part of the curve's has collapsed onto equal samples, where (1) has no maximum.
    least_sigma = 1.0e-6
    for e in range(k + 1):
        i = e if e < k else capacity
        support = sums[e, 0]
        fit[SUPPORT, i] = support
        fit[WEIGHT, i] = (1.0 - beam.p_outlier) * support / whole if whole > 0.0 else 0.0
        if support <= 0.0:
            continue
        shift = sums[e, 1] / support if e < k else 0.0  # mu_0 is held at r_max
        variance = sums[e, 2] / support - shift * shift  # about the new mean
        least = least_sigma * sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        fit[MEAN, i] += shift
        if variance > least * least:
            fit[SIGMA, i] = math.sqrt(variance)
        else:
            known = False  # on equal samples sigma goes to 0, and the likelihood has no bound
    return known


@jit
def _with_sigma_0(beam: Beam, sigma_0: float) -> Beam:
    """The same beam with another spread of c_0, mm."""
    return Beam(
        beam.curve_range,
        beam.curve_sigma,
        beam.range_max,
        sigma_0,
        beam.no_return_from,
        beam.no_return_to,
        beam.surface_end,
        beam.p_outlier,
        beam.outlier_density,
        beam.range_min,
        beam.range_top,
        beam.pixel_curves,
        beam.steps,
        beam.background,
    )


@jit
def _paper_block(
    block: SortedSamples,
    out: tuple[NDArray[Any], ...],
    beam: Beam,
    gamma: float,
    spacing: float,
    max_layers: int,
    min_samples: int,
    table: FloatArray,
) -> None:
    """Fill `out`, the arrays of `Layers` in their order, for the pixels of a block."""
    (
        n_modes,
        n_peaks,
        mean,
        sigma,
        weight,
        range_stderr,
        weight_stderr,
        probability,
        no_return,
        outlier,
        likelihood,
        n_samples,
        n_iter,
        status,
    ) = out
    columns = padded(block.values.shape[1])
    value, times = np.empty(columns), np.empty(columns)
    place, height = np.empty(MAX_PEAKS), np.empty(MAX_PEAKS)
    range_errors, weight_errors = np.zeros(MAX_PEAKS), np.zeros(MAX_PEAKS)
    work, sums = new_workspace(MAX_PEAKS, columns), np.zeros((MAX_PEAKS + 1, 3))
    fit = work.fit
    iterations = 50  # EM iterations (paper, section V)
    for pixel in range(len(block.valid)):
        n = block.valid[pixel]
        n_samples[pixel] = n
        if n < min_samples:
            status[pixel] = _TOO_FEW_SAMPLES
            continue
        values = block.values[pixel]
        found = _grid_modes(values[:n], beam, gamma, spacing, place, height)
        k = 0
        for i in range(found):
            if not is_no_return(place[i], beam):
                place[k], height[k] = place[i], height[i]
                k += 1
        n_peaks[pixel] = k
        while k > max_layers:
            k = _without_lowest(k, place, height)
        fit[:] = 0.0
        with_no_return, known = _start(k, place, fit, beam), True
        if k == 0:
            fit[SIGMA, -1], fit[WEIGHT, -1] = beam.sigma_max, 1.0 - beam.p_outlier if with_no_return else 0.0
        else:
            for _ in range(iterations):
                known = _iterate(values, n, k, fit, beam, sums[: k + 1]) and known
            n_iter[pixel] = iterations
        sort_surfaces(k, fit, GAIN + 1)
        data = gather(values, n, beam.curve_range, beam.curve_sigma, value, times)
        fitted = _with_sigma_0(beam, fit[SIGMA, -1])
        likelihood[pixel] = log_likelihood(data, k, fit, fitted, work.scratch)
        surface_gains(data, k, work, fitted)
        known = standard_errors(data, k, fit, fitted, MODE_FREE, work.scratch, range_errors, weight_errors) and known
        n_modes[pixel] = k
        for i in range(k):
            mean[pixel, i], sigma[pixel, i], weight[pixel, i] = fit[MEAN, i], fit[SIGMA, i], fit[WEIGHT, i]
            range_stderr[pixel, i], weight_stderr[pixel, i] = range_errors[i], weight_errors[i]
            probability[pixel, i] = 1.0 - chance_of(fit[GAIN, i], table[n])
        no_return[pixel] = fit[WEIGHT, -1]
        outlier[pixel] = beam.p_outlier if k > 0 or with_no_return else 1.0
        status[pixel] = _NO_SURFACE if k == 0 else _OK if known else _DEGENERATE


def paper_pixels(samples: SortedSamples, sensor: Sensor, *, gamma: float, max_layers: int, min_samples: int) -> Layers:
    """Layers of each pixel of a block by the paper's algorithm.

    Parameters
    ----------
    samples : SortedSamples
        The samples.
    sensor : Sensor
        Noise curve, working range and p(c_r). Without `range_max_mm` there is no c_0.
    gamma : float
        gamma of test (5), as a share.
    max_layers : int
        Most modes that EM starts with; the lowest are left out.
    min_samples : int
        Fewest valid samples of a pixel that is fitted.

    Returns
    -------
    Layers
        Of the leading shape (pixel,).

    Raises
    ------
    ValueError
        If the sensor has no noise curve.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, equations (1), (4) and (5), and section V.
    """
    beam = beam_of(sensor)
    # The paper's uniform part is p(c_r) / r_max; a density over the working range is p(c_r) / (r_max - r_min).
    outlier_density = beam.outlier_density * (beam.range_top - beam.range_min) / beam.range_top
    beam = beam._replace(outlier_density=outlier_density, background=uniform_background())
    out = Layers.empty((len(samples.valid),), max_layers)
    # of the least sigma: a quarter of the narrowest kernel's h
    spacing = 0.125 * float(np.min(sensor.noise.sigma_mm)) if sensor.noise is not None else math.nan
    table = gain_table(samples.values.shape[1])
    _paper_block(samples, out.arrays(), beam, gamma, spacing, max_layers, min_samples, table)
    return out
