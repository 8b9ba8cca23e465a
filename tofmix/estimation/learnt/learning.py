"""Learn the noise of pixels: sigma by range, shape of the error, width, background and drift of pixels, memory.

1. sigma(r) comes from isolated clusters (`noise.measurement`) and from differences of samples (`noise.series`).
   Where surfaces lie close together, both are too large. So smaller sigmas are tried too, and the one of the largest
   held-out likelihood is kept (`sigma_curve`). Each is judged with the background that it leaves: fog
   seems to be a surface of a wide sigma, where the model has no fog.
2. Parts are added while one gains held-out likelihood, then dropped where the others make them needless (`parts`).
3. The memory of the errors is measured last: it changes no likelihood of a pixel.

Candidates for the noise model, compared by the likelihood of held-out pixels.

Selection of the parts of the noise: forward by held-out gain, then backward.

Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd edition, 2009, sections 3.3.2 and 7.10.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.learnt.folds import Fold, folds_of, whole_fold
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import (
    OF_BACKGROUND,
    PARTS,
    memory_of,
    shrunken_effects,
    with_part,
    without_part,
)
from tofmix.estimation.learnt.shape_fit import shapes_differ
from tofmix.estimation.learnt.sigma_curve import different_starts, first_curves, with_sigma
from tofmix.estimation.noise.training_pixels import Pixels, medians
from tofmix.sensor import NoiseCurve, Sensor


@dataclass(frozen=True, slots=True)
class NoiseCandidate:
    """A model by fold, and its scores.

    Parameters
    ----------
    noises : tuple of PixelNoise
        The model that each fold has learnt from its training pixels.
    scores : (pixel,) float64
        Log likelihood of the held-out pixels of all folds, nat.
    """

    noises: tuple[PixelNoise, ...]
    scores: FloatArray


def candidate_of(folds: Sequence[Fold], noises: Sequence[PixelNoise | None]) -> NoiseCandidate | None:
    """Judge the models of the folds; None where a fold has none."""
    known = tuple(noise for noise in noises if noise is not None)
    if len(known) < len(folds):
        return None
    return NoiseCandidate(known, np.concatenate([fold.scores(noise) for fold, noise in zip(folds, known, strict=True)]))


def held_out_gain(
    one: NoiseCandidate,
    other: NoiseCandidate,
    *,
    standard_errors: float = 3.0,
    least_gain: float = 0.1,
    false_choice: float = 1.0e-3,
) -> float:
    """Gain of the first over the second, nat a pixel; 0 where noise alone may give it, or it changes no count.

    One of two tests must pass. Most pixels gain: the mean is some standard errors above 0. Or a few pixels gain much:
    if the second model were true, the product of the likelihood ratios of held-out pixels would exceed e^g with
    probability e^-g at most, however the first was learnt. The pixel that gains most is left out.

    Parameters
    ----------
    one, other : Candidate
        The models, judged by the same pixels.
    standard_errors : float
        Least mean gain of the first test, in its standard errors.
    least_gain : float
        Least mean gain of both tests, nat a pixel: less changes no count.
    false_choice : float
        Largest probability e^-g of a wrong choice by the second test.

    References
    ----------
    Vovk and Wang, Annals of Statistics 49(3), 2021, doi:10.1214/20-AOS2020: e-values.
    """
    gain, error = mean_difference(one.scores, other.scores)
    if gain > max(standard_errors * error, least_gain):
        return gain
    difference = one.scores - other.scores
    difference = np.sort(difference[np.isfinite(difference)])[:-1]
    if difference.size and difference.sum() > max(math.log(1.0 / false_choice), least_gain * difference.size):
        return float(difference.mean())
    return 0.0


def mean_difference(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Mean of one - other over the pixels (pixel,) that both know, and its standard error; outliers are clipped.

    Fewer than three pixels give 0, with an infinite error.
    """
    difference = one - other
    difference = difference[np.isfinite(difference)]
    if difference.size < 3:  # noqa: PLR2004  two numbers have no robust spread
        return 0.0, math.inf
    middle = float(np.median(difference))
    # Differences of pixels are clipped at so many median absolute deviations, so that no single pixel decides.
    clip_deviations = 10.0
    reach = clip_deviations * MAD_TO_SIGMA * float(np.median(np.abs(difference - middle))) + 1e-9
    difference = np.clip(difference, middle - reach, middle + reach)
    return float(difference.mean()), float(difference.std() / math.sqrt(difference.size)) + 1e-12


