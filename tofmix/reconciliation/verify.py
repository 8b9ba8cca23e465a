"""Step 5: simulate the refined model with fresh seeds, and say what the effects explain.

`floor` is the gap of two simulations of the refined model that differ in their seed, `before` and `after` that of
the recording. The verdict weighs what the effects gained against the largest disagreement that is left.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.reconciliation import links
from tofmix.reconciliation.add import Added
from tofmix.reconciliation.beside import settled_within
from tofmix.reconciliation.compare import Compared, compare
from tofmix.reconciliation.joint import views
from tofmix.reconciliation.likelihood import Likelihood, State
from tofmix.reconciliation.localise import disagreements
from tofmix.reconciliation.memory import memory_left, memory_of
from tofmix.reconciliation.mixture import Scene
from tofmix.reconciliation.nameless import better_law
from tofmix.reconciliation.panel import Curve
from tofmix.reconciliation.pattern_shape import smooth, tilted
from tofmix.reconciliation.refit import begin
from tofmix.reconciliation.way import EXACT, LOST, Settings, fit_part, held_out
from tofmix.reconciliation.widths import with_widths
from tofmix.simulation.cast import cast_scene
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.effects.stuck_pixels import StuckPixels
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

EXPLAINED = 0.9
"""Share of gain and largest remaining disagreement that the gain must be."""

CLOSED = 0.8
"""Share of the panel's gap that the effects must close, unless what is left is within chance and tolerance."""

SIGNATURES: dict[str, tuple[str, ...]] = {
    "range_offset": ("bias", "trend", "common_mode"),
    "surface_pose": ("bias", "trend", "common_mode"),
    "wiggling": ("bias", "pattern"),
    "amplitude_walk": ("bias", "pattern"),
    "scattering": ("bias", "pattern"),
    "multipath": ("bias", "pattern", "spread"),
    "fixed_pattern": ("bias", "pattern"),
    "temperature_drift": ("trend", "common_mode"),
    "motion": ("trend", "common_mode"),
    "interference": ("bursts", "common_mode", "spread"),
    "temporal_correlation": ("memory", "neighbour_correlation", "common_mode"),
    "excess_noise": ("spread", "tails", "skew", "spread_pattern", "memory"),
    "vignetting": ("spread", "tails", "skew", "spread_pattern", "memory"),
    "outliers": ("tails", "skew", "spread", "memory"),
    "flying_pixels": ("bias", "skew", "spread", "bridging"),
    "pixel_crosstalk": ("bias", "spread", "bridging"),
    "dropout": ("invalid",),
    "saturation": ("invalid",),
    "quantisation": ("discreteness",),
}
"""The statistics in which each kind must show, so that none of them is left open where it is named."""

OPEN = 0.03
"""Share of an effect's gain that may be left in its own statistics: no law of ours is exact."""

IN_TIME = 0.005
"""Share of what the effects gained that may be left of a change of all frames in time."""

ECHO = 0.1
"""Correlation, at any lag, that a memory of one frame may leave."""

_FEW = 0.1
_SEEDS_APART = 1000
_SIMULATED = 0.1
_WITHIN_CHANCE = 0.15  # of a gap
_SANE = 1.5  # times chance, which the refined model's own simulation may be from it, where the recording is no further
_SETTLED, _UNTOUCHED = 0.97, 0.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verified:
    """What verification says.

    Parameters
    ----------
    verdict : str
        ``agree``, ``explained``, ``partly_explained`` or ``unexplained``.
    state : State
        The model that is written: without effects that do not explain.
    before, after, floor : Compared
        Panels of the model as given, of the refined one, and of a simulation of it.
    gain : float
        Held-out gain of all effects, nats.
    left : float
        The largest disagreement that is left, nats.
    law : str or None
        Of what a smooth law, which no effect is, fits better than the effects that were found.
    own : Effect or None
        The model's own effect with other numbers, which fits better than the effects that were found.
    """

    verdict: str
    state: State
    before: Compared
    after: Compared
    floor: Compared
    gain: float
    left: float
    law: str | None = None
    own: Effect | None = None

    @property
    def closed(self) -> float | None:
        """Share of the gap that is closed; None where there is none beyond chance."""
        room = self.before.gap - self.floor.gap
        return None if room < _WITHIN_CHANCE else (self.before.gap - self.after.gap) / room


