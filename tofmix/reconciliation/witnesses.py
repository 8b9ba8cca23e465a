"""What a recording's amplitudes and temperatures say of an effect, beside what its ranges say.

Use `amplitude_witnesses` and `warm_up_witness` for what goes into `Likelihood.objective`, and `as_bright_as_seen` for
a model in which laws of amplitude act on recorded ones. They steer parameters, never names: held-out gains are of
ranges alone.

A witness is only as good as the model's amplitudes are, or as the thermometer's place is. How good the amplitudes are,
the recording tells: by how much its other surfaces differ from the model.
"""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.mixture import Mixture
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level
from tofmix.simulation.effects.multipath import Multipath
from tofmix.simulation.effects.parameter import Parameter
from tofmix.simulation.effects.temperature_drift import TemperatureDrift
from tofmix.simulation.model import Model

_SINGLE = 0.9  # weight of a pixel's main surface
_LEAST_PIXELS = 12  # of a surface, for the median of its amplitudes
_ROUGH = 0.3  # scatter of a surface's log ratios above which its amplitudes follow another law
_MEDIAN_DEVIATION = round(NormalDist().inv_cdf(0.75), 4)
"""Median absolute deviation of a standard Gaussian, Phi^-1(3/4), to four decimals."""

_OWN_UNIT = 0.02  # a surface whose amplitude is right to this: the recording's unit is the model's
_BEST = 0.002  # log ratio: scatter of a model's amplitudes that is supposed before it is seen,
_SUPPOSED = 2  # as if seen on so many surfaces
_LEAST_OTHERS = 2  # surfaces, beside which one stands out
_LEAST_RISE_K = 0.5  # of the temperature, for a law of its own
_SAME_LAW = 0.9  # of the temperature's variance that a warm-up must explain
_LAG = 0.03  # by which the part that drifts may differ from the one that was measured
_THERMAL_DOF = 4  # of Student's t: a time constant that differs is no proof


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeWitness:
    """Logarithm of recorded over predicted amplitude of one surface, against that of the scene's others.

    Parameters
    ----------
    surface : str
        The surface.
    log_ratio : float
        Less the mean of the others.
    scale, dof : float
        Of Student's t distribution that it has if nothing acts on this surface alone.
    turn_mm : float
        d_u.
    """

    surface: str
    log_ratio: float
    scale: float
    dof: float
    turn_mm: float

    def log_density(self, effect: Effect) -> float:
        """Of what was recorded, given an effect; 0 for one that it says nothing of."""
        if not isinstance(effect, Multipath) or effect.surface != self.surface:
            return 0.0
        mixed = abs(1 + effect.share * cmath.exp(1j * math.pi * effect.extra_path_mm / self.turn_mm))
        away = (self.log_ratio - math.log(max(mixed, 1e-9))) / self.scale
        return float(student.logpdf(away, self.dof) - student.logpdf(0.0, self.dof))


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmUpWitness:
    """The time constant with which the recorded temperature rises, s, and its relative error."""

    time_constant_s: float
    error: float

    def log_density(self, effect: Effect) -> float:
        """Of what was recorded, given an effect; 0 for one that it says nothing of."""
        if not isinstance(effect, TemperatureDrift):
            return 0.0
        away = math.log(effect.time_constant_s / self.time_constant_s) / self.error
        return float(student.logpdf(away, _THERMAL_DOF) - student.logpdf(0.0, _THERMAL_DOF))


Witness = AmplitudeWitness | WarmUpWitness