def select_parts(
    folds: Sequence[Fold],
    best: NoiseCandidate,
    parts: Sequence[str],
    *,
    required: Sequence[str],
    together: bool = False,
    map_parts: Callable[[Callable[[str], NoiseCandidate | None], Iterable[str]], Iterable[NoiseCandidate | None]],
) -> tuple[NoiseCandidate, list[str]]:
    """Add the part of the largest held-out gain while one gains; then drop parts that the others make needless.

    Parameters
    ----------
    folds : sequence of Fold
        Pixels that teach and pixels that judge.
    best : Candidate
        The model to start from.
    parts : sequence of str
        Names of the parts that may be added; see `parts.PARTS`.
    required : sequence of str
        Parts that are added first, whatever they gain, and kept.
    together : bool
        Whether background is tried together with its density too: a uniform one explains no dense fog, and gains
        nothing alone. It takes time where there is no background.
    map_parts : callable
        Applies a function to several parts: `map`, or the `map` of a pool of threads.

    Returns
    -------
    Candidate
        The model with the selected parts.
    list of str
        The selected parts, in the order of their addition.
    """
    selected: list[str] = []

    def one_more(part: str) -> NoiseCandidate | None:
        return candidate_of(folds, [with_part(fold, one, part) for fold, one in zip(folds, best.noises, strict=True)])

    for part in required:
        trial = one_more(part)
        if trial is not None:
            best = trial
            selected.append(part)
    while len(selected) < len(parts) + len(required):
        left = [part for part in parts if part not in selected]
        if not together and "background" not in selected:
            left = [part for part in left if part != "density"]
        trials = [(part, trial) for part, trial in zip(left, map_parts(one_more, left), strict=True) if trial]
        gains = [held_out_gain(trial, best) for _, trial in trials]
        if max(gains, default=0.0) <= 0.0:
            break
        part, best = trials[int(np.argmax(gains))]
        selected += [part] if part != "density" or "background" in selected else list(OF_BACKGROUND)
    for part in tuple(selected):
        if len(selected) > 1 and part not in required:
            trial = candidate_of(folds, [without_part(noise, part) for noise in best.noises])
            if trial is not None and held_out_gain(best, trial) == 0.0:
                best = trial
                selected.remove(part)
    return best, selected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearntModel:
    """A noise model, and the pixels that it was learnt from.

    Parameters
    ----------
    noise : PixelNoise
        The noise model.
    pixels : int
        Pixels that it was learnt from.
    ranges_mm : (n,) float64
        Ranges of the clusters, mm; without clusters, medians of pixels.
    pixel_effects : (n, 1 + DRIFTS) float64
        Log width and drift, mm, of the clusters of one surface, by `parts.shrunken_effects`.
    kept_start : bool
        Whether no other curve predicts held-out pixels better than the one that was given to start from.
    given_holds : bool
        Whether the curve to compare with predicts held-out pixels as well as the model.
    shapes_differ : bool
        Whether the shape of the error differs between pixels: the model has one for all.
    """

    noise: PixelNoise
    pixels: int
    ranges_mm: FloatArray
    pixel_effects: FloatArray
    kept_start: bool
    given_holds: bool
    shapes_differ: bool


