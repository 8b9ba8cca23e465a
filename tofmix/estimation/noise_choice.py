"""The camera of an estimate: the recording's, with the chosen noise curve and share of outliers.

`tofmix estimate` and `tofmix.estimate` both call `choose_sensor`. It prints nothing and warns of nothing: it returns
notes, which the command prints and of which Python warns.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from tofmix.circle import has_no_return
from tofmix.errors import BadInputError
from tofmix.estimation.beam import beam_of, outlier_interval, step_matters
from tofmix.estimation.filters import learn_filter
from tofmix.estimation.noise.curve_check import is_contradicted
from tofmix.estimation.noise.measurement import MeasuredNoise, disagreement, measure_noise
from tofmix.estimation.noise.steps import step_of_recording
from tofmix.estimation.samples import sensor_with_span
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.estimation.spatial_filters import neighbour_correlation
from tofmix.estimation.unrolling import UnrolledSource
from tofmix.noise_shape import WHOLE_MM, RangeStep
from tofmix.options import NOISE
from tofmix.recording import (
    SampleSource,
    TypedSource,
    amplitude_source,
    by_target,
    independent_samples,
    samples_a_frame,
)
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.temporal_filter import ApartMedians

T = TypeVar("T")

FILE, AUTO = "file", "auto"
"""Noise or outliers of the recording's own sensor, and of its samples."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """A sentence about the choice; `is_warning` if the result may be wrong because of it."""

    text: str
    is_warning: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseRequest:
    """How the noise is chosen, and learnt.

    Parameters
    ----------
    noise : {"file", "auto"} or NoiseCurve
        The recording's curve, a curve from its samples, or this curve.
    outliers : {"file", "auto"} or float
        p(c_r): the recording's, counted in its samples, or this share.
    asked : bool
        Whether the caller gave `noise`; if not, samples that contradict the file's curve replace it.
    shape, widths : str
        Parts of learnt noise, as in `tofmix.options.NOISE`.
    window_frames, stride_frames : int
        The windows, in frames.
    workers : int
        Threads.
    tolerance : float
        Relative difference of the file's curve and the measured one from which a note is a warning.
    """

    noise: str | NoiseCurve
    outliers: str | float
    asked: bool
    window_frames: int
    stride_frames: int
    shape: str = AUTO
    widths: str = AUTO
    workers: int = 1
    tolerance: float = 0.10


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseChoice:
    """The sensor of the estimate, the notes on it, and whether samples replaced the curve."""

    sensor: Sensor
    notes: tuple[Note, ...]
    from_samples: bool


Spelling = Callable[[str, str], str]
"""An option with its value as the caller spells it: ``--noise auto``, or ``noise='auto'``. No value is a switch."""


def gaussian_option(options: EstimateOptions, spell: Spelling) -> str | None:
    """The option that allows Gaussian noise only, or None."""
    if options.paper:
        return spell("paper", "")
    if options.refine is Refine.NONE:
        return spell("refine", options.refine.value)
    return spell("sigma", options.sigma.value) if options.sigma is SigmaMode.FREE else None


def check_parts(options: EstimateOptions, *, shape: str, widths: str, other_noise: str | None, spell: Spelling) -> None:
    """Refuse options of learnt noise if no noise is learnt.

    Parameters
    ----------
    options : EstimateOptions
        Of the estimate.
    shape, widths : str
        The options of learnt noise.
    other_noise : str or None
        The noise if it is neither ``auto`` nor left out.
    spell : Spelling
        For the message.

    Raises
    ------
    ValueError
        If an option needs learnt noise, and another option excludes it.
    """
    for name, value in (("noise_shape", shape), ("noise_widths", widths)):
        if refusal := NOISE[name].refusal(name, value):
            raise ValueError(refusal)
    chosen = [spell(name, value) for name, value in (("noise_shape", shape), ("noise_widths", widths)) if value != AUTO]
    excludes = gaussian_option(options, spell) or (None if other_noise is None else spell("noise", other_noise))
    if chosen and excludes:
        raise ValueError(f"{' and '.join(chosen)} needs learnt noise; {excludes} uses a Gaussian curve: leave one out")


