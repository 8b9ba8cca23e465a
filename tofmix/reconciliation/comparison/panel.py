"""The panel: statistics of scores over axes, with known null distributions.

If the model is right, scores are standard normal. Their first four Hermite polynomials then have mean 0, variance 1 and
no correlation, so means over bins of any axis have known variances. `tofmix.reconciliation.comparison.compare` computes
the whole panel.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.error_shape import hermite, moves
from tofmix.reconciliation.likelihood.likelihood import ModelState, Part
from tofmix.reconciliation.likelihood.memory import memory_of, one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture

SHAPES = ("bias", "spread", "skew", "tails")

_ENOUGH = 200  # samples of a bin
_CLIPPED_MEAN, _CLIPPED_SPREAD = 0.97756, 1.29675  # mean and spread of min(x^2, 2.5^2), x a standard normal number
_TOLD = 0.5  # least part of the variance of a pixel's log width that its samples determine


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """A statistic against an axis: arrays (bin,).

    Parameters
    ----------
    statistic, axis : str
        Names of statistic and axis, as in `gap.json`.
    lower, upper : (bin,) float64
        Limits of the bins, in `unit`.
    value : (bin,) float64
        Mean of the statistic; 0 if the model is right.
    variance : (bin,) float64
        Variance of the value if the model is right.
    unit : str
        Unit of the axis.
    scale_mm : (bin,) float64
        Shift of the bin's samples with a return that raises their mean by 1, mm; 0 without returns.
    information : float, optional
        Information beyond curves of lower order, nats (`tofmix.reconciliation.comparison.compare`); None if not
        computed.
    recording : int
        Number of its recording, from 0.
    """

    statistic: str
    axis: str
    lower: FloatArray
    upper: FloatArray
    value: FloatArray
    variance: FloatArray
    unit: str
    scale_mm: FloatArray
    information: float | None = None
    recording: int = 0

    @property
    def name(self) -> tuple[str, str, int]:
        """Statistic, axis and recording, which identify it in its panel."""
        return self.statistic, self.axis, self.recording

    @property
    def of_lines(self) -> bool:
        """Whether it tells how samples of a row or column vary together beside their frame: noise of a camera's lines.

        An effect that moves all samples of a frame or of a surface is not the cause.
        """
        return self.statistic == "common_mode" and self.axis in ("row", "col")

    @property
    def varying(self) -> "Curve":
        """The curve without bins whose value could not differ if the model is right: their scores are all equal."""
        some = self.variance > 0
        if some.all():
            return self
        return replace(
            self,
            lower=self.lower[some],
            upper=self.upper[some],
            value=self.value[some],
            variance=self.variance[some],
            scale_mm=self.scale_mm[some],
        )

    @property
    def chi2(self) -> float:
        """Sum of the squares of the values, in units of their variances."""
        return float((self.value**2 / self.variance).sum())

    @property
    def dof(self) -> int:
        """Bins."""
        return self.value.size

    @property
    def distance(self) -> float:
        """Root mean square deviation in standard errors; noise alone gives 1."""
        return float(np.sqrt(self.chi2 / self.dof)) if self.dof else 1.0

    @property
    def z(self) -> float:
        """Wilson and Hilferty's normal deviate of the chi-square."""
        part = 2 / (9 * max(self.dof, 1))
        return float((np.cbrt(self.chi2 / max(self.dof, 1)) - (1 - part)) / np.sqrt(part)) if self.dof else 0.0

    @property
    def excess_nats(self) -> float:
        """Half of chi-square minus its expectation: the largest possible gain by an explanation of this curve."""
        return 0.5 * (self.chi2 - self.dof)

    @property
    def largest(self) -> float:
        """The largest value minus two standard errors; for many bins, such as pixels and frames, `size`."""
        many_bins = 40  # with more, a sum of squares is nearly normal
        if self.dof > many_bins:
            return self.size
        return float((np.abs(self.value) - 2 * np.sqrt(self.variance)).max()) if self.dof else 0.0

    @property
    def size(self) -> float:
        """Root mean square of the values beyond noise, weighted by their information."""
        return float(np.sqrt(max(self.chi2 - self.dof, 0.0) / (1 / self.variance).sum())) if self.dof else 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axis:
    """Bins (pixel,) of the pixels, and the limits of the bins."""

    name: str
    unit: str
    bin: IntArray
    lower: FloatArray
    upper: FloatArray