def log_ratios(model: Model, evidence: Evidence, mixture: Mixture) -> dict[str, float]:
    """Median logarithm of recorded over predicted amplitude of each surface that fills enough pixels by itself.

    Parameters
    ----------
    model : Model
        For its surfaces' names.
    evidence : Evidence
        One recording; without amplitudes there are no ratios.
    mixture : Mixture
        What the model predicts of it.
    """
    if evidence.amplitude is None:
        return {}
    predicted, surface = mixture.of_main(mixture.amplitude), mixture.of_main(mixture.surface)
    known = (evidence.amplitude > 0) & (predicted > 0)
    known &= mixture.of_main(mixture.weight) > _SINGLE * (1 - mixture.invalid[0])
    out = {}
    for number, given in enumerate(model.surfaces):
        own = known & (surface == number)
        if own.sum() < _LEAST_PIXELS:
            continue
        ratio = np.log(evidence.amplitude[own] / predicted[own])
        middle = float(np.median(ratio))
        if float(np.median(np.abs(ratio - middle))) / _MEDIAN_DEVIATION < _ROUGH:
            out[given.name] = middle
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenAmplitude(Effect):
    """Amplitudes of each surface times a factor, for what acts by amplitude after the light has been mixed.

    No effect of a camera, and never written: it stands for reflectivities that the model has wrong.
    """

    kind: ClassVar[str] = "seen_amplitude"
    level: ClassVar[Level] = Level.CORRELATION

    factors: tuple[float, ...]

    @classmethod
    def parameters(cls) -> Mapping[str, Parameter]:
        """None: no model file has it."""
        return {}

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002  the effects' own signature
        """Multiply; ranges and their noise stay."""
        factor = np.array([*self.factors, 1.0])  # the last is for no surface, number -1
        echoes.amplitude = echoes.amplitude * factor[echoes.surface]


def as_bright_as_seen(model: Model, ratios: dict[str, float]) -> Model:
    """The model with each surface as bright, against the others, as it was recorded.

    The unit of recorded amplitudes may be any; it is the model's if one surface's amplitude is right.
    """
    if len(ratios) < _LEAST_OTHERS:
        return model
    own_unit = min(abs(r) for r in ratios.values()) < _OWN_UNIT
    unit = 0.0 if own_unit else float(np.median(list(ratios.values())))
    factors = tuple(math.exp(ratios.get(s.name, unit) - unit) for s in model.surfaces)
    return replace(model, effects=(*model.effects, SeenAmplitude(factors=factors)))


def amplitude_witnesses(ratios: dict[str, float], turn_mm: float) -> list[AmplitudeWitness]:
    """What each surface's amplitude says, where there are others to hold it against."""
    out = []
    for name, ratio in ratios.items():
        others = np.array([r for other, r in ratios.items() if other != name])
        if others.size < _LEAST_OTHERS:
            continue
        dof = _SUPPOSED + others.size - 1
        spread = (_SUPPOSED * _BEST**2 + float(((others - others.mean()) ** 2).sum())) / dof
        scale = math.sqrt(spread * (1 + 1 / others.size))
        above = ratio - float(others.mean())
        out.append(AmplitudeWitness(surface=name, log_ratio=above, scale=scale, dof=dof, turn_mm=turn_mm))
    return out


def warm_up_witness(evidence: Evidence) -> WarmUpWitness | None:
    """The time constant of one recording's temperature, where it rises as in a warm-up.

    Least squares of ``a + b (1 - exp(-t / tau))``.
    """
    if evidence.temperature_c is None or not np.isfinite(evidence.temperature_c).all():
        return None
    now, warm = evidence.time_s, evidence.temperature_c
    duration = max(float(now[-1]), 1e-3)

    def rest(log_tau: float) -> tuple[float, float]:
        law = np.stack([np.ones_like(now), -np.expm1(-now / math.exp(log_tau))], axis=1)
        found = np.linalg.lstsq(law, warm, rcond=None)[0]
        return float(((warm - law @ found) ** 2).sum()), float(found[1] * law[-1, 1])

    bounds = (math.log(duration / 100), math.log(duration * 30))
    grid = np.linspace(*bounds, 40)
    start = grid[int(np.argmin([rest(x)[0] for x in grid]))]
    step = float(grid[1] - grid[0])
    best = float(minimize_scalar(lambda x: rest(x)[0], bounds=(start - step, start + step), method="bounded").x)
    left, rise = rest(best)
    spread = float(((warm - warm.mean()) ** 2).sum())
    if abs(rise) < _LEAST_RISE_K or left > (1 - _SAME_LAW) * spread:
        return None
    curve = (rest(best + 0.1)[0] - 2 * left + rest(best - 0.1)[0]) / 0.01  # of the sum of squares against log tau
    error = math.sqrt(2 * left / max(len(now) - 3, 1) / curve) if curve > 0 else math.inf
    return WarmUpWitness(time_constant_s=math.exp(best), error=math.hypot(error, _LAG)) if error < 1 else None