def noise_options(noise: str, outliers: str | float, *, shape: str, widths: str) -> dict[str, str | float]:
    """Options of the sensor for the provenance of layers; those of learnt noise only if they are not the defaults."""
    options: dict[str, str | float] = {"noise": noise, "outliers": outliers}
    parts = {"noise_shape": shape, "noise_widths": widths}
    return options | {name: value for name, value in parts.items() if value != AUTO}


def choose_sensor(
    name: object,
    use: Callable[[Sensor], SampleSource],
    sensor: Sensor,
    options: EstimateOptions,
    request: NoiseRequest,
    *,
    spell: Spelling,
    progress: Callable[[int, int], None] | None = None,
    before_learning: Callable[[], object] | None = None,
) -> NoiseChoice:
    """The recording's sensor with the chosen noise and p(c_r).

    Parameters
    ----------
    name : object
        The recording, for messages.
    use : callable
        Gives the samples with a sensor.
    sensor : Sensor
        The recording's.
    options : EstimateOptions
        Of the estimate, with the unambiguous range at which readings are folded.
    request : NoiseRequest
        The choice.
    spell : Spelling
        For remedies in messages.
    progress : callable, optional
        Receives the finished steps of a calibration, and their number.
    before_learning : callable, optional
        Called before noise is learnt, which not every recording needs.

    Returns
    -------
    NoiseChoice
        It depends on the samples and the options alone.

    Raises
    ------
    BadInputError
        If there is no noise curve, or the samples do not determine one.
    """
    chooser = _Chooser(name, use, options, request, spell, progress, before_learning)
    chosen = chooser.choose(sensor)
    return NoiseChoice(
        sensor=chosen,
        notes=tuple(chooser.notes),
        from_samples=request.noise == AUTO or (request.noise == FILE and chooser.replaced),
    )


