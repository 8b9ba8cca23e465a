"""The camera that an estimate uses: the recording's, with the noise curve and outlier share that were asked for."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tofmix.cli.options import note, progress_bar
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tqdm import tqdm

    from tofmix.estimation.noise.measurement import MeasuredNoise
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.recording import SampleSource
    from tofmix.sensor import Sensor
    from tofmix.sensors import SensorProfile

T = TypeVar("T")

FILE, AUTO = "file", "auto"

TOLERANCE = 0.10
"""Relative difference of the file's curve and the measured one that is worth a word."""


def outlier_choice(text: str) -> str | float:
    """``file``, ``auto`` or a probability, from the command line.

    Raises
    ------
    UsageError
        If it is none of them.
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
    """What --noise says; without it ``file``, or ``auto`` where the file has no curve."""
    if asked is not None:
        return asked
    return FILE if source.sensor.noise is not None else AUTO


def circle_choice(unambiguous_range: float | None, *, wrap: bool) -> float | None:
    """What --unambiguous-range says.

    Raises
    ------
    UsageError
        If --wrap is there too.
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
    from tofmix.ranging import unambiguous_range_mm

    frequency = source.sensor.modulation_frequency_hz
    if frequency is None:
        raise BadInputError(
            f"{source.path}: sensor: no modulation_frequency_hz, which --wrap needs; give --unambiguous-range MM"
        )
    return unambiguous_range_mm(frequency)


@dataclass(frozen=True, slots=True, kw_only=True)
class Learning:
    """How a recording's noise is learnt.

    Parameters
    ----------
    window_frames, stride_frames : int
        The windows, in frames.
    shape : str
        ``gaussian`` or ``auto``.
    widths : str
        ``common``, ``own`` or ``auto``.
    min_samples : int
        Fewest samples of a pixel.
    workers : int
        Threads.
    asked : bool
        Whether --noise was given: else a file's curve is held against the samples.
    circle_mm : float or None
        Unambiguous range, mm, at which readings are folded.
    """

    window_frames: int
    stride_frames: int
    shape: str = "auto"
    widths: str = "auto"
    min_samples: int = 3
    workers: int = 1
    asked: bool = True
    circle_mm: float | None = None


def sensor_for(
    source: "RecordingFile",
    *,
    noise: str,
    outliers: str | float,
    circle_mm: float | None = None,
    learning: Learning | None = None,
) -> "Sensor":
    """The recording's sensor with the chosen noise and p(c_r).

    Parameters
    ----------
    source : RecordingFile
        The recording.
    noise : str
        ``file``, ``auto`` or the name of a built-in sensor.
    outliers : str or float
        What `outlier_choice` returned.
    circle_mm : float, optional
        Unambiguous range, mm, at which readings are folded.
    learning : Learning, optional
        How the noise is learnt; without it only a Gaussian's sigma is measured, and no curve is questioned.

    Raises
    ------
    UsageError
        If there is no built-in sensor of that name.
    BadInputError
        If there is no noise curve, or the recording does not tell it.
    """
    from tofmix.estimation.mixture.beam import beam_of
    from tofmix.sensors import PROFILES, profiles_with_noise

    if noise not in (FILE, AUTO, *PROFILES):
        known = ", ".join(profiles_with_noise())
        raise UsageError(f"--noise: unknown profile {noise!r}; choose file, auto or one of {known}")
    sensor = source.sensor
    if noise == FILE and sensor.noise is None:
        raise BadInputError(
            f"{source.path}: sensor/noise_sigma: no noise curve; measure it with --noise auto,"
            f" or choose a built-in one with --noise PROFILE ({', '.join(profiles_with_noise())})"
        )
    if isinstance(outliers, float):
        sensor = replace(sensor, outlier_probability=outliers)
    if noise not in (FILE, AUTO):
        sensor = _with_profile(source, sensor, noise)
    source.sensor = sensor
    if learning is None:
        sensor = _with_measured(source, noise, outliers, circle_mm)
    elif noise == AUTO:
        sensor = _with_learnt(source, outliers, learning)
    else:
        if outliers == AUTO:
            sensor = replace(sensor, outlier_probability=_measured(source, circle_mm).outlier_probability)
            source.sensor = sensor
        sensor = _as_the_file_says(source, learning, question=noise == FILE and not learning.asked)
    if circle_mm is not None and sensor.noise is not None and sensor.noise.law is not None:
        sensor = replace(sensor, noise=replace(sensor.noise, law=None))
        click.echo(f"tofmix: {source.path}: noise: on a wrapped range axis sigma depends on range only", err=True)
    try:
        beam_of(sensor, circle_mm)
    except ValueError as error:
        raise BadInputError(f"{source.path}: sensor: {error}") from error
    _say_where_c_0_is_missing(source, sensor, circle_mm)
    return sensor


