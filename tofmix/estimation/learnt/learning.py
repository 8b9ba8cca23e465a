"""Learn a recording's noise: sigma by range, the shape of the error, widths, backgrounds and drifts of single pixels.

1. sigma(r) comes from clusters (`noise.measurement`) and from differences of samples (`pair_differences`).
   Surfaces may lie too close for either, so that smaller scales are tried too: the one that predicts best stays.
2. Parts are added one by one, the most helpful first: background, drift, widths, shape. Each is learnt from clusters
   (`clusters`) of two thirds of the pixels, and kept only if the others are predicted better with it (`held_out`).
3. Parts that are no longer needed beside the others are dropped again.
4. The memory of the errors, from frame to frame, is measured last: it moves no likelihood, but what noise gains.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.compiled.robust import MAD_TO_SIGMA
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.learnt.clusters import ClusterFits, Clusters, find_clusters, fit_clusters
from tofmix.estimation.learnt.held_out import LEAST_GAIN, flat_thresholds, held_out_scores
from tofmix.estimation.learnt.law import MOST_LOG_WIDTH, SCALE_OF_SPREAD, TAIL_DEGREES, precision_of_t
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.pair_differences import sigma_from_differences
from tofmix.estimation.learnt.shape_fit import fit_shape, histogram, shapes_differ
from tofmix.estimation.learnt.shares import PixelWidths, background_shares, pixel_widths
from tofmix.estimation.noise.pixel_noise import pixel_curves
from tofmix.learnt_noise import DRIFTS
from tofmix.sensor import NoiseCurve, Sensor

SURE = 3.0
"""Standard errors by which a part must gain likelihood on pixels that no fit has seen."""

WORTH = 0.1
"""Nats a pixel that a part must gain at least: less moves no count."""

SURE_NATS = math.log(1000.0)
"""Nats that a part must gain, all judging pixels together, where a few have most of it: chance does once in 1000."""

MANY_PIXELS = 900
"""From so many pixels on, a third of them is enough to judge by."""

_FOLDS = 3  # parts of the pixels: two thirds are learnt from, one third judges
_SEED = 20080922  # of the split into folds, so that the same recording gives the same noise

LEAST_CLUSTERS = 12
"""Fewer clusters teach no part but sigma."""

COMMON = 0.05
"""Clusters a pixel, at least, that sigma(r) is measured with: fewer may stand clear by chance alone."""

SCALES = (1.0, 0.5, 0.25, 0.125)
"""Factors on the scale of the differences that are tried: where surfaces lie close in every pixel, they widen it."""

MAX_LAYERS = 4
"""Most surfaces that a pixel is given while the noise is learnt."""

FIRST_PRIOR = (0.5, 2.0)
"""Pseudo-counts of background and of the rest before any pixel has told."""

MOST_COUNTED = 600
"""Pixels whose surfaces are counted to measure backgrounds, or widths where no cluster is clear: more tell no more."""

SAME = 1.02
"""Curves within this factor are one: no count differs by it."""

_SPREADS = np.geomspace(0.02, 1.0, 30)
_NEVER = 1e-12  # least likelihood before its logarithm is taken

_FREE_WIDTH = 0.6
"""Spread of log width while widths are measured: wide enough to leave each to its own samples."""

_FREE_DRIFT_SIGMAS = 3.0
"""Scale of the drift, in sigmas, while drifts are measured."""

_PARTS = ("background", "drift", "widths", "shape")
_ROUNDS = 3  # rounds of counting under the last noise and learning from that count
_MEMORY_WORTH, _MOST_MEMORY = 0.05, 0.95  # autocorrelation at lag one: less counts as none, more is never returned
_MEMORY_ROUNDS = 30  # iterations for the memory that the fitted mean and drift hide
_LEAST_BIN = 20  # clusters in a bin of range
_WIDE_BIN = 0.12  # greatest width of a bin, as a part of its range


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lesson:
    """What `learn_pixel_noise` found.

    Parameters
    ----------
    noise : PixelNoise
        The noise model.
    pixels : int
        Pixels that it was learnt from.
    ranges_mm : (n,) float64
        Ranges of the clusters, mm: where the recording has surfaces.
    own : (n, 1 + DRIFTS) float64
        Log width and drift, mm, of the clusters of one surface, chance taken off: what pixels have of their own.
    clusters : int
        Clusters that stand clear, of one surface.
    kept_start : bool
        Whether no other curve predicts better than the one that was given to start from.
    given_holds : bool
        Whether the curve to beat predicts as well as what was learnt.
    shapes_differ : bool
        Whether the shape of the error differs between pixels, for which one is used.
    """

    noise: PixelNoise
    pixels: int
    ranges_mm: FloatArray
    own: FloatArray
    clusters: int
    kept_start: bool
    given_holds: bool
    shapes_differ: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pixels:
    """Pixels to learn from.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples in the order of frames, mm, NaN where invalid, with their rounding spread evenly over its step.
    amplitude : (pixel, frame) float32, optional
        Their amplitudes.
    rounding_mm : float
        The step of the stored ranges.
    """

    samples: Float32Array
    amplitude: Float32Array | None = None
    rounding_mm: float = 0.0

    def chosen(self, which: BoolArray) -> "Pixels":
        """Some of them."""
        light = None if self.amplitude is None else np.ascontiguousarray(self.amplitude[which])
        return Pixels(samples=np.ascontiguousarray(self.samples[which]), amplitude=light, rounding_mm=self.rounding_mm)

    def some(self, most: int) -> "Pixels":
        """At most so many of them, evenly spread."""
        count = len(self.samples)
        if count <= most:
            return self
        which = np.zeros(count, dtype=np.bool_)
        which[np.linspace(0, count - 1, most).astype(int)] = True
        return self.chosen(which)


class _Learner:
    """Pixels to learn from, pixels to judge by, and the camera."""

    def __init__(self, learn: Pixels, judge: Pixels, sensor: Sensor) -> None:
        self.learn, self.judge, self._sensor = learn, judge, sensor

    def beam(self, noise: PixelNoise, pixels: Pixels) -> Beam:
        beam = beam_of(replace(self._sensor, noise=noise.curve))
        if noise.curve.law is not None and pixels.amplitude is not None and len(pixels.samples):
            beam = beam._replace(pixel_curves=pixel_curves(pixels.samples.T, pixels.amplitude.T, noise.curve))
        return beam

    def scores(self, noise: PixelNoise) -> FloatArray:
        """Held-out log likelihood (pixel,) of the judging pixels, nat."""
        beam = self.beam(noise, self.judge)
        thresholds = flat_thresholds(always_one=noise.background is None)
        found, _ = held_out_scores(self.judge.samples, noise.laws(), beam, thresholds, MAX_LAYERS)
        return found

    def clusters(self, noise: PixelNoise) -> Clusters:
        return find_clusters(self.learn.samples, self.beam(noise, self.learn))

    def widths(self, noise: PixelNoise, free: PixelNoise) -> PixelWidths:
        """Widths of some pixels, by a count."""
        pixels, thresholds = self.learn.some(MOST_COUNTED), flat_thresholds()
        beam = self.beam(noise, pixels)
        return pixel_widths(pixels.samples, noise.laws(), free.laws()[0], beam, thresholds, MAX_LAYERS)

    def fits(self, noise: PixelNoise, clusters: Clusters, *, second: bool = False) -> ClusterFits:
        free = replace(noise, background=noise.background or (0.5, 5.0))
        return fit_clusters(self.learn.samples, clusters, free.laws()[0], self.beam(noise, self.learn), second)


def _folds(pixels: Pixels, sensor: Sensor) -> list[_Learner]:
    """Every third pixel judges what the others teach; where pixels are few, each third in turn."""
    count = len(pixels.samples)
    part = np.random.default_rng(_SEED).permutation(count) % _FOLDS  # neighbours are alike: no fold has them all
    turns = range(_FOLDS) if count < MANY_PIXELS else [_FOLDS - 1]
    return [_Learner(pixels.chosen(part != turn), pixels.chosen(part == turn), sensor) for turn in turns]


@dataclass(frozen=True, slots=True)
class _Trial:
    """A model of each fold, learnt from its own pixels, and what they predict of the others."""

    noises: tuple[PixelNoise, ...]
    scores: FloatArray


def _tried(folds: Sequence[_Learner], noises: Sequence[PixelNoise | None]) -> _Trial | None:
    """Judge the models; None where a fold has none."""
    known = tuple(noise for noise in noises if noise is not None)
    if len(known) < len(folds):
        return None
    return _Trial(known, np.concatenate([fold.scores(noise) for fold, noise in zip(folds, known, strict=True)]))


def _helps(one: _Trial, other: _Trial) -> float:
    """Gain of the first over the second, nat a pixel; 0 where it may be chance, or moves no count.

    Two tests, of which one must pass. Most pixels gain: the mean is several standard errors above 0. Or a few gain
    much: if the second were true, the product of the pixels' likelihood ratios would exceed e^g with a chance of e^-g
    at most, whatever was learnt (they are of samples and pixels that no fit has seen); the best pixel does not count.

    References
    ----------
    Vovk and Wang, Annals of Statistics 49(3), 2021, doi:10.1214/20-AOS2020: e-values.
    """
    gain, error = better_by(one.scores, other.scores)
    if gain > max(SURE * error, WORTH):
        return gain
    away = one.scores - other.scores
    away = np.sort(away[np.isfinite(away)])[:-1]
    if away.size and away.sum() > max(SURE_NATS, WORTH * away.size):
        return float(away.mean())
    return 0.0


def better_by(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Mean of one - other over pixels that have both, and its standard error."""
    away = one - other
    away = away[np.isfinite(away)]
    if away.size < 3:  # noqa: PLR2004  no spread to speak of
        return 0.0, math.inf
    # A single odd pixel decides nothing: differences are held within ten median deviations.
    middle = float(np.median(away))
    reach = 10.0 * MAD_TO_SIGMA * float(np.median(np.abs(away - middle))) + 1e-9
    away = np.clip(away, middle - reach, middle + reach)
    return float(away.mean()), float(away.std() / math.sqrt(away.size)) + 1e-12


