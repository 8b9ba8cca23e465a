"""Learn the noise of pixels: sigma by range, shape of the error, width, background and drift of pixels, memory.

1. sigma(r) comes from isolated clusters (`noise.measurement`) and from differences of samples (`pair_differences`).
   Where surfaces lie close together, both are too large. So smaller sigmas are tried too, and the one of the largest
   held-out likelihood is kept (`sigma_curve`, `candidates`). Each is judged with the background that it leaves: fog
   seems to be a surface of a wide sigma, where the model has no fog.
2. Parts are added while one gains held-out likelihood, then dropped where the others make them needless (`parts`,
   `selection`).
3. The memory of the errors is measured last (`memory`): it changes no likelihood of a pixel.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.candidates import NoiseCandidate, candidate_of, held_out_gain
from tofmix.estimation.learnt.folds import Fold, folds_of, whole_fold
from tofmix.estimation.learnt.memory import centred, memory_of
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.parts import OF_BACKGROUND, PARTS, shrunken_effects, with_part
from tofmix.estimation.learnt.selection import select_parts
from tofmix.estimation.learnt.shape_fit import shapes_differ
from tofmix.estimation.learnt.sigma_curve import different_starts, first_curves, with_sigma
from tofmix.estimation.noise.training_pixels import Pixels, medians
from tofmix.sensor import NoiseCurve, Sensor


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
            best, added = select_parts(folds, plain, parts, required=("widths",) if widths else (), map_parts=pool.map)
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
    if pixels.step is None:
        noise = replace(noise, memory=memory_of(fits, noise))
    elif not pixels.is_coarse(noise.curve):
        noise = replace(noise, memory=memory_of(fits._replace(error=centred(fits.error)), noise))
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


def _best_curve(
    folds: Sequence[Fold], curves: Sequence[NoiseCurve], sensor: Sensor, parts: Sequence[str]
) -> tuple[NoiseCurve, NoiseCandidate | None]:
    """Return the start that predicts held-out pixels best, and the Gaussian noise measured from it, if any.

    Where several starts lead to different curves, each is judged with the `parts` of the background, if they gain:
    without them the widest curve alone explains fog.
    """
    starts = [(curve, candidate_of(folds, noises)) for curve, noises in different_starts(folds, curves, sensor)]
    known = [(curve, plain) for curve, plain in starts if plain is not None]
    if not known:
        return curves[0], None
    chosen, best = known[0], None
    for curve, plain in known:
        trial = _with_parts(folds, plain, parts) if len(known) > 1 else plain
        if best is None or held_out_gain(trial, best) > 0.0:
            chosen, best = (curve, plain), trial
    return chosen


def _with_parts(folds: Sequence[Fold], plain: NoiseCandidate, parts: Sequence[str]) -> NoiseCandidate:
    """The candidate with all of the parts, and with sigma measured under them; as it is where they gain nothing."""
    noises = []
    for fold, noise in zip(folds, plain.noises, strict=True):
        for part in parts:
            noise = with_part(fold, noise, part) or noise  # noqa: PLW2901
        noises.append(with_sigma(fold, noise))
    trial = candidate_of(folds, noises)
    return plain if trial is None or held_out_gain(trial, plain) == 0.0 else trial