def panel_axes(evidence: Evidence, m: Mixture, part: Part, *, bins: int = 12, measured: bool = False) -> Iterator[Axis]:
    """Bins of the part's pixels, by predicted quantities and by position.

    Ranges and amplitudes of a `measured` scene have errors. Bins of them would collect the pixels whose errors are
    large and of one sign, so pixels are sorted by what their neighbours saw of the same surface.
    """
    shares = tuple(np.arange(1, bins) / bins)
    rows, cols = evidence.image
    row, col = np.divmod(part[1], cols)
    mean, lit = m.of_main(m.mean), m.of_main(m.lit)
    contrast = _contrast(np.where(lit, mean, m.high).reshape(rows, cols)).ravel()[part[1]]
    seen = np.where((m.weight[0] > 0) & m.lit[0], m.surface[0], -1)[:, part[1]]
    several = np.zeros(part[1].size, dtype=np.int64)
    for number in range(int(seen.max(initial=-1)) + 1):
        several += (seen == number).any(axis=0)
    ones = np.zeros(part[1].size, dtype=np.int64)
    yield Axis(name="all", unit="1", bin=ones, lower=np.zeros(1), upper=np.ones(1))
    by_range, by_amplitude = mean, m.of_main(m.amplitude)
    if measured:
        by_range, by_amplitude = (of_neighbours(v, m.of_main(m.surface), (rows, cols)) for v in (mean, by_amplitude))
    yield _quantiles("range", "mm", by_range[part[1]], shares)
    yield _quantiles("amplitude", "1", by_amplitude[part[1]], shares)
    yield _values("surface", m.of_main(m.surface)[part[1]])
    yield _values("surfaces_in_pixel", np.minimum(several, 3))
    if rows > 1:  # a single row equals the axis `all`
        yield _values("row", row)
    if cols > 1:
        yield _values("col", col)
    yield _quantiles("radius", "pixel", np.hypot(row - (rows - 1) / 2, col - (cols - 1) / 2), shares)
    yield _quantiles("neighbour_contrast", "mm", contrast, (0.5, 0.8, 0.9, 0.95))


def of_neighbours(values: FloatArray, surface: IntArray, image: tuple[int, int]) -> FloatArray:
    """Mean (pixel,) of the sixteen pixels two rows or columns away that see the same surface; the own one without any.

    Those next to a pixel have its errors: amplitudes without a record are those at ranges of a pixel's neighbours.
    """
    away = 2  # pixels
    own, of = (np.pad(v.reshape(image), away, constant_values=-2) for v in (values, surface))
    total, count = np.zeros(image), np.zeros(image)
    rows, cols = image
    steps = range(-away, away + 1)
    for down, right in ((i, j) for i in steps for j in steps if max(abs(i), abs(j)) == away):
        place = slice(away + down, away + down + rows), slice(away + right, away + right + cols)
        same = of[place] == surface.reshape(image)
        total += np.where(same, own[place], 0.0)
        count += same
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), values.reshape(image)).ravel())


def _quantiles(name: str, unit: str, values: FloatArray, shares: tuple[float, ...]) -> Axis:
    inner = np.unique(np.quantile(values, shares))
    edges = np.concatenate([[values.min()], inner, [values.max()]])
    return Axis(
        name=name, unit=unit, bin=np.searchsorted(inner, values, side="right"), lower=edges[:-1], upper=edges[1:]
    )


def _values(name: str, values: IntArray) -> Axis:
    bins = values - min(int(values.min()), 0)
    lower = np.arange(bins.max() + 1, dtype=np.float64) + min(int(values.min()), 0)
    return Axis(name=name, unit="1", bin=bins, lower=lower, upper=lower + 1)


def _contrast(image: FloatArray) -> FloatArray:
    framed = np.pad(image, 1, mode="edge")
    near = [framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:]]
    return np.asarray(np.max([np.abs(n - image) for n in near], axis=0))