def learn_pixel_noise(
    pixels: Pixels,
    sensor: Sensor,
    start: NoiseCurve | None,
    *,
    shape: bool = True,
    widths: bool | None = None,
    drift: bool = True,
    density: bool = True,
    instead_of: NoiseCurve | None = None,
    workers: int = 1,
) -> LearntModel:
    """Learn the noise from pixels of some windows.

    Parameters
    ----------
    pixels : Pixels
        Pixels that teach and judge.
    sensor : Sensor
        The camera: its working range and p(c_r) are used.
    start : NoiseCurve or None
        A curve measured in another way, which is tried first.
    shape : bool
        Whether the error may have another shape than a Gaussian's.
    widths : bool, optional
        Whether each pixel has a width; None: where the samples show it.
    drift : bool
        Whether the ranges of a pixel may drift within a window.
    density : bool
        Whether background may have a density over range; if not, it is uniform.
    instead_of : NoiseCurve, optional
        A Gaussian curve to compare with.
    workers : int
        Threads; the result does not depend on them.

    Returns
    -------
    LearntModel
        It depends on the pixels, the sensor and the options alone.

    Raises
    ------
    ValueError
        If no two samples of a pixel differ, or none is valid.
    """
    barred = {"shape": not shape, "widths": widths is not None, "drift": not drift, "density": not density}
    parts = tuple(part for part in PARTS if not barred.get(part, False))
    folds = folds_of(pixels, sensor)
    curves = first_curves(pixels, start)
    if not curves:
        raise ValueError("noise: no two samples of a pixel differ, or none is valid")
    chosen, plain = _best_curve(folds, curves, sensor, [part for part in parts if part in OF_BACKGROUND])
    best, added, measured = plain, list[str](), curves[0]
    if plain is not None:
        measured = plain.noises[-1].curve
        with ThreadPoolExecutor(workers, thread_name_prefix="tofmix") as pool:
            best, added = select_parts(
                folds,
                plain,
                parts,
                required=("widths",) if widths else (),
                together=_most_see_more(pixels, measured),
                map_parts=pool.map,
            )
    given_holds = False
    if instead_of is not None and best is not None:
        given = PixelNoise.gaussian(instead_of, sensor.outlier_probability)
        trial = candidate_of(folds, [given] * len(folds))
        given_holds = trial is not None and held_out_gain(best, trial) == 0.0
    whole = whole_fold(pixels, sensor)
    noise = with_sigma(whole, PixelNoise.gaussian(measured, sensor.outlier_probability))
    for part in added:
        noise = with_part(whole, noise, part) or noise
    clusters = whole.clusters(noise)
    fits = whole.fits(noise, clusters)
    if pixels.step is None or not pixels.is_coarse(noise.curve):
        noise = replace(noise, memory=memory_of(fits, noise))
    if noise.memory > 0.0:
        noise = with_sigma(whole, noise)
    ranges = fits.place if len(fits.place) else medians(pixels.samples)
    return LearntModel(
        noise=noise,
        pixels=len(pixels.samples),
        ranges_mm=np.asarray(ranges),
        pixel_effects=shrunken_effects(whole, noise),
        kept_start=chosen is curves[0] and start is not None,
        given_holds=given_holds,
        shapes_differ=shapes_differ(whole.smooth_errors(fits, clusters)),
    )


def _most_see_more(pixels: Pixels, curve: NoiseCurve) -> bool:
    """Whether most pixels have samples farther from their median than the noise of a surface reaches."""
    far_sigmas = 8.0  # more than the tails of any shape reach in most pixels
    samples = pixels.samples[np.isfinite(pixels.samples).any(axis=1)]
    middle = medians(samples)[:, np.newaxis]
    with np.errstate(invalid="ignore"):
        far = np.abs(samples - middle) > far_sigmas * curve.sigma(middle)
    return bool(far.any(axis=1).mean() > 0.5)  # noqa: PLR2004  most


def _best_curve(
    folds: Sequence[Fold], curves: Sequence[NoiseCurve], sensor: Sensor, parts: Sequence[str]
) -> tuple[NoiseCurve, NoiseCandidate | None]:
    """Return the start that predicts held-out pixels best, and the Gaussian noise measured from it, if any.

    Where several starts lead to different curves, each is judged with the `parts` of the background, if they gain:
    without them the widest curve alone explains fog. Its noise then has the sigma that was measured beside them.
    """
    starts = [(curve, candidate_of(folds, noises)) for curve, noises in different_starts(folds, curves, sensor)]
    known = [(curve, plain) for curve, plain in starts if plain is not None]
    if not known:
        return curves[0], None
    chosen, best = known[0], None
    for curve, plain in known:
        trial = _with_parts(folds, plain, parts) if len(known) > 1 else plain
        if best is None or held_out_gain(trial, best) > 0.0:
            chosen, best = (curve, plain if trial is plain else _without(folds, trial, parts)), trial
    return chosen


def _without(folds: Sequence[Fold], candidate: NoiseCandidate, parts: Sequence[str]) -> NoiseCandidate:
    """The candidate without parts; its sigma stays."""
    noises = candidate.noises
    for part in parts:
        noises = tuple(without_part(noise, part) for noise in noises)
    return candidate_of(folds, noises) or candidate


def _with_parts(folds: Sequence[Fold], plain: NoiseCandidate, parts: Sequence[str]) -> NoiseCandidate:
    """The candidate with all of the parts, and with sigma measured under them; as it is where they gain nothing."""
    noises = []
    for fold, noise in zip(folds, plain.noises, strict=True):
        for part in parts:
            noise = with_part(fold, noise, part) or noise  # noqa: PLW2901
        noises.append(with_sigma(fold, noise))
    trial = candidate_of(folds, noises)
    return plain if trial is None or held_out_gain(trial, plain) == 0.0 else trial
