"""Render a cast scene into frames, block by block, and describe the camera of the recording.

Use `render_blocks` to write a recording of any length in bounded memory. It is
the end of the path scene -> sensor -> recording.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.sensor import Sensor
from tofmix.simulation.averaging import average_frame, exposure_times, exposures
from tofmix.simulation.events import (
    Drawn,
    Truth,
    amplitude_draws,
    draw,
    drawn_widths,
    event_table,
    frame_generator,
    noisy_amplitude,
    stored_range,
)
from tofmix.simulation.exposure import Caster, Exposer, StillScene, check_averages, recorded_amplitude
from tofmix.simulation.model import Model


class _Frame(NamedTuple):
    """One frame's samples, (pixel,), and its true scene."""

    number: int
    range_mm: NDArray[np.uint16]
    amplitude: Float32Array
    range_true: Float32Array | None = None


_Map = Callable[..., Iterable[Any]]
_DrawFrame = Callable[[int], _Frame]
_Frames = Callable[[range, _Map], Iterator[_Frame]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameBlock:
    """Consecutive frames of a recording.

    Parameters
    ----------
    start : int
        Number of the first frame.
    range_mm : (frame, row, col) uint16
        Samples, mm, 1 to 65,534; 0 where invalid, which only effects cause.
    amplitude : (frame, row, col) float32
        Amplitudes.
    time_s : (frame,) float64
        Start of each frame, s; frame 0 at 0.
    range_true : (frame, row, col, layer) float32 or None
        True ranges, mm, where surfaces move; None where they do not.
    """

    start: int
    range_mm: NDArray[np.uint16]
    amplitude: Float32Array
    time_s: FloatArray
    range_true: Float32Array | None = None

    @property
    def stop(self) -> int:
        """Number after the last frame."""
        return self.start + len(self.range_mm)


def recording_sensor(model: Model, *, averaged: bool = False) -> Sensor:
    """The camera as a recording of the model describes it.

    Parameters
    ----------
    averaged : bool
        Whether the frames are on-board averages: then integration time and noise are those of the default time. The
        shape and the background are those of single samples: a mean has others, which the recording does not store.

    Raises
    ------
    BadInputError
        If `averaged`, and the camera measures no phase, or one sample is not shorter than the default integration
        time.
    """
    if not averaged:
        sensor = model.sensor.sensor()
        if model.scene is None or sensor.noise is None:
            return sensor
        return replace(sensor, noise=replace(sensor.noise, width_spread=model.scene.recorded_spread))
    model.sensor.turn_mm("--averaged")  # the mean is one of phasors
    check_averages(model)
    exposure_times(model.sensor)
    noise = replace(model.sensor.noise, shape=None, background=None)
    return replace(model.sensor, noise=noise, integration_time_ms=model.sensor.default_integration_time_ms).sensor()


def render_blocks(
    model: Model,
    truth: Truth,
    *,
    n_frames: int,
    seed: int,
    averaged: bool = False,
    block_frames: int = 100,
    threads: int = 1,
    caster: Caster | None = None,
) -> Iterator[FrameBlock]:
    """Render the frames of a cast scene in blocks.

    A frame depends on the model, the seed and its number alone: blocks and threads of any number give the same bytes,
    and the first frames are the same however many follow.

    Parameters
    ----------
    truth : Truth
        Result of `tofmix.simulation.casting.cast.cast_scene` for it.
    n_frames : int
        Number of frames, at least 1. The model's own `recording` settings are the caller's to pass or override.
    seed : int
        Seed of every random draw, at least 0.
    averaged : bool
        Simulate the camera's on-board integration over its default time instead of single samples.
    block_frames : int
        Most frames in a block, at least 1; memory is proportional to it.
    threads : int
        Frames rendered side by side, at least 1.
    caster : Caster, optional
        Casts the scene at other times, if surfaces move; then the blocks hold no true ranges.

    Returns
    -------
    iterator of FrameBlock
        The blocks in order.

    Raises
    ------
    ValueError
        If a number is below its least, or the truth is of another image size than the model's camera.
    BadInputError
        If `averaged`, and the camera measures no phase, or one sample is not shorter than the default integration
        time.
    """
    for name, value, least in (
        ("n_frames", n_frames, 1),
        ("seed", seed, 0),
        ("block_frames", block_frames, 1),
        ("threads", threads, 1),
    ):
        if value < least:
            raise ValueError(f"{name}: {value} is not at least {least}")
    if averaged:
        model.sensor.turn_mm("--averaged")
        check_averages(model)
        exposure_times(model.sensor)
    layers = 0
    if not model.effects and truth.lost is None:
        render = _independent(_averaged(model, truth, seed) if averaged else _single(model, truth, seed))
    else:
        exposer = Exposer(model, truth, seed=seed, n_frames=n_frames, caster=caster)
        layers = truth.range_true.shape[2] if model.moves and caster is None else 0
        render = _independent(_averaged_with_effects(exposer)) if averaged else _with_effects(exposer)
    starts = range(0, n_frames, block_frames)
    blocks = (range(start, min(start + block_frames, n_frames)) for start in starts)
    return (_render(model, render, frames, layers, threads) for frames in blocks)


def _single(model: Model, truth: Truth, seed: int) -> _DrawFrame:
    table = event_table(truth, model.sensor)
    noise, width = model.sensor.noise_at(model.sensor.integration_time_ms), drawn_widths(model.sensor, seed=seed)
    sigma_mm = table.sigma(noise, width)
    known = model.sensor.modulation_frequency_hz is not None
    turn_mm = model.sensor.turn_mm("amplitude noise") if known else math.nan

    def frame(number: int) -> _Frame:
        samples = draw(table, sigma_mm=sigma_mm, rng=frame_generator(seed, number), shape=noise.shape)
        amplitude = samples.amplitude
        if not math.isnan(turn_mm):
            draws = amplitude_draws(amplitude.size, seed=seed, frame=number)
            noisy = noisy_amplitude(amplitude.astype(np.float64), samples.sigma_mm, draws, turn_mm=turn_mm)
            amplitude = noisy.astype(np.float32)
        return _Frame(number, stored_range(samples.range_mm), amplitude)

    return frame


def _averaged(model: Model, truth: Truth, seed: int) -> _DrawFrame:
    table = event_table(truth, model.sensor)
    turn_mm = model.sensor.turn_mm("--averaged")
    parts = exposures(table, model.sensor, drawn_widths(model.sensor, seed=seed))
    shape = model.sensor.noise.shape

    def frame(number: int) -> _Frame:
        rng = frame_generator(seed, number)
        draws = amplitude_draws(table.threshold.shape[1], seed=seed, frame=number)
        range_mm, amplitude = average_frame(table, parts, turn_mm=turn_mm, rng=rng, shape=shape, draws=draws)
        return _Frame(number, stored_range(range_mm), amplitude)

    return frame


def _independent(draw_frame: _DrawFrame) -> _Frames:
    """Frames that know nothing of each other."""

    def render(frames: range, pool: _Map) -> Iterator[_Frame]:
        return iter(pool(draw_frame, frames))

    return render


def _averaged_with_effects(exposer: Exposer) -> _DrawFrame:
    def frame(number: int) -> _Frame:
        scene = exposer.scene(number)
        samples = exposer.average(number, scene)
        return _Frame(number, samples.stored(), recorded_amplitude(samples), scene.range_true)

    return frame


def _with_effects(exposer: Exposer) -> _Frames:
    """Frames of which each may remember the noise of the one before: that is done in order, all else side by side."""
    before: FloatArray | None = None

    def begin(frame: int) -> tuple[int, StillScene, Drawn, FloatArray]:
        scene = exposer.scene(frame)
        drawn = exposer.draw(frame, scene)
        return frame, scene, drawn, exposer.noise(frame, drawn)

    def end(begun: tuple[int, StillScene, Drawn, FloatArray]) -> _Frame:
        frame, scene, _, _ = begun
        samples = exposer.expose(*begun)
        return _Frame(frame, samples.stored(), recorded_amplitude(samples), scene.range_true)

    def coloured(
        begun: Iterable[tuple[int, StillScene, Drawn, FloatArray]],
    ) -> Iterator[tuple[int, StillScene, Drawn, FloatArray]]:
        nonlocal before
        for frame, scene, drawn, noise in begun:
            before = exposer.colour(noise, before)
            yield frame, scene, drawn, before

    def render(frames: range, pool: _Map) -> Iterator[_Frame]:
        frames_at_once = 16  # held in memory with all that their samples carry
        for first in range(0, len(frames), frames_at_once):
            some = frames[first : first + frames_at_once]
            yield from pool(end, list(coloured(pool(begin, some))))

    return render


@contextmanager
def _side_by_side(threads: int) -> Iterator[_Map]:
    """A `map` that works in threads."""
    if threads == 1:
        yield map
        return
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map


def _render(model: Model, render: _Frames, frames: range, layers: int, threads: int) -> FrameBlock:
    """One block; with `layers` true ranges a pixel and frame, or none."""
    shape = (len(frames), model.sensor.rows, model.sensor.cols)
    block = FrameBlock(
        start=frames.start,
        range_mm=np.empty(shape, dtype=np.uint16),
        amplitude=np.empty(shape, dtype=np.float32),
        time_s=np.array(frames, dtype=np.float64) / model.recording.frame_rate_hz,
        range_true=np.empty((*shape, layers), dtype=np.float32) if layers else None,
    )
    with _side_by_side(threads) as pool:
        for frame in render(frames, pool):
            at = frame.number - frames.start
            block.range_mm[at] = frame.range_mm.reshape(shape[1:])
            block.amplitude[at] = frame.amplitude.reshape(shape[1:])
            if block.range_true is not None and frame.range_true is not None:
                block.range_true[at] = frame.range_true
    return block