def learn_pixel_noise(
    pixels: Pixels,
    sensor: Sensor,
    start: NoiseCurve | None,
    *,
    shape: bool = True,
    widths: bool | None = None,
    drift: bool = True,
    instead_of: NoiseCurve | None = None,
    workers: int = 1,
) -> Lesson:
    """Learn the noise from pixels of some windows.

    Parameters
    ----------
    pixels : Pixels
        What teaches and what judges; with the step of stored ranges smoothed over.
    sensor : Sensor
        For the working range and p(c_r).
    start : NoiseCurve or None
        A curve measured in another way, which is tried first.
    shape : bool
        Whether the error may have a shape other than a Gaussian's.
    widths : bool, optional
        Whether pixels have widths of their own; None: as the samples say.
    drift : bool
        Whether a pixel's ranges may drift within a window.
    instead_of : NoiseCurve, optional
        A Gaussian curve that what is learnt must beat on pixels that no fit has seen.
    workers : int
        Threads, which try parts side by side; nothing depends on them.

    Returns
    -------
    Lesson
        It depends on the samples, the sensor and the options alone.

    Raises
    ------
    ValueError
        If nothing of the noise can be told.
    """
    barred = {"shape": not shape, "widths": widths is not None, "drift": not drift}
    parts = tuple(part for part in _PARTS if not barred.get(part, False))
    folds = _folds(pixels, sensor)
    whole = _Learner(pixels, pixels.chosen(np.zeros(len(pixels.samples), dtype=np.bool_)), sensor)
    curves = _first_curves(pixels.samples, start)
    if not curves:
        raise ValueError("noise: no two samples of a pixel differ, or none is valid")
    chosen, plain = curves[0], None
    for curve, noises in _apart(folds, curves, sensor):
        trial = _tried(folds, noises)
        if trial is not None and (plain is None or _helps(trial, plain) > 0.0):
            chosen, plain = curve, trial
    best, added, measured = plain, list[str](), curves[0]
    if plain is not None:
        measured = plain.noises[-1].curve
        with ThreadPoolExecutor(workers, thread_name_prefix="tofmix") as pool:
            best, added = _with_parts(
                folds, plain, parts, insisted=("widths",) if widths else (), side_by_side=pool.map
            )
    given_holds = False
    if instead_of is not None and best is not None:
        given = PixelNoise.gaussian(instead_of, sensor.outlier_probability)
        trial = _tried(folds, [given] * len(folds))
        given_holds = trial is not None and _helps(best, trial) == 0.0
    noise = _with_curve(whole, PixelNoise.gaussian(measured, sensor.outlier_probability))
    for part in added:
        noise = _learn(whole, noise, part) or noise
    fits = whole.fits(noise, whole.clusters(noise))
    noise = replace(noise, memory=_memory(fits, noise))
    if noise.memory > 0.0:
        noise = _with_curve(whole, noise)
    ranges = fits.place if len(fits.place) else medians(pixels.samples)
    return Lesson(
        noise=noise,
        pixels=len(pixels.samples),
        ranges_mm=np.asarray(ranges),
        own=_own(whole, noise),
        clusters=len(fits.place),
        kept_start=chosen is curves[0] and start is not None,
        given_holds=given_holds,
        shapes_differ=shapes_differ(fits.error),
    )