class _Chooser:
    """One choice: its inputs, and the notes so far."""

    def __init__(
        self,
        name: object,
        use: Callable[[Sensor], SampleSource],
        options: EstimateOptions,
        request: NoiseRequest,
        spell: Spelling,
        progress: Callable[[int, int], None] | None,
        before_learning: Callable[[], object] | None,
    ) -> None:
        self.name, self.stored, self.options, self.request, self.spell = name, use, options, request, spell
        self.circle_mm, self.progress = options.unambiguous_range_mm, progress
        self.before_learning = before_learning
        self.notes: list[Note] = []
        self.step: RangeStep | None = None
        self.replaced = False  # the curve is no longer that of the file
        self.of_type = False  # the step is that of whole mm, which integers have

    def choose(self, given: Sensor) -> Sensor:
        noise, outliers = self.request.noise, self.request.outliers
        if given.learnt is not None and FILE == noise == outliers:
            return given  # of an earlier estimate: drift, memory and thresholds are not in the curve
        sensor = self._without_step(self._with_filter(given))
        if noise == FILE and sensor.noise is None:
            raise BadInputError(
                f"{self.name}: sensor/noise_sigma: no noise curve; measure it with {self.spell('noise', AUTO)}, or"
                f" choose a built-in one with {self.spell('noise', 'PROFILE')} (tofmix sensors lists them)"
            )
        if not isinstance(outliers, str):
            sensor = replace(sensor, outlier_probability=outliers)
        if noise == FILE and self.circle_mm is not None:
            self._check_circle(sensor)  # on a circle too short for its curve, samples contradict any
        if isinstance(noise, NoiseCurve):
            curve = self._with_rounding(noise, sensor)
            sensor = self._with_least_sigma(replace(sensor, noise=curve, learnt=None), curve)
        if gaussian_option(self.options, self.spell) is not None:
            sensor = self._with_measured(sensor)
        elif noise == AUTO:
            sensor = self._with_learnt(sensor)
        else:
            if outliers == AUTO:
                sensor = replace(sensor, outlier_probability=self._measured(sensor).outlier_probability)
            sensor = self._as_given(sensor)
        if self.circle_mm is not None and sensor.noise is not None and sensor.noise.law is not None:
            sensor, self.replaced = replace(sensor, noise=replace(sensor.noise, law=None)), True
            self._warn("noise: on a wrapped range axis sigma depends on range only")
        self._check_circle(sensor)
        self._note_missing_no_return(sensor)
        return self._before_filter(self._with_step(sensor))

    def use(self, sensor: Sensor) -> SampleSource:
        """The samples that noise is learnt from, with a sensor."""
        return independent_samples(self.stored(sensor), for_noise=True)

    def _with_filter(self, given: Sensor) -> Sensor:
        """The sensor with the camera's filters: the file's, or those that the samples show."""
        if self.options.paper:
            return replace(given, temporal_filter=None, neighbour_correlation=None)
        if given.neighbour_correlation is None:
            given = replace(given, neighbour_correlation=neighbour_correlation(self.stored(given)))
        found = given.temporal_filter or learn_filter(self.stored(given))
        if found is None:
            return given
        sensor = replace(given, temporal_filter=found)
        if given.noise is not None:
            sensor = replace(sensor, noise=self._with_rounding(given.noise, sensor))
        if given.sample_max_mm is None:
            return sensor
        return sensor_with_span(self.use(sensor), self.circle_mm)  # an average hides the extreme samples

    def _with_rounding(self, curve: NoiseCurve, sensor: Sensor) -> NoiseCurve:
        """A curve of samples with the rounding of the stored ranges, which the inverse of a filter enlarges."""
        found = sensor.temporal_filter
        if found is None or not found.rounding_mm(1.0):
            return curve
        step = step_of_recording(self.stored(sensor))
        rounding = 0.0 if step is None else found.rounding_mm(step.typical())
        return replace(curve, sigma_mm=np.hypot(curve.sigma_mm, rounding))

    def _before_filter(self, sensor: Sensor) -> Sensor:
        """The sensor with the noise of samples before a median; noise was learnt from medians, which spread less.

        A curve that is asked for is that of samples before it.
        """
        found, asked = sensor.temporal_filter, self.request.asked and self.request.noise != AUTO
        median = None if found is None else found.median
        if median is None or sensor.noise is None or asked:
            return sensor
        return replace(sensor, noise=sensor.noise.scaled(1.0 / ApartMedians(median.parameter).sd()))

    def _check_circle(self, sensor: Sensor) -> None:
        """Refuse a circle that is too short for the noise."""
        try:
            beam_of(sensor, self.circle_mm)
        except ValueError as error:
            raise BadInputError(f"{self.name}: sensor: {error}") from error

    def _without_step(self, sensor: Sensor) -> Sensor:
        """Take the step of the stored ranges from the sensor, or from the samples; return the sensor without it."""
        self.step = sensor.step
        if self.step is None:
            source = self.use(sensor)
            self.step = step_of_recording(source)
            whole = self.step is not None and self.step.is_common and self.step.typical() == WHOLE_MM
            self.of_type = whole and isinstance(source, TypedSource) and not source.stored_type.startswith("float")
        if self.step is not None and samples_a_frame(self.use(sensor)) > 1:
            self.step = self.step.without_pixels()
        sensor = replace(sensor, range_step_mm=None)
        return sensor if self.step is None or sensor.noise is None else self._with_least_sigma(sensor, sensor.noise)

    def _with_least_sigma(self, sensor: Sensor, curve: NoiseCurve) -> Sensor:
        """The sensor with at least the sigma that the step tells."""
        least = np.zeros(1) if self.step is None else self.step.least_sigma(curve.range_mm)
        if (curve.sigma_mm >= least).all():
            return sensor
        return replace(sensor, noise=replace(curve, sigma_mm=np.maximum(curve.sigma_mm, least)))

    def _step_for(self, curve: NoiseCurve | None) -> RangeStep | None:
        """The step for work with a curve; None where it is that of whole mm in integers, and a small part of sigma."""
        fine = self.step is None or curve is None or not step_matters(self.step, curve, of_type=self.of_type)
        return None if self.of_type and fine else self.step

    def _with_step(self, sensor: Sensor) -> Sensor:
        """The sensor with the step of the stored ranges, at the ranges of its curve where it differs by range."""
        step, curve = self.step, sensor.noise
        if step is None or curve is None:
            return sensor
        matters = step_matters(step, curve, of_type=self.of_type)
        if matters and sensor.learnt is None and gaussian_option(self.options, self.spell) is None:
            sensor = self._calibrated(sensor)
        if self.of_type and not matters:
            return sensor
        if step.own_mm is not None:
            _, rows, cols = self.use(sensor).shape
            own = step.at(np.zeros(rows * cols), np.arange(rows * cols))
            return replace(sensor, range_step_mm=own.reshape(rows, cols))
        if step.is_common:
            return replace(sensor, range_step_mm=np.array(step.typical()))
        curve = curve.with_ranges(step.range_mm)
        return replace(sensor, noise=curve, range_step_mm=step.at(curve.range_mm))

    def _note(self, text: str) -> None:
        self.notes.append(Note(text=f"{self.name}: {text}"))

    def _warn(self, text: str) -> None:
        self.notes.append(Note(text=f"{self.name}: {text}", is_warning=True))

    def _with_measured(self, sensor: Sensor) -> Sensor:
        """The sensor with the sigma and the share of outliers of single surfaces, if requested."""
        given, sensor = sensor, replace(sensor, learnt=None)
        if AUTO not in (self.request.noise, self.request.outliers):
            return sensor
        measured = self._measured(given)
        if self.request.noise == AUTO:
            self._note_measured(given, measured)
            self._warn_of_difference(given, measured)
            sensor = replace(sensor, noise=measured.curve)
        if self.request.outliers == AUTO:
            sensor = replace(sensor, outlier_probability=measured.outlier_probability)
        return sensor

    def _with_learnt(self, given: Sensor) -> Sensor:
        """The sensor with all parts of the noise that the samples show."""
        from tofmix.estimation.learnt.recordings import learn_noise  # with the learnt engine, which others do not need

        found = self._learnt(given, learn_noise)
        sensor, measured = found.sensor, found.measured
        if self.request.outliers == AUTO:
            if measured is None:
                raise BadInputError(
                    f"{self.name}: outliers: no pixel sees exactly one surface, so outliers cannot be counted;"
                    f" give {self.spell('outliers', 'P')}"
                )
            sensor = replace(sensor, outlier_probability=measured.outlier_probability)
        kept = measured is not None and (found.model is None or found.model.kept_start)
        law = f"; {_amplitude_text(measured)}" if kept and measured and self._has_amplitude(given) else ""
        self._note(f"noise: {found.line()}{law}")
        if kept and measured is not None:
            self._warn_of_difference(given, measured)
        return sensor

    def _as_given(self, sensor: Sensor) -> Sensor:
        """The sensor with its own noise, or with the learnt one if samples may contradict it and do."""
        if sensor.noise is None:
            return sensor
        if sensor.learnt is not None and self.request.outliers == FILE:
            return sensor  # of an earlier estimate: drift, memory and thresholds are not in the curve
        if sensor.noise.has_parts:
            return self._calibrated(sensor)
        if self.request.noise != FILE or self.request.asked or not self._is_contradicted(sensor):
            return sensor
        from tofmix.estimation.learnt.recordings import learn_instead

        found = self._learnt(sensor, learn_instead)
        if found is None:
            return sensor
        self.replaced = True
        self._note(
            f"noise: the samples contradict the file's curve; learnt instead: {found.line()}"
            f" ({self.spell('noise', FILE)} keeps the file's curve)"
        )
        return found.sensor

    def _calibrated(self, sensor: Sensor) -> Sensor:
        """The sensor with the gains that its own noise alone reaches, rounding included."""
        from tofmix.estimation.learnt.recordings import calibrated

        return calibrated(
            self._ranges(sensor),
            window_frames=self.request.window_frames,
            step=self._step_for(sensor.noise),
            min_samples=self.options.min_samples,
            workers=self.request.workers,
            progress=self.progress,
        )

    def _is_contradicted(self, sensor: Sensor) -> bool:
        request = self.request
        try:
            return is_contradicted(
                self._ranges(sensor),
                window_frames=request.window_frames,
                stride_frames=request.stride_frames,
                step=self._step_for(sensor.noise),
            )
        except ValueError as error:
            raise self._unmeasured(error) from error

    def _ranges(self, sensor: Sensor) -> SampleSource:
        source = self.use(sensor)
        return source if self.circle_mm is None else UnrolledSource(source, self.circle_mm)

    def _learnt(self, sensor: Sensor, learn: Callable[..., T]) -> T:
        request = self.request
        if self.before_learning is not None:
            self.before_learning()
        try:
            return learn(
                self._ranges(sensor),
                window_frames=request.window_frames,
                stride_frames=request.stride_frames,
                shape=request.shape == AUTO,
                widths=None if request.widths == AUTO else request.widths == "own",
                drift=self.circle_mm is None,
                density=self.circle_mm is None,
                step=self.step,
                step_of_type=self.of_type,
                min_samples=self.options.min_samples,
                workers=request.workers,
                progress=self.progress,
            )
        except ValueError as error:
            raise self._unmeasured(error) from error

    def _measured(self, sensor: Sensor) -> MeasuredNoise:
        source = self.use(sensor)
        try:
            return measure_noise(
                source if self.circle_mm is None else UnrolledSource(by_target(source), self.circle_mm),
                step=self._step_for(None),
            )
        except ValueError as error:
            raise self._unmeasured(error) from error

    def _unmeasured(self, error: ValueError) -> BadInputError:
        return BadInputError(f"{self.name}: {error}; choose a curve with {self.spell('noise', 'PROFILE')}")

    def _has_amplitude(self, sensor: Sensor) -> bool:
        return amplitude_source(self.use(sensor)) is not None

    def _note_measured(self, given: Sensor, measured: MeasuredNoise) -> None:
        """Note the curve that replaces a missing one, and whether sigma depends on amplitude."""
        parts = []
        if given.noise is None:
            curve = measured.curve
            first, last = (f"{curve.sigma_mm[k]:.3g} mm at {curve.range_mm[k]:.0f} mm" for k in (0, -1))
            ends = first if len(curve.range_mm) == 1 else f"{first} to {last}"
            parts.append(f"the file has no curve; its samples show sigma {ends}")
        if self._has_amplitude(given):
            parts.append(_amplitude_text(measured))
        if parts:
            self._note(f"noise: {'; '.join(parts)}")

    def _warn_of_difference(self, given: Sensor, measured: MeasuredNoise) -> None:
        if given.noise is None or given.noise.law is not None:
            return  # the curve of a law holds at its reference amplitudes, which are not the measured ones'
        range_mm, ratio = disagreement(measured, given.noise)
        tolerance = self.request.tolerance
        if not 1.0 - tolerance <= ratio <= 1.0 + tolerance:
            self._warn(
                f"sensor/noise_sigma: the file's sigma is {ratio:.2f} times the measured one at {range_mm:.0f} mm; the"
                " measured curve is used"
            )

    def _note_missing_no_return(self, sensor: Sensor) -> None:
        if self.circle_mm is None and sensor.range_max_mm is None and sensor.noise is not None:
            low, high = outlier_interval(sensor, sensor.noise)
            known = sensor.range_min_mm is not None and low == sensor.range_min_mm
            ends = "range_min_mm to the largest sample" if known else "the smallest sample to the largest"
            self._note(
                "sensor: no range_max_mm: the share without a return is unknown, and random values spread from"
                f" {ends}, {low:.0f} to {high:.0f} mm"
            )
        if self.circle_mm is not None and sensor.range_max_mm is not None and not has_no_return(sensor, self.circle_mm):
            self._warn(
                f"sensor: samples without a return, at range_max_mm {sensor.range_max_mm:g}, look like a surface at the"
                f" fold of {self.circle_mm:.1f} mm; c_0 is left out"
            )


def _amplitude_text(measured: MeasuredNoise) -> str:
    law = measured.curve.law
    if law is None or measured.law_gain is None:
        return "sigma is measured by range only; amplitude adds no information"
    powers = [f"^-{power:.2f}" for power in law.exponents()]
    falls = powers[0] + "".join(f", {p} from {a:.4g} on" for p, a in zip(powers[1:], law.amplitude[1:-1], strict=True))
    return (
        f"sigma is measured by range and amplitude; it varies as amplitude{falls}"
        f" (+{measured.law_gain:.0f} nat on pixels held out)"
    )
