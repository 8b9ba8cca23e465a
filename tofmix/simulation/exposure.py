"""One frame of a model with effects, and the distribution of each pixel's next sample.

One frame through the camera, effect by effect: geometry, light, correlation, range, read-out.

Use `Exposer` where a model has effects; `tofmix.simulation.render` draws models without any from equation (1) directly.
Both draw events and noise from the same stream, and each effect has a separate one: a further effect, or one of zero
magnitude, changes no other draw.

Prediction of each pixel's next sample by a model.

Use `predict` to hold a recording against a model. The result is the marginal distribution of one sample. Links between
samples (memory, bursts of frames, neighbours) are declared by each effect and not included.
"""

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.simulation.averaging import MeanNoise, exposures, phasor_mean
from tofmix.simulation.casting.cast import MovingCaster, cast_scene
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Level
from tofmix.simulation.events import (
    Drawn,
    EventTable,
    Truth,
    amplitude_draws,
    draw_events,
    drawn_widths,
    event_table,
    events_behind,
    frame_generator,
    loss_draws,
    noisy_amplitude,
    shaped,
)
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


def equation_1(truth: Truth, model: Model) -> Prediction:
    """The prediction without any effect.

    Parameters
    ----------
    truth : Truth
        Result of `tofmix.simulation.casting.cast.cast_scene` for the model.

    References
    ----------
    Equation (1).
    """
    sensor = model.sensor
    pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
    noise = sensor.noise_at(sensor.integration_time_ms)
    nothing, far = np.full((1, pixels), -1), np.full((1, pixels), sensor.range_max_mm)
    ranges = np.vstack([np.nan_to_num(truth.range_true.reshape(pixels, layers).T.astype(np.float64)), far])
    seen = np.nan_to_num(truth.weight_true.reshape(pixels, layers).T)
    weight = np.vstack([seen, truth.weight_no_return.reshape(1, pixels)]).astype(np.float64)
    random = sensor.random_share
    random = random if isinstance(random, float) else random.ravel()
    weight *= (1.0 - random) / weight.sum(axis=0)
    if truth.lost is None:
        lost = np.zeros(pixels)
    else:  # as measured, of all samples of a pixel: random values are lost too
        lost = truth.lost.ravel().astype(np.float64)
        weight, random = weight * (1.0 - lost), random * (1.0 - lost)
    amplitude = np.vstack([truth.amplitude.reshape(pixels, layers).T.astype(np.float64), np.zeros((1, pixels))])
    sigma_mm = noise.sigma(ranges, amplitude)
    if truth.width is not None:
        sigma_mm[:-1] *= truth.width.reshape(pixels, layers).T
    return Prediction(
        turn_mm=Context(sensor=sensor, surfaces=(), seed=0).turn_mm,
        surface=np.vstack([truth.surface.reshape(pixels, layers).T.astype(np.int64), nothing]),
        true_range_mm=ranges,
        range_mm=ranges,
        amplitude=amplitude,
        sigma_mm=sigma_mm,
        weight=weight,
        invalid=lost,
        outlier=random,
        limits_mm=(sensor.range_min_mm, sensor.range_max_mm),
        stuck_mm=np.full(pixels, np.nan),
        error_shape=noise.shape,
    )


