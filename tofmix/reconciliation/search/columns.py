"""The changes that effects make to summaries, with each effect's numbers as linear coefficients with a prior.

A `Term` is an effect of one kind (and surface). Each of its coefficients has a column: the change of the pixels' biases
and widths. If a law is not linear in a parameter (the time constant of a drift, the exponent of a walk), it has one
term for each of a few values of this parameter.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.search.summaries import PixelSummary, surfaces_of
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.base import Latent, Target
from tofmix.simulation.effects.parameter import Holds, Parameter
from tofmix.simulation.effects.prior import StudentPrior
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.surface import Surface

_TAUS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # time constants of a drift, as parts of the recording
_EXPONENTS = (0.5, 1.0, 1.6)  # of a walk
_SMALL = 0.01  # share of light, for slopes
_TURN_DEG = 0.1  # tilt, for slopes
_WIDER = 0.05  # logarithm of a width, for slopes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """The change that one unit of a coefficient makes to each recording.

    Parameters
    ----------
    bias_mm : tuple of (pixel,) float64
        Change of the mean, for each summary.
    profile : tuple of (tenth,) float64
        Factor on this change in each tenth of the time.
    width : tuple of (pixel,) float64
        Change of the logarithm of the width.
    prior : float
        Standard deviation of the prior of the coefficient.
    """

    bias_mm: tuple[FloatArray, ...]
    profile: tuple[FloatArray, ...]
    width: tuple[FloatArray, ...]
    prior: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Term:
    """An effect as coefficients.

    Parameters
    ----------
    kind, surface : str
        Kind and surface of the effect; the surface is empty for an effect of the camera.
    columns : tuple of Column
        One for each coefficient.
    make : callable
        Makes the effect from coefficients (coefficient,); ValueError if they are out of bounds.
    choices : int
        Number of values of a nonlinear parameter among which this one is chosen.
    """

    kind: str
    surface: str
    columns: tuple[Column, ...]
    make: Callable[[FloatArray], Effect]
    choices: int = 1

    @property
    def name(self) -> tuple[str, str]:
        """Kind and surface."""
        return self.kind, self.surface


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColumnScales:
    """Units of priors and finite steps.

    Parameters
    ----------
    sigma_mm : float
        Typical sigma.
    duration_s : float
        Of the recording.
    turn_mm : float
        d_u; NaN where the camera has none.
    reference : float
        Typical amplitude.
    """

    sigma_mm: float
    duration_s: float
    turn_mm: float
    reference: float


def terms(likelihood: Likelihood, state: ModelState, seen: Sequence[PixelSummary], kinds: Sequence[str]) -> list[Term]:
    """The terms of some kinds: effects that are possible in the recordings and that summaries show.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    state : State
        The state of the summaries.
    seen : sequence of Summary
        Its summaries.
    kinds : sequence of str
        Kinds of the registry. Kinds that neither move nor widen samples by a law have no term.
    """
    make = ColumnMaker(likelihood, state, seen)
    return [
        term for kind in kinds if summed_up(kind) for term in make.possible(TERMS.get(kind, partial(_declared, kind)))
    ]


def summed_up(kind: str) -> bool:
    """Whether summaries show a kind: it has a law in `TERMS`, or one number that moves or widens samples."""
    return kind in TERMS or _number(kind) is not None


def _number(kind: str) -> Parameter | None:
    """The number of a kind without a hidden state that moves or widens samples in proportion to it; None for others."""
    effect = EFFECTS[kind]
    if effect.latent is not Latent.NONE or effect.target not in (Target.BIAS, Target.SPREAD):
        return None
    numbers = [p for p in effect.parameters().values() if p.holds is not Holds.MAP]
    return numbers[0] if len(numbers) == 1 and numbers[0].zero == 0 and numbers[0].typical[1] > 0 else None


class ColumnMaker:
    """Makes columns from the predicted changes of a small effect."""

    def __init__(self, likelihood: Likelihood, state: ModelState, seen: Sequence[PixelSummary]) -> None:
        self.likelihood, self.state, self.seen = likelihood, state, seen
        self.base = likelihood.mixture(state)
        used = [s.view.mixture.of_main(s.view.mixture.sigma)[s.used] for s in seen]
        lit = [s.view.mixture.of_main(s.view.mixture.amplitude)[s.used] for s in seen]
        amplitude = np.concatenate(lit)
        amplitude = amplitude[amplitude > 0]
        turn = likelihood.scene.model.sensor.modulation_frequency_hz
        self.scales = ColumnScales(
            sigma_mm=float(np.median(np.concatenate(used))) if any(u.size for u in used) else 1.0,
            duration_s=max(float(likelihood.evidence.time_s.max()), 1e-3),
            turn_mm=math.nan if turn is None else likelihood.scene.model.sensor.turn_mm("reconcile"),
            reference=float(np.exp(np.log(amplitude).mean())) if amplitude.size else 1.0,
        )
        self.surfaces = list(dict.fromkeys(name for s in seen for name, _ in surfaces_of(s)))

    def surface(self, name: str) -> Surface:
        """The surface of this name in the model of the first recording that has it."""
        return next(s for seen in self.seen for s in seen.view.scene.model.surfaces if s.name == name)

    def possible(self, of_kind: "Callable[[ColumnMaker], Iterator[Term]]") -> list[Term]:
        """The terms of a kind; none if the camera or the scene cannot have it."""
        try:
            return list(of_kind(self))
        except ValueError:
            return []

    def column(
        self, effect: Effect, size: float, prior: float, *, profile: Callable[[FloatArray], FloatArray] | None = None
    ) -> Column:
        """The change that an effect makes, for each unit of its size; `profile` is the course over the time in s.

        Raises
        ------
        ValueError
            If the camera or the scene cannot have the effect.
        """
        effect.check(self.likelihood.scene.model.sensor, self.likelihood.scene.names)
        changed = self.likelihood.mixture(_with(self.state, effect))
        bias, width, times = [], [], []
        for s in self.seen:
            before, after = self.base.of_frames(s.view.frames), changed.of_frames(s.view.frames)
            place = after.main_of(before)
            seen = s.used & (place >= 0)  # if the surface is out of the pixel, nothing is known
            moved = _of(after, "mean", place) - before.of_main(before.mean)
            wider = np.log(_of(after, "sigma", place) / before.of_main(before.sigma))
            bias.append(np.where(seen, moved, 0.0) / size)
            width.append(np.where(seen, wider, 0.0) / size)
            times.append(np.ones(s.elapsed_s.size) if profile is None else profile(s.elapsed_s))
        return Column(bias_mm=tuple(bias), profile=tuple(times), width=tuple(width), prior=prior)


def _of(m: Mixture, name: str, component: IntArray) -> FloatArray:
    values: FloatArray = getattr(m, name)[0]
    return np.asarray(np.take_along_axis(values, np.maximum(component, 0)[None], axis=0)[0])


def _with(state: ModelState, effect: Effect) -> ModelState:
    return replace(state, effects=(*state.effects, effect))


def _offset(make: ColumnMaker) -> Iterator[Term]:
    size, prior = make.scales.sigma_mm, _prior("range_offset", "offset_mm")
    yield Term(
        kind="range_offset",
        surface="",
        make=lambda c: _effect("range_offset", offset_mm=float(c[0])),
        columns=(make.column(_effect("range_offset", offset_mm=size), size, prior),),
    )


def _pose(make: ColumnMaker) -> Iterator[Term]:
    """A shift alone, or a shift with both tilts."""
    size, prior = make.scales.sigma_mm, _prior("surface_pose", "shift_mm")
    for name in make.surfaces:
        made = partial(_moved, make.surface(name))
        shift = make.column(made(np.array([size])), size, prior)
        tilts = tuple(
            make.column(made(np.array(c)), _TURN_DEG, _prior("surface_pose", "yaw_deg"))
            for c in ((0.0, _TURN_DEG, 0.0), (0.0, 0.0, _TURN_DEG))
        )
        for columns in ((shift,), (shift, *tilts)):
            yield Term(kind="surface_pose", surface=name, make=made, columns=columns, choices=2)


def _moved(surface: Surface, c: FloatArray) -> Effect:
    shift, about_u, about_v = (*(float(v) for v in c), 0.0, 0.0)[:3]
    return SurfacePose.tilted(surface, shift, (about_u, about_v))


def _motion(make: ColumnMaker) -> Iterator[Term]:
    """Parameter: the way in the whole recording. It has the prior of a pose."""
    size, duration, prior = make.scales.sigma_mm, make.scales.duration_s, _prior("surface_pose", "shift_mm")

    def moving(surface: str, c: FloatArray) -> Effect:
        return _effect("motion", surface=surface, velocity_mm_s=float(c[0]) / duration)

    for name in make.surfaces:
        at_once = _moved(make.surface(name), np.array([size]))
        column = make.column(at_once, size, prior, profile=lambda t: t / duration)
        yield Term(kind="motion", surface=name, make=partial(moving, name), columns=(column,))


def _wiggling(make: ColumnMaker) -> Iterator[Term]:
    def made(c: FloatArray) -> Effect:
        return _effect("wiggling", amplitude_mm=math.hypot(c[0], c[1]), phase_rad=math.atan2(c[1], c[0]))

    size, prior = make.scales.sigma_mm, _prior("wiggling", "amplitude_mm")
    both = tuple(make.column(made(np.array(c)), size, prior) for c in ((size, 0.0), (0.0, size)))
    yield Term(kind="wiggling", surface="", make=made, columns=both)


def _walk(make: ColumnMaker) -> Iterator[Term]:
    size, prior, reference = make.scales.sigma_mm, _prior("amplitude_walk", "scale_mm"), make.scales.reference

    def made(exponent: float, c: FloatArray) -> Effect:
        return _effect("amplitude_walk", scale_mm=float(c[0]), reference_amplitude=reference, exponent=exponent)

    for exponent in _EXPONENTS:
        law = make.column(made(exponent, np.array([size])), size, prior)
        yield Term(
            kind="amplitude_walk", surface="", make=partial(made, exponent), columns=(law,), choices=len(_EXPONENTS)
        )


def _drift(make: ColumnMaker) -> Iterator[Term]:
    size, prior = make.scales.sigma_mm, _prior("temperature_drift", "amplitude_mm")
    constant = _effect("range_offset", offset_mm=size)

    def made(tau_s: float, c: FloatArray) -> Effect:
        return _effect("temperature_drift", amplitude_mm=float(c[0]), time_constant_s=tau_s)

    def rise(tau_s: float, t: FloatArray) -> FloatArray:
        return np.asarray(-np.expm1(-t / tau_s))

    for part in _TAUS:
        tau_s = part * make.scales.duration_s
        column = make.column(constant, size, prior, profile=partial(rise, tau_s))
        yield Term(
            kind="temperature_drift", surface="", make=partial(made, tau_s), columns=(column,), choices=len(_TAUS)
        )


def _scattering(make: ColumnMaker) -> Iterator[Term]:
    def made(c: FloatArray) -> Effect:
        return _effect("scattering", share=float(c[0]))

    law = make.column(made(np.array([_SMALL])), _SMALL, _prior("scattering", "share"))
    yield Term(kind="scattering", surface="", make=made, columns=(law,))


def _multipath(make: ColumnMaker) -> Iterator[Term]:
    """The second path's phasor over the first one's. In phase it changes the noise, a quarter turn off the range."""
    turn = make.scales.turn_mm

    def made(surface: str, c: FloatArray) -> Effect:
        path_mm = math.atan2(c[1], c[0]) % (2 * math.pi) / math.pi * turn
        return _effect("multipath", surface=surface, share=math.hypot(c[0], c[1]), extra_path_mm=path_mm)

    prior = _prior("multipath", "share")
    for name in make.surfaces:
        own = partial(made, name)
        both = tuple(make.column(own(np.array(c)), _SMALL, prior) for c in ((_SMALL, 0.0), (0.0, _SMALL)))
        yield Term(kind="multipath", surface=name, make=own, columns=both)


def _reflection(make: ColumnMaker) -> Iterator[Term]:
    """The phasor's component at the most likely range, and that a quarter turn off, as the range is uncertain."""
    turn, size = make.scales.turn_mm, _SMALL * make.scales.reference
    likely = EFFECTS["internal_reflection"].parameters()["range_mm"].prior
    middle = likely.center if isinstance(likely, StudentPrior) else 0.0

    def made(c: FloatArray) -> Effect:
        range_mm = middle + math.atan2(c[1], c[0]) / (2 * math.pi) * turn
        return _effect("internal_reflection", amplitude=math.hypot(c[0], c[1]), range_mm=range_mm)

    along = _prior("internal_reflection", "amplitude")
    across = along * 2 * math.pi / turn * _prior("internal_reflection", "range_mm")
    both = (
        make.column(made(np.array((size, 0.0))), size, along),
        make.column(made(np.array((0.0, size))), size, across),
    )
    yield Term(kind="internal_reflection", surface="", make=made, columns=both)


