"""Render a cast scene into frames, block by block, and say what camera the recording is of.

Use `render_blocks` to write a recording of any length in bounded memory. It is
the end of the path scene -> sensor -> recording.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.sensor import Sensor
from tofmix.simulation.averaging import average_frame, exposure_times, exposures
from tofmix.simulation.events import draw, event_table, frame_generator, stored_range
from tofmix.simulation.model import Model
from tofmix.simulation.truth import Truth

_DrawFrame = Callable[[np.random.Generator], tuple[FloatArray, Float32Array]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameBlock:
    """Consecutive frames of a recording.

    Parameters
    ----------
    start : int
        Number of the first frame.
    range_mm : (frame, row, col) uint16
        Samples, mm, 1 to 65,534.
    amplitude : (frame, row, col) float32
        Amplitudes.
    time_s : (frame,) float64
        Start of each frame, s; frame 0 at 0.
    """

    start: int
    range_mm: NDArray[np.uint16]
    amplitude: Float32Array
    time_s: FloatArray

    @property
    def stop(self) -> int:
        """Number after the last frame."""
        return self.start + len(self.range_mm)


def recording_sensor(model: Model, *, averaged: bool = False) -> Sensor:
    """The camera as a recording of the model describes it.

    Parameters
    ----------
    model : Model
        The model.
    averaged : bool
        Whether the frames are on-board averages: then integration time and noise are those of the default time.

    Raises
    ------
    BadInputError
        If `averaged`, and the camera measures no phase, or one sample is not shorter than the default integration
        time.
    """
    if not averaged:
        return model.sensor.sensor()
    model.sensor.turn_mm("--averaged")  # the mean is one of phasors
    exposure_times(model.sensor)
    return replace(model.sensor, integration_time_ms=model.sensor.default_integration_time_ms).sensor()


def render_blocks(
    model: Model,
    truth: Truth,
    *,
    n_frames: int,
    seed: int,
    averaged: bool = False,
    block_frames: int = 100,
    threads: int = 1,
) -> Iterator[FrameBlock]:
    """Render the frames of a cast scene in blocks.

    A frame depends on the model, the seed and its number alone: blocks and threads of any number give the same bytes,
    and the first frames are the same however many follow.

    Parameters
    ----------
    model : Model
        The model.
    truth : Truth
        What `tofmix.simulation.cast.cast_scene` returned for it.
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
    draw_frame = _averaged(model, truth) if averaged else _single(model, truth)
    starts = range(0, n_frames, block_frames)
    blocks = (range(start, min(start + block_frames, n_frames)) for start in starts)
    return (_render(model, draw_frame, seed, frames, threads) for frames in blocks)


def _single(model: Model, truth: Truth) -> _DrawFrame:
    table = event_table(truth, model.sensor)
    sigma_mm = table.sigma(model.sensor.noise_at(model.sensor.integration_time_ms))

    def frame(rng: np.random.Generator) -> tuple[FloatArray, Float32Array]:
        samples = draw(table, sigma_mm=sigma_mm, rng=rng)
        return samples.range_mm, samples.amplitude

    return frame


def _averaged(model: Model, truth: Truth) -> _DrawFrame:
    table = event_table(truth, model.sensor)
    turn_mm = model.sensor.turn_mm("--averaged")
    parts = exposures(table, model.sensor)

    def frame(rng: np.random.Generator) -> tuple[FloatArray, Float32Array]:
        return average_frame(table, parts, turn_mm=turn_mm, rng=rng)

    return frame


def _render(model: Model, draw_frame: _DrawFrame, seed: int, frames: range, threads: int) -> FrameBlock:
    """One block; each thread writes its own frames of it."""
    shape = (len(frames), model.sensor.rows, model.sensor.cols)
    block = FrameBlock(
        start=frames.start,
        range_mm=np.empty(shape, dtype=np.uint16),
        amplitude=np.empty(shape, dtype=np.float32),
        time_s=np.array(frames, dtype=np.float64) / model.recording.frame_rate_hz,
    )

    def render(frame: int) -> None:
        range_mm, amplitude = draw_frame(frame_generator(seed, frame))
        block.range_mm[frame - frames.start] = stored_range(range_mm).reshape(shape[1:])
        block.amplitude[frame - frames.start] = amplitude.reshape(shape[1:])

    if threads == 1:
        for frame in frames:
            render(frame)
        return block
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(render, frames))  # a list, so that a thread's exception is raised here
    return block
