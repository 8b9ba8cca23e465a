"""The mixture that a model with effects predicts for each sample of a recording.

Use `Scene.mixture` with the effects to be tried. What links samples (frames of interference, pixels' own
biases, stuck pixels, memory) is left to `tofmix.reconciliation.likelihood`; all else is the registry's own prediction.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.noise_shape import NoiseShape
from tofmix.projection import beam_directions_of
from tofmix.reconciliation.error_shape import GAUSSIAN, ShapeTable, shape_table
from tofmix.reconciliation.planes import ranges_to
from tofmix.simulation.cast import cast_scene
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.effects.saturation import Saturation
from tofmix.simulation.effects.surface_pose import SurfacePose, posed
from tofmix.simulation.effects.temperature_drift import TemperatureDrift
from tofmix.simulation.model import Model
from tofmix.simulation.prediction import Prediction, predict
from tofmix.simulation.truth import Truth

Poses = tuple[tuple[float, float, float], ...]
"""Of each surface, by which it stands elsewhere: shift along its normal, mm; yaw and pitch, degrees."""

LINKS = ("interference", "fixed_pattern", "stuck_pixels", "temporal_correlation")
"""Kinds that link samples: no part of the mixture."""

_IN_TIME = ("temperature_drift", "motion")  # kinds of which `predict` knows one time

_TIMES, _MOST_TIMES = 8, 32  # at which a moving scene is worked out
_STEP_MM = 15.0  # that a surface moves from one to the next, if there are enough of them


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mixture:
    """The predicted distribution of every sample.

    Parameters
    ----------
    weight, mean, sigma, rate : (time, component, pixel) float64
        Probability; mean and standard deviation, mm; change of the mean, mm/s.
    lit : (time, component, pixel) bool
        Whether light of a surface is in it, so that biases act.
    surface : (time, component, pixel) int64
        Its number; -1 for none.
    amplitude : (time, component, pixel) float64
        Its amplitude.
    true_range : (time, component, pixel) float64
        Its range before any effect, mm.
    invalid : (time, pixel) float64
        Probability of an invalid sample.
    outlier, background : (pixel,) float64
        Share of random values; the part of it that is the camera's background.
    low, high : float
        Limits of random values, mm.
    step, period : float
        Lattice and fold, mm; 0 for none.
    key, since : (frame,)
        Which time a frame goes by, and the time since then, s.
    frame_bias : (frame,) float64
        Bias of a frame's lit components, mm.
    shape : NoiseShape or None
        Density of every component's error in units of its sigma; Gaussian without it.
    table : ShapeTable
        The same for the kernels.
    """

    weight: FloatArray
    mean: FloatArray
    sigma: FloatArray
    rate: FloatArray
    lit: BoolArray
    surface: IntArray
    amplitude: FloatArray
    true_range: FloatArray
    invalid: FloatArray
    outlier: FloatArray
    background: FloatArray
    low: float
    high: float
    step: float
    period: float
    key: IntArray
    since: FloatArray
    frame_bias: FloatArray
    shape: NoiseShape | None = None
    table: ShapeTable = GAUSSIAN

    def widened(self, log_width: FloatArray) -> "Mixture":
        """The same with every sigma times the exponential of logarithms of a shape that goes with (.., .., pixel)."""
        return replace(self, sigma=self.sigma * np.exp(log_width))

    @property
    def told(self) -> FloatArray:
        """Share (pixel,) of the samples at the first time that tell of the scene: valid, and no background."""
        return np.asarray(1.0 - self.invalid[0] - self.background)

    def of_frames(self, frames: slice) -> "Mixture":
        """That of one recording by itself, not copied."""
        if frames.stop - frames.start == self.key.size:
            return self
        first, last = int(self.key[frames].min()), int(self.key[frames].max())
        times = slice(first, last + 1)
        return replace(
            self, weight=self.weight[times], mean=self.mean[times], sigma=self.sigma[times], rate=self.rate[times],
            lit=self.lit[times], surface=self.surface[times], amplitude=self.amplitude[times],
            true_range=self.true_range[times], invalid=self.invalid[times], key=self.key[frames] - first,
            since=self.since[frames], frame_bias=self.frame_bias[frames],
        )  # fmt: skip

    @property
    def main(self) -> IntArray:
        """The heaviest component (pixel,) at the first time."""
        return np.asarray(self.weight[0].argmax(axis=0))

    def of_main(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (time, component, pixel) of the heaviest component, (pixel,)."""
        return np.asarray(np.take_along_axis(values[0], self.main[None], axis=0)[0])


