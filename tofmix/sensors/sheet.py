"""Known properties of a camera: the numbers of a profile, of which some may be missing.

Use a sheet where a camera is only described: `tofmix sensors`, `tofmix import`. For a simulation, or for its noise,
`CameraSheet.profile` gives the whole `SensorProfile`, or names the missing data.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

from tofmix.measurement import Measurement
from tofmix.optics.projection import Projection
from tofmix.recording import MOST_PIXELS_A_SIDE
from tofmix.sensor import DEFAULT_OUTLIER_PROBABILITY, NoiseCurve, Sensor
from tofmix.sensors.profile import SensorProfile, recorded_sensor
from tofmix.share_law import ShareLaw

NOISE_KEYS = ("noise", "reference_integration_time_ms", "exponent")
"""Keys of a noise curve at any integration time; each needs the others."""

_MAY_BE_LEFT_OUT = (
    "modulation_frequency_hz",
    "default_integration_time_ms",
    "projection",
    "measurement",
    "share_law",
    "valid_status",
)
VIEW_KEYS = ("fov_horizontal_deg", "fov_vertical_deg")
"""Keys that a `projection` replaces."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSheet:
    """A camera of which not all need be known: None means unknown.

    Parameters
    ----------
    name : str
        The camera's name.
    confirmed : bool
        Whether the figures were checked against the maker's data or a measurement.
    sources : tuple of str
        Where the figures come from.
    valid_status : tuple of int, optional
        Status codes with which the camera marks valid samples.
    share_law : ShareLaw, optional
        How the camera's samples share out among the surfaces of a pixel.

    The other fields are those of `SensorProfile`.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds. The message begins with the key.
    """

    name: str
    measurement: Measurement | None = None
    rows: int | None = None
    cols: int | None = None
    fov_horizontal_deg: float | None = None
    fov_vertical_deg: float | None = None
    projection: Projection | None = None
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
        for key in ("rows", "cols"):
            value = getattr(self, key)
            if value is not None and not 1 <= value <= MOST_PIXELS_A_SIDE:
                raise ValueError(f"{key}: {value} is not in 1..{MOST_PIXELS_A_SIDE}")
        for key, most in (("fov_horizontal_deg", 360.0), ("fov_vertical_deg", 180.0)):
            value = getattr(self, key)
            if value is not None and value > most:
                raise ValueError(f"{key}: {value:g} is above {most:g}")
        given = [key for key in NOISE_KEYS if getattr(self, key) is not None]
        if given and len(given) < len(NOISE_KEYS):
            lacking = ", ".join(key for key in NOISE_KEYS if key not in given)
            raise ValueError(f"noise curve: {given[0]} without {lacking}; they go together")
        self.sensor()
        if not self.missing():
            self.profile()

    def known(self) -> dict[str, Any]:
        """Fields that are known, by their names."""
        held = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in held.items() if value is not None}

    def missing(self) -> tuple[str, ...]:
        """Fields that a simulation needs and that are not known; those of the noise as ``noise`` alone."""
        empty = [field.name for field in fields(self) if getattr(self, field.name) is None]
        not_needed = (*_MAY_BE_LEFT_OUT, *NOISE_KEYS[1:], *(() if self.projection is None else VIEW_KEYS))
        return tuple(key for key in empty if key not in not_needed)

    def profile(self) -> SensorProfile:
        """The whole camera.

        Raises
        ------
        ValueError
            If something is missing, or outside its bounds.
        """
        if lacking := self.missing():
            raise ValueError(f"{self.name}: not known: {', '.join(lacking)}")
        settings = self.known()
        for of_files in ("valid_status", "share_law"):  # not of a simulated camera
            settings.pop(of_files, None)
        # Without a profile nobody has said what the camera integrates by default; the curve's own time is the guess.
        settings.setdefault("default_integration_time_ms", settings["reference_integration_time_ms"])
        profile = SensorProfile(**settings)
        profile.sensor()  # the tau law may take sigma out of its bounds
        return profile

    def sensor(self) -> Sensor:
        """The camera as a recording describes it; unknown values stay unknown.

        Raises
        ------
        ValueError
            If a number is outside its bounds.
        """
        if not self.missing():
            return replace(self.profile().sensor(), share_law=self.share_law)
        known = self.outlier_probability
        return recorded_sensor(
            self,
            outlier_probability=DEFAULT_OUTLIER_PROBABILITY if known is None else known,
            noise=self._noise_at_own_time(),
            share_law=self.share_law,
        )

    def _noise_at_own_time(self) -> NoiseCurve | None:
        if self.noise is None or self.reference_integration_time_ms is None or self.exponent is None:
            return None
        if self.integration_time_ms is None:
            return None if self.exponent else self.noise
        longer = self.integration_time_ms / self.reference_integration_time_ms
        return self.noise.scaled((1.0 / longer) ** self.exponent, amplitude_factor=longer)


UNKNOWN = CameraSheet(name="unknown")
"""A camera of which nothing is known."""