def predict(
    model: Model,
    truth: Truth | None = None,
    *,
    time_s: float = 0.0,
    seed: int | None = None,
    without_effects: Prediction | None = None,
) -> Prediction:
    """The marginal distribution of each pixel's sample at a time.

    Parameters
    ----------
    model : Model
        The model, effects included.
    truth : Truth, optional
        The scene as cast for this time; cast here if it is left out.
    time_s : float
        Time since the first frame, s.
    seed : int, optional
        Seed of the recording for the draws that hold for it all (patterns, widths); by default the model's.
    without_effects : Prediction, optional
        `equation_1` of the truth and the model, where it is known already; it stays as it is.

    Returns
    -------
    Prediction
        The mixture. Each effect's `predicts` says whether its part is exact.
    """
    if without_effects is None:
        without_effects = equation_1(cast_scene(model, time_s=time_s) if truth is None else truth, model)
    prediction = copy.copy(without_effects)  # effects put new arrays in the place of those they change
    names = tuple(surface.name for surface in model.surfaces)
    seed = model.recording.seed if seed is None else seed
    width = drawn_widths(model.sensor, seed=seed)
    if width is not None:
        prediction.sigma_mm = prediction.sigma_mm * width
    start = Context(sensor=model.sensor, surfaces=names, seed=seed, placed=model.placed(time_s), time_s=time_s)
    for effect in model.acting():
        if effect.level is not Level.GEOMETRY:
            context = replace(start, prepared=effect.prepare(start, 1))
            effect.predict(prediction, replace(context, expected=effect.expect(prediction, context)))
    return prediction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillScene:
    """One cast of the scene, for every frame that sees it.

    Parameters
    ----------
    table : EventTable
        The events.
    sigma_mm : (event, pixel) float64
        Their noise, mm.
    surface : (event, pixel) int64
        Their surfaces; -1 without one.
    expected : tuple
        Data of the scene for each acting effect.
    range_true : (row, col, layer) float32
        Its true ranges, mm.
    placed : tuple of Surface
        The model's surfaces where they stand.
    lost : (pixel,) float64 or None
        Share of the samples that are lost, of a measured scene.
    """

    table: EventTable
    sigma_mm: FloatArray
    surface: IntArray
    expected: tuple[Any, ...]
    range_true: Float32Array
    placed: tuple[Surface, ...]
    lost: FloatArray | None = None


class Caster(Protocol):
    """Casts a scene time after time."""

    def cast(self, time_s: float) -> Truth:
        """Surfaces of each pixel at a time."""


