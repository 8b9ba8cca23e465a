"""Standard errors, in closed form, of effects that link samples."""

from dataclasses import replace

import numpy as np

from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState
from tofmix.reconciliation.likelihood.memory import fit_memory, memory_error
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.interference import Interference
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.effects.stuck_pixels import StuckPixels
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation

_LIKELY = 0.5  # probability from which a frame counts as disturbed


def latent_errors(
    likelihood: Likelihood, state: ModelState, effect: Effect, seed: int
) -> tuple[Effect, dict[str, float]]:
    """An effect with latent states, fitted to all samples, and the standard errors of its numbers.

    Parameters
    ----------
    likelihood, state
        The refined model, with latent states from all frames.
    effect : Effect
        One of the state's.
    seed : int
        Seed of the draws for quantised samples.
    """
    frames, pixels = likelihood.evidence.shape
    if isinstance(effect, StuckPixels):
        return effect, {}
    if isinstance(effect, Interference):
        return _bursts(likelihood, state, effect)
    if isinstance(effect, TemporalCorrelation):
        everything = np.arange(frames), np.arange(pixels)
        mixture = likelihood.mixture(state)
        z = likelihood.scores(state, everything, seed, mixture)
        refitted = fit_memory(likelihood, z, mixture, everything) or effect
        return refitted, {"coefficient": memory_error(likelihood, z, mixture, everything, refitted.coefficient)}
    if isinstance(effect, Quantisation):
        return effect, {"step_mm": 0.5 * effect.step_mm**2 / likelihood.scene.model.sensor.range_max_mm}
    return effect, {}


def _bursts(likelihood: Likelihood, state: ModelState, effect: Interference) -> tuple[Effect, dict[str, float]]:
    """The share of disturbed frames, with errors from counts and from the curvature."""
    share = float(np.clip(state.disturbed.mean(), 1e-4, 0.99))
    frames = state.disturbed.size
    mixture = likelihood.mixture(state)
    part = np.flatnonzero(state.disturbed > _LIKELY), np.arange(likelihood.evidence.shape[1])
    step = 0.02 * effect.sigma_mm
    bare = replace(state, effects=tuple(e for e in state.effects if e is not effect))

    def value(sigma: float) -> float:
        return likelihood.sums(mixture, bare, part, variance=np.full(frames, sigma**2)).total

    drop = (2 * value(effect.sigma_mm) - value(effect.sigma_mm + step) - value(effect.sigma_mm - step)) / step**2
    bursts = max(frames * share / effect.burst_frames, 1.0)
    errors = {
        "probability": share_error(share, frames / max(2 * effect.burst_frames * (1 - share) - 1, 1.0)),
        "sigma_mm": float(1 / np.sqrt(drop)) if drop > 0 else effect.sigma_mm,
        "burst_frames": float(effect.burst_frames / np.sqrt(bursts)),
    }
    return replace(effect, probability=share), errors


def share_error(share: float, independent: float) -> float:
    """Standard error of a share among so many independent frames; with few frames the share is moved towards one half.

    References
    ----------
    Agresti and Coull, Am. Statistician 52 (1998) 119: two of each sort more.
    """
    nearer = (share * independent + 2) / (independent + 4)
    return float(np.sqrt(nearer * (1 - nearer) / independent))
