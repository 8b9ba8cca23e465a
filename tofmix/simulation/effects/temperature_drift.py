"""Warm-up: a bias that grows and settles after power-on."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, about, number
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.search import (
    EFFECT_NATS,
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

_PAIRS = ((0.15, 0.02), (0.4, 0.05), (1.2, 0.1))
"""Pairs of time constants of linear forms, likewise."""

_APART = 2.0
"""Least ratio of two time constants: nearer ones are one."""

_GRID, _BEST = 12, 3
"""Time constants of the grid where searches for two begin, and pairs of them that are tried."""

_TWO = "two time constants"
"""Name of the form."""

_AT_ONCE = 1.2
"""Of the shortest time constant, below which a drift is an offset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureDrift(Effect):
    """Bias ``amplitude_mm * (1 - exp(-t / time_constant_s))``, t from the first frame on, and a second such term.

    The delay of the light source's driver and of the pixel changes with temperature, and both warm up after power-on.
    Some mm to some ten mm over 20 to 40 minutes are reported. The time constant is the housing's.

    The chip of the light source has far less heat to take up than the housing and warms up within seconds, with a delay
    of its own sign: ranges then fall first and rise later, or the other way round. `amplitude_2_mm` and
    `time_constant_2_s` are this second term. `reconcile` looks for it at the price of one more effect, and gives the
    longer time constant first.

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
    amplitude_2_mm: float = number(
        "Final bias of a second term.",
        unit="mm",
        low=-1000,
        high=1000,
        default=0,
        zero=0,
        typical=(2, 20),
        prior=StudentPrior(scale=10, dof=3),
    )
    time_constant_2_s: float | None = number(
        "Time until 63 % of it; needed where `amplitude_2_mm` is not 0.",
        unit="s",
        low=0,
        high=1e6,
        low_open=True,
        required=False,
        typical=(5, 60),
        prior=about(20, 8),
    )

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        if self.amplitude_2_mm and self.time_constant_2_s is None:
            raise ValueError("time_constant_2_s: missing, and amplitude_2_mm is not 0")

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """The drift at the end, which is independent of the time constant, and the logarithm of the time constant.

        Then both of two terms.
        """
        # a drift within three frames is an offset with a bad first frame
        fastest = max(facts.recorded_s / 100, 3.0 * facts.interval_s)

        second = max(facts.recorded_s / 100, facts.interval_s)  # beside a slow one it is no offset

        def make(x: FloatArray, least_s: float = fastest) -> "TemperatureDrift":
            tau = math.exp(bounded(x[1], math.log(least_s), math.log(facts.duration_s * 30)))
            reached = -math.expm1(-facts.duration_s / tau)
            return cls(amplitude_mm=float(x[0]) * facts.sigma_mm / reached, time_constant_s=tau)

        paused = facts.duration_s > 1.5 * facts.recorded_s  # longer than its frames take
        spans = {facts.recorded_s, facts.duration_s} if paused else {facts.duration_s}
        taus = sorted({max(part * span, 1.1 * fastest) for part in (0.1, 0.4, 1.5) for span in spans})
        yield Problem(
            make=make,
            starts=tuple((size, math.log(tau)) for size in (-1.0, 1.0) for tau in taus),
            steps=(0.3, 0.4),
            other=lambda x: bool(x[1] < math.log(_AT_ONCE * fastest)),
        )

        def both(x: FloatArray) -> Effect:
            slow, fast = make(x[:2]), make(x[2:], second)
            bounded(slow.time_constant_s / fast.time_constant_s, _APART, math.inf)
            return replace(slow, amplitude_2_mm=fast.amplitude_mm, time_constant_2_s=fast.time_constant_s)

        def vector(two: tuple[float, float, float, float]) -> tuple[float, ...]:
            a, slow, b, fast = two
            reached = [-math.expm1(-facts.duration_s / tau) / facts.sigma_mm for tau in (slow, fast)]
            return a * reached[0], math.log(slow), b * reached[1], math.log(fast)

        yield Problem(
            make=both,
            starts=tuple(vector(two) for two in two_terms(*facts.course(), (1.5 * second, 10 * facts.duration_s))),
            steps=(0.3, 0.4, 0.3, 0.4),
            other=lambda x: bool(x[3] < math.log(_AT_ONCE * second) or x[1] - x[3] < math.log(_AT_ONCE * _APART)),
            form=_TWO,
            price_nats=EFFECT_NATS,
        )

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The amplitude, for each of some time constants: an offset with its course in time. Then both of two terms."""
        size, spread = facts.sigma_mm, spread_of(cls, "amplitude_mm")
        constant = RangeOffset(offset_mm=size)

        def made(tau_s: float, c: FloatArray) -> Effect:
            return cls(amplitude_mm=float(c[0]), time_constant_s=tau_s)

        def rise(tau_s: float, t: FloatArray) -> FloatArray:
            return np.asarray(-np.expm1(-t / tau_s))

        for part in _TAUS:
            tau_s = part * facts.duration_s
            one = Coefficient(effect=constant, size=size, spread=spread, course=partial(rise, tau_s))
            yield LinearForm(coefficients=(one,), make=partial(made, tau_s), choices=len(_TAUS), searched=2)

        def both(taus_s: tuple[float, float], c: FloatArray) -> Effect:
            slow, fast = taus_s
            return cls(
                amplitude_mm=float(c[0]), time_constant_s=slow, amplitude_2_mm=float(c[1]), time_constant_2_s=fast
            )

        spreads = spread, spread_of(cls, "amplitude_2_mm")
        for parts in _PAIRS:
            slow, fast = (part * facts.duration_s for part in parts)
            two = tuple(
                Coefficient(effect=constant, size=size, spread=own, course=partial(rise, tau_s))
                for tau_s, own in zip((slow, fast), spreads, strict=True)
            )
            yield LinearForm(
                coefficients=two,
                make=partial(both, (slow, fast)),
                choices=len(_PAIRS),
                searched=4,
                form=_TWO,
                price_nats=EFFECT_NATS,
            )

    def explain(self) -> str:
        """One sentence."""
        if not self.amplitude_2_mm:
            return f"ranges drift by {self.amplitude_mm:+g} mm in all, 63 % of it within {self.time_constant_s:g} s"
        return (
            f"ranges drift by {self.amplitude_mm:+g} mm, 63 % of it within {self.time_constant_s:g} s, "
            f"and besides by {self.amplitude_2_mm:+g} mm, 63 % of it within {self.time_constant_2_s or 0:g} s"
        )

    @property
    def warm_up_s(self) -> float:
        """Its time constant: it is that of the housing."""
        return self.time_constant_s

    def frame_bias(self, time_s: FloatArray) -> FloatArray:
        """Bias at some times, mm."""
        bias = np.asarray(self.amplitude_mm * -np.expm1(-time_s / self.time_constant_s))
        if not self.amplitude_2_mm or self.time_constant_2_s is None:
            return bias
        return np.asarray(bias + self.amplitude_2_mm * -np.expm1(-time_s / self.time_constant_2_s))

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias of this time."""
        echoes.add_bias(self.frame_bias(np.array(context.time_s)))


def two_terms(
    time_s: FloatArray, bias_mm: FloatArray, limits_s: tuple[float, float]
) -> list[tuple[float, float, float, float]]:
    """The two terms that explain most of a bias in time, beside a constant: linear least squares on a grid.

    Parameters
    ----------
    time_s, bias_mm : (n,) float64
        Times, s, and the bias then, mm.
    limits_s : (float, float)
        Least and largest time constant, s.

    Returns
    -------
    list of (float, float, float, float)
        Final bias, mm, and time constant, s, of the slower and of the faster term, for the best pairs of time
        constants, the best first.
    """
    taus = np.geomspace(*limits_s, _GRID)
    rises = -np.expm1(-time_s[:, None] / taus)
    found = []
    for slow in range(_GRID):
        for fast in range(slow):
            if taus[slow] > _AT_ONCE * _APART * taus[fast]:
                columns = np.stack([rises[:, slow], rises[:, fast], np.ones(time_s.size)], axis=1)
                numbers = np.linalg.lstsq(columns, bias_mm, rcond=1e-6)[0]
                left = float(((bias_mm - columns @ numbers) ** 2).sum())
                found.append((left, (float(numbers[0]), float(taus[slow]), float(numbers[1]), float(taus[fast]))))
    return [terms for _, terms in sorted(found)[:_BEST]]
