"""Harmonics of the modulation: a bias that is a sine of range."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import Prior, StudentPrior, UniformPrior, number, sines
from tofmix.simulation.effects.search import EFFECT_NATS, FormFacts, LinearForm, Problem, SearchFacts, spread_of
from tofmix.simulation.effects.sines import Sine, bias_of, coefficients_of, form_of_sines, problem_of_sines

_OWN = 4.0
"""Periods a turn of the sine that every camera of four samples has."""

_FURTHER = (8.0, 12.0)
"""Periods a turn of the next two sines of such a camera, for searches."""

_OF_FURTHER = StudentPrior(scale=10, dof=3, half=True)
"""Prior of their amplitudes, mm: of triangles, the seventh harmonic is a fifth of the third."""

_ANY_PHASE = UniformPrior(low=-2 * math.pi, high=2 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wiggling(Effect):
    """Bias ``amplitude_mm * sin(8 pi r / d_u + phase_rad)``, with the range r before the bias, and further sines.

    Four correlation samples a period give the phase of a pure sine. The light is not a pure sine: its third and fifth
    harmonics alias onto the fundamental, with four periods a turn. A third harmonic of relative strength h in the
    correlation changes the phase by up to h rad, thus the range by d_u h / 2 pi: 12 mm for 1 % at 20 MHz, 60 mm for 5
    %, with a period of d_u / 4 = 1.874 m. In a real camera, noise and amplitude vary in the same way; here only the
    bias does.

    Of N samples a period, the harmonics k N - 1 and k N + 1 are seen with k N periods a turn: with four samples the
    seventh and the ninth give 8 periods, the eleventh and the thirteenth 12. `harmonics` adds such sines, of any number
    of periods. `reconcile` looks for those of 8 periods, and of 8 and 12, each at the price of one more effect. Sines
    of 1 and 2 periods tell something else about a camera: they are `tap_mismatch`.

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
        prior=_ANY_PHASE,
    )
    harmonics: tuple[Sine, ...] = sines("Up to two further sines: of periods a turn, largest bias, phase at range 0.")

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components, from six phases; then further sines, each at the price of one effect."""

        def make(x: FloatArray) -> Effect:
            return cls(amplitude_mm=math.hypot(x[0], x[1]) * facts.sigma_mm, phase_rad=math.atan2(x[1], x[0]))

        turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
        yield Problem(make=make, starts=tuple((0.7 * math.cos(t), 0.7 * math.sin(t)) for t in turns), steps=(0.3, 0.3))
        for n in range(1, len(_FURTHER) + 1):
            periods = (_OWN, *_FURTHER[:n])
            yield problem_of_sines(cls.of_sines, facts, periods, form=_form(n), price_nats=n * EFFECT_NATS)

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Two components of each sine."""
        spreads = (spread_of(cls, "amplitude_mm"), *(_OF_FURTHER.spread for _ in _FURTHER))
        periods: tuple[float, ...] = (_OWN, *_FURTHER)
        pairs = [
            coefficients_of(cls.of_sines, p, size_mm=facts.sigma_mm, spread_mm=spread)
            for p, spread in zip(periods, spreads, strict=True)
        ]
        for n in range(len(_FURTHER) + 1):
            own = slice(0, n + 1)
            yield form_of_sines(cls.of_sines, pairs[own], periods[own], form=_form(n))

    @classmethod
    def of_sines(cls, all_: tuple[Sine, ...]) -> "Wiggling":
        """The effect from all its sines, that of four periods among them or not."""
        most = cls.parameters()["amplitude_mm"].high  # a linear fit may go beyond
        own = next(((min(size, most), phase) for p, size, phase in all_ if p == _OWN), (0.0, 0.0))
        further = tuple((p, min(size, most), phase) for p, size, phase in all_ if p != _OWN)
        return cls(amplitude_mm=own[0], phase_rad=own[1], harmonics=further)

    def numbers(self) -> dict[str, float]:
        """Its numbers by name; those of a further sine are called by its periods, as in ``harmonic_8_mm``."""
        own = {"amplitude_mm": self.amplitude_mm, "phase_rad": self.phase_rad}
        for periods, size_mm, phase_rad in self.harmonics:
            own |= {f"harmonic_{periods:g}_mm": size_mm, f"harmonic_{periods:g}_rad": phase_rad}
        return {name: float(value) for name, value in own.items()}

    def priors(self) -> dict[str, Prior]:
        """The prior density of each number."""
        declared = {n: p.prior for n, p in self.parameters().items() if p.prior is not None}
        further = [n for n in self.numbers() if n not in declared]
        return declared | {n: _OF_FURTHER if n.endswith("_mm") else _ANY_PHASE for n in further}

    def explain(self) -> str:
        """One sentence."""
        return (
            f"the range error is a sine of range with amplitude {self.amplitude_mm:g} mm and phase"
            f" {self.phase_rad:g} rad, four periods in one unambiguous range"
            + "".join(
                f"; another has {size:.4g} mm, {phase:.4g} rad and {p:g} periods" for p, size, phase in self.harmonics
            )
        )

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias at the range that the light has."""
        own = self.amplitude_mm * np.sin(echoes.range_mm * (8 * math.pi / context.turn_mm) + self.phase_rad)
        echoes.add_bias(own + bias_of(self.harmonics, echoes.range_mm, context.turn_mm) if self.harmonics else own)


def _form(further: int) -> str:
    """Name of the form with so many further sines; empty for none."""
    return f"{further} further" if further else ""