def verify(likelihood: Likelihood, added: Added, settings: Settings) -> Verified:
    """Judge what was added.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    added : Added
        The outcome of the search.
    settings : Settings
        How.
    """
    held = held_out(likelihood, settings)
    likelihood.scene.anchor(())  # edges where the model as given has them, not where a pose put them
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.tolerance)
    before = compare(likelihood, start, held, seed=settings.seed)
    likelihood.scene.anchor(added.state.effects)
    after = compare(likelihood, added.state, held, seed=settings.seed) if added.chosen else before
    floor = _floor(likelihood, added.state, settings)
    loud = _beyond(disagreements(added.panel, settings.alpha), floor)
    left = max((_weight(c, floor) for c in loud), default=0.0)
    scale = _scale(likelihood, settings)
    gain = scale * _gain(added, lost=True)
    parts = fit_part(likelihood, settings), held
    law = better_law(likelihood, added.state, added.chosen, parts, settings.tolerance)
    signed = law is None and _signed(likelihood, added, floor, settings)
    enough = _outweighs(added, loud, floor, scale) and _closes_tolerably(
        likelihood, added, (before, after, floor), settings
    )
    sane = floor.gap <= max(before.gap, _SANE)
    verdict = _verdict(added, before, loud, enough=enough, signed=signed and sane)
    if verdict == "explained" and changes_in_time(added.state, loud, floor, scale * _gain(added, lost=False)):
        verdict = "partly_explained"
    found = Verified(
        verdict=verdict, state=added.state, before=before, after=after, floor=floor, gain=gain, left=left, law=law
    )
    return revoked(likelihood, found, settings) if added.chosen and verdict in ("agree", "unexplained") else found


def revoked(likelihood: Likelihood, found: Verified, settings: Settings) -> Verified:
    """What verification says where no effect stands: the model as given."""
    likelihood.scene.anchor(())
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.tolerance)
    likelihood.scene.anchor(start.effects)
    return replace(found, state=start, after=found.before, floor=_floor(likelihood, start, settings))


def _beyond(loud: list[Curve], floor: Compared) -> list[Curve]:
    """Curves that stand above what a simulation of the model itself shows, where its prediction is an approximation."""
    return [c for c in loud if _weight(c, floor) > _SIMULATED * c.excess_nats]


def _gain(added: Added, *, lost: bool) -> float:
    """Gains by candidates, which count latent states and memory too; with or without those of lost samples.

    Without those of exact laws, which are no measure of what is left.
    """
    return sum(c.gain for c in added.chosen if c.kind not in EXACT and (lost or c.kind not in LOST))


def _scale(likelihood: Likelihood, settings: Settings) -> float:
    """How many times the part that candidates were scored on is in all that is held out."""
    part = likelihood.evidence.part(fit=False, split=settings.split)
    held = held_out(likelihood, settings)
    return len(held[0]) * len(held[1]) / max(len(part[0]) * len(part[1]), 1)


def _outweighs(added: Added, loud: list[Curve], floor: Compared, scale: float) -> bool:
    """Whether effects gained far more than what is left: those that lose samples of lost ones, the others of ranges."""
    for lost in (True, False):
        left = max((_weight(c, floor) for c in loud if (c.statistic == "invalid") == lost), default=0.0)
        gain = scale * _gain(added, lost=lost)
        if left and gain < EXPLAINED * (gain + left):
            return False
    return True


def _weight(curve: Curve, floor: Compared) -> float:
    """What a curve that is left counts for, nats.

    What a simulation shows too is the prediction's fault, not the model's; third and fourth powers of single pixels
    hang on few samples.
    """
    few = curve.statistic in ("skew_pattern", "tails_pattern")
    own = {c.name: c.excess_nats for c in floor.curves}.get(curve.name, 0.0)
    return max(curve.excess_nats - max(own, 0.0), 0.0) * (_FEW if few else 1.0)


def _signed(likelihood: Likelihood, added: Added, floor: Compared, settings: Settings) -> bool:
    """Whether no effect leaves the statistic open in which it must show, or has numbers that make it another one."""
    scale = _scale(likelihood, settings)
    loud = disagreements(added.panel, settings.alpha)
    for candidate in added.chosen:
        if candidate.fitted is not None and candidate.fitted.at_a_bound:
            return False
        own = SIGNATURES.get(candidate.kind, ())
        open_ = max((_weight(c, floor) for c in loud if c.statistic in own), default=0.0)
        if open_ > OPEN * scale * candidate.gain:
            return False
    coefficient = memory_of(added.state)
    if coefficient and memory_left(likelihood, added.state, coefficient, settings.seed) > ECHO:
        return False
    known = (added.state.pixel_variance > 0).reshape(likelihood.evidence.image)
    maps = [e.map for e in added.state.effects if isinstance(e, FixedPattern) and e.map is not None]
    if not maps or not known.any():
        return True
    mixture = likelihood.mixture(added.state)
    held = held_out(likelihood, settings)
    surfaces = [v.mixture.of_main(v.mixture.surface).reshape(known.shape) for v in views(likelihood, mixture, held)]
    values = [m.values.astype(np.float64) for m in maps]
    return not any(smooth(v, known) or any(tilted(v, known, s) for s in surfaces) for v in values)


