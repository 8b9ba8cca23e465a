"""Light that the camera itself reflects into its lens: one phasor in every pixel."""

import cmath
import math
from dataclasses import dataclass
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.prior import StudentPrior


@dataclass(frozen=True, slots=True, kw_only=True)
class InternalReflection(Effect):
    """z becomes z + c, c = amplitude exp(2 pi i range / d_u), the same in every pixel and frame.

    A cover glass, the housing or the rim of the lens sends light of the illumination straight back into the lens. Its
    way is short and does not depend on the scene. A target of amplitude A at range r is moved by d_u / 2 pi arg(1 + c
    exp(-2 pi i r / d_u) / A): towards the camera within half a turn of the reflection, away from it beyond. Dark and
    far targets move most: 5 units from 0 move an amplitude of 500 at 1.8 m by 12 mm at 20 MHz and one of 100 at 3.0 m
    by 36 mm. The amplitude becomes |z + c|, and noise falls or rises with its inverse. In a scene of one distance and
    one brightness it is a constant bias.

    The amplitude is in the unit of the recording's amplitudes, in which a white target at 1 m has 1000 for 1.2 ms. As
    cameras have other units, its prior has long tails. The range is that of a glass or a housing. The same phasor with
    the phase of the scene is `scattering`.

    References
    ----------
    Texas Instruments, OPT3101 Distance Sensor System Calibration, SBAU310: crosstalk between illumination and receiver,
    measured without a target and subtracted as a phasor. Karel, Ghuffar and Pfeifer, Modelling and compensating
    internal light scattering in time of flight range cameras, Photogrammetric Record 27 (2012).
    """

    kind: ClassVar[str] = "internal_reflection"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias towards one short range, in inverse proportion to amplitude, by range as a sine"
    typical: ClassVar[str] = "1 to 3 % of the target's own amplitude, from 0 onto 1.9 m at 20 MHz: -12 to -36 mm"
    basis: ClassVar[str] = "physics; the share assumed"
    remedy: ClassVar[str] = (
        "Light that the camera itself reflects can be measured and subtracted: record with all light absorbed, such as"
        " by black velvet at a distance, and take the mean phasor of each pixel off. A cover glass nearer to the lens,"
        " or a light barrier between lamp and lens, lessens it."
    )
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern", "spread")
    acts_on_phase: ClassVar[bool] = True

    amplitude: float = number(
        "Amplitude of the reflected light.",
        unit="1",
        low=0,
        high=1e6,
        zero=0,
        typical=(1, 50),
        prior=StudentPrior(scale=20, dof=4, half=True),
    )
    range_mm: float = number(
        "Half its way from lamp to lens, as a range.",
        unit="mm",
        low=-100_000,
        high=100_000,
        typical=(10, 200),
        prior=StudentPrior(center=50, scale=100, dof=3),
    )

    def explain(self) -> str:
        """One sentence."""
        return (
            "the camera itself, such as its cover glass or housing, reflects light into every pixel: an amplitude of "
            f"{self.amplitude:g} from a range of {self.range_mm:g} mm"
        )

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the phasor."""
        z = echoes.phasor()
        reflected = cmath.rect(self.amplitude, 2 * math.pi * self.range_mm / context.turn_mm)
        echoes.replace_phasor(z, z + reflected)
