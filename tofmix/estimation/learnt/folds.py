"""Cross-validation: the pixels of a fold teach a model of the noise, and others judge it.

Held-out likelihood: of samples that no fit has seen, in pixels that the noise was not learnt from.
"""

from collections import OrderedDict
from contextlib import suppress
from dataclasses import replace

import numpy as np

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import Beam, PixelCurves, all_steps, beam_of, steps_of
from tofmix.estimation.learnt.acceleration import LEARNING_ITER, LEARNING_TOL, maximise
from tofmix.estimation.learnt.background import (
    PixelWidths,
    background_counts,
    background_shares,
    cell_edges,
    pixel_widths,
)
from tofmix.estimation.learnt.clusters import ClusterFits, cluster_likelihoods, find_clusters, fit_clusters
from tofmix.estimation.learnt.components import LEAST_SAMPLES, TOTAL, Samples, fill_cells, fill_times, take_samples
from tofmix.estimation.learnt.counting import LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, LearntRules, count_surfaces
from tofmix.estimation.learnt.em import background_density, mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.model import GainThresholds, PixelNoise
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.estimation.mixture.counting import FALSE_ALARMS
from tofmix.estimation.noise.amplitude import beam_of_pixel, pixel_curves
from tofmix.estimation.noise.isolated_clusters import LEAST_CLUSTERS, LEAST_TO_CLUSTER, WEAK_PRIOR, Clusters
from tofmix.estimation.noise.series import SEED
from tofmix.estimation.noise.training_pixels import MANY_PIXELS, Pixels
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor

PARTS = 4
"""Parts of the frames of a pixel, each predicted by a fit to the others. A fit to fewer samples predicts badly under
the true noise too, above all where a shape is steep."""

LEAST_GAIN = 7.0
"""Threshold of a further surface under any model, nat: for Gaussian noise it is 6 at one false alarm in 1000."""


SURPRISES = 0.02
"""Share of background that is mixed into every model: samples of a surface that no other frame shows are improbable
under all models, and must not decide between them."""

_CHANCES = len(FALSE_ALARMS)
_MULTIPLIER, _BITS = 0x9E3779B1, 0xFFFFFFFF
"""Hash of a frame: the factor is 2^32 by the golden ratio, odd (Knuth, The Art of Computer Programming 3, 6.4)."""


def flat_thresholds(*, always_one: bool = False) -> GainThresholds:
    """Make thresholds that are the same for all models and samples: those of a model are known after its choice.

    With `always_one`, each pixel has a surface. A model without background by pixel must not explain a pixel by
    background alone.
    """
    no_surface_nats = 1.0e9  # threshold of the first surface where each pixel has one, below 0: no gain is as low
    # Threshold of the first surface over background alone, nat. It is low because the background may span few sigmas: a
    # pixel with a surface must not pass for background. A pixel without surfaces costs all models the same.
    least_first_gain = 4.0
    return GainThresholds(
        log_n=np.zeros(1),
        background=np.zeros(1),
        more=np.full((1, 1, _CHANCES), LEAST_GAIN) + 1e-9 * np.arange(_CHANCES),
        first=np.full((1, _CHANCES), -no_surface_nats if always_one else least_first_gain) + 1e-9 * np.arange(_CHANCES),
    )


@borrowing
def _part_of(frame: int) -> int:
    """Part of a frame, 0 to PARTS - 1, by a hash: surfaces, or targets of a frame, may come in turn."""
    mixed = (frame + 1) * _MULTIPLIER & _BITS
    mixed = (mixed ^ mixed >> 15) * _MULTIPLIER & _BITS
    return (mixed ^ mixed >> 13) % PARTS