def _first_curves(samples: Float32Array, start: NoiseCurve | None) -> list[NoiseCurve]:
    """Curves to start from: the given one, that of the differences, and smaller ones."""
    curves = [] if start is None else [start]
    found = sigma_from_differences(samples)
    if found is not None:
        ranges, sigmas = found
    else:
        seen = samples[np.isfinite(samples).sum(axis=1) > 1]
        if len(seen) == 0:
            return curves
        away = np.abs(seen - medians(seen)[:, None])
        spread = MAD_TO_SIGMA * float(np.median(medians(away)))
        if not spread > 0:
            return curves
        ranges, sigmas = np.array([float(np.median(medians(seen)))]), np.array([spread])
    for scale in SCALES:
        curve = NoiseCurve(ranges, sigmas * scale)
        if all(abs(math.log(_ratio(curve, other))) > math.log(1.1) for other in curves):
            curves.append(curve)
    return curves


def _apart(
    folds: Sequence[_Learner], curves: Sequence[NoiseCurve], sensor: Sensor
) -> Iterator[tuple[NoiseCurve, list[PixelNoise]]]:
    """Each curve with Gaussian noise whose sigma(r) each fold has measured from there, but none a second time."""
    known: list[list[PixelNoise]] = []
    for curve in curves:
        first = PixelNoise.gaussian(curve, sensor.outlier_probability)
        noises = [_with_curve(fold, first) for fold in folds]
        if not any(all(map(_same, noises, others)) for others in known):
            known.append(noises)
            yield curve, noises


