"""A camera as its profile or a model describes it: its image, its range, its noise at any integration time.

`Camera` may lack numbers: use it where a camera is only described (`tofmix sensors`, `tofmix import`).
`Camera.complete` gives the `CompleteCamera` that a simulation needs, or names what is missing. A recording is of one
integration time; its camera is a `tofmix.sensor.Sensor`, which `Camera.sensor` makes.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.circle import unambiguous_range_mm
from tofmix.errors import BadInputError
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import Projection
from tofmix.sensor import DEFAULT_OUTLIER_PROBABILITY, NoiseCurve, Sensor
from tofmix.sensor_schema import (
    LAW_NUMBERS,
    NOT_NEEDED,
    NUMBERS,
    RARE_SENSOR_NUMBERS,
    VIEW_NUMBERS,
    Measurement,
    ShareLaw,
)

_NOISE = ("noise", *LAW_NUMBERS)
"""Fields of the noise at any integration time; each needs the others."""

_OF_RECORDINGS = ("valid_status", "share_law")
"""Fields that a simulated camera does not have."""

_OF_SENSORS = (
    "name",
    "modulation_frequency_hz",
    "integration_time_ms",
    "range_min_mm",
    "range_max_mm",
    *VIEW_NUMBERS,
    "projection",
    "measurement",
    "share_law",
)
"""Fields that the sensor of a recording takes over as they are."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """A camera of which not all need be known: None means unknown.

    Parameters
    ----------
    name : str
        The camera's name.
    rows, cols : int, optional
        Size of the image, 1 to 4096 pixels each.
    fov_horizontal_deg, fov_vertical_deg : float, optional
        Full field of view, above 0, up to 360 and 180; left out where there is a `projection`.
    projection : Projection, optional
        Where the pixels look, if not with equal angles over the field of view.
    measurement : Measurement, optional
        What the camera measures.
    range_min_mm, range_max_mm : float, optional
        Working range, mm.
    integration_time_ms : float, optional
        Integration time tau of one sample, above 0.
    default_integration_time_ms : float, optional
        What the camera integrates on board when nobody sets it, above 0.
    noise : NoiseCurve, optional
        sigma(r) at `reference_integration_time_ms`.
    reference_integration_time_ms : float, optional
        Integration time at which `noise` holds, above 0.
    exponent : float, optional
        sigma(r, tau) = sigma(r) * (reference / tau) ** exponent; at least 0.
    modulation_frequency_hz : float, optional
        Modulation frequency, above 0; None if the camera measures no phase.
    outlier_probability : float, optional
        p(c_r) of equation (1), in [0, 1).
    confirmed : bool
        Whether the figures were checked against the maker's data or a measurement.
    sources : tuple of str
        Where the figures come from.
    valid_status : tuple of int, optional
        Status codes with which the camera marks valid samples.
    share_law : ShareLaw, optional
        How the camera's samples share out among the surfaces of a pixel.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds. The message begins with the key.
    """

    name: str
    rows: int | None = None
    cols: int | None = None
    fov_horizontal_deg: float | None = None
    fov_vertical_deg: float | None = None
    projection: Projection | None = None
    measurement: Measurement | None = None
    range_min_mm: float | None = None
    range_max_mm: float | None = None
    integration_time_ms: float | None = None
    default_integration_time_ms: float | None = None
    noise: NoiseCurve | None = None
    reference_integration_time_ms: float | None = None
    exponent: float | None = None
    modulation_frequency_hz: float | None = None
    outlier_probability: float | None = None
    confirmed: bool = False
    sources: tuple[str, ...] = ()
    valid_status: tuple[int, ...] | None = None
    share_law: ShareLaw | None = None

    def __post_init__(self) -> None:
        too_wide = [key for key in VIEW_NUMBERS if (getattr(self, key) or 0.0) > NUMBERS[key].high]
        self._check("rows", "cols", *too_wide, *LAW_NUMBERS)
        given = [key for key in _NOISE if getattr(self, key) is not None]
        if given and len(given) < len(_NOISE):
            lacking = ", ".join(key for key in _NOISE if key not in given)
            raise ValueError(f"noise curve: {given[0]} without {lacking}; they go together")
        self.sensor()

    def _check(self, *keys: str) -> None:
        for key in keys:
            value = getattr(self, key)
            if value is not None and (reason := NUMBERS[key].refusal(value, digits="g")):
                raise ValueError(f"{key}: {reason}")

    def known(self) -> dict[str, Any]:
        """Fields that are known, by their names."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in held.items() if value is not None}

    def missing(self) -> tuple[str, ...]:
        """Fields that a simulation needs and that are not known; those of the noise as ``noise`` alone."""
        may_lack = {*NOT_NEEDED, *LAW_NUMBERS, *_OF_RECORDINGS, "projection", "measurement"}
        may_lack |= set() if self.projection is None else set(VIEW_NUMBERS)
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is None and f.name not in may_lack)

    def complete(self) -> "CompleteCamera":
        """The camera of which all is known that a simulation needs.

        Raises
        ------
        ValueError
            If something is missing, or outside its bounds.
        """
        if lacking := self.missing():
            raise ValueError(f"{self.name}: not known: {', '.join(lacking)}")
        settings = {name: value for name, value in self.known().items() if name not in _OF_RECORDINGS}
        # Without a profile nobody has said what the camera integrates by default; the curve's own time is the guess.
        settings.setdefault("default_integration_time_ms", settings["reference_integration_time_ms"])
        camera = CompleteCamera(**settings)
        camera.sensor()  # the tau law may take sigma out of its bounds
        return camera

    def sensor(self) -> Sensor:
        """The camera as a recording at `integration_time_ms` describes it; unknown values stay unknown.

        Raises
        ------
        ValueError
            If a number is outside its bounds.
        """
        if not self.missing():
            return replace(self.complete().sensor(), share_law=self.share_law)
        p_random = DEFAULT_OUTLIER_PROBABILITY if self.outlier_probability is None else self.outlier_probability
        sensor, tau = self._recorded(p_random, None), self.integration_time_ms
        if self.noise is None or (tau is None and self.exponent):
            return sensor
        return replace(sensor, noise=self.noise if tau is None else self.noise_at(tau))

    def _recorded(self, outlier_probability: float, noise: NoiseCurve | None) -> Sensor:
        shared = {key: getattr(self, key) for key in _OF_SENSORS}
        return Sensor(**shared, outlier_probability=outlier_probability, noise=noise)

    def noise_at(self, integration_time_ms: float) -> NoiseCurve:
        """sigma(r) at another integration time, by the tau law.

        Parameters
        ----------
        integration_time_ms : float
            Integration time of one sample, ms, above 0.

        Returns
        -------
        NoiseCurve
            `noise` times (reference / tau) ** exponent. Amplitudes grow with tau, those of its law too.

        Raises
        ------
        ValueError
            If the noise is not known, the time is not finite and above 0, or sigma would not be.
        """
        noise, reference, exponent = self.noise, self.reference_integration_time_ms, self.exponent
        if noise is None or reference is None or exponent is None:
            raise ValueError(f"the noise of {self.name} is not known")
        if reason := NUMBERS["integration_time_ms"].refusal(integration_time_ms, digits="g"):
            raise ValueError(f"integration_time_ms: {reason}")
        try:
            factor = (reference / integration_time_ms) ** exponent
        except OverflowError:
            raise ValueError(f"exponent: {exponent:g}: sigma overflows at {integration_time_ms:g} ms") from None
        return noise.scaled(factor, amplitude_factor=integration_time_ms / reference)

    def sensor_of(self, shape: tuple[int, int]) -> Sensor:
        """The camera as a recording of an image (rows, cols) describes it.

        A projection is of an image of one size alone: where pixels of another look stays unknown.
        """
        sensor = self.sensor()
        if sensor.projection is None or (self.rows or shape[0], self.cols or shape[1]) == tuple(shape):
            return sensor
        return replace(sensor, projection=None)

    def size_doubt(self, shape: tuple[int, int]) -> str:
        """Doubt about an image (rows, cols) of another size than the camera's; empty without one."""
        if self.rows is None or self.cols is None or shape == (self.rows, self.cols):
            return ""
        view = "field of view is used" if self.projection is None else "projection is not used"
        return f"{shape[0]} x {shape[1]} pixels, {self.name} has {self.rows} x {self.cols}; its {view} for this image"

    def turned(self, shape: tuple[int, int]) -> str:
        """Reason to refuse an image whose rows and columns are those of the camera, swapped; empty without one."""
        if shape[0] == shape[1] or shape != (self.cols, self.rows):
            return ""
        return (
            f"images of {shape[0]} x {shape[1]} pixels, {self.name} has {self.rows} x {self.cols}: rows and columns"
            " are swapped"
        )