def shapes(
    z: Float32Array, axes: list[Axis], m: Mixture, state: ModelState, part: Part, recording: int = 0
) -> Iterator[Curve]:
    """Means of the four Hermite polynomials over bins of pixels, and pixel by pixel."""
    count = np.isfinite(z).sum(axis=0)
    sigma = m.of_main(m.sigma)[part[1]]
    unknown = state.pixel_variance[part[1]] / sigma**2  # a measured map has errors
    of_width = state.log_width_error[recording, part[1]] ** 2  # so have widths
    scene = state.errors
    of_shares = np.zeros(count.size) if scene is None else scene.shares[part[1]]
    common = 0.0 if scene is None else scene.common_to(len(part[0]), state.memory)
    all_widths = 0.0 if scene is None else scene.common_log_width**2
    free = one_surface(m)[part[1]] | (memory_of(state) == 0)  # only pixels of one surface are freed of a memory
    further = further_moves(unknown)
    for name, power, off, wider, more in zip(SHAPES, hermite(z), *moves(m.shape), further, strict=True):
        errors = off**2 * unknown + wider**2 * of_width + of_shares
        total: FloatArray = np.asarray(np.nansum(power, axis=0, dtype=np.float64))
        if scene is not None:
            total = total - count * more.mean
            errors = errors + more.variance + more.scatter / np.maximum(count, 1)
        for axis in axes:
            curve = _curve(name, axis, total, (count, errors), sigma_of_lit(m, part))
            shared = off**2 * common + wider**2 * all_widths
            yield curve if not shared else replace(curve, variance=curve.variance + shared)
        enough = (count >= _ENOUGH / 10) & free
        value = total[enough] / count[enough]
        number = part[1][enough].astype(np.float64)
        own = "pattern" if name == "bias" else f"{name}_pattern"
        spread = 1.0 / count[enough] + errors[enough] + off**2 * common + wider**2 * all_widths
        yield Curve(
            statistic=own,
            axis="all",
            lower=number,
            upper=number + 1,
            value=value,
            variance=spread,
            unit="1",
            scale_mm=sigma[enough],
        )


class FurtherMoves(NamedTuple):
    """What unknown biases do to the mean of a polynomial of a pixel's scores beyond `moves`. Arrays are (pixel,)."""

    mean: FloatArray
    variance: FloatArray
    scatter: FloatArray
    """Variance of each sample's polynomial, in addition to 1."""


def further_moves(bias: FloatArray) -> Iterator[FurtherMoves]:
    """Those of the four polynomials, for Gaussian scores and biases of this variance (pixel,), in sigma squared.

    The polynomial of order k of z + d is a sum of those of z of orders j up to k, each times a power k - j of d.
    """
    nothing = np.zeros(bias.size)
    yield FurtherMoves(nothing, nothing, nothing)
    yield FurtherMoves(bias / math.sqrt(2.0), bias**2, 2.0 * bias)
    yield FurtherMoves(nothing, 2.5 * bias**3, 3.0 * bias + 4.5 * bias**2)
    scatter = 4.0 * bias + 9.0 * bias**2 + 10.0 * bias**3
    yield FurtherMoves(3.0 * bias**2 / math.sqrt(24.0), 4.0 * bias**4, scatter)


def widths(state: ModelState, spread: float, recording: int = 0) -> Iterator[Curve]:
    """Whether the widths of pixels are spread as in the model: their mean square, clipped at 2.5 spreads.

    Only a camera with a spread of widths has this curve. An estimated width is nearer to the mean than the true one,
    because of its error.

    Parameters
    ----------
    state : ModelState
        The model with the estimated widths.
    spread : float
        The model's standard deviation of the log width.
    recording : int
        Which one, from 0.
    """
    found, error = state.log_width[recording], state.log_width_error[recording]
    expected = spread**2 - error**2
    told = state.working & (error > 0) & (expected > _TOLD * spread**2)
    if not told.any():
        return
    far_width = 2.5  # largest width in spreads: one pixel with another cause must not decide
    square = np.minimum(found[told] ** 2 / expected[told], far_width**2)
    value = (float(square.mean()) - _CLIPPED_MEAN) / _CLIPPED_SPREAD
    yield Curve(
        statistic="widths",
        axis="all",
        lower=np.zeros(1),
        upper=np.ones(1),
        value=np.array([value]),
        variance=np.array([1.0 / told.sum()]),
        unit="1",
        scale_mm=np.ones(1),
    )


def sigma_of_lit(m: Mixture, part: Part) -> FloatArray:
    """Sigma of a part's pixels, mm; infinite without a return, because no bias moves these samples."""
    return np.where(m.of_main(m.lit)[part[1]], m.of_main(m.sigma)[part[1]], np.inf)