def _with_measured(source: "RecordingFile", noise: str, outliers: str | float, circle_mm: float | None) -> "Sensor":
    """The sensor with the sigma and the share of outliers that single surfaces tell, where they are asked for."""
    sensor = replace(source.sensor, learnt=None)
    if AUTO not in (noise, outliers):
        return sensor
    measured = _measured(source, circle_mm)
    if noise == AUTO:
        _say_what_was_measured(source, measured)
        _warn_where_they_differ(source, measured)
        sensor = replace(sensor, noise=measured.curve)
    if outliers == AUTO:
        sensor = replace(sensor, outlier_probability=measured.outlier_probability)
    return sensor


def _with_learnt(source: "RecordingFile", outliers: str | float, learning: Learning) -> "Sensor":
    """The sensor with all that the recording teaches of its noise; said in a line."""
    from tofmix.estimation.learnt.recordings import learn_noise

    found = _learnt(source, learning, learn_noise)
    sensor = found.sensor
    if outliers == AUTO:
        if found.measured is None:
            raise BadInputError(
                f"{source.path}: outliers: no pixel sees exactly one surface, so outliers cannot be counted;"
                " give --outliers P"
            )
        sensor = replace(sensor, outlier_probability=found.measured.outlier_probability)
    kept = found.measured is not None and (found.lesson is None or found.lesson.kept_start)
    law = f"; {_amplitude_text(found.measured)}" if kept and found.measured and source.has_amplitude else ""
    note(f"{source.path}: noise: {found.line()}{law}")
    if kept and found.measured is not None:
        _warn_where_they_differ(source, found.measured)
    return sensor


def _as_the_file_says(source: "RecordingFile", learning: Learning, *, question: bool) -> "Sensor":
    """The sensor with the file's noise, or, where it may be questioned and samples contradict it, the learnt one."""
    from tofmix.estimation.learnt.recordings import calibrated, has_parts, learn_if_contradicted

    sensor = source.sensor
    if sensor.noise is None:
        return sensor
    if has_parts(sensor.noise):
        with calibration_bar() as progress:
            return calibrated(
                _ranges(source, learning), window_frames=learning.window_frames, min_samples=learning.min_samples,
                workers=learning.workers, progress=progress,
            )  # fmt: skip
    found = _learnt(source, learning, learn_if_contradicted) if question else None
    if found is None:
        return sensor
    note(
        f"{source.path}: noise: the samples contradict the file's curve; learnt instead: {found.line()}"
        " (--noise file keeps the file's curve)"
    )
    return found.sensor


def _ranges(source: "RecordingFile", learning: Learning) -> "SampleSource":
    from tofmix.estimation.unrolling import UnrolledSource

    return source if learning.circle_mm is None else UnrolledSource(source, learning.circle_mm)


def _learnt(source: "RecordingFile", learning: Learning, learn: Callable[..., T]) -> T:
    try:
        with calibration_bar() as progress:
            return learn(
                _ranges(source, learning),
                window_frames=learning.window_frames,
                stride_frames=learning.stride_frames,
                shape=learning.shape == AUTO,
                widths=None if learning.widths == AUTO else learning.widths == "own",
                drift=learning.circle_mm is None,
                min_samples=learning.min_samples,
                workers=learning.workers,
                progress=progress,
            )
    except ValueError as error:
        raise BadInputError(f"{source.path}: {error}; choose a curve with --noise PROFILE") from error


@contextmanager
def calibration_bar() -> Iterator[Callable[[int, int], None]]:
    """A progress bar for the calibration of learnt noise; it shows once there is something to calibrate."""
    bars: list[tqdm[Any]] = []

    def progress(done: int, of: int) -> None:
        if not bars:
            bars.append(progress_bar(of, "noise", "step"))
        bars[0].update(done - bars[0].n)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()


