"""The mixture that a model with effects predicts for each sample of a recording.

Use `Scene.mixture` with the effects to try. `tofmix.reconciliation.likelihood.likelihood` adds the hidden states that
link samples (frames of interference, biases of pixels, stuck pixels, memory); everything else is the prediction of the
registry's effects.
"""

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.noise_shape import NoiseShape
from tofmix.optics.projection import beam_directions_of
from tofmix.reconciliation.likelihood.error_shape import GAUSSIAN, ShapeTable, shape_table
from tofmix.simulation.casting.cast import EDGE_ON, by_neighbours, met_plane
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.effects.base import Effect, Latent, Level
from tofmix.simulation.effects.hidden import PixelBias
from tofmix.simulation.events import Truth
from tofmix.simulation.exposure import equation_1, predict
from tofmix.simulation.measured_scene import MeasuredScene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

LINKING = (Latent.FRAME, Latent.PIXEL, Latent.MEMORY)
"""Hidden states that link samples. They are no part of the mixture; a quantisation step is a part of it."""

_TIMES = (4, 8, 16, 32)  # times at which a changing scene is computed; the most unless only surfaces move
_COARSE = _TIMES[1]  # most times of a prediction that only ranks effects
_STEP_MM = 15.0  # largest move of a surface from one time to the next, if there are enough times
_SOON_S = 1e-3  # for the velocity of a surface
_LEAST_SIGMA_MM = 0.05  # of a prediction
_LEAST_REST = 0.3  # of a measured width, at least, is noise: a way takes no more of it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mixture:
    """The predicted distribution of every sample.

    Parameters
    ----------
    weight, mean, sigma, rate : (time, component, pixel) float64
        Probability; mean and standard deviation, mm; change of the mean, mm/s.
    lit : (time, component, pixel) bool
        Whether it contains light of a surface, so that biases act.
    surface : (time, component, pixel) int64
        Its number; -1 for none.
    amplitude : (time, component, pixel) float64
        Its amplitude.
    true_range : (time, component, pixel) float64
        Its range before any effect, mm.
    invalid : (time, pixel) float64
        Probability of an invalid sample.
    outlier, background : (pixel,) float64
        Share of random values; the camera's background in this share.
    low, high : float
        Limits of random values, mm.
    step, period : float
        Quantisation step and fold, mm; 0 for none.
    key, since : (frame,)
        Number of the time that a frame uses, and the time since then, s.
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
        """The same with each sigma multiplied by exp(log_width), which broadcasts to (time, component, pixel)."""
        return replace(self, sigma=self.sigma * np.exp(log_width))

    @property
    def told(self) -> FloatArray:
        """Share (pixel,) of samples of the scene at the first time: valid and no background."""
        return np.asarray(1.0 - self.invalid[0] - self.background)

    def of_frames(self, frames: slice) -> "Mixture":
        """The mixture of one recording, not copied."""
        if frames.stop - frames.start == self.key.size:
            return self
        first, last = int(self.key[frames].min()), int(self.key[frames].max())
        times = slice(first, last + 1)
        return replace(
            self,
            weight=self.weight[times],
            mean=self.mean[times],
            sigma=self.sigma[times],
            rate=self.rate[times],
            lit=self.lit[times],
            surface=self.surface[times],
            amplitude=self.amplitude[times],
            true_range=self.true_range[times],
            invalid=self.invalid[times],
            key=self.key[frames] - first,
            since=self.since[frames],
            frame_bias=self.frame_bias[frames],
        )

    @property
    def typical_speed(self) -> float:
        """Typical change of the range of the heaviest components that move, mm/s; 0 if none does."""
        rate = self.of_main(self.rate)
        moving = rate[rate != 0]
        return float(np.median(moving)) if moving.size else 0.0

    def near_turn(self, off_mm: NDArray[Any]) -> NDArray[Any]:
        """Differences of samples from a mean, mm, of any shape: on the turn nearest the mean, if the axis folds."""
        return off_mm if self.period <= 0 else np.asarray(off_mm - self.period * np.rint(off_mm / self.period))

    @property
    def main(self) -> IntArray:
        """The heaviest component (pixel,) at the first time."""
        return np.asarray(self.weight[0].argmax(axis=0))

    def of_main(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (time, component, pixel) of the heaviest component, (pixel,)."""
        return np.asarray(np.take_along_axis(values[0], self.main[None], axis=0)[0])

    def main_means(self, pixels: IntArray) -> FloatArray:
        """Mean (frame, pixel) of the heaviest component of some pixels, mm; NaN in frames in which it has no light."""
        at = self.key[:, None], self.main[pixels], pixels
        mean = self.mean[at] + self.rate[at] * self.since[:, None] + self.frame_bias[:, None]
        return np.where(self.lit[at], mean, np.nan)