def _curve(name: str, axis: Axis, total: FloatArray, known: tuple[FloatArray, FloatArray], sigma: FloatArray) -> Curve:
    """Means over bins; `known` are the samples of each pixel, and the additional variance of its mean."""
    count, unknown = known
    n = np.bincount(axis.bin, count, minlength=axis.lower.size)
    enough_of_means = 40  # samples of a bin, for a mean or a spread
    some = n >= (enough_of_means if name in ("bias", "spread") else _ENOUGH)
    value = np.bincount(axis.bin, total, minlength=n.size)[some] / n[some]
    per_mm = np.bincount(axis.bin, count / sigma, minlength=n.size)[some] / n[some]
    scale = np.where(per_mm > 0, 1.0 / np.maximum(per_mm, 1e-9), 0.0)
    shared = np.bincount(axis.bin, count**2 * unknown, minlength=n.size)[some] / n[some] ** 2
    return Curve(
        statistic=name,
        axis=axis.name,
        lower=axis.lower[some],
        upper=axis.upper[some],
        value=value,
        variance=1.0 / n[some] + shared,
        unit=axis.unit,
        scale_mm=scale,
    )


def invalid(evidence: Evidence, m: Mixture, state: ModelState, axes: list[Axis], part: Part) -> Iterator[Curve]:
    """Invalid samples beyond those that the model predicts, over bins of pixels, and by frame."""
    lost = evidence.samples[part[0]][:, part[1]] == 0
    working = state.working[part[1]]
    of_time = np.bincount(m.key[part[0]], minlength=len(m.invalid)).astype(np.float64)  # frames
    expected = of_time @ m.invalid[:, part[1]]
    seen = lost.sum(axis=0)
    of_scene = np.zeros(part[1].size) if state.errors is None else state.errors.lost[part[1]] * len(part[0]) ** 2
    for axis in axes:
        use = axis.bin[working]
        wanted = np.bincount(use, expected[working], minlength=axis.lower.size)
        found = np.bincount(use, seen[working], minlength=axis.lower.size)
        n = np.bincount(use, minlength=axis.lower.size) * len(part[0])
        share = np.bincount(
            use,
            (of_time @ (m.invalid * (1 - m.invalid))[:, part[1]])[working],
            minlength=axis.lower.size,
        )
        unknown = np.bincount(use, of_scene[working], minlength=axis.lower.size)
        some = n >= _ENOUGH
        n = n[some]
        yield Curve(
            statistic="invalid",
            axis=axis.name,
            lower=axis.lower[some],
            upper=axis.upper[some],
            value=(found - wanted)[some] / n,
            variance=(np.maximum(share[some], 1.0) + unknown[some]) / n**2,
            unit=axis.unit,
            scale_mm=np.ones(n.size),
        )
    by_frame = lost[:, working].sum(axis=1) - m.invalid[:, part[1][working]].sum(axis=1)[m.key[part[0]]]
    level = max(float(lost[:, working].sum(axis=1).mean()), 1.0)
    size = float(working.sum())
    frame = part[0].astype(np.float64)
    yield Curve(
        statistic="invalid",
        axis="frame",
        lower=frame,
        upper=frame + 1,
        value=by_frame / size,
        variance=np.full(len(part[0]), (level + of_scene.sum() / len(part[0]) ** 2) / size**2),
        unit="1",
        scale_mm=np.ones(len(part[0])),
    )


def neighbours(z: Float32Array, evidence: Evidence, part: Part) -> Iterator[Curve]:
    """Correlation of neighbours in a row, and in a column, without the means of pixels.

    Means of frames are removed too. This gives any two of n pixels a correlation of -1 / n, so few pixels have no
    result.
    """
    rows, cols = evidence.image
    enough_pixels = 12  # for the correlation of neighbours in the image
    if part[1].size < enough_pixels:
        return
    flat = np.nan_to_num(z - np.nanmean(np.where(np.isfinite(z).any(axis=0), z, 0), axis=0))
    cube = np.zeros((len(part[0]), rows * cols), dtype=np.float32)
    cube[:, part[1]] = flat - flat.mean(axis=1, keepdims=True)
    image = cube.reshape(-1, rows, cols)
    both = {"col": (image[:, :, 1:], image[:, :, :-1]), "row": (image[:, 1:], image[:, :-1])}
    for axis, (a, b) in both.items():
        if a.size == 0:  # one column, or one row
            continue
        n = max(int(((a != 0) & (b != 0)).sum()), 1)
        value = float((a * b).sum(dtype=np.float64)) / n + 1.0 / part[1].size
        yield Curve(
            statistic="neighbour_correlation",
            axis=axis,
            lower=np.zeros(1),
            upper=np.ones(1),
            value=np.array([value]),
            variance=np.array([1.0 / n]),
            unit="1",
            scale_mm=np.ones(1),
        )


