"""Harmonics of the modulation: a bias that is a sine of range."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, UniformPrior, number
from tofmix.simulation.effects.search import Coefficient, FormFacts, LinearForm, Problem, SearchFacts, spread_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Wiggling(Effect):
    """Bias ``amplitude_mm * sin(8 pi r / d_u + phase_rad)``, with the range r before the bias.

    Four correlation samples a period give the phase of a pure sine. The light is not a pure sine: its third and fifth
    harmonics alias onto the fundamental, with four periods a turn. A third harmonic of relative strength h in the
    correlation changes the phase by up to h rad, thus the range by d_u h / 2 pi: 12 mm for 1 % at 20 MHz, 60 mm for 5
    %, with a period of d_u / 4 = 1.874 m. In a real camera, noise and amplitude vary in the same way; here only the
    bias does.

    References
    ----------
    Lindner and Kolb, Lateral and depth calibration of PMD-distance sensors, ISVC 2006. Koehler et al.,
    Sensors 25(1), 109, 2025, doi:10.3390/s25010109, for the noise.
    """

    kind: ClassVar[str] = "wiggling"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "bias against range, a sine of period d_u / 4"
    typical: ClassVar[str] = "+-12 mm for 1 % of third harmonic at 20 MHz, +-60 mm for 5 %; period 1.874 m"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    acts_on_phase: ClassVar[bool] = True
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "more distances, spread over a quarter of the unambiguous range",
        "amplitude_walk": "a dark and a bright board at one distance",
        "fixed_pattern": "the same image at a second distance",
    }

    amplitude_mm: float = number(
        "Largest bias.",
        unit="mm",
        low=0,
        high=1000,
        zero=0,
        typical=(3, 60),
        prior=StudentPrior(scale=30, dof=3, half=True),
    )
    phase_rad: float = number(
        "Phase of the sine at range 0.",
        unit="rad",
        low=-2 * math.pi,
        high=2 * math.pi,
        default=0,
        prior=UniformPrior(low=-2 * math.pi, high=2 * math.pi),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components, from six phases."""

        def make(x: FloatArray) -> Effect:
            return cls(amplitude_mm=math.hypot(x[0], x[1]) * facts.sigma_mm, phase_rad=math.atan2(x[1], x[0]))

        turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
        yield Problem(make=make, starts=tuple((0.7 * math.cos(t), 0.7 * math.sin(t)) for t in turns), steps=(0.3, 0.3))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Two components."""

        def make(c: FloatArray) -> Effect:
            return cls(amplitude_mm=math.hypot(c[0], c[1]), phase_rad=math.atan2(c[1], c[0]))

        size, spread = facts.sigma_mm, spread_of(cls, "amplitude_mm")
        both = tuple(
            Coefficient(effect=make(np.array(c)), size=size, spread=spread) for c in ((size, 0.0), (0.0, size))
        )
        yield LinearForm(coefficients=both, make=make)

    def explain(self) -> str:
        """One sentence."""
        return (
            f"the range error is a sine of range with amplitude {self.amplitude_mm:g} mm and phase"
            f" {self.phase_rad:g} rad, four periods in one unambiguous range"
        )

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias at the range that the light has."""
        echoes.add_bias(self.amplitude_mm * np.sin(echoes.range_mm * (8 * math.pi / context.turn_mm) + self.phase_rad))
