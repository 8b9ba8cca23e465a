"""The camera that an estimate uses: the recording's, with the noise curve and outlier share that were asked for."""

from dataclasses import replace
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import note
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.estimation.noise import MeasuredNoise
    from tofmix.io.recording_file import RecordingFile
    from tofmix.sensor import Sensor
    from tofmix.sensors import SensorProfile

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
        raise UsageError(f"--outliers: {text!r} is neither file, auto nor a probability in [0, 1)")
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


def sensor_for(
    source: "RecordingFile", *, noise: str, outliers: str | float, circle_mm: float | None = None
) -> "Sensor":
    """The recording's sensor with the chosen noise curve and p(c_r).

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

    Raises
    ------
    UsageError
        If there is no built-in sensor of that name.
    BadInputError
        If there is no noise curve, or the recording does not tell it.
    """
    from tofmix.estimation.beam import beam_of
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
    measured = _measured(source, circle_mm) if AUTO in (noise, outliers) else None
    if noise == AUTO and measured is not None:
        _say_what_was_measured(source, measured)
        _warn_where_they_differ(source, measured)
        sensor = replace(sensor, noise=measured.curve)
    elif noise != FILE:
        sensor = _with_profile(source, sensor, noise)
    if outliers == AUTO and measured is not None:
        sensor = replace(sensor, outlier_probability=measured.outlier_probability)
    elif isinstance(outliers, float):
        sensor = replace(sensor, outlier_probability=outliers)
    if circle_mm is not None and sensor.noise is not None and sensor.noise.law is not None:
        sensor = replace(sensor, noise=replace(sensor.noise, law=None))
        click.echo(f"tofmix: {source.path}: noise: on a wrapped range axis sigma goes by range alone", err=True)
    try:
        beam_of(sensor, circle_mm)
    except ValueError as error:
        raise BadInputError(f"{source.path}: sensor: {error}") from error
    _say_where_c_0_is_missing(source, sensor, circle_mm)
    return sensor


def _say_where_c_0_is_missing(source: "RecordingFile", sensor: "Sensor", circle_mm: float | None) -> None:
    from tofmix.circle import has_no_return
    from tofmix.estimation.beam import outlier_interval

    if circle_mm is None and sensor.range_max_mm is None and sensor.noise is not None:
        low, high = outlier_interval(sensor, sensor.noise)
        known = sensor.range_min_mm is not None and low == sensor.range_min_mm
        ends = "range_min_mm to the largest sample" if known else "the least sample to the largest"
        click.echo(
            f"tofmix: {source.path}: sensor: no range_max_mm: there is no share without a return, and random values are"
            f" taken to spread from {ends}, {low:.0f} to {high:.0f} mm",
            err=True,
        )
    if circle_mm is not None and sensor.range_max_mm is not None and not has_no_return(sensor, circle_mm):
        click.echo(
            f"tofmix: {source.path}: sensor: samples without a return, at range_max_mm {sensor.range_max_mm:g}, cannot"
            f" be told from a surface at the fold of {circle_mm:.1f} mm; there is no c_0",
            err=True,
        )


def _measured(source: "RecordingFile", circle_mm: float | None) -> "MeasuredNoise":
    from tofmix.estimation.noise import measure_noise
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
        return "sigma is measured by range alone; amplitude does not tell more"
    powers = [f"^-{power:.2f}" for power in law.exponents()]
    falls = powers[0] + "".join(f", {p} from {a:.4g} on" for p, a in zip(powers[1:], law.amplitude[1:-1], strict=True))
    return (
        f"sigma is measured by range and amplitude; it goes as amplitude{falls}"
        f" (+{measured.law_gain:.0f} nat on pixels held out)"
    )


def _warn_where_they_differ(source: "RecordingFile", measured: "MeasuredNoise") -> None:
    from tofmix.estimation.noise import disagreement

    if source.sensor.noise is None or source.sensor.noise.law is not None:
        return  # the curve of a law holds at its reference amplitudes, which are not the measured ones'
    range_mm, ratio = disagreement(measured, source.sensor.noise)
    if not 1.0 - TOLERANCE <= ratio <= 1.0 + TOLERANCE:
        click.echo(
            f"tofmix: {source.path}: sensor/noise_sigma: the file's sigma is {ratio:.2f} times the measured one"
            f" at {range_mm:.0f} mm; the measured curve is used",
            err=True,
        )
