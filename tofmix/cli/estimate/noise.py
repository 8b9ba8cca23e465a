"""The noise options of the command line: their texts, and the notes of the choice on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import AUTO, FILE, note
from tofmix.cli.progress import Progress
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.estimation.noise_choice import NoiseChoice, NoiseRequest
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.sensor import NoiseCurve, Sensor


def outlier_choice(text: str) -> str | float:
    """``file``, ``auto`` or a probability, from the command line.

    Raises
    ------
    UsageError
        If it is neither of them.
    """
    if text in (FILE, AUTO):
        return text
    try:
        probability = float(text)
    except ValueError:
        probability = -1.0
    if not 0.0 <= probability < 1.0:
        raise UsageError(f"--outliers: {text!r} is not file, auto or a probability in [0, 1)")
    return probability


def noise_choice(source: "RecordingFile", asked: str | None) -> str:
    """The value of --noise; without it ``file``, or ``auto`` for a file without a curve."""
    if asked is not None:
        return asked
    return FILE if source.sensor.noise is not None else AUTO


def circle_choice(unambiguous_range: float | None, *, wrap: bool) -> float | None:
    """The value of --unambiguous-range.

    Raises
    ------
    UsageError
        If --wrap is given too.
    """
    if wrap and unambiguous_range is not None:
        raise UsageError("--wrap takes the unambiguous range from the recording; leave out --unambiguous-range")
    return unambiguous_range


def circle_of(source: "RecordingFile") -> float:
    """Return the unambiguous range of the recording's camera, mm.

    Raises
    ------
    BadInputError
        If its modulation frequency is not known.
    """
    from tofmix.optics.ranging import unambiguous_range_mm

    frequency = source.sensor.modulation_frequency_hz
    if frequency is None:
        raise BadInputError(
            f"{source.path}: sensor: no modulation_frequency_hz, which --wrap needs; give --unambiguous-range MM"
        )
    return unambiguous_range_mm(frequency)


def spell(name: str, value: str) -> str:
    """An option with its value, as on the command line; a switch has no value."""
    return f"--{name.replace('_', '-')} {value}".rstrip()


def noise_of(source: "RecordingFile", noise: str) -> "str | NoiseCurve":
    """``file``, ``auto``, or the noise curve of the built-in sensor of this name.

    Raises
    ------
    UsageError
        If there is no such sensor, or its noise is not known.
    """
    from tofmix.sensors import PROFILES, noise_of_profile, profiles_with_noise

    if noise in (FILE, AUTO):
        return noise
    if noise not in PROFILES:
        known = ", ".join(profiles_with_noise())
        raise UsageError(f"--noise: unknown profile {noise!r}; choose file, auto or one of {known}")
    try:
        curve, doubt = noise_of_profile(noise, source.sensor.integration_time_ms)
    except ValueError as error:
        raise UsageError(f"--noise: {error}") from error
    if doubt is not None:
        click.echo(f"tofmix: {source.path}: {doubt}", err=True)
    return curve


def sensor_for(source: "RecordingFile", options: "EstimateOptions", request: "NoiseRequest") -> "NoiseChoice":
    """Choose the recording's sensor, and print the notes on it.

    Raises
    ------
    BadInputError
        If there is no noise curve, or the samples do not determine one.
    """
    from tofmix.estimation.noise_choice import choose_sensor

    def use(sensor: "Sensor") -> "RecordingFile":
        source.sensor = sensor
        return source

    from tofmix.pipeline.first_run import compile_learning_beside

    with calibration_bar() as progress:
        choice = choose_sensor(
            source.path, use, source.sensor, options, request, spell=spell, progress=progress,
            before_learning=compile_learning_beside,
        )  # fmt: skip
    for said in choice.notes:
        if said.is_warning:
            click.echo(f"tofmix: {said.text}", err=True)
        else:
            note(said.text)
    return choice


@contextmanager
def calibration_bar() -> Iterator[Callable[[int, int], None]]:
    """A progress bar for the calibration of learnt noise; it shows once there is something to calibrate."""
    bars: list[Progress] = []

    def progress(done: int, of: int) -> None:
        if not bars:
            bars.append(Progress(of, "noise", "step"))
        bars[0].update(done - bars[0].done)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()
