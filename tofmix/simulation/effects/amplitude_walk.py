"""A bias that depends on the amplitude of a sample."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
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

_FLAT = 0.1
"""Exponent below which a walk is an offset."""

_EXPONENTS = (0.5, 1.0, 1.6)
"""Of linear forms, and where searches begin."""

_SATURATIONS = (0.3, 1.5)
"""Saturation amplitudes of linear forms, and where searches begin, over a typical amplitude."""

_LEAST_SATURATION, _MOST_SATURATION = 0.01, 30.0
"""Likewise, below which a walk is a power of the amplitude, and above which it is an offset."""

_SATURATING = "saturating"
"""Name of the form."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeWalk(Effect):
    """Bias ``scale_mm * (reference_amplitude / (amplitude + saturation_amplitude)) ** exponent``.

    At low signal, charge lags behind in the pixel, and its non-linearity turns the phase: dark targets appear nearer or
    farther than bright ones at the same range. Some mm to a few cm between black and white targets are reported. The
    amplitude is the light's, after all light effects. The bias is limited to 100 m.

    A power has no end at low signal; the delay of a charge has: alone in the pixel, it needs its whole time t to the
    tap, and with n others, whose field pushes it, t / (1 + n / n0). That is an exponent of 1, a `saturation_amplitude`
    of n0, and a bias of c t / 2 without any light. If it is 0, the bias is a power of the amplitude; if it is far above
    the amplitudes of a recording, the bias is an offset. `reconcile` looks for it at the price of one more effect.

    References
    ----------
    Lindner and Kolb, Calibration of the intensity-related distance error of the PMD ToF-camera, SPIE 6764, 2007.
    Janesick, Scientific charge-coupled devices, SPIE Press 2001, chapter 5: drift by the charges' own field.
    """

    kind: ClassVar[str] = "amplitude_walk"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias against amplitude, at one range too"
    typical: ClassVar[str] = "some mm to a few cm between black and white targets"
    basis: ClassVar[str] = "reported"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "a dark and a bright board at one distance",
    }

    scale_mm: float = number(
        "Bias at the reference amplitude.",
        unit="mm",
        low=-1000,
        high=1000,
        zero=0,
        typical=(1, 50),
        prior=StudentPrior(scale=25, dof=3),
    )
    reference_amplitude: float = number(
        "Amplitude at which the bias is `scale_mm`.", unit="1", low=0, high=1e6, low_open=True
    )
    exponent: float = number(
        "Exponent of its decrease with amplitude.",
        unit="1",
        low=0,
        high=4,
        default=1,
        typical=(0.5, 2),
        prior=StudentPrior(center=1, scale=0.6),
    )
    saturation_amplitude: float = number(
        "Amplitude below which the bias hardly grows.", unit="1", low=0, high=1e6, default=0
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """From either sign and three exponents; the reference is a typical amplitude. Then one that saturates."""
        lit = facts.lit_amplitudes
        if lit.size == 0:
            return
        reference = float(f"{math.exp(np.log(lit).mean()):.4g}")

        def make(x: FloatArray) -> Effect:
            return cls(
                scale_mm=float(x[0]) * facts.sigma_mm, reference_amplitude=reference, exponent=bounded(x[1], 0.05, 4.0)
            )

        starts = tuple((size, exponent) for size in (-0.5, 0.5) for exponent in _EXPONENTS)
        yield Problem(make=make, starts=starts, steps=(0.2, 0.2), other=lambda x: bool(x[1] < _FLAT))
        low, high = math.log(_LEAST_SATURATION), math.log(_MOST_SATURATION)

        def saturating(x: FloatArray) -> Effect:
            ratio = math.exp(bounded(x[2], low - 1, high + 1))
            exponent = bounded(x[1], 0.05, 4.0)
            return cls(
                scale_mm=float(x[0]) * facts.sigma_mm * (1 + ratio) ** exponent,  # of a typical amplitude
                reference_amplitude=reference,
                exponent=exponent,
                saturation_amplitude=reference * ratio,
            )

        yield Problem(
            make=saturating,
            starts=tuple((*start, math.log(ratio)) for start in starts for ratio in _SATURATIONS),
            steps=(0.2, 0.2, 0.4),
            other=lambda x: bool(x[1] < _FLAT or not low < x[2] < high),
            form=_SATURATING,
            price_nats=EFFECT_NATS,
        )

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The scale, for each of some exponents; then for each of some saturation amplitudes, of exponent 1."""
        size, spread = facts.sigma_mm, spread_of(cls, "scale_mm")

        def made(exponent: float, saturation: float, c: FloatArray) -> Effect:
            return cls(
                scale_mm=float(c[0]),
                reference_amplitude=facts.amplitude,
                exponent=exponent,
                saturation_amplitude=saturation,
            )

        for exponent in _EXPONENTS:
            make = partial(made, exponent, 0.0)
            scale = Coefficient(effect=make(np.array([size])), size=size, spread=spread)
            yield LinearForm(coefficients=(scale,), make=make, choices=len(_EXPONENTS), searched=2)
        for ratio in _SATURATIONS:
            make = partial(made, 1.0, ratio * facts.amplitude)
            scale = Coefficient(effect=make(np.array([size])), size=size, spread=spread * (1 + ratio))
            yield LinearForm(
                coefficients=(scale,),
                make=make,
                choices=len(_SATURATIONS),
                searched=3,
                form=_SATURATING,
                price_nats=EFFECT_NATS,
            )

    def explain(self) -> str:
        """One sentence."""
        saturation, of = self.saturation_amplitude, "amplitude"
        if saturation:
            of = f"amplitude plus {saturation:g}"
        return (
            f"ranges change by {self.scale_mm:+g} mm at {of} {'= ' if saturation else ''}{self.reference_amplitude:g}, "
            f"and with {of} to the power of {-self.exponent:g}"
        )

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the bias of each amplitude."""
        faintest = self.reference_amplitude * 1.0e-30
        ratio = self.reference_amplitude / np.maximum(echoes.amplitude + self.saturation_amplitude, faintest)
        with np.errstate(over="ignore"):
            # 100 m are beyond any range: amplitude 0 must not give infinity
            bias = self.scale_mm * np.minimum(ratio**self.exponent, 1.0e5 / max(abs(self.scale_mm), 1.0e-9))
        echoes.add_bias(bias)
