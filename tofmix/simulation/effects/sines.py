"""Biases that are sums of sines of range: what `wiggling` and `tap_mismatch` share."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.search import Coefficient, LinearForm, Problem, SearchFacts

if TYPE_CHECKING:
    from tofmix.simulation.effects.base import Effect

Sine = tuple[float, float, float]
"""Periods a turn, amplitude, mm, and phase at range 0, rad."""

_FIRST_STEP = 0.3  # of a component, in sigma


def bias_of(sines: Sequence[Sine], range_mm: FloatArray, turn_mm: float) -> FloatArray:
    """Sum of ``mm * sin(2 pi periods r / d_u + rad)``, mm, in the shape of the ranges r, mm."""
    bias = np.zeros(np.shape(range_mm))
    for periods, size_mm, phase_rad in sines:
        bias += size_mm * np.sin(range_mm * (2 * math.pi * periods / turn_mm) + phase_rad)
    return bias


def of_components(periods: Sequence[float], components_mm: FloatArray) -> tuple[Sine, ...]:
    """Sines from two components each: size times cosine and sine of the phase."""
    pairs = zip(periods, np.reshape(components_mm, (-1, 2)).tolist(), strict=True)
    return tuple((p, math.hypot(a, b), math.atan2(b, a)) for p, (a, b) in pairs)


def fitted_components(facts: SearchFacts, periods: Sequence[float]) -> FloatArray:
    """Components (2 a sine,), mm, of the sines that explain most of the residuals: linear least squares.

    Parameters
    ----------
    facts : SearchFacts
        Ranges, residuals and noise of pixels.
    periods : sequence of float
        Periods a turn of each sine.

    Returns
    -------
    (2 * len(periods),) float64
        As for `of_components`; 0 if no residual is known.
    """
    known = np.isfinite(facts.residual_mm)
    if not known.any():
        return np.zeros(2 * len(periods))
    phase = 2 * math.pi / facts.turn_mm * np.outer(facts.range_mm[known], periods)
    columns = np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(phase.shape[0], -1)
    weight = 1 / facts.noise_mm[known]
    found = np.linalg.lstsq(columns * weight[:, None], facts.residual_mm[known] * weight, rcond=1e-6)[0]
    return np.asarray(found)


def problem_of_sines(
    make: "Callable[[tuple[Sine, ...]], Effect]",
    facts: SearchFacts,
    periods: Sequence[float],
    *,
    form: str = "",
    price_nats: float = 0.0,
) -> Problem:
    """The search for the components of some sines, in sigma, from the fit to the residuals and from small ones."""

    def made(x: FloatArray) -> "Effect":
        return make(of_components(periods, np.asarray(x) * facts.sigma_mm))

    fitted = tuple((fitted_components(facts, periods) / facts.sigma_mm).tolist())
    small = tuple(_FIRST_STEP * turn for turn in (1.0, -1.0))
    starts = (fitted, *((size,) * (2 * len(periods)) for size in small))
    return Problem(
        make=made, starts=starts, steps=(_FIRST_STEP,) * (2 * len(periods)), form=form, price_nats=price_nats
    )


def coefficients_of(
    make: "Callable[[tuple[Sine, ...]], Effect]", periods: float, *, size_mm: float, spread_mm: float
) -> tuple[Coefficient, Coefficient]:
    """Both components of one sine as coefficients of a linear form."""
    along, across = (make(of_components((periods,), np.array(c) * size_mm)) for c in ((1.0, 0.0), (0.0, 1.0)))
    return (
        Coefficient(effect=along, size=size_mm, spread=spread_mm),
        Coefficient(effect=across, size=size_mm, spread=spread_mm),
    )


def form_of_sines(
    make: "Callable[[tuple[Sine, ...]], Effect]",
    coefficients: Sequence[tuple[Coefficient, Coefficient]],
    periods: Sequence[float],
    *,
    form: str = "",
) -> LinearForm:
    """Some sines as one linear form; each further one pays by the priors of its coefficients."""
    return LinearForm(
        coefficients=tuple(c for pair in coefficients for c in pair),
        make=lambda c: make(of_components(periods, c)),
        form=form,
    )