def _same(one: PixelNoise, other: PixelNoise) -> bool:
    """Whether two curves have about the same sigma at all ranges of the first."""
    return bool(np.all(np.abs(np.log(one.curve.sigma_mm / other.curve.sigma(one.curve.range_mm))) < math.log(SAME)))


def medians(samples: Float32Array) -> FloatArray:
    """Median of the valid samples of each pixel (pixel, frame) that has any, mm."""
    return np.array([float(np.median(row[np.isfinite(row)])) for row in samples if np.isfinite(row).any()])


def _ratio(one: NoiseCurve, other: NoiseCurve) -> float:
    """Typical ratio of two curves, at the ranges of the first."""
    return float(np.exp(np.median(np.log(one.sigma_mm / other.sigma(one.range_mm)))))


def _with_parts(
    folds: Sequence[_Learner],
    best: _Trial,
    parts: Sequence[str],
    *,
    insisted: Sequence[str],
    side_by_side: Callable[[Callable[[str], _Trial | None], Iterable[str]], Iterable[_Trial | None]],
) -> tuple[_Trial, list[str]]:
    """Add the parts that pixels which no fit has seen ask for, the most helpful first; then drop those not needed.

    Parts that are insisted on come first, and stay.
    """
    have: list[str] = []

    def one_more(part: str) -> _Trial | None:
        return _tried(folds, [_learn(fold, one, part) for fold, one in zip(folds, best.noises, strict=True)])

    for part in insisted:
        trial = one_more(part)
        if trial is not None:
            best = trial
            have.append(part)
    while len(have) < len(parts) + len(insisted):
        left = [part for part in parts if part not in have]
        trials = [(part, trial) for part, trial in zip(left, side_by_side(one_more, left), strict=True) if trial]
        gains = [_helps(trial, best) for _, trial in trials]
        if max(gains, default=0.0) <= 0.0:
            break
        part, best = trials[int(np.argmax(gains))]
        have.append(part)
    for part in tuple(have):
        if len(have) > 1 and part not in insisted:
            trial = _tried(folds, [_without(noise, part) for noise in best.noises])
            if trial is not None and _helps(best, trial) == 0.0:
                best = trial
                have.remove(part)
    return best, have


def _without(noise: PixelNoise, part: str) -> PixelNoise:
    if part == "background":
        return replace(noise, background=None)
    if part == "drift":
        return replace(noise, drift_mm=np.zeros(DRIFTS))
    if part == "widths":
        return replace(noise, curve=replace(noise.curve, width_spread=0.0))
    return replace(noise, curve=replace(noise.curve, shape=None))


