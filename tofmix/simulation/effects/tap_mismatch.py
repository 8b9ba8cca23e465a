"""Taps of unequal gain or offset: a bias of one and two periods a turn."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, UniformPrior, number
from tofmix.simulation.effects.search import EFFECT_NATS, FormFacts, LinearForm, Problem, SearchFacts, spread_of
from tofmix.simulation.effects.sines import Sine, bias_of, coefficients_of, form_of_sines, problem_of_sines

_ANY_PHASE = UniformPrior(low=-2 * math.pi, high=2 * math.pi)

_FORMS: Mapping[str, tuple[float, ...]] = {"2 periods": (2.0,), "1 period": (1.0,), "both": (1.0, 2.0)}
"""Periods a turn of the sines of each form."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TapMismatch(Effect):
    """Bias ``amplitude_1_mm * sin(2 pi r / d_u + phase_1_rad) + amplitude_2_mm * sin(4 pi r / d_u + phase_2_rad)``.

    The phase is the arctangent of two differences of charges, C1 - C3 and C0 - C2. A gain of one difference that is
    larger by a share g makes an ellipse of the circle: the range is off by d_u g / 4 pi, with two periods a turn, 6 mm
    for 1 % at 20 MHz. If the two taps of a difference are unequal by a share g, the charge that both have in common
    does not cancel: it moves the circle by g / 2c of its radius, c the contrast of the modulation, and the range is off
    by d_u g / 4 pi c with one period a turn, 12 mm for 1 % at a contrast of 0.5. The common charge grows with the light
    of the camera itself; that of other light does not, and is not in this law. `wiggling` has four periods: it tells
    about the light, this effect about the pixel. A phasor that is the same for all amplitudes is `internal_reflection`.

    References
    ----------
    Godbaz, Cree and Dorrington, Understanding and ameliorating non-linear phase and amplitude responses in AMCW lidar,
    Remote Sensing 4 (2012) 21. Lange, 3D time-of-flight distance measurement with custom solid-state image sensors in
    CMOS/CCD-technology, PhD thesis, Siegen 2000.
    """

    kind: ClassVar[str] = "tap_mismatch"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "bias against range, sines of period d_u and d_u / 2"
    typical: ClassVar[str] = "+-6 mm for 1 % of gain between the two differences at 20 MHz, +-12 mm between two taps"
    basis: ClassVar[str] = "physics"
    remedy: ClassVar[str] = (
        "A camera that takes two frames with its taps exchanged, and adds them, cancels unequal taps; see whether yours"
        " can. If not, measure the range error of a board over one unambiguous range, and subtract it."
    )
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    acts_on_phase: ClassVar[bool] = True
    magnitudes: ClassVar[tuple[str, ...]] = ("amplitude_1_mm", "amplitude_2_mm")
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "more distances, spread over half of the unambiguous range",
        "surface_pose": "more distances, spread over half of the unambiguous range",
        "wiggling": "more distances, spread over half of the unambiguous range",
        "amplitude_walk": "a dark and a bright board at one distance",
        "internal_reflection": "a dark and a bright board at one distance",
        "fixed_pattern": "the same image at a second distance",
    }

    amplitude_1_mm: float = number(
        "Largest bias of one period a turn.",
        unit="mm",
        low=0,
        high=1000,
        default=0,
        zero=0,
        typical=(2, 40),
        prior=StudentPrior(scale=15, dof=3, half=True),
    )
    phase_1_rad: float = number(
        "Its phase at range 0.", unit="rad", low=-2 * math.pi, high=2 * math.pi, default=0, prior=_ANY_PHASE
    )
    amplitude_2_mm: float = number(
        "Largest bias of two periods a turn.",
        unit="mm",
        low=0,
        high=1000,
        default=0,
        zero=0,
        typical=(2, 40),
        prior=StudentPrior(scale=15, dof=3, half=True),
    )
    phase_2_rad: float = number(
        "Its phase at range 0.", unit="rad", low=-2 * math.pi, high=2 * math.pi, default=0, prior=_ANY_PHASE
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components of either sine, or of both, the second at the price of one effect."""
        for form, periods in _FORMS.items():
            price = (len(periods) - 1) * EFFECT_NATS
            yield problem_of_sines(cls.of_sines, facts, periods, form=form, price_nats=price)

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Likewise."""
        spread = spread_of(cls, "amplitude_1_mm")
        pairs = {p: coefficients_of(cls.of_sines, p, size_mm=facts.sigma_mm, spread_mm=spread) for p in _FORMS["both"]}
        for form, periods in _FORMS.items():
            yield form_of_sines(cls.of_sines, [pairs[p] for p in periods], periods, form=form)

    @classmethod
    def of_sines(cls, all_: tuple[Sine, ...]) -> "TapMismatch":
        """The effect from one or both of its sines."""
        most = cls.parameters()["amplitude_1_mm"].high  # a linear fit may go beyond
        of = {periods: (min(size_mm, most), phase_rad) for periods, size_mm, phase_rad in all_}
        (first, phase_1), (second, phase_2) = of.get(1.0, (0.0, 0.0)), of.get(2.0, (0.0, 0.0))
        return cls(amplitude_1_mm=first, phase_1_rad=phase_1, amplitude_2_mm=second, phase_2_rad=phase_2)

    @property
    def _sines(self) -> tuple[Sine, Sine]:
        return (1.0, self.amplitude_1_mm, self.phase_1_rad), (2.0, self.amplitude_2_mm, self.phase_2_rad)

    def explain(self) -> str:
        """One sentence."""
        said = [
            f"{size:g} mm and phase {phase:g} rad with {'one period' if periods == 1 else 'two periods'}"
            for periods, size, phase in self._sines
            if size
        ]
        return f"unequal taps: the range error is a sine of range, {' and one of '.join(said) or '0 mm'} a turn"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias at the range that the light has."""
        echoes.add_bias(bias_of(self._sines, echoes.range_mm, context.turn_mm))