def _noise(make: ColumnMaker) -> Iterator[Term]:
    def made(c: FloatArray) -> Effect:
        return _effect("excess_noise", factor=math.exp(c[0]))

    law = make.column(made(np.array([_WIDER])), _WIDER, _prior_factor("excess_noise", "factor"))
    yield Term(kind="excess_noise", surface="", make=made, columns=(law,))


def _vignetting(make: ColumnMaker) -> Iterator[Term]:
    def made(c: FloatArray) -> Effect:
        return _effect("vignetting", corner_factor=math.exp(c[0]))

    law = make.column(made(np.array([_WIDER])), _WIDER, _prior_factor("vignetting", "corner_factor"))
    yield Term(kind="vignetting", surface="", make=made, columns=(law,))


def _declared(kind: str, make: ColumnMaker) -> Iterator[Term]:
    number = _number(kind)
    if number is None:
        return
    size = number.typical[0]

    def made(c: FloatArray) -> Effect:
        return _effect(kind, **{number.name: float(c[0])})

    law = make.column(made(np.array([size])), size, _prior(kind, number.name))
    yield Term(kind=kind, surface="", make=made, columns=(law,))


def _prior_factor(kind: str, name: str) -> float:
    """Standard deviation of the logarithm of a factor, as its prior has it."""
    parameter = EFFECTS[kind].parameters()[name]
    return 0.5 * math.log(parameter.typical[1]) if parameter.prior is None else parameter.prior.spread


def _prior(kind: str, name: str) -> float:
    """Standard deviation of a coefficient, as its prior has it; without one, half of the largest typical magnitude."""
    parameter = EFFECTS[kind].parameters()[name]
    return 0.5 * parameter.typical[1] if parameter.prior is None else parameter.prior.spread


def _effect(kind: str, **values: float | str) -> Effect:
    make: Callable[..., Effect] = EFFECTS[kind]
    return make(**values)


TERMS: dict[str, Callable[[ColumnMaker], Iterator[Term]]] = {
    "range_offset": _offset,
    "surface_pose": _pose,
    "motion": _motion,
    "wiggling": _wiggling,
    "amplitude_walk": _walk,
    "temperature_drift": _drift,
    "scattering": _scattering,
    "multipath": _multipath,
    "internal_reflection": _reflection,
    "excess_noise": _noise,
    "vignetting": _vignetting,
}
"""Kinds whose laws are nonlinear, act in time, or have several numbers."""