def _learn(learner: _Learner, noise: PixelNoise, part: str) -> PixelNoise | None:
    """The model with one part more, and all parts that it has learnt again; None where too few clusters teach it."""
    if part == "background":
        return _with_background(learner, noise)
    clusters = learner.clusters(noise)
    if len(clusters.pixel) < LEAST_CLUSTERS:
        return None
    single = _single(learner, noise, clusters)
    if len(single.pixel) < LEAST_CLUSTERS:
        return None
    learnt = {"drift": _with_drift, "widths": _with_widths, "shape": _with_shape}[part]
    trial = learnt(learner, noise, single)
    if trial is not None and part != "drift":  # without the part, pixels that need it most seemed two surfaces
        trial = learnt(learner, trial, _single(learner, _with_curve(learner, trial), clusters))
    return None if trial is None else _with_curve(learner, trial)


def _chosen(clusters: Clusters, which: BoolArray) -> Clusters:
    return Clusters(clusters.pixel[which], clusters.low[which], clusters.high[which])


def _single(learner: _Learner, noise: PixelNoise, clusters: Clusters) -> Clusters:
    """Clusters in which no second surface is likely, as far as the model can tell; all where most have one."""
    fits = learner.fits(noise, clusters, second=True)
    single = fits.gain < LEAST_GAIN
    # A wrong shape splits most pixels: then a split tells of the shape, and not of a second surface.
    return _chosen(clusters, single) if 2 * single.sum() > len(single) else clusters


def _with_curve(learner: _Learner, noise: PixelNoise) -> PixelNoise:
    """Measure sigma by range anew: the median width of the clusters near each range; of pixels, where none is clear."""
    for _ in range(_ROUNDS):
        free = replace(noise, curve=replace(noise.curve, width_spread=_FREE_WIDTH))
        clusters = learner.clusters(noise)
        if len(clusters.pixel) >= max(LEAST_CLUSTERS, COMMON * len(learner.learn.samples)):
            fits = learner.fits(free, clusters)
            place, wide = fits.place, fits.log_width + _bias(noise, fits.support, 1.0)
        else:
            pixels = learner.widths(noise, free)
            if len(pixels.place) < LEAST_CLUSTERS:
                return noise
            place, wide = pixels.place, pixels.log_width + _bias(noise, pixels.support, pixels.surfaces)
        curve = _curve_through(place, wide, noise.curve)
        change = abs(math.log(_ratio(curve, noise.curve)))
        noise = replace(noise, curve=curve)
        if change < 0.01:  # noqa: PLR2004  1 % of sigma is below what samples tell of it
            break
    return noise


def _bias(noise: PixelNoise, support: FloatArray, surfaces: FloatArray | float) -> FloatArray:
    """Log factor by which fitted widths fall short: means and drifts have taken their part of the spread.

    Where errors remember, that part is larger: slow errors have (1 + rho) / (1 - rho) times the variance of all.
    """
    taken = surfaces * (1.0 + np.count_nonzero(noise.drift_mm)) * (1.0 + noise.memory) / (1.0 - noise.memory)
    return np.asarray(-0.5 * np.log(np.maximum(1.0 - taken / np.maximum(support, taken + 2.0), 0.1)))


def _curve_through(at_mm: FloatArray, log_width: FloatArray, curve: NoiseCurve) -> NoiseCurve:
    """Curve through the median widths of bins of range."""
    order = np.argsort(at_mm, kind="stable")
    place = at_mm[order]
    wide = log_width[order] + np.log(curve.sigma(place))
    ranges, sigmas, first = [], [], 0
    while first < len(place):
        stop = max(
            first + _LEAST_BIN, int(np.searchsorted(place, place[first] * (1.0 + _WIDE_BIN) + 1e-9, side="right"))
        )
        if len(place) - stop < _LEAST_BIN // 2:
            stop = len(place)
        ranges.append(float(np.median(place[first:stop])))
        sigmas.append(float(np.exp(np.median(wide[first:stop]))))
        first = stop
    at, where = np.unique(np.round(np.array(ranges), 3), return_index=True)
    law = curve.law
    if law is not None:
        law = replace(law, reference=np.interp(at, curve.range_mm, law.reference))
    return replace(curve, range_mm=at, sigma_mm=np.array(sigmas)[where], law=law)