@jit
def held_out_scores(
    samples: Float32Array, laws: tuple[Law, Law], beam: Beam, thresholds: GainThresholds, max_layers: int
) -> tuple[FloatArray, FloatArray]:
    """Log likelihood of each of `PARTS` of a pixel's frames under a fit to the others.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples, mm, NaN where invalid.
    laws : (Law, Law)
        The noise, with and without drift.
    beam : Beam
        The fixed part of equation (1).
    thresholds : Thresholds
        Gains that surfaces must have; see `flat_thresholds`.
    max_layers : int
        Most surfaces of a pixel.

    Returns
    -------
    (pixel,) float64
        Sum over the parts, nat; NaN where a pixel has too few samples.
    (pixel,) float64
        Mean number of surfaces.
    """
    pixels, frames = samples.shape
    out, found = np.full(pixels, np.nan), np.zeros(pixels)
    value, time = np.empty(frames), np.empty(frames)
    part = np.empty(frames, dtype=np.float32)
    work = new_workspace(max_layers + 1, frames, _CHANCES)
    rules = LearntRules(LEARNING_FALSE_ALARM, LEARNING_NO_RETURN_GAIN, max_layers)
    for pixel in range(pixels):
        own = beam_of_pixel(beam, pixel)
        total, count = 0.0, 0
        for held in range(PARTS):
            for frame in range(frames):
                part[frame] = samples[pixel, frame] if _part_of(frame) != held else np.nan
            n = take_samples(part, value, time)
            if n < LEAST_SAMPLES:
                continue
            data = Samples(value[:n], time[:n])
            fill_times(data, work.scratch)
            fill_cells(data, own, work.scratch)
            k, law = count_surfaces(data, work, laws, own, thresholds, rules)
            maximise(data, k, work.fit, law, own, LEARNING_ITER, LEARNING_TOL, work.scratch)
            found[pixel] += k / PARTS
            for frame in range(frames):
                part[frame] = samples[pixel, frame] if _part_of(frame) == held else np.nan
            m = take_samples(part, value, time)
            if m == 0:
                continue
            seen = Samples(value[:m], time[:m])
            fill_times(seen, work.scratch)
            fill_cells(seen, own, work.scratch)
            mix(seen, k, work.fit, law, own, work.scratch)
            floor = SURPRISES * background_density(own)
            for j in range(m):
                total += np.log((1.0 - SURPRISES) * work.scratch[TOTAL, j] + floor)
            count += m
        if count > 0:
            out[pixel] = total
    return out, found


MAX_LAYERS = 4
"""Most surfaces of a pixel while the noise is learnt."""

MOST_COUNTED = 600
"""Most pixels whose surfaces are counted, to measure backgrounds or widths."""

MOST_FOR_DENSITY = 300
"""Most pixels whose surfaces are counted, to measure the density of background."""


