"""Warm-up: a bias that grows and settles after power-on."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, about, number
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of,
)

_TAUS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Time constants of linear forms, as parts of the duration."""

_LEAST_FRAMES = 3.0
"""Least time constant, in frames: a faster drift is an offset with a bad first frame."""

_AT_ONCE = 1.2
"""Of the shortest time constant, below which a drift is an offset."""

_PAUSED = 1.5
"""Times the duration of its frames, above which a recording has pauses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureDrift(Effect):
    """Bias ``amplitude_mm * (1 - exp(-t / time_constant_s))``, t the time since the first frame.

    The delay of the light source's driver and of the pixel changes with temperature, and both warm up after power-on.
    Some mm to some ten mm over 20 to 40 minutes are reported. The time constant is the housing's.

    References
    ----------
    Kahlmann, Remondino and Ingensand, ISPRS Archives XXXVI-5, 2006: warm-up of the SwissRanger.
    """

    kind: ClassVar[str] = "temperature_drift"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias of the whole image against time, settling"
    typical: ClassVar[str] = "some mm to some ten mm over 20 to 40 minutes"
    basis: ClassVar[str] = "reported"
    target: ClassVar[Target] = Target.TREND
    shows_in: ClassVar[tuple[str, ...]] = ("trend", "common_mode")
    changes_in_time: ClassVar[bool] = True
    static_partner: ClassVar[str] = "range_offset"
    several_optima: ClassVar[bool] = True
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "20 minutes from power-on",
        "motion": "20 minutes from power-on, or a second surface that stands still",
    }

    amplitude_mm: float = number(
        "Final bias; negative if ranges become shorter.",
        unit="mm",
        low=-1000,
        high=1000,
        zero=0,
        typical=(2, 50),
        prior=StudentPrior(scale=25, dof=3),
    )
    time_constant_s: float = number(
        "Time until 63 % of the final bias.",
        unit="s",
        low=0,
        high=1e6,
        low_open=True,
        typical=(60, 1800),
        prior=about(120, 10),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """The drift at the end, which is independent of the time constant, and the logarithm of the time constant."""
        fastest = max(facts.recorded_s / 100, _LEAST_FRAMES * facts.interval_s)

        def make(x: FloatArray) -> Effect:
            tau = math.exp(bounded(x[1], math.log(fastest), math.log(facts.duration_s * 30)))
            reached = -math.expm1(-facts.duration_s / tau)
            return cls(amplitude_mm=float(x[0]) * facts.sigma_mm / reached, time_constant_s=tau)

        paused = facts.duration_s > _PAUSED * facts.recorded_s
        spans = {facts.recorded_s, facts.duration_s} if paused else {facts.duration_s}
        taus = sorted({max(part * span, 1.1 * fastest) for part in (0.1, 0.4, 1.5) for span in spans})
        yield Problem(
            make=make,
            starts=tuple((size, math.log(tau)) for size in (-1.0, 1.0) for tau in taus),
            steps=(0.3, 0.4),
            other=lambda x: bool(x[1] < math.log(_AT_ONCE * fastest)),
        )

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The amplitude, for each of some time constants: an offset with its course in time."""
        size, spread = facts.sigma_mm, spread_of(cls, "amplitude_mm")
        constant = RangeOffset(offset_mm=size)

        def made(tau_s: float, c: FloatArray) -> Effect:
            return cls(amplitude_mm=float(c[0]), time_constant_s=tau_s)

        def rise(tau_s: float, t: FloatArray) -> FloatArray:
            return np.asarray(-np.expm1(-t / tau_s))

        for part in _TAUS:
            tau_s = part * facts.duration_s
            one = Coefficient(effect=constant, size=size, spread=spread, course=partial(rise, tau_s))
            yield LinearForm(coefficients=(one,), make=partial(made, tau_s), choices=len(_TAUS))

    def explain(self) -> str:
        """One sentence."""
        return f"ranges drift by {self.amplitude_mm:+g} mm in all, 63 % of it within {self.time_constant_s:g} s"

    @property
    def settled_after_s(self) -> float:
        """Its time constant."""
        return self.time_constant_s

    @property
    def warm_up_s(self) -> float:
        """Its time constant: it is that of the housing."""
        return self.time_constant_s

    def frame_bias(self, time_s: FloatArray) -> FloatArray:
        """Bias at some times, mm."""
        return np.asarray(self.amplitude_mm * -np.expm1(-time_s / self.time_constant_s))

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias of this time."""
        echoes.add_bias(self.frame_bias(np.array(context.time_s)))