UNKNOWN = Camera(name="unknown")
"""A camera of which nothing is known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompleteCamera(Camera):
    """A camera of which all is known that a simulation needs: the fields of `Camera`, none of these None.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds: 0 <= `range_min_mm` < `range_max_mm` <= 65,000; if a pixel of
        the image looks nowhere, or random values are not below 1. The message begins with the key.
    """

    rows: int
    cols: int
    range_min_mm: float
    range_max_mm: float
    integration_time_ms: float
    default_integration_time_ms: float
    noise: NoiseCurve
    reference_integration_time_ms: float
    exponent: float
    outlier_probability: float = DEFAULT_OUTLIER_PROBABILITY

    def __post_init__(self) -> None:
        self._check(*(key for key in NUMBERS if key not in RARE_SENSOR_NUMBERS))
        if not 0 <= self.range_min_mm < self.range_max_mm:
            raise ValueError(f"range_min_mm: {self.range_min_mm:g} is not in [0, range_max_mm = {self.range_max_mm:g})")
        self._check_background()
        self.optics.check(self.shape)

    def _check_background(self) -> None:
        background = self.noise.background
        if background is None:
            return
        if background.ndim and background.shape != self.shape:
            raise ValueError(f"background: shape {background.shape} differs from the image {self.shape}")
        most, rest = float(background.max()), 1.0 - self.outlier_probability
        if most >= rest:
            raise ValueError(f"background: {most:g} is not below {rest:g}, 1 less outlier_probability")

    def sensor(self) -> Sensor:
        """The camera as a recording at `integration_time_ms` describes it.

        Raises
        ------
        ValueError
            If the noise curve is not finite at that time.
        """
        return self._recorded(self.outlier_probability, self.noise_at(self.integration_time_ms))

    @property
    def random_share(self) -> float | FloatArray:
        """Probability of a random value: p(c_r) and the background, one for all pixels or for each (row, col)."""
        background = self.noise.background
        if background is None:
            return self.outlier_probability
        return np.broadcast_to(self.outlier_probability + background, self.shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.rows, self.cols

    @property
    def optics(self) -> Projection:
        """The projection: `projection`, or equal angles over the field of view.

        Raises
        ------
        ValueError
            If there is neither.
        """
        if self.projection is not None:
            return self.projection
        if self.fov_horizontal_deg is None or self.fov_vertical_deg is None:
            raise ValueError("fov_horizontal_deg: no field of view, and no projection")
        return Equiangular(fov_horizontal_deg=self.fov_horizontal_deg, fov_vertical_deg=self.fov_vertical_deg)

    def turn_mm(self, purpose: str) -> float:
        """Unambiguous range d_u = c / (2 f), mm, for effects on the phase.

        Parameters
        ----------
        purpose : str
            The caller, in words of the user: "--averaged", or an effect's kind.

        Raises
        ------
        BadInputError
            If the camera has no modulation frequency.
        """
        if self.modulation_frequency_hz is None:
            raise BadInputError(
                f"[sensor]: modulation_frequency_hz: {self.name} has none, and {purpose} acts on the phase;"
                f" give one, or leave out {purpose}"
            )
        return unambiguous_range_mm(self.modulation_frequency_hz)
