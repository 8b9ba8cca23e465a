"""Information of a recording's amplitudes and temperatures about an effect, in addition to ranges.

Use `amplitude_information` and `warm_up_information` for the terms of `Likelihood.objective`, and `as_bright_as_seen`
for a model in which laws of amplitude use recorded amplitudes. They affect parameters, never names: held-out gains are
of ranges alone.

The information depends on the accuracy of the model's amplitudes, or on the position of the thermometer. The accuracy
of amplitudes is estimated from the recording, by the deviations of its other surfaces from the model.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from tofmix.reconciliation.evidence import LEAST_PIXELS, Evidence
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level
from tofmix.simulation.effects.parameter import Parameter
from tofmix.simulation.model import Model

_SINGLE = 0.9  # weight of a pixel's main surface
_ROUGH = 0.3  # largest scatter of a surface's log ratios; above, its amplitudes follow another law
_MEDIAN_DEVIATION = round(NormalDist().inv_cdf(0.75), 4)
"""Median absolute deviation of a standard Gaussian, Phi^-1(3/4), to four decimals."""

_OWN_UNIT = 0.02  # log ratio: if a surface is right to this, the unit of amplitudes is the model's
_BEST = 0.002  # log ratio: prior scatter of a model's amplitudes,
_SUPPOSED = 2  # with the weight of so many surfaces
_LEAST_OTHERS = 2  # least number of other surfaces
_LEAST_RISE_K = 0.5  # least rise of the temperature
_SAME_LAW = 0.9  # of the temperature's variance that a warm-up must explain
_LAG = 0.03  # relative difference between the drifting part and the measured one
_THERMAL_DOF = 4  # of Student's t: another time constant is weak evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeInformation:
    """Logarithm of recorded over predicted amplitude of one surface, relative to the other surfaces.

    Parameters
    ----------
    surface : str
        The surface.
    log_ratio : float
        The logarithm minus the mean of the others.
    scale, dof : float
        Of its Student's t distribution if no effect acts on this surface alone.
    turn_mm : float
        d_u.
    """

    surface: str
    log_ratio: float
    scale: float
    dof: float
    turn_mm: float

    def log_density(self, effect: Effect) -> float:
        """Log density of the observation, given an effect; 0 if the observation does not depend on it."""
        factor = self._factor(effect)
        if factor is None:
            return 0.0
        away = (self.log_ratio - math.log(max(factor, 1e-9))) / self.scale
        return float(student.logpdf(away, self.dof) - student.logpdf(0.0, self.dof))

    def log_odds(self, effect: Effect) -> float:
        """Log density of the observation with an effect, less that without it."""
        if self._factor(effect) is None:
            return 0.0
        none = float(student.logpdf(self.log_ratio / self.scale, self.dof) - student.logpdf(0.0, self.dof))
        return self.log_density(effect) - none

    def _factor(self, effect: Effect) -> float | None:
        """Factor on the surface's amplitude; None if the effect does not act on it alone."""
        return effect.amplitude_factor(self.turn_mm) if getattr(effect, "surface", None) == self.surface else None


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmUpInformation:
    """The time constant of the recorded temperature, s, and its relative error."""

    time_constant_s: float
    error: float

    def log_density(self, effect: Effect) -> float:
        """Log density of the observation, given an effect; 0 if the observation does not depend on it."""
        if effect.warm_up_s is None:
            return 0.0
        away = math.log(effect.warm_up_s / self.time_constant_s) / self.error
        return float(student.logpdf(away, _THERMAL_DOF) - student.logpdf(0.0, _THERMAL_DOF))

    def log_odds(self, effect: Effect) -> float:  # noqa: ARG002  as of amplitudes
        """0: a temperature that rises does not show that ranges drift."""
        return 0.0


SideInformation = AmplitudeInformation | WarmUpInformation


def log_ratios(model: Model, evidence: Evidence, mixture: Mixture) -> dict[str, float]:
    """Median logarithm of recorded over predicted amplitude of each surface that fills enough pixels by itself.

    Parameters
    ----------
    model : Model
        The model, for the names of its surfaces.
    evidence : Evidence
        One recording; without amplitudes there are no ratios.
    mixture : Mixture
        The prediction of the model.
    """
    if evidence.amplitude is None:
        return {}
    predicted, surface = mixture.of_main(mixture.amplitude), mixture.of_main(mixture.surface)
    known = (evidence.amplitude > 0) & (predicted > 0)
    known &= mixture.of_main(mixture.weight) > _SINGLE * (1 - mixture.invalid[0])
    out = {}
    for number, given in enumerate(model.surfaces):
        own = known & (surface == number)
        if own.sum() < LEAST_PIXELS:
            continue
        ratio = np.log(evidence.amplitude[own] / predicted[own])
        middle = float(np.median(ratio))
        if float(np.median(np.abs(ratio - middle))) / _MEDIAN_DEVIATION < _ROUGH:
            out[given.name] = middle
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenAmplitude(Effect):
    """Multiply the amplitudes of each surface by a factor, for effects that depend on amplitude after mixing.

    It is no effect of a camera and is never written: it corrects wrong reflectivities of the model.
    """

    kind: ClassVar[str] = "seen_amplitude"
    level: ClassVar[Level] = Level.CORRELATION

    factors: tuple[float, ...]

    @classmethod
    def parameters(cls) -> Mapping[str, Parameter]:
        """None: no model file has it."""
        return {}

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002  the effects' own signature
        """Multiply amplitudes; ranges and their noise do not change."""
        factor = np.array([*self.factors, 1.0])  # the last is for number -1, no surface
        echoes.amplitude = echoes.amplitude * factor[echoes.surface]


def as_bright_as_seen(model: Model, ratios: dict[str, float]) -> Model:
    """The model with the recorded brightness of each surface, relative to the others.

    Recorded amplitudes may have any unit. If the amplitude of one surface is right, the unit is the model's.
    """
    if len(ratios) < _LEAST_OTHERS:
        return model
    own_unit = min(abs(r) for r in ratios.values()) < _OWN_UNIT
    unit = 0.0 if own_unit else float(np.median(list(ratios.values())))
    factors = tuple(math.exp(ratios.get(s.name, unit) - unit) for s in model.surfaces)
    return replace(model, effects=(*model.effects, SeenAmplitude(factors=factors)))


def amplitude_information(ratios: dict[str, float], turn_mm: float) -> list[AmplitudeInformation]:
    """The information of each surface's amplitude, if there are enough other surfaces."""
    out = []
    for name, ratio in ratios.items():
        others = np.array([r for other, r in ratios.items() if other != name])
        if others.size < _LEAST_OTHERS:
            continue
        dof = _SUPPOSED + others.size - 1
        spread = (_SUPPOSED * _BEST**2 + float(((others - others.mean()) ** 2).sum())) / dof
        scale = math.sqrt(spread * (1 + 1 / others.size))
        above = ratio - float(others.mean())
        out.append(AmplitudeInformation(surface=name, log_ratio=above, scale=scale, dof=dof, turn_mm=turn_mm))
    return out


def warm_up_information(evidence: Evidence) -> WarmUpInformation | None:
    """The time constant of one recording's temperature, if it rises as in a warm-up.

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
    return WarmUpInformation(time_constant_s=math.exp(best), error=math.hypot(error, _LAG)) if error < 1 else None
