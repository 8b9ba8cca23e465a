"""Properties of a camera: its working range, its beam, and its noise curve sigma(r).

Everything that reads samples or makes them shares these types. A sensor
described in a file is read by `tofmix.io`; the built-in ones are in
`tofmix.sensors`.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import IMAGE_RANK, FloatArray
from tofmix.noise_shape import BackgroundDensity, LearntNoise, NoiseShape, RangeStep
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import PINHOLE, Projection, ideal_pinhole
from tofmix.sensor_schema import (
    NUMBERS,
    RARE_SENSOR_NUMBERS,
    SENSOR_NUMBERS,
    Measurement,
    ShareLaw,
    measurement_of,
    share_law_of,
)
from tofmix.temporal_filter import TemporalFilter
from tofmix.wording import counted

DEFAULT_OUTLIER_PROBABILITY = 1.0e-4  # p(c_r) where neither file nor option gives one

_LEAST_FREQUENCY_HZ, _MOST_FREQUENCY_HZ = 1.0, 1e12  # of modulation; anything else is a wrong unit

MOST_WIDTH_SPREAD = 2.0
"""Standard deviation of log width: widths that differ by a factor of e^2 from pixel to pixel are no camera's."""


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeLaw:
    """How noise depends on a sample's amplitude: a factor on the noise curve.

    The logarithm of the factor is linear in that of the amplitude between the points, and constant past their ends: a
    straight piece is a power law.

    Parameters
    ----------
    reference : (n,) float64
        Amplitude, above 0, at which the curve's sigma holds, one for each range of the curve.
    amplitude : (m,) float64
        Strictly ascending amplitudes, above 0.
    factor : (m,) float64
        Factor at each of them, above 0; only its ratios matter.

    Raises
    ------
    ValueError
        If a list is empty, has another length or shape, is not above 0, or the amplitudes do not ascend.
    """

    reference: FloatArray
    amplitude: FloatArray
    factor: FloatArray

    def __post_init__(self) -> None:
        for key in ("reference", "amplitude", "factor"):
            values = np.array(getattr(self, key), dtype=np.float64, copy=True)
            if values.ndim != 1 or values.size == 0 or not (np.isfinite(values) & (values > 0)).all():
                raise ValueError(f"noise curve: {key} must be a list of finite numbers above 0")
            values.setflags(write=False)
            object.__setattr__(self, key, values)
        if self.amplitude.shape != self.factor.shape:
            raise ValueError(
                f"noise curve: {counted(self.amplitude.size, 'amplitude')}, but {counted(self.factor.size, 'factor')}"
            )
        if not (np.diff(self.amplitude) > 0).all():
            raise ValueError("noise curve: its amplitudes do not ascend")

    def log_factor(self, amplitude: ArrayLike) -> FloatArray:
        """Logarithm of the factor at amplitudes of any shape; NaN where one is not a number above 0."""
        values = np.asarray(amplitude, dtype=np.float64)
        log_amplitude = np.log(np.where(values > 0, values, np.nan))
        return np.asarray(np.interp(log_amplitude, np.log(self.amplitude), np.log(self.factor)), dtype=np.float64)

    def scaled(self, factor: float) -> Self:
        """The same law of amplitudes that are `factor` times as large, as another integration time gives."""
        return replace(self, reference=self.reference * factor, amplitude=self.amplitude * factor)

    def exponents(self) -> FloatArray:
        """Power (m - 1,) of amplitude by which noise falls from each point to the next."""
        return np.asarray(-np.diff(np.log(self.factor)) / np.diff(np.log(self.amplitude)))


