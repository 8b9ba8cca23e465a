"""A camera as a profile or a model describes it: its image, its range, its noise at any integration time.

Use it to simulate a camera, or to take a noise curve at another integration
time. A recording is of one integration time; there `tofmix.sensor.Sensor`
suffices, which `SensorProfile.sensor` makes.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.measurement import Measurement
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import Projection
from tofmix.optics.ranging import unambiguous_range_mm
from tofmix.recording import MOST_PIXELS_A_SIDE
from tofmix.sensor import DEFAULT_OUTLIER_PROBABILITY, NoiseCurve, Sensor
from tofmix.share_law import ShareLaw

if TYPE_CHECKING:
    from tofmix.sensors.sheet import CameraSheet

MAX_RANGE_MM = 65_000.0  # ranges are stored as whole mm in 16 bits

_ABOVE_ZERO = (
    "fov_horizontal_deg",
    "fov_vertical_deg",
    "range_max_mm",
    "modulation_frequency_hz",
    "integration_time_ms",
    "default_integration_time_ms",
    "reference_integration_time_ms",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorProfile:
    """A camera and the law by which its noise follows the integration time.

    Parameters
    ----------
    name : str
        The camera's name.
    rows, cols : int
        Size of the image, 1 to 4096 pixels each.
    fov_horizontal_deg, fov_vertical_deg : float, optional
        Full field of view, above 0, up to 360 and 180; left out where there is a `projection`.
    range_min_mm, range_max_mm : float
        Working range, 0 <= min < max <= 65,000.
    modulation_frequency_hz : float or None
        Modulation frequency, above 0; None if the camera measures no phase.
    integration_time_ms : float
        Integration time tau of one sample, above 0.
    default_integration_time_ms : float
        What the camera integrates on board when nobody sets it, above 0.
    outlier_probability : float
        p(c_r) of equation (1), in [0, 1).
    noise : NoiseCurve
        sigma(r) at `reference_integration_time_ms`.
    reference_integration_time_ms : float
        Integration time at which `noise` holds, above 0.
    exponent : float
        sigma(r, tau) = sigma(r) * (reference / tau) ** exponent; at least 0.
    projection : Projection, optional
        Where the pixels look, if not with equal angles over the field of view.
    measurement : Measurement, optional
        What the camera measures.
    confirmed : bool
        Whether the figures were checked against the maker's data or a measurement.
    sources : tuple of str
        Where the figures come from.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds. The message begins with the key.
    """

    name: str
    rows: int
    cols: int
    fov_horizontal_deg: float | None = None
    fov_vertical_deg: float | None = None
    projection: Projection | None = None
    measurement: Measurement | None = None
    range_min_mm: float
    range_max_mm: float
    integration_time_ms: float
    default_integration_time_ms: float
    noise: NoiseCurve
    reference_integration_time_ms: float
    exponent: float
    modulation_frequency_hz: float | None = None
    outlier_probability: float = DEFAULT_OUTLIER_PROBABILITY
    confirmed: bool = False
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for key in ("rows", "cols"):
            value = getattr(self, key)
            if not 1 <= value <= MOST_PIXELS_A_SIDE:
                raise ValueError(f"{key}: {value} is not in 1..{MOST_PIXELS_A_SIDE}")
        for key in _ABOVE_ZERO:
            value = getattr(self, key)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{key}: {value:g} is not a finite number above 0")
        for key, most in (("fov_horizontal_deg", 360.0), ("fov_vertical_deg", 180.0), ("range_max_mm", MAX_RANGE_MM)):
            if (getattr(self, key) or 0.0) > most:
                raise ValueError(f"{key}: {getattr(self, key):g} is above {most:g}")
        if not 0 <= self.range_min_mm < self.range_max_mm:
            raise ValueError(f"range_min_mm: {self.range_min_mm:g} is not in [0, range_max_mm = {self.range_max_mm:g})")
        if not 0 <= self.outlier_probability < 1:
            raise ValueError(f"outlier_probability: {self.outlier_probability:g} is not in [0, 1)")
        if not (math.isfinite(self.exponent) and self.exponent >= 0):
            raise ValueError(f"exponent: {self.exponent:g} is not a finite number of at least 0")
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
            If the time is not finite and above 0, or sigma would not be.
        """
        if not (math.isfinite(integration_time_ms) and integration_time_ms > 0):
            raise ValueError(f"integration_time_ms: {integration_time_ms:g} is not a finite number above 0")
        try:
            factor = (self.reference_integration_time_ms / integration_time_ms) ** self.exponent
        except OverflowError:
            raise ValueError(f"exponent: {self.exponent:g}: sigma overflows at {integration_time_ms:g} ms") from None
        return self.noise.scaled(factor, amplitude_factor=integration_time_ms / self.reference_integration_time_ms)

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

    def sensor(self) -> Sensor:
        """The camera as a recording at `integration_time_ms` describes it.

        Raises
        ------
        ValueError
            If the noise curve is not finite at that time.
        """
        return recorded_sensor(
            self, outlier_probability=self.outlier_probability, noise=self.noise_at(self.integration_time_ms)
        )


def recorded_sensor(
    camera: "SensorProfile | CameraSheet",
    *,
    outlier_probability: float,
    noise: NoiseCurve | None,
    share_law: ShareLaw | None = None,
) -> Sensor:
    """Make the sensor of a recording by a camera, with the numbers that a recording has.

    Parameters
    ----------
    camera : SensorProfile or CameraSheet
        The camera.
    outlier_probability : float
        p(c_r).
    noise : NoiseCurve or None
        The noise curve at the camera's integration time.
    share_law : ShareLaw or None
        How samples share out among the surfaces of a pixel.

    Raises
    ------
    ValueError
        If a number is outside its bounds.
    """
    return Sensor(
        name=camera.name,
        modulation_frequency_hz=camera.modulation_frequency_hz,
        integration_time_ms=camera.integration_time_ms,
        range_min_mm=camera.range_min_mm,
        range_max_mm=camera.range_max_mm,
        fov_horizontal_deg=camera.fov_horizontal_deg,
        fov_vertical_deg=camera.fov_vertical_deg,
        projection=camera.projection,
        measurement=camera.measurement,
        share_law=share_law,
        outlier_probability=outlier_probability,
        noise=noise,
    )