def changes_in_time(state: State, loud: list[Curve], floor: Compared, gain: float) -> bool:
    """Whether means of frames or pixels still change in time: laws in time are exact, so that something else is there.

    Where frames are disturbed, or noise has a memory, these means have that in them.
    """
    if state.bursts is not None or memory_of(state):
        return False
    left = (_weight(c, floor) for c in loud if (c.statistic, c.axis) in (("trend", "time"), ("common_mode", "frame")))
    # One frame is like the next where a bias stays, which shows in the biases, and where it slowly changes
    same, stays = (
        max((_weight(c, floor) for c in loud if c.statistic in some), default=0.0)
        for some in (("memory",), ("bias", "pattern"))
    )
    return max(left, default=0.0) > IN_TIME * gain or same > max(IN_TIME * gain, stays)


def _closes_tolerably(
    likelihood: Likelihood, added: Added, panels: tuple[Compared, Compared, Compared], settings: Settings
) -> bool:
    """Whether the refined model, or one within the tolerance of it, closes most of the gap; over all pixels."""
    before, after, floor = panels
    if _closes(before, after, floor):
        return True
    held = held_out(likelihood, settings)
    near = settled_within(likelihood, added.state, added.chosen, held, settings.tolerance)
    return _closes(before, compare(likelihood, near, held, seed=settings.seed), floor)


def _closes(before: Compared, after: Compared, floor: Compared) -> bool:
    """Whether a refined model closes most of the gap above chance."""
    chance = max(floor.gap, 1.0)
    return after.gap - chance <= (1 - CLOSED) * max(before.gap - chance, _WITHIN_CHANCE)


def _verdict(added: Added, before: Compared, loud: list[Curve], *, enough: bool, signed: bool) -> str:
    if not added.chosen:
        return "unexplained" if loud else "agree"
    if signed and enough:
        return "explained"
    sure = not loud or any(c.kind in EXACT for c in added.chosen) or _settled(added, before, loud)
    return "partly_explained" if signed and sure else "unexplained"


def _settled(added: Added, before: Compared, loud: list[Curve]) -> bool:
    """Whether what is left stands on other curves than what was explained, and was there before."""
    was = {c.name: c.excess_nats for c in before.curves}
    now = {c.name: c.excess_nats for c in added.panel.curves}
    top = max(was, key=lambda name: was[name])
    settled = now.get(top, 0.0) < (1 - _SETTLED) * was[top]
    return settled and all(c.excess_nats > _UNTOUCHED * was.get(c.name, 0.0) for c in loud[:3])


def refined_model(scene: Scene, state: State) -> Model:
    """A scene's model with those of a state's effects that act in it."""
    effects: tuple[Effect, ...] = (*scene.model.effects, *scene.own(state.effects))
    return replace(scene.model, effects=effects)


def _floor(likelihood: Likelihood, state: State, settings: Settings) -> Compared:
    evidence = likelihood.evidence
    samples = np.empty_like(evidence.samples)
    for number, (frames, scene) in enumerate(zip(evidence.recordings, likelihood.scene.members, strict=True)):
        seed = settings.seed + 1 + _SEEDS_APART * number
        model = _as_recorded(_as_found(refined_model(scene, state), state), evidence.time_s[frames])
        samples[frames] = simulate_like(model, frames.stop - frames.start, seed=seed)
    again = Likelihood(replace(evidence, samples=samples), likelihood.scene)
    if state.bursts is not None:
        mixture = likelihood.mixture(state)
        state = replace(state, disturbed=links.disturbed_frames(again, mixture, state, state.bursts))
    alike = replace(state, log_width=np.zeros_like(state.log_width), log_width_error=np.zeros_like(state.log_width))
    state = with_widths(again, alike, fit_part(likelihood, settings)[0])  # a simulation draws its own
    return compare(again, state, held_out(likelihood, settings), seed=settings.seed + 1)


def _as_recorded(model: Model, time_s: FloatArray) -> Model:
    """The model at the recording's own frame rate."""
    duration = float(time_s[-1] - time_s[0])
    if duration <= 0:
        return model
    return replace(model, recording=replace(model.recording, frame_rate_hz=(time_s.size - 1) / duration))


def _as_found(model: Model, state: State) -> Model:
    """The model with maps that were found in the recording, where it says only what is drawn from a seed."""
    image = model.sensor.rows, model.sensor.cols

    def found(effect: Effect) -> Effect:
        if isinstance(effect, FixedPattern) and effect.map is None:
            return links.with_map(effect, state.pixel_bias, image)
        if isinstance(effect, StuckPixels) and effect.map is None:
            return replace(effect, map=PixelMap("stuck_pixels.npy", state.stuck_mm.reshape(image).astype(np.float32)))
        return effect

    return replace(model, effects=tuple(found(e) for e in model.effects))


def simulate_like(model: Model, frames: int, *, seed: int) -> NDArray[np.uint16]:
    """Samples (frame, pixel) of a model, as `Evidence` holds them."""
    pixels = model.sensor.rows * model.sensor.cols
    samples = np.empty((frames, pixels), dtype=np.uint16)
    for block in render_blocks(model, cast_scene(model), n_frames=frames, seed=seed, threads=2):
        samples[block.start : block.stop] = block.range_mm.reshape(-1, pixels)
    return samples