class Scene:
    """A model's scene, cast with its surfaces as effects place them.

    Predictions depend on the effects alone. The casts used last are kept, because fits use them again.

    An effect of a surface that the model does not have belongs to another recording. The effects of the model act in
    every mixture, except those that link samples, which are in `links`.

    Parameters
    ----------
    model : Model
        The model with its effects.
    time_s : (frame,) float64
        Times of the frames.
    kept_bytes, kept : int
        Kept casts: most memory, and least number.

    Attributes
    ----------
    beams : (pixel, 3) float64
        Unit vectors of the beams of the pixels' centres.
    """

    def __init__(
        self, model: Model, time_s: FloatArray, *, kept_bytes: int = 1 << 26, kept: int = 2 * _TIMES[-1]
    ) -> None:
        self.model = model
        self.time_s = time_s
        self._kept_bytes, self._kept = kept_bytes, kept
        self.names = tuple(surface.name for surface in model.surfaces)
        self.members: tuple[Scene, ...] = (self,)
        self.links = tuple(e for e in model.effects if _links(e) and not _mapped_bias(e))
        self._apart = tuple(e for e in model.effects if _stands_apart(e))
        rest = tuple(e for e in model.effects if e not in (*self.links, *self._apart))
        alike = replace(model.sensor.noise, width_spread=0.0)  # widths belong to the recording: a state has them
        self._still = replace(model, effects=rest, sensor=replace(model.sensor, noise=alike))
        self._apart_mm: FloatArray | None = None
        if model.scene is not None:  # laws act on ranges without the pixels' own errors, which stay as they were seen
            smooth, self._apart_mm = by_neighbours(model, model.scene)
            self._still = replace(self._still, scene=smooth)
        self._table = shape_table(model.sensor.noise.shape)
        self._caster = PolygonCaster(model.sensor)
        self.beams = beam_directions_of(model.sensor.optics, model.sensor.shape).reshape(-1, 3)
        self._casts: OrderedDict[tuple[Surface, ...], tuple[Truth, Prediction]] = OrderedDict()

    @property
    def casts(self) -> int:
        """Number of kept casts."""
        return len(self._casts)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of the model."""
        return self.model.effects

    def surface(self, name: str) -> Surface:
        """A surface of the model."""
        return self.model.surfaces[self.names.index(name)]

    def own(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """The effects among these that act in this scene."""
        return tuple(e for e in effects if all(name in self.names for name in e.surfaces.values()))

    def _cast(self, surfaces: tuple[Surface, ...]) -> tuple[Truth, Prediction]:
        """The cast of the scene with these surfaces, and its prediction without effects."""
        kept = self._casts.pop(surfaces, None)
        if kept is None:
            truth = self._caster.cast(replace(self._still, surfaces=surfaces))
            kept = truth, equation_1(truth, self._still)
            most = max(self._kept, self._kept_bytes // max(_size(kept), 1))
            while len(self._casts) >= most:
                self._casts.popitem(last=False)
        self._casts[surfaces] = kept  # now the last one used
        return kept

    def _times(self, effects: tuple[Effect, ...], *, coarse: bool) -> FloatArray:
        """Times (time,) at which the scene is computed, s; a single one if only biases of frames change."""
        changing = [e for e in effects if e.changes_in_time and e.frame_bias(self.time_s) is None]
        if not changing:
            return np.zeros(1)
        end_s = float(self.time_s[-1])
        count = _TIMES[-1]
        if all(e.level is Level.GEOMETRY for e in changing):
            first, last = (np.array([plane_distance(s) for s in self._placed(effects, t)]) for t in (0.0, end_s))
            count = next((n for n in _TIMES if n * _STEP_MM >= np.abs(last - first).max()), count)
        edges = np.linspace(0.0, end_s, (min(count, _COARSE) if coarse else count) + 1)
        return np.asarray((edges[1:] + edges[:-1]) / 2)

    def _placed(self, effects: tuple[Effect, ...], time_s: float) -> tuple[Surface, ...]:
        """The surfaces as effects place them at a time."""
        surfaces = self.model.surfaces
        for effect in effects:
            if effect.level is Level.GEOMETRY:
                surfaces = tuple(effect.place(surface, time_s) for surface in surfaces)
        return surfaces

    def _velocities(self, effects: tuple[Effect, ...], time_s: float) -> FloatArray:
        """Rate of change of the rays to each surface (surface + 1,), per mm of their length and s; 0 for no surface."""
        out = np.zeros(len(self.names) + 1)
        if any(e.level is Level.GEOMETRY and e.changes_in_time for e in effects):
            now, soon = (
                np.array([plane_distance(s) for s in self._placed(effects, t)]) for t in (time_s, time_s + _SOON_S)
            )
            out[:-1] = (soon / now - 1.0) / _SOON_S
        return out

    @property
    def has_way(self) -> bool:
        """Whether the widths of a measured scene hold the way of what moves.

        Times count from the middle of a reference that the recording itself begins with, else from 0: then the surfaces
        stood still.
        """
        scene = self.model.scene
        return scene is not None and not scene.way_mm and float(self.time_s[0]) > 0

    def _fill_measured_rate(
        self, rate: FloatArray, surface: IntArray, moving: FloatArray, effects: tuple[Effect, ...], time_s: float
    ) -> None:
        """Rates of change (component, pixel) of measured ranges, mm/s, whose surfaces (surface + 1,) move at a time.

        What is beside its plane, as a round thing is, goes as far as the plane does along each beam.
        """
        now, soon = (self._placed(effects, t) for t in (time_s, time_s + _SOON_S))
        for number in np.flatnonzero(moving):
            (here, cosine), (there, _) = (met_plane(placed[number], self.beams) for placed in (now, soon))
            of_plane = np.where(cosine > EDGE_ON, (there - here) / _SOON_S, 0.0)
            rate[:] = np.where(surface == number, of_plane, rate)

    def _at_rest(self, sigma: FloatArray, rate: FloatArray, rest: float | None) -> FloatArray:
        """Noise (time, component, pixel) of a measured scene, mm, without the way of surfaces in the reference.

        `rest` is as of `mixture`. A steady way of w has the standard deviation w / sqrt 12.
        """
        if rest is not None:
            return np.where(rate != 0, rest * sigma, sigma)
        way = 2.0 * max(float(self.time_s[0]), 0.0) * rate
        return np.asarray(np.sqrt(np.maximum(sigma**2 - way**2 / 12.0, (_LEAST_REST * sigma) ** 2)))

    def measured_at_rest(self, effects: tuple[Effect, ...], rest: float | None = None) -> MeasuredScene | None:
        """The measured scene with the widths of its surfaces at rest, as these effects move them; None without one."""
        scene = self.model.scene
        velocity = self._velocities((*self._apart, *self.own(effects)), 0.0)
        if scene is None or not self.has_way or not velocity.any():
            return scene
        noise = self.model.sensor.noise_at(self.model.sensor.integration_time_ms)
        sigma = scene.width * noise.sigma(np.nan_to_num(scene.range_mm, nan=1.0), scene.amplitude)
        rate = scene.range_mm * velocity[np.minimum(scene.surface, velocity.size - 1)]
        return replace(scene, width=scene.width * self._at_rest(sigma, rate, rest) / sigma)

    def mixture(self, effects: tuple[Effect, ...] = (), *, coarse: bool = False, rest: float | None = None) -> Mixture:
        """The prediction of the model and these effects, without hidden states that link samples.

        A coarse one has few times: good enough to rank effects. `rest` is the noise of what moves, over that of a
        measured scene whose widths hold its way; None if the way is steady.
        """
        effects = (*self._apart, *self.own(effects))
        times = self._times((*self._still.effects, *effects), coarse=coarse)
        last = [e for e in effects if e.loses_by_noise]
        acting = tuple(e for e in effects if not _links(e) and not _stands_apart(e) and not e.loses_by_noise)
        own = (*self._still.effects, *acting)
        parts = []
        for t in times:
            placed = self._placed(effects, float(t))
            truth, without_effects = self._cast(placed)
            model = replace(self._still, surfaces=placed, effects=own)
            parts.append(predict(model, truth, time_s=float(t), without_effects=without_effects))
        for part in parts:
            for effect in last:
                effect.lose_by_noise(part)
        return self._stack(parts, times, effects, rest)

    def _stack(
        self, parts: list[Prediction], times: FloatArray, effects: tuple[Effect, ...], rest: float | None
    ) -> Mixture:
        most, pixels = max(len(p.weight) for p in parts), parts[0].weight.shape[1]

        def stack(name: str, fill: float) -> FloatArray:
            if len(parts) == 1:
                return np.asarray(getattr(parts[0], name)[None])
            out = np.full((len(parts), most, pixels), fill)
            for rows, part in zip(out, parts, strict=True):
                rows[: len(part.weight)] = getattr(part, name)
            return out

        surface = stack("surface", -1).astype(np.int64, copy=False)
        velocity = np.stack([self._velocities(effects, float(t)) for t in times])
        key = np.clip(
            (self.time_s * len(times) / max(float(self.time_s[-1]), 1e-9)).astype(np.int64), 0, len(times) - 1
        )
        bias = np.zeros(len(self.time_s))
        for effect in effects:
            of_effect = effect.frame_bias(self.time_s)
            bias += 0.0 if of_effect is None else of_effect
        first, true_range = parts[0], stack("true_range_mm", 1.0)
        rate = np.zeros(true_range.shape)
        if velocity.any() and self.model.scene is None:
            rate = true_range * np.stack([own[of] for own, of in zip(velocity, surface, strict=True)])
        elif velocity.any():
            for own, of, moving, t in zip(rate, surface, velocity, times, strict=True):
                self._fill_measured_rate(own, of, moving, effects, float(t))
        mean = stack("range_mm", 1.0)
        if self._apart_mm is not None:
            mean = mean + np.take_along_axis(self._apart_mm[None], surface, axis=1)
        sigma = np.maximum(stack("sigma_mm", 1.0), _LEAST_SIGMA_MM)
        if self.has_way and velocity.any():
            sigma = self._at_rest(sigma, rate, rest)
        sensor = self.model.sensor
        share = 0.0 if sensor.noise.background is None else sensor.noise.background
        background = np.broadcast_to(share, sensor.shape).ravel().astype(np.float64)
        return Mixture(
            weight=stack("weight", 0.0),
            mean=mean,
            sigma=sigma,
            rate=rate,
            lit=surface >= 0,
            surface=surface,
            amplitude=stack("amplitude", 0.0),
            true_range=true_range,
            invalid=np.stack([p.invalid for p in parts]),
            outlier=np.zeros(pixels) + first.outlier,
            background=background,
            low=first.limits_mm[0],
            high=first.limits_mm[1],
            step=first.step_mm,
            period=first.period_mm or 0.0,
            key=key,
            since=self.time_s - times[key],
            frame_bias=bias,
            shape=first.error_shape,
            table=self._table,
        )


def _links(effect: Effect) -> bool:
    """Whether an effect has a hidden state that links samples."""
    return effect.hides and effect.latent in LINKING


def _mapped_bias(effect: Effect) -> bool:
    """Whether an effect is a bias of each pixel that a map has: then nothing of it is hidden."""
    return isinstance(effect.hidden, PixelBias) and effect.hidden.map_of(effect) is not None


def _stands_apart(effect: Effect) -> bool:
    """Whether `predict` leaves out an effect: it places surfaces, or is a bias of each frame."""
    return effect.level is Level.GEOMETRY or effect.frame_bias(np.zeros(1)) is not None


def _size(kept: tuple[Truth | Prediction, ...]) -> int:
    """Bytes of a cast and of its prediction."""
    return sum(getattr(getattr(of, name), "nbytes", 0) for of in kept for name in of.__dataclass_fields__)


def plane_distance(surface: Surface) -> float:
    """Distance of a surface's plane from the camera along its normal, signed, mm; never 0."""
    distance = float(surface.rotation()[:, 2] @ np.array(surface.center_mm))
    return distance if abs(distance) > 1.0 else 1.0


