"""Simulate a recording of a model: its scene cast, and its frames drawn."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tofmix.errors import BadInputError
from tofmix.io.recording.recording_writer import CHUNK_FRAMES, RecordingWriter
from tofmix.jobs.reporter import Reporter
from tofmix.sensor import Sensor
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.exposure import drawn_truth
from tofmix.simulation.model import Model
from tofmix.simulation.render import FrameBlock, recording_sensor, render_blocks


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """A model whose frames can be drawn; `averaged` are those of on-board averages."""

    model: Model
    sensor: Sensor
    truth: Truth
    averaged: bool
    threads: int

    @classmethod
    def of(cls, model: Model, name: str, *, averaged: bool, threads: int) -> Self:
        """Cast the scene of a model.

        Raises
        ------
        BadInputError
            If the camera cannot average, or a surface leaves the bounds of a model before the last frame.
        """
        try:
            sensor, truth = recording_sensor(model, averaged=averaged), cast_scene(model)
            model.placed((model.recording.frames - 1) / model.recording.frame_rate_hz)
        except BadInputError as error:
            raise BadInputError(f"{name}: {error}") from error
        return cls(model=model, sensor=sensor, truth=truth, averaged=averaged, threads=threads)

    def blocks(self) -> Iterator[FrameBlock]:
        """The frames in blocks, which a file stores together."""
        frames, seed = self.model.recording.frames, self.model.recording.seed
        return render_blocks(
            self.model,
            self.truth,
            n_frames=frames,
            seed=seed,
            averaged=self.averaged,
            block_frames=CHUNK_FRAMES,
            threads=self.threads,
        )

    def write(self, output: Path, name: str, reporter: Reporter, *, overwrite: bool) -> None:
        """Write the recording of a model named `name`; each frame is a step of progress."""
        model, frames, seed = self.model, self.model.recording.frames, self.model.recording.seed
        writer = RecordingWriter(
            output,
            shape=(frames, model.sensor.rows, model.sensor.cols),
            sensor=self.sensor,
            truth=self.truth,
            model_text=model.text,
            effect_truth=drawn_truth(model, seed=seed, n_frames=frames),
            moving=model.moves,
            title=f"synthetic recording of {Path(name).name}",
            overwrite=overwrite,
            attributes={"seed": seed, "averaged": int(self.averaged)},
        )
        with reporter.steps(frames, "simulate", "frame"), writer:  # the bar stays until the file has its name
            for block in self.blocks():
                writer.write(
                    block.start,
                    block.range_mm,
                    time_s=block.time_s,
                    amplitude=block.amplitude,
                    range_true=block.range_true,
                )
                reporter.progress(len(block.range_mm))
