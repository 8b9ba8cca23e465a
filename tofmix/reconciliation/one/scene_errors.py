"""The errors of what a model knows of its scene: the interface by which the one search takes them.

A scene of rectangles is given, and has none. A measured scene is known as well as its recording tells:

- the mean of each pixel to the variance `own_variance_mm2`, and all means together by `columns_mm`;
- the width of its noise to `log_width_variance`, those of a surface together to `lent_log_width`, and all of them to
  `common_log_width`;
- its share of lost samples as from `lost_frames` frames: the number of lost samples is beta-binomial; and all shares
  together to `common_lost`;
- the noise that all samples of a frame share goes on while the recording is measured, so that a course in time is known
  to `frame_noise_mm` in each frame, however many pixels show it;
- where the recording shows it, all samples wander together, as the ranges of a real camera do within minutes: a course
  in time is a random walk, whose size is integrated out (`tofmix.reconciliation.likelihood.wander`).

The first two are parts of covariances (`tofmix.reconciliation.one.static_errors`); the others are integrated out of the
log-likelihood here, in closed form.

`Edges` is what any scene has whose surfaces are a little off: a surface that is moved along its normal has its edges
elsewhere in the image. So pixels that several surfaces share have other shares, and some see through a gap between two
surfaces that touch in the model.

References
----------
Skellam, J. R. Statist. Soc. B 10 (1948) 257, for the beta-binomial distribution; Searle, Casella and McCulloch,
Variance Components, 4.3, for what the samples of a frame share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import betaln, logsumexp

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.reconciliation.likelihood import wander
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.reference_errors import ReferenceErrors
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.events import Truth
from tofmix.simulation.measured_scene import UNKNOWN_WALK
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneErrors:
    """The errors of a scene in one recording. Use `SceneErrors.of` or `SceneErrors.none`.

    Parameters
    ----------
    columns_mm : (k, pixel) float64
        Errors that all means have in common, mm, with unit priors.
    own_variance_mm2 : (pixel,) float64
        Variance of the mean of each pixel.
    log_width_variance : (pixel,) float64
        Variance of the logarithm of each pixel's width.
    lent_log_width : (pixel,) float64
        Error of the logarithm of each pixel's width that all pixels of its surface share.
    common_log_width : float
        Standard error of the logarithm of all widths together.
    lost_frames : (pixel,) float64
        Independent frames that tell the share of lost samples; 0 where it is given.
    lost_share : (pixel,) float64
        The scene's share of lost samples.
    common_lost : float
        Standard error of the logarithm of all shares of lost samples together.
    frame_noise_mm : float
        Standard deviation of what the samples of one frame have in common.
    typical_mm : float
        Noise of a typical sample, mm.
    walks : tuple of float
        Probability of each of `WALKS`.
    longer : float
        Length of this recording over that of the scene.
    wanders : bool
        Whether all means wander together, as these samples show.
    """

    columns_mm: FloatArray
    own_variance_mm2: FloatArray
    log_width_variance: FloatArray
    lent_log_width: FloatArray
    common_log_width: float
    lost_frames: FloatArray
    lost_share: FloatArray
    common_lost: float
    frame_noise_mm: float
    typical_mm: float
    walks: tuple[float, ...] = UNKNOWN_WALK
    longer: float = 1.0
    wanders: bool = False

    @classmethod
    def none(cls, pixels: int) -> Self:
        """Those of a scene that is given."""
        nothing = np.zeros(pixels)
        return cls(
            columns_mm=np.zeros((0, pixels)),
            own_variance_mm2=nothing,
            log_width_variance=nothing,
            lent_log_width=nothing,
            common_log_width=0.0,
            lost_frames=nothing,
            lost_share=nothing,
            common_lost=0.0,
            frame_noise_mm=0.0,
            typical_mm=0.0,
        )

    def wandering(self) -> Self:
        """The same where all means wander."""
        return replace(self, wanders=True)

    @classmethod
    def of(cls, errors: ReferenceErrors | None, mixture: Mixture, frames: int, memory: float) -> Self:
        """Those of a measured scene; `none` without any.

        Parameters
        ----------
        errors : ReferenceErrors or None
            Errors of the scene; None if it is given.
        mixture : Mixture
            The prediction of the model as given.
        frames : int
            Frames of the measured recording.
        memory : float
            Coefficient of the memory of the noise in the model as given.
        """
        lit = mixture.of_main(mixture.lit).astype(bool)
        if errors is None:
            return cls.none(lit.size)
        shared = errors.common_to(frames, memory)
        share = mixture.invalid[0]
        told = (errors.lost > 0) & (share < 1)
        weight = np.where(lit, 1.0 / errors.sigma_mm**2, 0.0)
        # of a shift of every pixel by its own sigma, the shift of all by as many mm that is nearest to it
        typical = float((weight * errors.sigma_mm).sum() / max(float(weight.sum()), 1e-300))
        return cls(
            columns_mm=np.where(lit, np.sqrt(shared) * errors.sigma_mm, 0.0)[None]
            if shared
            else np.zeros((0, lit.size)),
            own_variance_mm2=errors.variance_mm2,
            log_width_variance=errors.log_width**2,
            lent_log_width=errors.lent_log_width,
            common_log_width=errors.common_log_width,
            lost_frames=np.where(told, errors.lost_frames, 0.0),
            lost_share=errors.lost_share,
            common_lost=errors.common_lost,
            frame_noise_mm=errors.frame_noise * typical,
            typical_mm=typical,
            walks=errors.walks,
            longer=frames / max(errors.frames, 1),
        )

    def by_frames(self, slope: FloatArray, information: FloatArray) -> FloatArray:
        """What a bias of each frame changes in the log-likelihood (frame,), nats, beside the mean of all frames.

        Parameters
        ----------
        slope, information : (frame,) float64
            Of the log-likelihood in a bias of all samples of the frame, 1/mm and 1/mm2. The mean of all frames is an
            error of all means, which `columns_mm` has.
        """
        variance = self.frame_noise_mm**2
        if not variance:
            return np.zeros(slope.shape)
        left = slope - information * float(slope.sum()) / max(float(information.sum()), 1e-300)
        free = 1.0 + information * variance
        return np.asarray(0.5 * left**2 * variance / free - 0.5 * np.log(free))

    def by_course(self, slope: FloatArray, information: FloatArray) -> float:
        """What a walk of the means of all samples changes in the log-likelihood, nats, beside their mean over time.

        Parameters
        ----------
        slope, information : (frame,) float64
            As of `by_frames`, of independent samples.
        """
        free = (1.0 + information * self.frame_noise_mm**2) / self.typical_mm
        own = wander.gains(slope / free, information * self.typical_mm / free, longer=self.longer)
        return wander.gain(own, self.walks)

    def by_lost(self, lost: IntArray, frames: int, share: FloatArray, known: BoolArray | None = None) -> float:
        """What errors of the shares of lost samples change in the log-likelihood, nats.

        Parameters
        ----------
        lost : (pixel,) int64
            Lost samples.
        frames : int
            Frames of the recording.
        share : (pixel,) float64
            Predicted share of lost samples.
        known : (pixel,) bool
            Pixels of which the scene tells it; all without it.
        """
        least = 1e-6  # probability of a lost sample, as of the pass over samples
        nodes = 9  # of the integral over the logarithm of all shares
        told = (self.lost_frames > 0) & (share < 1) & (True if known is None else known)
        p, k, worth = np.maximum(share[told], least), lost[told], self.lost_frames[told]
        binomial = float((k * np.log(p) + (frames - k) * np.log1p(-p)).sum())
        of_effects = np.maximum(share[told] - self.lost_share[told], 0.0)
        place, weight = np.polynomial.hermite_e.hermegauss(nodes if self.common_lost else 1)
        of_all = np.exp(self.common_lost * (place - 0.5 * self.common_lost))  # its mean is 1
        nats = np.empty(place.size)
        for number, factor in enumerate(of_all):
            now = np.clip(of_effects + self.lost_share[told] * factor, least, 1.0 - least)
            a, b = worth * now, worth * (1.0 - now)
            nats[number] = float((betaln(k + a, frames - k + b) - betaln(a, b)).sum())
        return float(logsumexp(nats, b=weight / weight.sum())) - binomial


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The scene of one recording, to be cast with its surfaces moved. Use `Edges.of`.

    Parameters
    ----------
    model : Model
        The model.
    surface : (component, n) int64
        The surface of each component; -1 for none, as of what meets no surface.
    """

    model: Model
    surface: IntArray
    _pixels: IntArray
    _caster: PolygonCaster
    _given: FloatArray  # (component, n), shares
    _normal_per_range: FloatArray  # (surface,), shift along its normal for 1 mm of range in the median pixel

    @classmethod
    def of(cls, model: Model, pixels: IntArray, alone: Sequence[BoolArray]) -> "Edges":
        """Cast the model as it is.

        Parameters
        ----------
        model : Model
            Of rectangles.
        pixels : (n,) int64
            The pixels that surfaces share.
        alone : sequence of (pixel,) bool
            The pixels that see each surface alone.
        """
        caster = PolygonCaster(model.sensor)
        seen = caster.cast(_bare(model, model.surfaces))
        layers = seen.surface.shape[2]
        surface = np.concatenate([seen.surface.reshape(-1, layers)[pixels].T, np.full((1, pixels.size), -1)])
        slopes = [_slope(seen, s, alone[number], number) for number, s in enumerate(model.surfaces)]
        return cls(model, surface.astype(np.int64), pixels, caster, _shares(seen, pixels, surface), np.array(slopes))

    def change(self, shift_mm: FloatArray) -> FloatArray:
        """Changes of the shares (component, n) where the ranges of each surface (surface,) change by so much, mm."""
        normal_mm = shift_mm * self._normal_per_range
        if not normal_mm.any():
            return np.zeros(self._given.shape)
        moved = tuple(s.shifted(float(d)) for s, d in zip(self.model.surfaces, normal_mm, strict=True))
        return _shares(self._caster.cast(_bare(self.model, moved)), self._pixels, self.surface) - self._given


def _bare(model: Model, surfaces: tuple[Surface, ...]) -> Model:
    return Model(sensor=model.sensor, surfaces=surfaces)


def _shares(seen: Truth, pixels: IntArray, surface: IntArray) -> FloatArray:
    """Shares (component, n) of the surfaces of some components; the last component is that without a return."""
    layers = seen.surface.shape[2]
    own = seen.surface.reshape(-1, layers)[pixels]
    share = np.nan_to_num(seen.weight_true.reshape(-1, layers)[pixels].astype(np.float64))
    out = np.zeros(surface.shape)
    for layer in range(layers):
        out += np.where((surface == own[:, layer]) & (surface >= 0), share[:, layer], 0.0)
    out[-1] = seen.weight_no_return.ravel()[pixels]
    return out


def _slope(seen: Truth, surface: Surface, alone: BoolArray, number: int) -> float:
    """Shift along a surface's normal, mm, for 1 mm of range in the median pixel that sees it alone; 0 for none."""
    ranges = seen.range_true[..., 0].ravel()[alone & (seen.surface[..., 0].ravel() == number)]
    return surface.plane_distance_mm / float(np.median(ranges)) if ranges.size else 0.0