class Fold:
    """Pixels that teach, other pixels that judge, and their camera.

    Parameters
    ----------
    training : Pixels
        Pixels that models are learnt from.
    held_out : Pixels
        Pixels that models are judged by; none, where all pixels teach.
    sensor : Sensor
        The camera; its noise is not used.
    """

    def __init__(self, training: Pixels, held_out: Pixels, sensor: Sensor) -> None:
        self.training, self.held_out, self._sensor = training, held_out, sensor
        self._some: dict[int, Pixels] = {}
        self._curves: OrderedDict[tuple[int | bytes, ...], PixelCurves] = OrderedDict()
        self._clusters: tuple[NoiseCurve, Clusters] | None = None
        self._single: tuple[PixelNoise, Clusters, Clusters] | None = None

    def _beam(self, noise: PixelNoise, pixels: Pixels) -> Beam:
        beam = beam_of(replace(self._sensor, noise=noise.curve))
        if noise.curve.law is not None and pixels.amplitude is not None and len(pixels.samples):
            beam = beam._replace(
                pixel_curves=self._pixel_curves(noise.curve, noise.curve.law, pixels, pixels.amplitude)
            )
        return beam._replace(steps=steps_of(pixels.step, noise.curve)) if pixels.step is not None else beam

    def _pixel_curves(
        self, curve: NoiseCurve, law: AmplitudeLaw, pixels: Pixels, amplitude: Float32Array
    ) -> PixelCurves:
        """Curves of pixels, kept for the next fits: parts of the noise beyond sigma do not change them."""
        read = curve.range_mm, curve.sigma_mm, law.reference, law.amplitude, law.factor
        key: tuple[int | bytes, ...] = (id(pixels), *(values.tobytes() for values in read))
        found = self._curves.get(key)
        if found is None:
            found = pixel_curves(pixels.samples.T, amplitude.T, curve)
            self._curves[key] = found
            with suppress(KeyError):  # another thread may have removed it
                # Sets of pixels' curves that a fold keeps: those of some training pixels, of all, and of the held-out
                # ones.
                curves_kept = 4
                while len(self._curves) > curves_kept:
                    self._curves.popitem(last=False)
        return found

    def _training_pixels(self, most: int) -> Pixels:
        """At most `most` training pixels, evenly spread; the same object at each call."""
        known = self._some.get(most)
        return self._some.setdefault(most, self.training.some(most)) if known is None else known

    def smooth_errors(self, fits: ClusterFits, clusters: Clusters) -> FloatArray:
        """Standardised errors (cluster, frame) of fits, with the rounding of the samples spread over its step."""
        if self.training.step is None:
            return fits.error
        rounding = (self.training.smooth - self.training.samples)[clusters.pixel]
        return fits.error + rounding / (fits.sigma * np.exp(fits.log_width))[:, None]

    def rounding_variance(self, range_mm: FloatArray, sigma_mm: FloatArray) -> FloatArray:
        """Variance of the rounding over that of the noise (n,), at ranges (n,), mm, with sigma (n,), mm."""
        step = self.training.step
        return np.zeros(len(range_mm)) if step is None else np.asarray((step.rounding(range_mm) / sigma_mm) ** 2)

    def steps_at(self, range_mm: FloatArray, pixel: IntArray) -> FloatArray:
        """Step, mm, at ranges (n,), mm, of training pixels (n,); 0 where fits do not integrate over it."""
        step = self.training.step
        return np.zeros(len(range_mm)) if step is None else step.at(range_mm, pixel)

    def sigma_likelihoods(self, noise: PixelNoise, clusters: Clusters, fits: ClusterFits) -> FloatArray:
        """Log likelihood (cluster, `SIGMAS`) of each sigma by the step, in which every range in the step is as likely.

        Raises
        ------
        ValueError
            If the samples have no step that matters.
        """
        if self.training.step is None:
            raise ValueError("the samples have no step")
        step = self.training.step.at(fits.place, clusters.pixel)
        beam = self._beam(noise, self.training)._replace(steps=all_steps(self.training.step))
        samples = self.training.samples
        return cluster_likelihoods(samples, clusters, fits.place, fits.support, step, noise.laws()[1], beam)

    def scores(self, noise: PixelNoise) -> FloatArray:
        """Log likelihood (pixel,) of the held-out pixels, nat, by `held_out_scores`."""
        beam = self._beam(noise, self.held_out)
        thresholds = flat_thresholds(always_one=noise.background is None)
        found, _ = held_out_scores(self.held_out.samples, noise.laws(), beam, thresholds, MAX_LAYERS)
        return found

    def clusters(self, noise: PixelNoise) -> Clusters:
        """Isolated clusters of the training pixels; none where most have fewer than `LEAST_TO_CLUSTER` samples.

        They depend on the curve of the noise alone. Those of the last curve are kept.
        """
        known = self._clusters
        if known is None or known[0] is not noise.curve:
            known = self._clusters = noise.curve, self._found_clusters(noise)
        return known[1]

    def _found_clusters(self, noise: PixelNoise) -> Clusters:
        samples = self.training.samples
        filled = np.isfinite(samples).sum(axis=1)
        if filled.any() and np.median(filled[filled > 0]) < LEAST_TO_CLUSTER:
            return Clusters(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        return find_clusters(samples, self._beam(noise, self.training))

    def fits(self, noise: PixelNoise, clusters: Clusters, *, second: bool = False) -> ClusterFits:
        """One surface fitted to each cluster; with `second`, also the gain of a second one."""
        free = replace(noise, background=noise.background or WEAK_PRIOR)
        return fit_clusters(self.training.samples, clusters, free.laws()[0], self._beam(noise, self.training), second)

    def single_surfaces(self, noise: PixelNoise) -> tuple[Clusters, Clusters]:
        """Clusters of the training pixels, and those in which a second surface gains less than `LEAST_GAIN`.

        Those of the last noise are kept: each part of the noise is tried with them.
        """
        known = self._single
        if known is None or known[0] is not noise:
            clusters = self.clusters(noise)
            single = self.singles_of(noise, clusters) if len(clusters.pixel) >= LEAST_CLUSTERS else clusters
            known = self._single = noise, clusters, single
        return known[1:]

    def singles_of(self, noise: PixelNoise, clusters: Clusters) -> Clusters:
        """Clusters in which a second surface gains less than `LEAST_GAIN`; all where it gains more in most."""
        single = self.fits(noise, clusters, second=True).gain < LEAST_GAIN
        # A wrong shape splits most clusters: then a split shows the shape, and not a second surface.
        if 2 * single.sum() <= len(single):
            return clusters
        return Clusters(clusters.pixel[single], clusters.low[single], clusters.high[single])

    def widths(self, noise: PixelNoise, free: PixelNoise) -> PixelWidths:
        """Widths of some training pixels under `free`, of the surfaces that are counted under `noise`."""
        pixels = self._training_pixels(MOST_COUNTED)
        beam = self._beam(noise, pixels)
        return pixel_widths(pixels.samples, noise.laws(), free.laws()[0], beam, flat_thresholds(), MAX_LAYERS)

    def background_shares(self, noise: PixelNoise) -> tuple[FloatArray, FloatArray]:
        """Share of background and number of samples (pixel,) of some training pixels."""
        pixels = self._training_pixels(MOST_COUNTED)
        return background_shares(pixels.samples, noise.laws(), self._beam(noise, pixels), flat_thresholds(), MAX_LAYERS)

    def cell_edges(self, noise: PixelNoise, cell_sigmas: float) -> FloatArray:
        """Edges (cell + 1,) of cells of the density of background, mm."""
        beam = self._beam(noise, self.training)
        return cell_edges(noise.curve, beam.range_min, beam.range_top, cell_sigmas)

    def counts(self, edges: FloatArray) -> FloatArray:
        """Number (cell,) of all samples of some training pixels between edges, mm."""
        samples = self._training_pixels(MOST_FOR_DENSITY).samples
        return np.histogram(samples[np.isfinite(samples)], edges)[0].astype(np.float64)

    def background_counts(self, noise: PixelNoise, edges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Number (cell,) of those that are background; and share and number of samples (pixel,) of these pixels."""
        pixels = self._training_pixels(MOST_FOR_DENSITY)
        beam = self._beam(noise, pixels)
        return background_counts(pixels.samples, noise.laws(), beam, flat_thresholds(), MAX_LAYERS, edges)


def folds_of(pixels: Pixels, sensor: Sensor) -> list[Fold]:
    """Split pixels into thirds: one third judges; where pixels are few, each third in turn."""
    count = len(pixels.samples)
    folds = 3  # parts of the pixels: two thirds teach, one third judges
    part = np.random.default_rng(SEED).permutation(count) % folds  # neighbours are alike: no fold has them all
    turns = range(folds) if count < MANY_PIXELS else [folds - 1]
    return [Fold(pixels.chosen(part != turn), pixels.chosen(part == turn), sensor) for turn in turns]


def whole_fold(pixels: Pixels, sensor: Sensor) -> Fold:
    """Make a fold in which all pixels teach and none judges."""
    return Fold(pixels, pixels.chosen(np.zeros(len(pixels.samples), dtype=np.bool_)), sensor)
