"""The numbers, lists and choices that describe a camera, each with its name, for all files and checks.

The name of a number is that of its field (`tofmix.sensor.Sensor`, `tofmix.sensors.camera.Camera`), its key in TOML and
JSON, and its attribute in the HDF5 group `sensor`. A list of the noise is a key of ``[sensor.noise]`` in TOML; in HDF5
and JSON, ``noise_`` stands before its name.

The measurement decides whether the light of several surfaces in a pixel adds up in one sample. A camera's profile
declares it (``measurement`` of ``[sensor]``), and a recording carries it on (`tofmix.sensor.Sensor.measurement`).
Nothing guesses it from the name of a camera.

The law of shares decides how shares of samples become areas. A profile or a user declares it (``share_law`` of
``[sensor]``, or ``--shares``), and a recording carries it on (`tofmix.sensor.Sensor.share_law`). Samples alone do not
tell it.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple, TypeVar

E = TypeVar("E", bound=StrEnum)


class ShareLaw(StrEnum):
    """The chance of a surface to be the one of a sample.

    ``area``: the part of the pixel that it covers, as in the paper; ``detections``: that part times its brightness, as
    where single photons are detected; ``strongest``: the camera keeps the brightest return alone.
    """

    AREA = "area"
    DETECTIONS = "detections"
    STRONGEST = "strongest"


class Measurement(StrEnum):
    """What a sample is taken from.

    ``lock-in``: the phase of modulated light, to which all surfaces in a pixel add; ``pulses``: the time of flight of
    single pulses or photons, each of one surface; ``stereo``: the parallax of two images.
    """

    LOCK_IN = "lock-in"
    PULSES = "pulses"
    STEREO = "stereo"


def share_law_of(text: str) -> ShareLaw:
    """The law of this name; a ValueError if there is none."""
    return _member(ShareLaw, "share_law", text)


def measurement_of(text: str) -> Measurement:
    """The measurement of this name; a ValueError if there is none."""
    return _member(Measurement, "measurement", text)


def _member(kind: type[E], key: str, text: str) -> E:
    if text not in tuple(kind):
        raise ValueError(f'{key}: "{text}" is not one of {", ".join(kind)}')
    return kind(text)


class Number(NamedTuple):
    """A number of a camera.

    Parameters
    ----------
    unit : str
        Its unit, as the reference of files has it.
    words : str
        Its description there.
    low, high : float
        Its bounds. It is finite in any case; recordings may have numbers above `high`.
    above, below : bool
        Whether `low`, or `high`, is itself out of bounds.
    is_whole : bool
        Whether it is a whole number.
    """

    unit: str
    words: str
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False
    is_whole: bool = False

    def refusal(self, value: float, *, digits: str = "", limited: bool = True) -> str:
        """Reason to refuse a value; empty without one.

        Parameters
        ----------
        value : float
            The value.
        digits : str
            Format in which it is printed, such as ``g``.
        limited : bool
            Whether values above `high` are refused.
        """
        shown = format(value, "" if self.is_whole else digits)
        if self.below:
            return "" if self.low <= value < self.high else f"{shown} is not in [{self.low:g}, {self.high:g})"
        if self.is_whole:
            return "" if self.low <= value <= self.high else f"{shown} is not in {self.low:g}..{self.high:g}"
        if not math.isfinite(value) or not (value > self.low if self.above else value >= self.low):
            least = "above" if self.above else "of at least"
            return f"{shown} is not {'finite' if math.isinf(self.low) else f'a finite number {least} {self.low:g}'}"
        return f"{value:g} is above {self.high:g}" if limited and value > self.high else ""


def _positive(unit: str, words: str, high: float = math.inf) -> Number:
    return Number(unit, words, low=0.0, high=high, above=True)


def _pixels(words: str) -> Number:
    return Number("pixel", words, low=1, high=4096, is_whole=True)


NUMBERS: Mapping[str, Number] = {
    "rows": _pixels("height of the image"),
    "cols": _pixels("width of the image"),
    "fov_horizontal_deg": _positive("degree", "full horizontal field of view of the projection `equiangular`", 360.0),
    "fov_vertical_deg": _positive("degree", "full vertical field of view of it", 180.0),
    "range_min_mm": Number("mm", "shortest range that the camera measures"),
    "range_max_mm": _positive("mm", "longest range that it measures", 65_000.0),  # models: whole mm in 16 bits
    "modulation_frequency_hz": _positive("Hz", "of a lock-in camera"),
    "integration_time_ms": _positive("ms", "of one sample"),
    "default_integration_time_ms": _positive("ms", "of one frame of simulate --averaged"),
    "outlier_probability": Number(
        "1", "p(c_r), the share of random values; 1e-4 if unknown", low=0, high=1, below=True
    ),
    "reference_integration_time_ms": _positive("ms", "at which the noise curve of a model holds"),
    "exponent": Number("1", "sigma(r, tau) = sigma(r) * (reference / tau) ** exponent", low=0.0),
    "no_return_mm": Number(
        "mm",
        "optional: the constant that the camera returns without a surface, sought in the first 100 frames; without one,"
        " c_0 scatters around `range_max_mm`",
    ),
    "sample_min_mm": Number(
        "mm",
        "optional, by `estimate` if `range_max_mm` is unknown: the least valid sample",
    ),
    "sample_max_mm": Number("mm", "with it: the greatest one"),
    "neighbour_correlation": Number("1", "of the noise, under a filter over pixels", low=0, high=1),
}
"""The numbers of a camera, those of TOML files in their order there."""

VIEW_NUMBERS = ("fov_horizontal_deg", "fov_vertical_deg")
"""Numbers that a projection other than equal angles replaces."""

LAW_NUMBERS = ("reference_integration_time_ms", "exponent")
"""Numbers of the noise at any integration time: keys of ``[sensor.noise]``."""

SENSOR_NUMBERS = (
    "modulation_frequency_hz",
    "integration_time_ms",
    "range_min_mm",
    "range_max_mm",
    *VIEW_NUMBERS,
    "outlier_probability",
)
"""Numbers of a `Sensor` that every HDF5 file has; NaN means an unknown number."""

RARE_SENSOR_NUMBERS = ("no_return_mm", "sample_min_mm", "sample_max_mm", "neighbour_correlation")
"""Numbers of a `Sensor` that a file leaves out if they are not known; a camera's TOML file has none of them."""

NOT_NEEDED = ("modulation_frequency_hz", "default_integration_time_ms")
"""Numbers that a simulated camera may lack: one without phase has no frequency."""

CURVE_LISTS = ("range_mm", "sigma_mm")
"""Lists of a noise curve; ``noise_range`` and ``noise_sigma`` in HDF5."""

LAW_LISTS = {"reference_amplitude": "reference", "amplitude": "amplitude", "amplitude_factor": "factor"}
"""Lists of an `AmplitudeLaw` and its fields, in their order; they go together."""

SHAPE_LISTS = {"shape_z": "z", "shape_density": "density"}
"""Lists of a `NoiseShape` and its fields, in their order; they go together."""

DENSITY_LISTS = {"background_range": "range_mm", "background_density": "density"}
"""Lists of a `BackgroundDensity` and its fields, in their order, in HDF5 and JSON alone; they go together."""
