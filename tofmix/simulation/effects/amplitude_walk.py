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
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of,
)

_LARGEST_MM = 1.0e5  # beyond any range: amplitude 0 must not give infinity


_FLAT = 0.1
"""Exponent below which a walk is an offset."""

_EXPONENTS = (0.5, 1.0, 1.6)
"""Of linear forms, and where searches begin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeWalk(Effect):
    """Bias ``scale_mm * (reference_amplitude / amplitude) ** exponent``.

    At low signal, charge lags behind in the pixel, and its non-linearity turns the phase: dark targets appear nearer or
    farther than bright ones at the same range. Some mm to a few cm between black and white targets are reported. The
    amplitude is the light's, after all light effects. The bias is limited to 100 m.

    References
    ----------
    Lindner and Kolb, Calibration of the intensity-related distance error of the PMD ToF-camera, SPIE 6764, 2007.
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

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """From either sign and three exponents; the reference is a typical amplitude."""
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

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The scale, for each of some exponents."""
        size, spread = facts.sigma_mm, spread_of(cls, "scale_mm")

        def made(exponent: float, c: FloatArray) -> Effect:
            return cls(scale_mm=float(c[0]), reference_amplitude=facts.amplitude, exponent=exponent)

        for exponent in _EXPONENTS:
            scale = Coefficient(effect=made(exponent, np.array([size])), size=size, spread=spread)
            yield LinearForm(coefficients=(scale,), make=partial(made, exponent), choices=len(_EXPONENTS))

    def explain(self) -> str:
        """One sentence."""
        return (
            f"ranges change by {self.scale_mm:+g} mm at amplitude {self.reference_amplitude:g}, "
            f"and with amplitude to the power of {-self.exponent:g}"
        )

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the bias of each amplitude."""
        faintest = self.reference_amplitude * 1.0e-30
        ratio = self.reference_amplitude / np.maximum(echoes.amplitude, faintest)
        with np.errstate(over="ignore"):
            bias = self.scale_mm * np.minimum(ratio**self.exponent, _LARGEST_MM / max(abs(self.scale_mm), 1.0e-9))
        echoes.add_bias(bias)