class Scenes:
    """The scenes of several recordings, with the interface of one `Scene`; frames of the recordings follow each other.

    Parameters
    ----------
    members : tuple of Scene
        At least one; different surfaces have different names.
    """

    def __init__(self, members: tuple[Scene, ...]) -> None:
        self.members = members
        self.model = members[0].model
        self.names = tuple(dict.fromkeys(name for m in members for name in m.names))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of any of the models."""
        return tuple(e for m in self.members for e in m.effects)

    @property
    def has_way(self) -> bool:
        """As `Scene.has_way`, of any of the models."""
        return any(member.has_way for member in self.members)

    @property
    def links(self) -> tuple[Effect, ...]:
        """As `Scene.links`: the first of each kind, because there is one camera."""
        found: dict[str, Effect] = {}
        for member in self.members:
            found |= {e.kind: e for e in member.links if e.kind not in found}
        return tuple(found.values())

    def mixture(self, effects: tuple[Effect, ...] = (), *, coarse: bool = False, rest: float | None = None) -> Mixture:
        """The prediction of the models and these effects for all frames, as of `Scene.mixture`."""
        parts = [member.mixture(effects, coarse=coarse, rest=rest) for member in self.members]
        most = max(p.weight.shape[1] for p in parts)
        times = np.cumsum([0, *(len(p.weight) for p in parts)])
        joined = {name: np.concatenate([_padded(p, name, most) for p in parts]) for name in _BY_COMPONENT}
        key = np.concatenate([p.key + start for p, start in zip(parts, times[:-1], strict=True)])
        whole = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ("invalid", "since", "frame_bias")}
        changed: dict[str, Any] = {**joined, **whole, "key": key}
        return replace(parts[0], **changed)


_BY_COMPONENT = {
    "weight": 0.0,
    "mean": 1.0,
    "sigma": 1.0,
    "rate": 0.0,
    "lit": False,
    "surface": -1,
    "amplitude": 0.0,
    "true_range": 1.0,
}


def _padded(part: Mixture, name: str, components: int) -> NDArray[Any]:
    values: NDArray[Any] = getattr(part, name)
    missing = components - values.shape[1]
    return np.pad(values, ((0, 0), (0, missing), (0, 0)), constant_values=_BY_COMPONENT[name])
