"""The errors of a measured scene, as parts of the likelihood.

A scene that was recorded is known as well as its recording tells: each pixel's mean to s^2 v / n, its width to
1 / 2n, its shares to their counts; and the noise that all samples of a frame share moves all means together. So each
pixel has a bias with a normal prior of known variance, and all have one more in common. Both are integrated out of the
log-likelihood, with its slope s and information I about the present model:

    L + s^2 / 2I - x^2 / 2 (v / I + V) - log(1 + I V / v) / 2,    x = s / I

Use `ReferenceErrors.of` for a scene; `Likelihood` does the rest.

References
----------
Kennedy and O'Hagan, J. R. Statist. Soc. B 63 (2001) 425, for a discrepancy that is integrated out.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.measured_scene import NONE_LOST, OWN_ERROR, UNKNOWN_WALK, MeasuredScene

_LEAST_INFORMATION = 1e-12  # 1/mm2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceErrors:
    """The errors of a measured scene. Arrays are (pixel,).

    Parameters
    ----------
    sigma_mm : sigma of the main layer, mm.
    variance_mm2 : variance of each pixel's mean, mm2.
    log_width : standard error of the logarithm of its width.
    lent_log_width : error of the logarithm of its width that all pixels of its surface share.
    shares : variance that errors of the shares add to the means of its scores, in pixels of several layers.
    lost : variance of its share of lost samples, by its own frames.
    lost_share : its share of lost samples, as it may be: above 0 where none was lost.
    lost_worth : float
        The frames of the image, over those of the pixel, that tell its share of lost samples.
    common_lost : float
        Standard error of the logarithm of all shares of lost samples together.
    common : float
        Variance of what all means have in common, in sigma squared.
    common_log_width : float
        Standard error of the logarithm of all widths together.
    frame_noise : float
        Standard deviation of what the samples of one frame have in common, in sigma.
    walks : tuple of float
        Probability of each size of a walk of all means.
    frames : int
        Frames of the scene.
    """

    sigma_mm: FloatArray
    variance_mm2: FloatArray
    log_width: FloatArray
    lent_log_width: FloatArray
    shares: FloatArray
    lost: FloatArray
    lost_share: FloatArray
    lost_worth: float
    common_lost: float
    common: float
    common_log_width: float
    frame_noise: float
    walks: tuple[float, ...] = UNKNOWN_WALK
    frames: int = 1

    @classmethod
    def of(cls, scene: MeasuredScene, mixture: Mixture) -> Self:
        """The errors of a scene, with the prediction of its model."""
        sigma, known = mixture.of_main(mixture.sigma), scene.known.ravel()
        relative = np.where(known, scene.mean_variance().ravel(), 0.0)
        several = ((scene.surface >= 0).sum(axis=2) + (scene.no_return > 0) > 1).ravel()
        given, frames = scene.lost.ravel(), max(scene.frames, 1)
        seen, samples = given < 1.0, max(frames * int((given < 1.0).sum()), 1)
        total = max(frames * float(given[seen].sum()), NONE_LOST)
        lost = np.where(seen, np.maximum(given, NONE_LOST / samples), given)
        # Samples without a return have no range, so the mean is that of the main layer, however few samples it has
        share, error = scene.of_main(scene.share).ravel(), scene.of_main(scene.range_error_mm).ravel()
        of_mean = scene.repeats * error**2 + (OWN_ERROR * sigma) ** 2
        by_count = relative / np.where(share > 0, share, 1.0) * sigma**2
        return cls(
            sigma_mm=sigma,
            variance_mm2=np.where(known & np.isfinite(error), of_mean, by_count),
            log_width=np.where(known, scene.width_error().ravel(), 0.0),
            lent_log_width=scene.lent_log_width().ravel(),
            shares=np.where(several, relative, 0.0),
            lost=lost * (1.0 - lost) / (frames + 1.0) * scene.repeats,
            lost_share=np.where(seen, lost, 0.0),
            lost_worth=scene.lost_worth / frames,
            common_lost=math.sqrt(scene.repeats / total),
            common=scene.frame_variance() + (scene.middle_error_mm / float(np.median(sigma[known]))) ** 2
            if known.any()
            else scene.frame_variance(),
            common_log_width=scene.common_width_error(),
            frame_noise=scene.frame_noise,
            walks=scene.walks or UNKNOWN_WALK,
            frames=scene.frames,
        )

    @property
    def lost_frames(self) -> FloatArray:
        """Independent frames (pixel,) that tell the share of lost samples, with those that the image lends; or 0."""
        share = self.lost_share
        by_own = share * (1.0 - share) / np.where(self.lost > 0, self.lost, 1.0)
        return np.asarray(by_own * (1.0 + self.lost_worth))

    @property
    def typical_log_width(self) -> float:
        """The median standard error of the logarithm of a width; 0 if no pixel is known."""
        known = self.log_width > 0
        return float(np.median(self.log_width[known])) if known.any() else 0.0

    def common_to(self, frames: int, memory: float) -> float:
        """Variance of what all means over some frames have in common, less those of the scene, in sigma squared."""
        return self.common + (1.0 + memory) / (1.0 - memory) * self.frame_noise**2 / max(frames, 1)

    def marginal(
        self, sums: FloatArray, variance_mm2: FloatArray, repeats: float, frames: int
    ) -> tuple[FloatArray, float]:
        """What the errors change in a log-likelihood.

        Parameters
        ----------
        sums : (pixel, 4) float64
            Sums of a pass: log-likelihood, its slope (1/mm) and information (1/mm2) in a bias, and samples.
        variance_mm2 : (pixel,) float64
            Of each pixel's bias: the scene's, or what a pattern leaves of it.
        repeats : float
            v: frames that are worth one independent frame, by the memory of the noise.
        frames : int
            Frames of the pass.

        Returns
        -------
        by_pixel : (pixel,) float64
            Of each pixel's bias, nats.
        common : float
            Of the common one, nats.
        """
        slope, information = sums[:, 1], sums[:, 2]
        told = information > _LEAST_INFORMATION
        safe = np.where(told, information, 1.0)
        free = repeats + safe * variance_mm2
        by_pixel = 0.5 * slope**2 / safe * (1.0 - 1.0 / free) - 0.5 * np.log(free / repeats)
        shared = self.common_to(frames, (repeats - 1.0) / (repeats + 1.0))
        pull = float((slope / free * self.sigma_mm)[told].sum())
        known = float((safe / free * self.sigma_mm**2)[told].sum())
        common = 0.5 * shared * pull**2 / (1.0 + shared * known) - 0.5 * float(np.log1p(shared * known))
        return np.where(told, by_pixel, 0.0), common