class Exposer:
    """Makes the frames of a model with effects, in any order, in any thread.

    Parameters
    ----------
    model : Model
        The model.
    truth : Truth
        The scene as cast for time 0.
    seed : int
        The recording's seed.
    n_frames : int
        Frames of the recording.
    caster : Caster, optional
        Casts the scene at other times, if surfaces move.

    Raises
    ------
    BadInputError
        If a surface moves out of bounds within the recording.
    """

    def __init__(self, model: Model, truth: Truth, *, seed: int, n_frames: int, caster: Caster | None = None) -> None:
        self._model = model
        self._seed = seed
        self._effects = tuple(effect for effect in model.acting() if effect.level is not Level.GEOMETRY)
        names = tuple(surface.name for surface in model.surfaces)
        start = Context(sensor=model.sensor, surfaces=names, seed=seed)
        self._contexts = tuple(replace(start, prepared=effect.prepare(start, n_frames)) for effect in self._effects)
        self._turn_mm = start.turn_mm
        self._shape = model.sensor.noise.shape
        self._width = drawn_widths(model.sensor, seed=seed)
        self._still = self._scene(truth, 0.0)
        self._caster = (caster or MovingCaster(model)) if model.moves else None
        if self._caster is not None:
            model.placed(self._time(n_frames - 1))  # refused now, not after thousands of frames

    def scene(self, frame: int) -> StillScene:
        """The scene of a frame."""
        if self._caster is None:
            return self._still
        return self._scene(self._caster.cast(self._time(frame)), self._time(frame))

    def _time(self, frame: int) -> float:
        return frame / self._model.recording.frame_rate_hz

    def _scene(self, truth: Truth, time_s: float) -> StillScene:
        model, placed = self._model, self._model.placed(time_s)
        table = event_table(truth, model.sensor, outlier_share=model.outlier_share)
        pixels, layers = truth.n_modes.size, truth.range_true.shape[2]
        surface = np.full((layers + 2, pixels), -1, dtype=np.int64)
        surface[:layers] = truth.surface.reshape(pixels, layers).T
        return StillScene(
            table=table,
            sigma_mm=table.sigma(model.sensor.noise_at(model.sensor.integration_time_ms), self._width),
            surface=surface,
            expected=self._expect(truth, time_s, placed),
            range_true=truth.range_true,
            placed=placed,
            lost=None if truth.lost is None else truth.lost.ravel(),
        )

    def _expect(self, truth: Truth, time_s: float, placed: tuple[Surface, ...]) -> tuple[Any, ...]:
        """Expectations of light effects on the scene: each after those before it."""
        expected: list[Any] = [None] * len(self._effects)
        if any(type(effect).expect is not Effect.expect for effect in self._effects):
            prediction = equation_1(truth, self._model)
            for k, effect in enumerate(self._effects):
                if effect.level is not Level.LIGHT:
                    break
                context = replace(self._contexts[k], time_s=time_s, placed=placed)
                expected[k] = effect.expect(prediction, context)
                effect.predict(prediction, replace(context, expected=expected[k]))
        return tuple(expected)

    def draw(self, frame: int, scene: StillScene) -> Drawn:
        """Random draws of a frame, before any effect."""
        return draw_events(scene.table, rng=frame_generator(self._seed, frame))

    def noise(self, frame: int, drawn: Drawn) -> FloatArray:
        """Standard normal noise (2, pixel) of a frame: of its ranges, and of its amplitudes."""
        return np.stack([drawn.noise, amplitude_draws(drawn.noise.size, seed=self._seed, frame=frame)])

    def colour(self, noise: FloatArray, before: FloatArray | None) -> FloatArray:
        """A frame's normal noise with the memory from effects; `before` is the result for the frame before."""
        if before is None:
            return noise
        for effect in self._effects:
            noise = effect.colour(noise, before)
        return noise

    def expose(self, frame: int, scene: StillScene, drawn: Drawn, noise: FloatArray) -> FrameSamples:
        """One frame, read out.

        Parameters
        ----------
        frame : int
            Its number.
        scene : StillScene
            Result of `scene` for it.
        drawn : Drawn
            Result of `draw` for it.
        noise : (2, pixel) float64
            Standard normal noise of ranges and amplitudes, with its memory.

        Returns
        -------
        FrameSamples
            With noise in the amplitudes too. Effects act on the amplitude of the light, which has none.
        """
        samples = _samples(scene, drawn, shaped(noise[0], self._shape), scene.sigma_mm, self._turn_mm)
        if scene.lost is not None:
            samples.lose_any(loss_draws(drawn.event.size, seed=self._seed, frame=frame) < scene.lost)
        self._act(samples, frame, scene, read_out=False)
        samples.measure()
        self._act(samples, frame, scene, read_out=True)
        samples.amplitude = noisy_amplitude(samples.amplitude, samples.sigma_mm, noise[1], turn_mm=self._turn_mm)
        return samples

    def average(self, frame: int, scene: StillScene) -> FrameSamples:
        """One frame as on-board integration returns it: the phasor mean of exposures, read out once.

        `scene` is the result of `scene` for the frame. Only read-out effects act on the mean: a threshold, for example,
        is compared with the amplitude of the whole time.
        """
        rng = frame_generator(self._seed, frame)
        pixels = scene.table.threshold.shape[1]
        noise = MeanNoise(pixels=pixels)

        def exposed() -> Iterator[tuple[float, FloatArray, Float32Array]]:
            for number, part in enumerate(exposures(scene.table, self._model.sensor, self._width)):
                drawn = draw_events(scene.table, rng=rng)
                samples = _samples(scene, drawn, shaped(drawn.noise, self._shape), part.sigma_mm, self._turn_mm)
                self._act(samples, frame, scene, read_out=False, part=number)
                samples.measure()
                light = recorded_amplitude(samples)
                noise.add(part.fraction, light.astype(np.float64), samples.sigma_mm)
                yield part.fraction, samples.measured_mm, light

        range_mm, amplitude = phasor_mean(exposed(), turn_mm=self._turn_mm)
        mean = _read(range_mm, amplitude, self._turn_mm)
        self._act(mean, frame, scene, read_out=True)
        draws = amplitude_draws(pixels, seed=self._seed, frame=frame)
        mean.amplitude = noise.on(amplitude, draws, turn_mm=self._turn_mm).astype(np.float64)
        return mean

    def _act(self, samples: FrameSamples, frame: int, scene: StillScene, *, read_out: bool, part: int = 0) -> None:
        time_s, placed = self._time(frame), scene.placed
        for effect, context, expected in zip(self._effects, self._contexts, scene.expected, strict=True):
            if (effect.level is Level.READ_OUT) == read_out:
                now = replace(context, frame=frame, time_s=time_s, placed=placed, expected=expected, part=part)
                effect.sample(samples, now)