def _say_where_c_0_is_missing(source: "RecordingFile", sensor: "Sensor", circle_mm: float | None) -> None:
    from tofmix.circle import has_no_return
    from tofmix.estimation.mixture.beam import outlier_interval

    if circle_mm is None and sensor.range_max_mm is None and sensor.noise is not None:
        low, high = outlier_interval(sensor, sensor.noise)
        known = sensor.range_min_mm is not None and low == sensor.range_min_mm
        ends = "range_min_mm to the largest sample" if known else "the least sample to the largest"
        note(
            f"{source.path}: sensor: no range_max_mm: the share without a return is unknown, and random"
            f" values spread from {ends}, {low:.0f} to {high:.0f} mm"
        )
    if circle_mm is not None and sensor.range_max_mm is not None and not has_no_return(sensor, circle_mm):
        click.echo(
            f"tofmix: {source.path}: sensor: samples without a return, at range_max_mm {sensor.range_max_mm:g}, look"
            f" like a surface at the fold of {circle_mm:.1f} mm; c_0 is left out",
            err=True,
        )


def _measured(source: "RecordingFile", circle_mm: float | None) -> "MeasuredNoise":
    from tofmix.estimation.noise.measurement import measure_noise
    from tofmix.estimation.unrolling import UnrolledSource
    from tofmix.recording import by_target

    try:
        return measure_noise(source if circle_mm is None else UnrolledSource(by_target(source), circle_mm))
    except ValueError as error:
        raise BadInputError(f"{source.path}: {error}; choose a curve with --noise PROFILE") from error


def _profile_with_noise(name: str) -> "SensorProfile":
    from tofmix.sensors import load_sheet, profiles_with_noise

    sheet = load_sheet(name)
    if sheet.noise is None:
        known = ", ".join(profiles_with_noise())
        raise UsageError(
            f"--noise: the noise of {sheet.name} is not known; --noise auto measures it, {known} have a curve"
        )
    return sheet.profile()


def _with_profile(source: "RecordingFile", sensor: "Sensor", name: str) -> "Sensor":
    profile = _profile_with_noise(name)
    if sensor.integration_time_ms is None:
        click.echo(
            f"tofmix: {source.path}: sensor: no integration_time_ms; the curve of {name} is taken"
            f" at its default, {profile.integration_time_ms:g} ms",
            err=True,
        )
    return replace(sensor, noise=profile.noise_at(sensor.integration_time_ms or profile.integration_time_ms))


def _say_what_was_measured(source: "RecordingFile", measured: "MeasuredNoise") -> None:
    """Say in one line which curve stands in for a missing one, and whether sigma depends on amplitude."""
    said = []
    if source.sensor.noise is None:
        curve = measured.curve
        first, last = (f"{curve.sigma_mm[k]:.3g} mm at {curve.range_mm[k]:.0f} mm" for k in (0, -1))
        ends = first if len(curve.range_mm) == 1 else f"{first} to {last}"
        said.append(f"the file has no curve; its samples show sigma {ends}")
    if source.has_amplitude:
        said.append(_amplitude_text(measured))
    if said:
        note(f"{source.path}: noise: {'; '.join(said)}")


def _amplitude_text(measured: "MeasuredNoise") -> str:
    law = measured.curve.law
    if law is None or measured.law_gain is None:
        return "sigma is measured by range only; amplitude adds no information"
    powers = [f"^-{power:.2f}" for power in law.exponents()]
    falls = powers[0] + "".join(f", {p} from {a:.4g} on" for p, a in zip(powers[1:], law.amplitude[1:-1], strict=True))
    return (
        f"sigma is measured by range and amplitude; it varies as amplitude{falls}"
        f" (+{measured.law_gain:.0f} nat on pixels held out)"
    )


def _warn_where_they_differ(source: "RecordingFile", measured: "MeasuredNoise") -> None:
    from tofmix.estimation.noise.measurement import disagreement

    if source.sensor.noise is None or source.sensor.noise.law is not None:
        return  # the curve of a law holds at its reference amplitudes, which are not the measured ones'
    range_mm, ratio = disagreement(measured, source.sensor.noise)
    if not 1.0 - TOLERANCE <= ratio <= 1.0 + TOLERANCE:
        click.echo(
            f"tofmix: {source.path}: sensor/noise_sigma: the file's sigma is {ratio:.2f} times the measured one"
            f" at {range_mm:.0f} mm; the measured curve is used",
            err=True,
        )