def _with_drift(learner: _Learner, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Measure how far pixels drift, by each polynomial, beyond what chance lets their fits."""
    sigma = float(np.median(noise.curve.sigma_mm))
    free = replace(noise, drift_mm=np.full(DRIFTS, _FREE_DRIFT_SIGMAS * sigma))
    fits = learner.fits(free, clusters)
    width = np.exp(fits.log_width) * fits.sigma
    information = noise.laws()[0].information
    scales = np.zeros(DRIFTS)
    for d in range(DRIFTS):
        chance = (2.0 * d + 3.0) * width**2 / (information * np.maximum(fits.support, 1.0))
        square = np.quantile(np.abs(fits.drift[:, d]), 0.75) ** 2 / 1.1503**2
        scales[d] = math.sqrt(
            max(
                float(square - np.median(chance)),
                float(np.mean(np.clip(fits.drift[:, d] ** 2 - chance, 0.0, 9.0 * max(square, 1e-12)))) * 0.25,
                0.0,
            )
        )
    scales[scales < 0.02 * sigma] = 0.0  # a fiftieth of sigma moves no count
    return replace(noise, drift_mm=scales)


def _with_widths(learner: _Learner, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Measure how far the widths of pixels differ beyond chance."""
    fits = learner.fits(replace(noise, curve=replace(noise.curve, width_spread=_FREE_WIDTH)), clusters)
    chance = 1.0 / (noise.laws()[0].width_information * np.maximum(fits.support, 1.0))
    scale = width_scale(fits.log_width - float(np.median(fits.log_width)), np.asarray(chance))
    if scale is None:
        return None
    return replace(noise, curve=replace(noise.curve, width_spread=scale / SCALE_OF_SPREAD))


def width_scale(log_width: FloatArray, variance: FloatArray) -> float | None:
    """Scale of the Student t density of log width that measured ones show best; None where chance is all there is.

    Parameters
    ----------
    log_width : (n,) float64
        Measured, about their middle.
    variance : (n,) float64
        What chance adds to the variance of each.
    """
    at = np.linspace(-MOST_LOG_WIDTH, MOST_LOG_WIDTH, 601)
    seen = np.exp(-0.5 * (log_width[:, None] - at) ** 2 / variance[:, None]) / np.sqrt(variance[:, None])
    alike = np.exp(-0.5 * log_width**2 / variance) / np.sqrt(variance)
    best, chosen = float(np.log(np.maximum(alike, _NEVER)).sum()), None
    for scale in _SPREADS:
        prior = (1.0 + (at / scale) ** 2 / TAIL_DEGREES) ** (-0.5 * (TAIL_DEGREES + 1.0))
        found = float(np.log(np.maximum(seen @ (prior / prior.sum()), _NEVER)).sum())
        if found > best:
            best, chosen = found, float(scale)
    return chosen


def _own(learner: _Learner, noise: PixelNoise) -> FloatArray:
    """Log width and drift, mm, of the clusters of one surface (cluster, 1 + DRIFTS), without what chance adds to them.

    A prior has long tails so that no pixel is held against it. Those of the pixels are their own, and gains that noise
    reaches once in 1000 come from the tails.
    """
    clusters = learner.clusters(noise)
    if len(clusters.pixel):
        clusters = _single(learner, noise, clusters)
    out = np.zeros((len(clusters.pixel), 1 + DRIFTS))
    wide, moves = noise.curve.width_spread > 0.0, noise.drift_mm > 0.0
    if not len(out) or not (wide or moves.any()):
        return out
    sigma = float(np.median(noise.curve.sigma_mm))
    free = replace(noise, drift_mm=np.where(moves, _FREE_DRIFT_SIGMAS * sigma, 0.0))
    if wide:
        free = replace(free, curve=replace(free.curve, width_spread=_FREE_WIDTH))
    fits, law = learner.fits(free, clusters), noise.laws()[0]
    support = np.maximum(fits.support, 1.0)
    slow = (1.0 + noise.memory) / (1.0 - noise.memory)
    if wide:
        chance = (1.0 + noise.memory**2) / (1.0 - noise.memory**2) / (law.width_information * support)
        out[:, 0] = without_chance(fits.log_width - float(np.median(fits.log_width)), chance)
    width = np.exp(fits.log_width) * fits.sigma
    for d in np.flatnonzero(moves):
        chance = slow * (2.0 * d + 3.0) * width**2 / (law.information * support)
        out[:, 1 + d] = without_chance(fits.drift[:, d], chance)
    return out


def without_chance(value: FloatArray, variance: FloatArray) -> FloatArray:
    """Values about 0, each moved nearer to 0 so that they spread as the true ones do.

    Parameters
    ----------
    value : (n,) float64
        Measured values.
    variance : (n,) float64
        What chance adds to the variance of each.
    """
    square = max(float(np.mean(value**2 - variance)), 0.0)
    return value * np.sqrt(square / np.maximum(square + variance, 1e-300))


def _with_shape(learner: _Learner, noise: PixelNoise, clusters: Clusters) -> PixelNoise | None:
    """Learn the shape: errors of clusters in two folds of pixels.

    They are located once, under the shape so far: located anew under each shape found, errors crowd where that shape is
    high by chance, and it becomes steeper than the truth from round to round.
    """
    fits = learner.fits(noise, clusters)
    taken = 1.0 + np.count_nonzero(noise.drift_mm)
    stretch = 1.0 / np.sqrt(np.maximum(1.0 - taken / np.maximum(fits.support, taken + 2.0), 0.1))
    error = fits.error * stretch[:, None]
    even = clusters.pixel % 2 == 0
    shape = fit_shape((_errors(error[even]), _errors(error[~even])))
    return None if shape is None else replace(noise, curve=replace(noise.curve, shape=shape))


def _errors(error: FloatArray) -> FloatArray:
    return histogram(error[np.isfinite(error)])


def _with_background(learner: _Learner, noise: PixelNoise) -> PixelNoise:
    """Learn the prior of each pixel's background: a Beta density with the moments of what pixels have."""
    prior = noise.background or FIRST_PRIOR
    pixels = learner.learn.some(MOST_COUNTED)
    for _ in range(_ROUNDS):
        trial = replace(noise, background=prior)
        share, n = background_shares(
            pixels.samples, trial.laws(), learner.beam(trial, pixels), flat_thresholds(), MAX_LAYERS
        )
        prior = beta_prior(share, n)
    return replace(noise, background=prior)


def beta_prior(share: FloatArray, n: FloatArray) -> tuple[float, float]:
    """Pseudo-counts of a Beta density with the mean and the spread of the shares, chance taken off."""
    share, n = share[n > 0], n[n > 0]
    if share.size == 0:
        return FIRST_PRIOR
    mean = min(max(float(share.mean()), 1e-4), 0.99)
    chance = float(np.mean(mean * (1.0 - mean) / n))
    square = max(float(share.var()) - chance, 1e-4 * mean * (1.0 - mean))
    together = min(max(mean * (1.0 - mean) / square - 1.0, 0.5), 50.0)
    return mean * together, (1.0 - mean) * together


def _memory(fits: ClusterFits, noise: PixelNoise) -> float:
    """Correlation of the errors from one frame to the next, over all clusters; 0 where it is within chance.

    The mean and each polynomial of a drift take a part `taken` / n of the slow errors' variance, which is that of all
    errors by (1 + rho) / (1 - rho) for AR(1) noise, from the covariance and from the variance.
    """
    a, b = fits.error[:, :-1], fits.error[:, 1:]
    both = np.isfinite(a) & np.isfinite(b) & (np.abs(a) < 4.0) & (np.abs(b) < 4.0)  # noqa: PLR2004  background is not
    if both.sum() < 100:  # noqa: PLR2004  nothing to tell
        return 0.0
    x, y = a[both], b[both]
    n = max(float(np.median(fits.support)), 2.0)
    seen = float((x * y).mean() / math.sqrt((x * x).mean() * (y * y).mean()))
    taken = 1.0
    for d, scale in enumerate(noise.drift_mm.tolist()):
        told = n * noise.laws()[0].information / (float(np.median(fits.sigma)) ** 2 * (2.0 * d + 3.0))
        taken += told / (told + precision_of_t(0.0, scale)) if scale > 0.0 else 0.0
    found = seen
    for _ in range(_MEMORY_ROUNDS):
        slow = (1.0 + found) / (1.0 - found) * taken / n
        found = min(max(seen + slow * (1.0 - seen), 0.0), _MOST_MEMORY)
    return found if found > max(_MEMORY_WORTH, 3.0 / math.sqrt(both.sum())) else 0.0