class Scene:
    """A model's scene, cast once for each place of its surfaces.

    Effects of a surface that the model has not are none of its own: they are of another recording's scene. What the
    model has already acts in every mixture, but for what links samples, which is in `links`.

    Parameters
    ----------
    model : Model
        The model, with the effects it has already.
    time_s : (frame,) float64
        Times of the frames.
    """

    def __init__(self, model: Model, time_s: FloatArray) -> None:
        self.model = model
        self.time_s = time_s
        self.names = tuple(surface.name for surface in model.surfaces)
        self.members: tuple[Scene, ...] = (self,)
        self.links = tuple(e for e in model.effects if e.kind in LINKS and not _mapped_bias(e))
        self._moving = tuple(e for e in model.effects if e.kind in _IN_TIME)
        rest = tuple(e for e in model.effects if e not in (*self.links, *self._moving))
        alike = replace(model.sensor.noise, width_spread=0.0)  # widths are the recording's: a state has them
        self._still = replace(model, effects=rest, sensor=replace(model.sensor, noise=alike))
        self._table = shape_table(model.sensor.noise.shape)
        self._at_rest: Poses = ((0.0, 0.0, 0.0),) * len(self.names)
        self._cast: dict[Poses, Truth] = {}
        self._anchor: list[Poses] = [self._at_rest]
        self._count = _TIMES
        self.distance = np.array([_plane_distance(s) for s in model.surfaces])
        self.beams = beam_directions_of(model.sensor.optics, model.sensor.shape).reshape(-1, 3)
        self.truth(self._at_rest)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What the model has already."""
        return self.model.effects

    def own(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Those of some effects that act in this scene."""
        return tuple(e for e in effects if getattr(e, "surface", None) in (None, *self.names))

    def truth(self, poses: Poses) -> Truth:
        """The scene cast with its surfaces in these poses; kept."""
        if poses not in self._cast:
            moved = tuple(posed(s, *p) if any(p) else s for s, p in zip(self._still.surfaces, poses, strict=True))
            self._cast[poses] = cast_scene(replace(self._still, surfaces=moved))
        return self._cast[poses]

    def anchor(self, effects: tuple[Effect, ...]) -> None:
        """Cast the scene where these effects put it; nearby places are then reached by shifting ranges alone."""
        effects = (*self._moving, *self.own(effects))
        fastest = max((abs(e.velocity_mm_s) for e in effects if isinstance(e, Motion)), default=0.0)
        way_mm = fastest * float(self.time_s[-1])
        self._count = int(np.clip(np.ceil(way_mm / _STEP_MM), _TIMES, _MOST_TIMES))
        times = self._times(effects)
        self._anchor = [_rounded(self._poses(effects, t)) for t in times]
        self._cast = {a: self.truth(a) for a in [self._at_rest, *self._anchor]}

    def _times(self, effects: tuple[Effect, ...]) -> FloatArray:
        if not any(isinstance(e, Motion) for e in effects):
            return np.zeros(1)
        edges = np.linspace(0.0, float(self.time_s[-1]), self._count + 1)
        return np.asarray((edges[1:] + edges[:-1]) / 2)

    def _poses(self, effects: tuple[Effect, ...], time_s: float) -> FloatArray:
        """Shift, mm, yaw and pitch, degrees (surface, 3), by which surfaces stand elsewhere at a time."""
        pose = np.zeros((len(self.names), 3))
        for e in effects:
            if isinstance(e, SurfacePose):
                pose[self.names.index(e.surface)] += e.shift_mm, e.yaw_deg, e.pitch_deg
            elif isinstance(e, Motion):
                pose[self.names.index(e.surface), 0] += e.velocity_mm_s * time_s
        return pose

    def _near(self, wanted: FloatArray, number: int) -> Truth:
        """The scene with surfaces in wanted poses: ranges of there, shares and edges from the anchor."""
        from_ = self._anchor[number] if number < len(self._anchor) else self._anchor[0]
        truth = self.truth(from_)
        change = wanted - np.array(from_)
        if not change.any():
            return truth
        ratio = np.ones((len(self.names) + 1, len(self.beams)))  # the last is for no surface, number -1
        for k, surface in enumerate(self._still.surfaces):
            if change[k, 1:].any():
                there, here = (ranges_to(posed(surface, *p), self.beams) for p in (wanted[k], from_[k]))
                with np.errstate(invalid="ignore"):
                    ratio[k] = np.where(np.isfinite(there / here), there / here, 1.0)
            elif change[k, 0]:
                ratio[k] += change[k, 0] / (self.distance[k] + from_[k][0])
        pixel = np.arange(len(self.beams)).reshape(*truth.surface.shape[:2], 1)
        scaled = (truth.range_true * ratio[truth.surface, pixel]).astype(np.float32)
        return replace(truth, range_true=scaled)

    def mixture(self, effects: tuple[Effect, ...] = ()) -> Mixture:
        """What the model and these effects predict, but for the kinds in `LINKS`."""
        effects = (*self._moving, *self.own(effects))
        times = self._times(effects)
        drifts = [e for e in effects if isinstance(e, TemperatureDrift)]
        wells = [e for e in effects if isinstance(e, Saturation)]
        acting = tuple(
            e for e in effects
            if e.kind not in LINKS and not isinstance(e, TemperatureDrift | Saturation | SurfacePose | Motion)
        )  # fmt: skip
        model = replace(self._still, effects=(*self._still.effects, *acting))
        parts = [predict(model, self._near(self._poses(effects, float(t)), k)) for k, t in enumerate(times)]
        for part in parts:
            for well in wells:
                _saturate(part, well)
        return self._stack(parts, times, effects, drifts)

    def _stack(
        self, parts: list[Prediction], times: FloatArray, effects: tuple[Effect, ...], drifts: list[TemperatureDrift]
    ) -> Mixture:
        most, pixels = max(len(p.weight) for p in parts), parts[0].weight.shape[1]

        def stack(name: str, fill: float) -> FloatArray:
            out = np.full((len(parts), most, pixels), fill)
            for rows, part in zip(out, parts, strict=True):
                rows[: len(part.weight)] = getattr(part, name)
            return out

        surface = stack("surface", -1).astype(np.int64)
        velocity = np.zeros((len(times), len(self.names) + 1))  # of each ray, per mm of its length
        for e in effects:
            if isinstance(e, Motion):
                moved = np.array([self._poses(effects, float(t))[:, 0] for t in times])
                at = self.names.index(e.surface)
                velocity[:, at] += e.velocity_mm_s / (self.distance[at] + moved[:, at])
        key = np.clip(
            (self.time_s * len(times) / max(float(self.time_s[-1]), 1e-9)).astype(np.int64), 0, len(times) - 1
        )
        bias = np.zeros(len(self.time_s))
        for drift in drifts:
            bias += drift.amplitude_mm * -np.expm1(-self.time_s / drift.time_constant_s)
        first, true_range = parts[0], stack("true_range_mm", 1.0)
        sensor = self.model.sensor
        share = 0.0 if sensor.noise.background is None else sensor.noise.background
        background = np.broadcast_to(share, sensor.shape).ravel().astype(np.float64)
        return Mixture(
            weight=stack("weight", 0.0), mean=stack("range_mm", 1.0), sigma=np.maximum(stack("sigma_mm", 1.0), 0.05),
            rate=true_range * np.take_along_axis(velocity[:, None], surface, axis=2), lit=surface >= 0,
            surface=surface, amplitude=stack("amplitude", 0.0), true_range=true_range,
            invalid=np.stack([p.invalid for p in parts]), outlier=np.zeros(pixels) + first.outlier,
            background=background, low=first.limits_mm[0], high=first.limits_mm[1], step=first.step_mm,
            period=first.period_mm or 0.0, key=key, since=self.time_s - times[key], frame_bias=bias,
            shape=first.error_shape, table=self._table,
        )  # fmt: skip


def _rounded(poses: FloatArray) -> Poses:
    """Poses as keys: to a micrometre and a tenth of a millidegree."""
    return tuple((round(float(d), 3), round(float(y), 4), round(float(p), 4)) for d, y, p in poses)


def _mapped_bias(effect: Effect) -> bool:
    """Whether an effect is a pattern that is known pixel by pixel."""
    return isinstance(effect, FixedPattern) and effect.map is not None


def _plane_distance(surface: object) -> float:
    """Distance of a surface's plane from the camera along its normal, signed, mm; never 0."""
    normal = surface.rotation()[:, 2]  # type: ignore[attr-defined]
    distance = float(normal @ np.array(surface.center_mm))  # type: ignore[attr-defined]
    return distance if abs(distance) > 1.0 else 1.0


def _saturate(prediction: Prediction, well: Saturation) -> None:
    """Lose what is too bright. The amplitude of one sample has the noise of its phase, so the edge is not sharp."""
    noise = prediction.amplitude * prediction.sigma_mm * (2 * np.pi / prediction.turn_mm)
    over = (prediction.amplitude - well.full_well_amplitude) / np.maximum(noise, 1e-9)
    prediction.lose(np.where(prediction.returned, ndtr(over), 0.0))
