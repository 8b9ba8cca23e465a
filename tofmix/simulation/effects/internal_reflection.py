"""Light that the camera itself reflects into its lens: one phasor in every pixel."""

import cmath
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import (
    SMALL_SHARE,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of,
)

_DARK = "a dark and a bright board at each of two distances, of which nothing else of the scene is near"


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
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": _DARK,
        "surface_pose": _DARK,
        "wiggling": _DARK,
        "amplitude_walk": _DARK,
        "scattering": _DARK,
        "multipath": _DARK,
        "fixed_pattern": "another scene: the pattern stays with its pixels",
    }

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

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components of the phasor, in units that shift the range of a typical pixel by about sigma."""
        lit = facts.lit_amplitudes
        if lit.size == 0:
            return
        unit = max(float(np.median(lit)) * 2 * math.pi * facts.sigma_mm / facts.turn_mm, 1e-6)

        def make(x: FloatArray) -> Effect:
            size = bounded(math.hypot(x[0], x[1]) * unit, 0, 1e6)
            return cls(amplitude=size, range_mm=math.atan2(x[1], x[0]) / (2 * math.pi) * facts.turn_mm)

        stray = stray_phasor(facts.range_mm, facts.amplitude, facts.residual_mm, facts.noise_mm, facts.turn_mm)
        starts = tuple((z.real, z.imag) for z in (stray / unit, 1, 1j, -1, -1j))
        yield Problem(make=make, starts=starts, steps=(0.3, 0.3))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The phasor's component at the most likely range, and that a quarter turn off, as the range is uncertain."""
        turn_mm, size = facts.turn_mm, SMALL_SHARE * facts.amplitude
        likely = cls.parameters()["range_mm"].prior
        middle_mm = likely.center if isinstance(likely, StudentPrior) else 0.0

        def make(c: FloatArray) -> Effect:
            range_mm = middle_mm + math.atan2(c[1], c[0]) / (2 * math.pi) * turn_mm
            return cls(amplitude=math.hypot(c[0], c[1]), range_mm=range_mm)

        along = spread_of(cls, "amplitude")
        across = along * 2 * math.pi / turn_mm * spread_of(cls, "range_mm")
        both = (
            Coefficient(effect=make(np.array((size, 0.0))), size=size, spread=along),
            Coefficient(effect=make(np.array((0.0, size))), size=size, spread=across),
        )
        yield LinearForm(coefficients=both, make=make)

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


def stray_phasor(
    range_mm: FloatArray, amplitude: FloatArray, residual_mm: FloatArray, sigma_mm: FloatArray, turn_mm: float
) -> complex:
    """The small phasor c that, added to every pixel's, explains most of the residuals: linear least squares.

    Parameters
    ----------
    range_mm, amplitude : (pixel,) float64
        Predicted range, mm, and amplitude.
    residual_mm : (pixel,) float64
        Measured minus predicted range, mm; NaN where it is not known.
    sigma_mm : (pixel,) float64
        Noise, mm.
    turn_mm : float
        d_u, mm.

    Returns
    -------
    complex
        To first order a pixel is moved by d_u / 2 pi Im(c exp(-2 pi i r / d_u)) / A. 0 if no pixel has an amplitude.
    """
    known = ~np.isnan(residual_mm) & (amplitude > 0)
    if math.isnan(turn_mm) or not known.any():
        return 0j
    phase = 2 * math.pi * range_mm[known] / turn_mm
    lever = turn_mm / (2 * math.pi) / (amplitude * sigma_mm)[known]
    columns = np.stack([-np.sin(phase), np.cos(phase)], axis=1) * lever[:, None]
    real, imaginary = np.linalg.lstsq(columns, residual_mm[known] / sigma_mm[known], rcond=None)[0]
    return complex(real, imaginary)