def discreteness(evidence: Evidence, part: Part, m: Mixture, state: ModelState) -> Iterator[Curve]:
    """Second differences of the histogram of whole mm, and its Fourier sums; 0 if the density is smooth.

    A normal density of sigma bends too, as full images of a flat wall show: its second difference over 1 mm, z sigma
    from its middle, is cosh(z / sigma) exp(-1 / 2 sigma^2) - 1 of its height. So much is no sign. If the model has a
    quantisation step: the share of samples off its steps.
    """
    smooth_mm = 2.0  # least sigma of a density that is smooth over three mm
    use = part[1][(state.working & (m.of_main(m.sigma) > smooth_mm))[part[1]]]
    values = evidence.samples[part[0]][:, use]
    count = np.bincount(values.ravel(), minlength=65_536)[1:].astype(np.float64)
    if m.step > 0:
        value = np.arange(1.0, 65_536.0)
        off = float(count[np.rint(np.rint(value / m.step) * m.step) != value].sum())
        n = max(float(count.sum()), 1.0)
        yield Curve(
            statistic="discreteness",
            axis="all",
            lower=np.zeros(1),
            upper=np.ones(1),
            value=np.array([off / n]),
            variance=np.array([max(off, 1.0) / n**2]),
            unit="1",
            scale_mm=np.ones(1),
        )
        return
    yield from _combs(evidence, part, m, state)
    curl = count[1:-1] - (count[:-2] + count[2:]) / 2
    variance = count[1:-1] + (count[:-2] + count[2:]) / 4
    full = variance >= _ENOUGH
    bent = np.bincount(values.ravel(), bend(values, m.of_main(m.sigma)[use]).ravel(), minlength=65_536)
    bent = bent[2:-1][full][::3]
    curl, variance = curl[full][::3], variance[full][::3]  # every third, so that they share no counts
    at: FloatArray = (np.flatnonzero(full) + 2.0)[::3].astype(np.float64)
    yield Curve(
        statistic="discreteness",
        axis="range",
        lower=at,
        upper=at + 1,
        value=curl / variance,
        variance=(1.0 + bent**2 / variance) / variance,
        unit="mm",
        scale_mm=np.ones(at.size),
    )


def bend(values: NDArray[np.uint16], sigma: FloatArray) -> FloatArray:
    """Second difference over 1 mm of each pixel's normal density at its samples (frame, pixel), over its height."""
    seen = np.where(values > 0, values, np.nan)
    some = (values > 0).any(axis=0)
    middle = np.zeros(sigma.size)
    middle[some] = np.nanmedian(seen[:, some], axis=0)
    far = 5.0  # sigma, beyond which samples are others
    z = np.clip(np.nan_to_num(seen - middle) / sigma, -far, far)
    return np.asarray(np.abs(np.cosh(z / sigma) * np.exp(-0.5 / sigma**2) - 1.0))


_PERIODS = range(2, 17)  # mm


def _combs(evidence: Evidence, part: Part, m: Mixture, state: ModelState) -> Iterator[Curve]:
    """Fourier sums of the samples over periods of whole mm: they show values that are too rare, even in few samples.

    They use samples and not scores, so a wide scene with few counts in a bin, or wrong means of the model, do not
    matter. With a memory there is no result, because samples repeat each other.
    """
    if memory_of(state) or m.period > 0:
        return
    sigma = np.where(state.working, np.where(m.weight[0] > 0, m.sigma[0], np.inf).min(axis=0), 0.0)[part[1]]
    values = evidence.samples[part[0]][:, part[1]]
    sums: list[float] = []
    counts: list[float] = []
    turns: list[float] = []
    smooth_turns = 0.8  # least sigma of a density without such a wave, in periods: the wave is e^-12.6
    for period in _PERIODS:
        of_each = np.bincount(values[:, sigma > smooth_turns * period].ravel(), minlength=1)
        of_each[0] = 0
        residues = np.bincount(np.arange(of_each.size) % period, of_each, minlength=period)
        n = residues.sum()
        waves = np.fft.rfft(residues)
        for k in range(1, period // 2 + 1):
            if n < _ENOUGH or math.gcd(k, period) > 1:
                continue
            both = [float(w) for w in (waves[k].real, waves[k].imag)[: 1 + (2 * k < period)]]
            sums += both
            counts += [n / len(both)] * len(both)
            turns += [period / k] * len(both)
    order = np.argsort(turns, kind="stable")  # periods of k turns lie between those of one turn
    at, power = np.array(turns)[order], np.maximum(np.array(counts)[order], 1)
    yield Curve(
        statistic="discreteness",
        axis="all",
        lower=at,
        upper=at,
        value=np.array(sums)[order] / power,
        variance=1.0 / power,
        unit="mm",
        scale_mm=np.ones(at.size),
    )