@dataclass(frozen=True, slots=True, eq=False)
class NoiseCurve:
    """Standard deviation of one sample against range, sigma(r).

    Interpolated linearly between its points and held constant past its ends.

    Parameters
    ----------
    range_mm : (n,) float64
        Strictly ascending ranges, mm.
    sigma_mm : (n,) float64
        Standard deviation at each of them, mm, above 0.
    law : AmplitudeLaw, optional
        How noise depends on amplitude; `sigma_mm` is then that at the law's reference amplitudes.
    shape : NoiseShape, optional
        Density of the error in units of sigma; Gaussian without it. Sigma is then half the width of its central 68 %.
    width_spread : float
        Standard deviation of the logarithm of a pixel's own width, a factor on sigma, at least 0.
    background : (row, col) float64, or (), optional
        Share of the samples of each pixel, or of all alike, that are random values, in [0, 1).
    background_density : BackgroundDensity, optional
        Density of random values over range; uniform over the working range without it.

    Raises
    ------
    ValueError
        If the two differ in length or are empty, if a value is not finite, the
        ranges do not ascend or a sigma is not above 0; if the law has another number of references; if the spread of
        widths or a share of background is out of its bounds.
    """

    range_mm: FloatArray
    sigma_mm: FloatArray
    law: AmplitudeLaw | None = None
    shape: NoiseShape | None = None
    width_spread: float = 0.0
    background: FloatArray | None = None
    background_density: BackgroundDensity | None = None

    def __post_init__(self) -> None:
        range_mm = np.array(self.range_mm, dtype=np.float64, copy=True)
        sigma_mm = np.array(self.sigma_mm, dtype=np.float64, copy=True)
        if range_mm.ndim != 1 or range_mm.shape != sigma_mm.shape or range_mm.size == 0:
            raise ValueError(
                "noise curve: range and sigma must be two lists of one length,"
                f" got shapes {range_mm.shape} and {sigma_mm.shape}"
            )
        if not np.isfinite(range_mm).all():
            raise ValueError("noise curve: a range is not finite")
        if not (np.diff(range_mm) > 0).all():
            raise ValueError("noise curve: its ranges do not ascend")
        bad = ~(np.isfinite(sigma_mm) & (sigma_mm > 0))
        if bad.any():
            k = int(np.argmax(bad))
            raise ValueError(
                f"noise curve: sigma is {sigma_mm[k]:g} mm at {range_mm[k]:g} mm; it must be finite and above 0"
            )
        range_mm.setflags(write=False)
        sigma_mm.setflags(write=False)
        object.__setattr__(self, "range_mm", range_mm)
        object.__setattr__(self, "sigma_mm", sigma_mm)
        if self.law is not None and self.law.reference.shape != range_mm.shape:
            references = counted(self.law.reference.size, "reference amplitude")
            raise ValueError(f"noise curve: {counted(range_mm.size, 'range')}, but {references}")
        if not 0 <= self.width_spread <= MOST_WIDTH_SPREAD:
            raise ValueError(f"noise curve: width_spread {self.width_spread:g} is not 0 to {MOST_WIDTH_SPREAD:g}")
        if self.background is not None:
            background = np.array(self.background, dtype=np.float64, copy=True)
            if background.ndim not in (0, 2) or not ((background >= 0) & (background < 1)).all():
                raise ValueError("noise curve: background must be one share, or a map (row, col) of them, in [0, 1)")
            background.setflags(write=False)
            object.__setattr__(self, "background", background)

    def sigma(self, range_mm: FloatArray | float, amplitude: ArrayLike | None = None) -> FloatArray:
        """sigma(r) in mm at ranges of any shape, mm.

        With `amplitude`, of a compatible shape, and a law: at that amplitude; at the reference amplitude if it is not a
        number above 0.
        """
        sigma = np.asarray(np.interp(range_mm, self.range_mm, self.sigma_mm), dtype=np.float64)
        if amplitude is None or self.law is None:
            return sigma
        reference = np.interp(range_mm, self.range_mm, self.law.reference)
        factor = np.exp(self.law.log_factor(amplitude) - self.law.log_factor(reference))
        return sigma * np.where(np.isnan(factor), 1.0, factor)

    def with_ranges(self, range_mm: ArrayLike) -> Self:
        """The same curve with further points at some ranges, mm: sigma is the same at every range."""
        points = np.union1d(self.range_mm, range_mm)
        law = self.law
        if law is not None:
            law = replace(law, reference=np.interp(points, self.range_mm, law.reference))
        return replace(self, range_mm=points, sigma_mm=self.sigma(points), law=law)

    @property
    def has_parts(self) -> bool:
        """Whether it has more than sigma by range and amplitude."""
        if self.background is not None or self.background_density is not None:
            return True
        return self.shape is not None or self.width_spread > 0

    def scaled(self, factor: float, *, amplitude_factor: float = 1.0) -> Self:
        """The same curve with every sigma times `factor`, and the law's amplitudes times `amplitude_factor`."""
        law = None if self.law is None else self.law.scaled(amplitude_factor)
        return replace(self, sigma_mm=self.sigma_mm * factor, law=law)

    def same_as(self, other: "NoiseCurve") -> bool:
        """Whether all numbers of two curves are equal."""
        pairs = [(self.range_mm, other.range_mm), (self.sigma_mm, other.sigma_mm)]
        if self.background is not None and other.background is not None:
            pairs.append((self.background, other.background))
        elif self.background is not other.background:
            return False
        for own, its in ((self.shape, other.shape), (self.background_density, other.background_density)):
            if (own is None) != (its is None) or (own is not None and not own.same_as(its)):  # type: ignore[arg-type]
                return False
        if self.width_spread != other.width_spread:
            return False
        if self.law is None or other.law is None:
            return self.law is other.law and all(np.array_equal(*pair) for pair in pairs)
        pairs += [(getattr(self.law, key), getattr(other.law, key)) for key in ("reference", "amplitude", "factor")]
        return all(np.array_equal(*pair) for pair in pairs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A camera as a recording describes it. None means unknown.

    Parameters
    ----------
    name : str
        The camera's name.
    modulation_frequency_hz, integration_time_ms : float or None
        Modulation frequency; integration time of one sample.
    range_min_mm, range_max_mm : float or None
        Working range. Without `range_max_mm` there is no c_0 in equation (1).
    fov_horizontal_deg, fov_vertical_deg : float or None
        Full field of view, of equal angles between pixels. Unused if there is a `projection`.
    projection : Projection or None
        Where the pixels look, if not by the field of view.
    measurement : Measurement or None
        What the camera measures; a text such as ``"pulses"`` becomes it.
    share_law : ShareLaw or None
        How samples share out among the surfaces of a pixel; a text such as ``"detections"`` becomes it. None counts as
        ``area``.
    outlier_probability : float
        p(c_r) of equation (1), in [0, 1).
    no_return_mm : float or None
        The one value that the camera returns where there is no surface, mm; None: samples without a return scatter
        around `range_max_mm` as those of a surface there do.
    sample_min_mm, sample_max_mm : float or None
        Least and largest valid sample of the recording, where `range_max_mm` is not known: random values spread
        between them (`tofmix.estimation.samples`). None: not looked for.
    neighbour_correlation : float or None
        Correlation of the noise of neighbouring pixels, where the camera filters ranges over them. None: it does not.
    noise : NoiseCurve or None
        sigma(r) at `integration_time_ms`.
    learnt : LearntNoise or None
        Noise of pixels that was learnt from the recording, in addition to the curve. With it, surfaces are counted
        under the learnt noise.
    range_step_mm : (), (row, col) or (n,) float64, or None
        Step on which the stored ranges lie, mm, above 0, where it is wider than that of the stored type: common, of
        each pixel, or at each range of the noise curve.
    temporal_filter : TemporalFilter or None
        How the camera filters ranges over time; the curve is that of its independent samples. None: it does not.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds, or steps by range are not as many as the curve has ranges.
    """

    name: str
    modulation_frequency_hz: float | None = None
    integration_time_ms: float | None = None
    range_min_mm: float | None = None
    range_max_mm: float | None = None
    fov_horizontal_deg: float | None = None
    fov_vertical_deg: float | None = None
    projection: Projection | None = None
    measurement: Measurement | None = None
    share_law: ShareLaw | None = None
    outlier_probability: float = DEFAULT_OUTLIER_PROBABILITY
    no_return_mm: float | None = None
    sample_min_mm: float | None = None
    sample_max_mm: float | None = None
    neighbour_correlation: float | None = None
    noise: NoiseCurve | None = None
    learnt: LearntNoise | None = None
    range_step_mm: FloatArray | None = None
    temporal_filter: TemporalFilter | None = None

    def __post_init__(self) -> None:
        for key in (*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS):
            value = getattr(self, key)
            if value is not None and (reason := NUMBERS[key].refusal(value, limited=False)):
                raise ValueError(f"{key}: {reason}")
        if self.measurement is not None:
            object.__setattr__(self, "measurement", measurement_of(self.measurement))
        if self.share_law is not None:
            object.__setattr__(self, "share_law", share_law_of(self.share_law))
        frequency = self.modulation_frequency_hz
        if frequency is not None and not _LEAST_FREQUENCY_HZ <= frequency <= _MOST_FREQUENCY_HZ:
            raise ValueError(f"modulation_frequency_hz: {frequency:g} is not between 1 Hz and 1 THz")
        if self.range_max_mm is not None and (self.range_min_mm or 0.0) >= self.range_max_mm:
            raise ValueError(f"range_min_mm: {self.range_min_mm} is not below range_max_mm {self.range_max_mm}")
        if self.range_step_mm is not None:
            self._check_step(self.range_step_mm)

    def _check_step(self, range_step_mm: ArrayLike) -> None:
        step = np.array(range_step_mm, dtype=np.float64, copy=True)
        points = 0 if self.noise is None else len(self.noise.range_mm)
        if step.ndim > IMAGE_RANK or step.size == 0 or not (np.isfinite(step) & (step > 0)).all():
            raise ValueError("range_step_mm: expected a number, a map (row, col) or a list of finite numbers above 0")
        if step.ndim == 1 and len(step) != points:
            raise ValueError(
                f"range_step_mm: {counted(len(step), 'step')}, but {counted(points, 'range')} in the curve"
            )
        step.setflags(write=False)
        object.__setattr__(self, "range_step_mm", step)

    @property
    def step(self) -> RangeStep | None:
        """The step of the stored ranges; None where it is that of the stored type."""
        step = self.range_step_mm
        if step is None:
            return None
        if step.ndim == 1 and self.noise is not None:
            return RangeStep(self.noise.range_mm, step)
        return RangeStep.common(float(step)) if step.ndim == 0 else RangeStep.of_pixels(step)

    @property
    def filters_over_pixels(self) -> bool:
        """Whether samples at edges are of several pixels."""
        return self.neighbour_correlation is not None

    @property
    def is_lock_in(self) -> bool | None:
        """Whether the camera measures the phase of modulated light; None if that is not known.

        A modulation frequency says so too, where nothing is declared or a user gave it.
        """
        if self.modulation_frequency_hz is not None:
            return True
        return None if self.measurement is None else self.measurement is Measurement.LOCK_IN

    @property
    def follows_drift(self) -> bool:
        """Whether an estimate with this sensor lets the ranges of a pixel drift within a window."""
        return self.learnt is not None and bool(self.learnt.drift_mm.any())

    @property
    def optics(self) -> Projection | None:
        """The projection: `projection`, or equal angles over the field of view; None if neither is known.

        Raises
        ------
        ValueError
            If the field of view cannot be.
        """
        if self.projection is not None or self.fov_horizontal_deg is None or self.fov_vertical_deg is None:
            return self.projection
        return Equiangular(fov_horizontal_deg=self.fov_horizontal_deg, fov_vertical_deg=self.fov_vertical_deg)


def with_lens(sensor: Sensor, lens: Pinhole) -> Sensor:
    """The sensor with the directions of its pixels by a lens."""
    return replace(sensor, projection=lens, fov_horizontal_deg=None, fov_vertical_deg=None)


def with_view(sensor: Sensor, view_deg: tuple[float, float], projection: str, shape: tuple[int, int]) -> Sensor:
    """The sensor with the directions of an image's pixels by a field of view.

    Parameters
    ----------
    view_deg : (float, float)
        Full field of view, horizontal and vertical, degrees.
    projection : {"equiangular", "pinhole"}
        Equal angles between pixels, or an ideal pinhole.
    shape : (int, int)
        Rows and columns of the image.

    Raises
    ------
    ValueError
        If no pinhole sees that much.
    """
    if projection == PINHOLE:
        return with_lens(sensor, ideal_pinhole(view_deg, shape))
    return replace(sensor, projection=None, fov_horizontal_deg=view_deg[0], fov_vertical_deg=view_deg[1])


def sensor_of_part(sensor: Sensor, rows: slice, cols: slice) -> Sensor:
    """The sensor of a part of its image: steps of single pixels are those of the part."""
    step = sensor.range_step_mm
    return sensor if step is None or step.ndim != IMAGE_RANK else replace(sensor, range_step_mm=step[rows, cols])
