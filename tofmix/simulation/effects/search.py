"""What an effect declares for `reconcile`: where a search for its numbers begins, and its law for small numbers.

Both have a form that follows from the declared parameters. An effect whose law is nonlinear, acts in time or has
several numbers has class methods `problems` (`OwnProblems`) and `linear_forms` (`OwnForms`) in its own file.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.base import Effect, Latent, Target
from tofmix.simulation.effects.parameter import Holds, Parameter

if TYPE_CHECKING:
    from tofmix.simulation.surface import Surface

SMALL_SHARE = 0.01
"""Share, or part of a typical amplitude, by which an effect is tried for a slope."""

SMALL_LOG = 0.05
"""Logarithm of a factor by which an effect is tried for a slope."""

EFFECT_NATS = 7.8
"""Price of one more effect, and of an optional part of a law that another camera does not have: log of some 25
kinds and surfaces that could be named, over one false alarm in 100 recordings."""

OUT_OF_SIGHT = 3.0
"""Distance, in sigma, from which a likelihood has no slope towards samples."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One search.

    Parameters
    ----------
    make : callable
        An effect from a vector of numbers; raises ValueError outside its bounds. The numbers have units in which a
        step of 1 is reasonable: multiples of sigma, logarithms.
    starts : tuple of tuples
        Start vectors.
    steps : tuple of float
        First steps.
    other : callable, optional
        Whether a vector is so close to a bound, or so large, that another effect describes the same.
    form : str
        Which of the kind's forms it fits; empty where its numbers say so.
    price_nats : float
        Price of an optional part of the law, beyond that of its numbers.
    shown : bool
        Whether a start is where samples lie that are far from the model: a law for small numbers does not lead there.
    """

    make: Callable[[FloatArray], Effect]
    starts: tuple[tuple[float, ...], ...]
    steps: tuple[float, ...]
    other: Callable[[FloatArray], bool] | None = None
    form: str = ""
    price_nats: float = 0.0
    shown: bool = False

    @property
    def parameters(self) -> int:
        """Free parameters."""
        return len(self.steps)


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFacts:
    """A surface that fills pixels, measured by their medians.

    Parameters
    ----------
    surface : Surface
        Of the model.
    sigma_mm : float
        Typical noise.
    residual_mm : float
        Measured minus predicted range.
    pixels : int
        Pixels that it fills.
    speed_mm_s : float
        Along the normal, at which more samples lie than at any other, from the model's pose at time 0.
    shift_mm, tilts_deg : float, (float, float)
        Measured pose: along the model's normal, and about the surface's own two axes.
    turn_nats : float
        Gain of the tilts beyond a shift; minus infinity if the pose is not known.
    turned_deg : (float, float)
        Tilts by which its edges move by sigma; 0 where a tilt moves them too little.
    """

    surface: "Surface"
    sigma_mm: float
    residual_mm: float
    pixels: int = 1
    speed_mm_s: float = 0.0
    shift_mm: float = 0.0
    tilts_deg: tuple[float, float] = (0.0, 0.0)
    turn_nats: float = -math.inf
    turned_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def name(self) -> str:
        """Of the surface."""
        return self.surface.name

    @property
    def far(self) -> bool:
        """Whether it is so far off that the likelihood has no slope towards it."""
        return abs(self.residual_mm) > OUT_OF_SIGHT * self.sigma_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchFacts:
    """Data of recordings and model that determine where searches begin.

    Parameters
    ----------
    sigma_mm : float
        Typical noise.
    turn_mm : float
        d_u; NaN for a camera without phase.
    duration_s, recorded_s, interval_s : float
        Of the recordings: whole, without pauses, between frames.
    surfaces : tuple of SurfaceFacts
        Surfaces that fill pixels.
    farthest_mm : float
        Range of the farthest surface; 0 without any.
    range_mm, amplitude, residual_mm, noise_mm : (lit pixel,) float64
        Predicted range and amplitude, measured minus predicted range (NaN where it is not known), and noise, of pixels
        with a return.
    measured_noise_mm : (lit pixel,) float64
        Spread of the samples from frame to frame; NaN where it is not known or the pixel sees several surfaces.
    place : (lit pixel, 2) float64
        Their places: right and down of the image's centre, in half diagonals.
    amplitudes, lost_shares : (pixel,) float64
        Predicted amplitude and share of invalid samples of all pixels.
    course : callable
        Times, s, of some frames and the median of measured minus predicted range in each, mm: (frame,), (frame,).
    gain : callable
        Gain, nats, of the bias of an effect on some samples of these pixels, its size free and not below 0.
    nearer : callable
        Share, median and spread, mm, of the samples that are nearer than all that the model has in their pixel and
        between two ranges, mm; None without such samples.
    """

    sigma_mm: float
    turn_mm: float
    duration_s: float
    recorded_s: float
    interval_s: float
    surfaces: tuple[SurfaceFacts, ...]
    farthest_mm: float
    range_mm: FloatArray
    place: FloatArray
    amplitude: FloatArray
    residual_mm: FloatArray
    noise_mm: FloatArray
    measured_noise_mm: FloatArray
    amplitudes: FloatArray
    lost_shares: FloatArray
    course: Callable[[], tuple[FloatArray, FloatArray]]
    gain: Callable[[Effect], float]
    nearer: Callable[[float, float], tuple[float, float, float] | None]

    def goes_far(self, seen: SurfaceFacts, pixels: int = 1) -> bool:
        """Whether a surface goes further than the noise of a mean of so many samples reaches, by ten of its sigma.

        Of all its pixels, what is uneven in its way is seen then, too.
        """
        reach = 10.0  # sigma
        return abs(seen.speed_mm_s) * self.duration_s * math.sqrt(pixels) > reach * seen.sigma_mm

    @property
    def typical_residual_mm(self) -> float:
        """Median of measured minus predicted ranges, mm; 0 where none is known."""
        known = self.residual_mm[~np.isnan(self.residual_mm)]
        return float(np.median(known)) if known.size else 0.0

    @property
    def lit_amplitudes(self) -> FloatArray:
        """Amplitudes of all pixels with light (n,)."""
        return self.amplitudes[self.amplitudes > 0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coefficient:
    """A coefficient of a linear form.

    Parameters
    ----------
    effect : Effect
        A small effect; the change that it makes is that of `size` of the coefficient.
    size : float
        See `effect`.
    spread : float
        Standard deviation of the coefficient's prior.
    course : callable, optional
        Factor (time,) on the change at some times, s; without it the change is constant.
    """

    effect: Effect
    size: float
    spread: float
    course: Callable[[FloatArray], FloatArray] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearForm:
    """An effect as linear coefficients. A law that is not linear in a number has one form for each of a few values.

    Parameters
    ----------
    coefficients : tuple of Coefficient
        They add up.
    make : callable
        The effect from coefficients (coefficient,); ValueError if they are out of bounds.
    surface : str
        Surface of the effect; empty for an effect of the camera.
    choices : int
        Number of forms of this kind and surface, of which one is chosen.
    searched : int
        Free parameters of this `Problem`; as many as coefficients if it is 0.
    form : str
        That of the `Problem` that fits the same law to samples.
    price_nats : float
        Price of numbers that are no coefficients: coefficients pay by their priors.
    """

    coefficients: tuple[Coefficient, ...]
    make: Callable[[FloatArray], Effect]
    surface: str = ""
    choices: int = 1
    searched: int = 0
    form: str = ""
    price_nats: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FormFacts:
    """Data of recordings and model that linear forms need.

    Parameters
    ----------
    sigma_mm : float
        Typical noise.
    duration_s : float
        Of the recordings.
    turn_mm : float
        d_u; NaN for a camera without phase.
    amplitude : float
        Typical amplitude.
    surfaces : tuple of Surface
        Surfaces that pixels see alone.
    gain : callable
        As of `SearchFacts`, on all samples of the pixels that see one surface.
    """

    sigma_mm: float
    duration_s: float
    turn_mm: float
    amplitude: float
    surfaces: "tuple[Surface, ...]"
    gain: Callable[[Effect], float]


def bounded(value: float, low: float, high: float) -> float:
    """A value within bounds.

    Raises
    ------
    ValueError
        If it is outside.
    """
    if not low <= value <= high:
        raise ValueError(f"{value} is out of bounds")
    return float(value)


def of_sigma(kind: type[Effect], name: str, sizes: tuple[float, ...], sigma_mm: float) -> Problem:
    """The search for one number in mm, from some multiples of sigma."""
    made: Callable[..., Effect] = kind
    return Problem(
        make=lambda x: made(**{name: float(x[0]) * sigma_mm}), starts=tuple((size,) for size in sizes), steps=(0.2,)
    )


def of_logarithm(kind: type[Effect], name: str, values: tuple[float, ...], *, most: float = 1e5) -> Problem:
    """The search for one positive number, at most `most`, by its logarithm, from some values."""
    made: Callable[..., Effect] = kind
    return Problem(
        make=lambda x: made(**{name: math.exp(bounded(x[0], -25, math.log(most)))}),
        starts=tuple((math.log(value),) for value in values),
        steps=(0.2,),
    )


def spread_of(kind: type[Effect], name: str) -> float:
    """Standard deviation of a number by its prior; without one, half of the largest typical magnitude."""
    parameter = kind.parameters()[name]
    return 0.5 * parameter.typical[1] if parameter.prior is None else parameter.prior.spread


def spread_of_factor(kind: type[Effect], name: str) -> float:
    """Standard deviation of the logarithm of a factor, likewise."""
    parameter = kind.parameters()[name]
    return 0.5 * math.log(parameter.typical[1]) if parameter.prior is None else parameter.prior.spread


@runtime_checkable
class OwnProblems(Protocol):
    """A kind with searches of its own."""

    def problems(self, facts: SearchFacts) -> Iterator[Problem]:
        """The searches for its numbers; none if the recordings cannot show it."""
        ...


@runtime_checkable
class OwnForms(Protocol):
    """A kind with a law of its own for small numbers."""

    def linear_forms(self, facts: FormFacts) -> Iterator[LinearForm]:
        """Its law for small numbers, as linear coefficients.

        Raises
        ------
        ValueError
            If the camera or the scene cannot have the effect.
        """
        ...


def problems_of(kind: type[Effect], facts: SearchFacts) -> Iterator[Problem]:
    """The searches for the numbers of a kind; none if the recordings cannot show it."""
    return kind.problems(facts) if isinstance(kind, OwnProblems) else declared_problems(kind, facts)


def forms_of(kind: type[Effect], facts: FormFacts) -> Iterator[LinearForm]:
    """The law of a kind for small numbers, as linear coefficients.

    Raises
    ------
    ValueError
        If the camera or the scene cannot have the effect.
    """
    return kind.linear_forms(facts) if isinstance(kind, OwnForms) else declared_forms(kind)


def has_form(kind: type[Effect]) -> bool:
    """Whether a kind moves or widens the samples of a pixel by a law."""
    return isinstance(kind, OwnForms) or number_of_form(kind) is not None


def number_of_form(kind: type[Effect]) -> Parameter | None:
    """The number in proportion to which a kind moves or widens samples, by its declaration; None without one."""
    if kind.latent is not Latent.NONE or kind.target not in (Target.BIAS, Target.SPREAD):
        return None
    numbers = [p for p in kind.parameters().values() if p.holds is not Holds.MAP]
    return numbers[0] if len(numbers) == 1 and numbers[0].zero == 0 and numbers[0].typical[1] > 0 else None


def declared_forms(kind: type[Effect]) -> Iterator[LinearForm]:
    """The linear form that follows from the declaration of a kind of one number; none for other kinds."""
    number = number_of_form(kind)
    if number is None:
        return
    made: Callable[..., Effect] = kind
    name, size = number.name, number.typical[0]

    def make(c: FloatArray) -> Effect:
        return made(**{name: float(c[0])})

    one = Coefficient(effect=made(**{name: float(size)}), size=size, spread=spread_of(kind, name))
    yield LinearForm(coefficients=(one,), make=make)


def declared_problems(kind: type[Effect], facts: SearchFacts) -> Iterator[Problem]:
    """The searches that follow from a declaration: all numbers from their typical sizes.

    By logarithms for numbers of one sign, in multiples of the size for others.
    """
    parameters = kind.parameters().values()
    free = [p for p in parameters if p.holds is Holds.NUMBER and not math.isnan(p.typical[0])]
    sizes = [math.sqrt(p.typical[0] * p.typical[1]) for p in free]
    logs = [p.low >= 0 for p in free]
    made: Callable[..., Effect] = kind

    def make(surface: dict[str, str], x: FloatArray) -> Effect:
        values = [math.exp(bounded(v, -50, 50)) if log else v for v, log in zip(x, logs, strict=True)]
        return made(**{p.name: float(v) * size for p, v, size in zip(free, values, sizes, strict=True)}, **surface)

    of_surface = any(p.holds is Holds.SURFACE for p in parameters)
    ways = tuple(product(*(((0.0,) if log else (-1.0, 1.0)) for log in logs)))
    for own in ({"surface": seen.name} for seen in facts.surfaces) if of_surface else ({},):
        yield Problem(make=partial(make, own), starts=ways, steps=(0.3,) * len(free))


def image_places(shape: tuple[int, int]) -> FloatArray:
    """Places (pixel, 2) of an image's pixels: right and down of its centre, in half diagonals.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    """
    rows, cols = shape
    row, col = np.divmod(np.arange(rows * cols), cols)
    half = max(0.5 * float(np.hypot(rows - 1, cols - 1)), 0.5)
    return np.stack([col - (cols - 1) / 2, row - (rows - 1) / 2], axis=1) / half