def _samples(scene: StillScene, drawn: Drawn, noise: FloatArray, sigma_mm: FloatArray, turn_mm: float) -> FrameSamples:
    table, pixels = scene.table, drawn.event.size
    index = events_behind(table, drawn) * pixels + np.arange(pixels)
    range_mm = table.range_mm.take(index)
    outlier_mm = np.full(pixels, np.nan)
    outlier_mm[drawn.random] = drawn.random_mm
    return FrameSamples(
        turn_mm=turn_mm,
        surface=scene.surface.take(index),
        true_range_mm=range_mm,
        range_mm=range_mm,
        amplitude=table.amplitude.take(index).astype(np.float64),
        sigma_mm=sigma_mm.take(index),
        noise=noise,
        outlier_mm=outlier_mm,
        lost=np.zeros(pixels, dtype=np.bool_),
        stuck=np.zeros(pixels, dtype=np.bool_),
    )


def _read(range_mm: FloatArray, amplitude: Float32Array, turn_mm: float) -> FrameSamples:
    """Samples that only read-out effects are still to act on."""
    pixels = range_mm.size
    return FrameSamples(
        turn_mm=turn_mm,
        surface=np.full(pixels, -1, dtype=np.int64),
        true_range_mm=range_mm,
        range_mm=range_mm,
        amplitude=amplitude.astype(np.float64),
        sigma_mm=np.zeros(pixels),
        noise=np.zeros(pixels),
        outlier_mm=np.full(pixels, np.nan),
        lost=np.zeros(pixels, dtype=np.bool_),
        stuck=np.zeros(pixels, dtype=np.bool_),
        measured_mm=range_mm,
    )


def drawn_truth(model: Model, *, seed: int, n_frames: int) -> tuple[EffectTruth, ...]:
    """Draws of a recording of this seed and length: patterns, defects, bursts, pixels' own widths."""
    start = Context(sensor=model.sensor, surfaces=tuple(surface.name for surface in model.surfaces), seed=seed)
    shape = {"row": model.sensor.rows, "col": model.sensor.cols, "frame": n_frames}
    drawn = [truth for effect in model.acting() for truth in effect.truth(effect.prepare(start, n_frames))]
    width = drawn_widths(model.sensor, seed=seed)
    if width is not None:
        drawn.append(
            EffectTruth(
                name="noise_width",
                dims=("row", "col"),
                values=width.astype(np.float32),
                unit="1",
                long_name="pixel's own width, a factor on sigma",
            )
        )
    return tuple(replace(truth, values=truth.values.reshape([shape[dim] for dim in truth.dims])) for truth in drawn)


def check_averages(model: Model) -> None:
    """Refuse effects that on-board averaging is not simulated with.

    Raises
    ------
    BadInputError
        If there is one.
    """
    for number, effect in enumerate(model.effects, 1):
        if not effect.averages:
            raise BadInputError(
                f"[[effect]] {number}: kind: {effect.kind} is not simulated in a camera that averages on board; take "
                "it out, or leave out --averaged"
            )


def recorded_amplitude(samples: FrameSamples) -> Float32Array:
    """Amplitudes as a recording has them: 0 for random values."""
    amplitude: Float32Array = np.where(samples.outlier, 0.0, samples.amplitude).astype(np.float32)
    return amplitude
