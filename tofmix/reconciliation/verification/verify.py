"""Step 5: simulate the refined model with new seeds, and judge the effects.

`floor` is the gap between the refined model and a simulation of it, `before` and `after` are gaps of the recording.
`tofmix.reconciliation.verdict` decides the verdict.

Scores end at four sigma, so a surface that comes 30 mm nearer with each frame looks like a bias of every later frame.
Use `far_trends` to place such a change: something moves through the scene, or the camera does. It takes medians of
ranges, so random values do not matter.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kruskal

from tofmix.arrays import FloatArray
from tofmix.reconciliation.comparison.compare import SMALLEST_P, Compared, Place, compare, disagreements
from tofmix.reconciliation.found import Added
from tofmix.reconciliation.likelihood.hidden_fits import pattern_image
from tofmix.reconciliation.likelihood.hidden_states import begin, latent_states
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import independent, memory_left, memory_of
from tofmix.reconciliation.likelihood.mixture import LINKING, Scene
from tofmix.reconciliation.likelihood.unsteady_way import UnsteadyWay
from tofmix.reconciliation.likelihood.wander import FARTHEST_SCORE
from tofmix.reconciliation.settings import Settings, fit_part, held_out
from tofmix.reconciliation.verdict import VerdictData, judge, share_closed
from tofmix.reconciliation.verification.contradictions import Contradiction, contradictions, smooth, tilted
from tofmix.reconciliation.verification.frame_levels import frame_medians
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.casting.polygon_cast import MovingPolygons
from tofmix.simulation.effects.base import Effect, with_hidden
from tofmix.simulation.effects.hidden import PixelBias, PixelValue
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

_PARTS = 10  # of the time


def far_trends(likelihood: Likelihood, state: ModelState, alpha: float) -> list[Place]:
    """The change in time of each recording whose ranges leave the reach of scores; none for most recordings.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings.
    state : ModelState
        A model: the change is that of the differences from it.
    alpha : float
        Level of the test that parts of the time differ, after correction for the recordings.

    References
    ----------
    Kruskal and Wallis, J. American Statistical Association 47 (1952) 583.
    """
    whole = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    seen = list(views(likelihood, likelihood.mixture(state), whole))
    found = (_far_trend(view, alpha / len(seen)) for view in seen)
    return [place for place in found if place is not None]


def _far_trend(view: RecordingView, alpha: float) -> Place | None:
    found = frame_medians(view)
    medians, frames, sigma = found.level_mm, found.frames, found.sigma_mm
    least_frames = 3  # of a part, for a median with a scatter
    parts = min(_PARTS, medians.size // least_frames)
    if parts < 2:  # noqa: PLR2004  two parts of the time to compare
        return None
    part = np.arange(medians.size) * parts // medians.size
    level = np.array([np.median(medians[part == k]) for k in range(parts)])
    first, last = sorted((int(level.argmin()), int(level.argmax())))
    change = float(level[last] - level[first])
    if abs(change) < FARTHEST_SCORE * sigma:
        return None
    p = float(kruskal(*(medians[part == k] for k in range(parts))).pvalue)
    if not p < alpha:
        return None
    now = view.evidence.time_s[frames]
    return Place(
        axis="time",
        statistic="trend",
        interval=(float(now[part == first][0]), float(now[part == last][-1])),
        size=change,
        unit="mm",
        p_value=max(p, SMALLEST_P),
        z=abs(change) / sigma,
        recording=view.number,
    )


_SEEDS_APART, _SIMULATIONS_APART = 1000, 100_000  # distance between seeds of recordings, and of simulations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verified:
    """The result of the verification.

    Parameters
    ----------
    verdict : str
        ``agree``, ``explained``, ``partly_explained`` or ``unexplained``.
    state : ModelState
        The model that is written, without effects that do not explain the recording.
    start : ModelState
        The model as given.
    before, after, floor : Compared
        Panels of the model as given, of the refined one, and of a simulation of it.
    findings : Findings
        The data of the verdict.
    against : tuple of Contradiction
        Evidence against single effects, which would otherwise have been named.
    """

    verdict: str
    state: ModelState
    start: ModelState
    before: Compared
    after: Compared
    floor: Compared
    findings: VerdictData
    against: tuple[Contradiction, ...] = ()

    @property
    def law(self) -> str | None:
        """Axis of a smooth law that fits better than the found effects; None without one."""
        return self.findings.law

    @property
    def own(self) -> Effect | None:
        """The model's own effect with other numbers, if it fits better than the found effects."""
        return self.findings.own

    @property
    def closed(self) -> float | None:
        """Share of the gap that is closed; None if there is no gap beyond noise."""
        return share_closed(self.before, self.after, self.floor)


def verify(likelihood: Likelihood, added: Added, settings: Settings, own: Effect | None = None) -> Verified:
    """Judge the added effects.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    added : Added
        The outcome of the search.
    own : Effect, optional
        The model's own effect with other numbers, if it is better than the added effects.
    """
    held = held_out(likelihood, settings)
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.accepted(likelihood))
    before = compare(likelihood, start, held, seed=settings.seed)
    after = compare(likelihood, added.state, held, seed=settings.seed) if added.chosen else before
    floor = simulated(likelihood, added.state, settings)
    part = likelihood.evidence.part(fit=False, split=settings.split)
    found = VerdictData(
        chosen=added.chosen,
        before=before,
        after=after,
        floor=floor,
        near=added.panel,
        alpha=settings.alpha,
        samples=int((likelihood.evidence.samples[held[0]][:, held[1]] > 0).sum()),
        frames=likelihood.evidence.shape[0],
        independent=independent(likelihood, added.state, settings.alpha, settings.seed),
        judged=len(held[0]) * len(held[1]) / max(len(part[0]) * len(part[1]), 1),
        law=added.law,
        faint_law=added.faint_law,
        changed=bool(likelihood.evidence.changed),
        own=own,
        bound=any(c.at_a_bound for c in added.chosen),
        echo=_echoes(likelihood, added.state, settings),
        shaped=_shaped(likelihood, added.state, held),
    )
    # Gains of exact laws do not limit the remaining deviation
    gain = sum(c.gain for c in added.chosen if not (c.exact or c.loses))
    found = replace(found, nulls=_nulls(likelihood, added.state, settings, found))
    found = replace(found, in_time=changes_in_time(added.state, found, found.judged * gain))
    against = contradictions(likelihood, added, settings) if judge(found) in ("explained", "partly_explained") else ()
    far = tuple(far_trends(likelihood, added.state, settings.alpha)) if added.chosen else ()
    found = replace(found, contradicted=bool(against or far))
    verdict = judge(found)
    out = Verified(
        verdict=verdict,
        state=added.state,
        start=start,
        before=before,
        after=after,
        floor=floor,
        findings=found,
        against=against,
    )
    return revoked(likelihood, out, settings) if added.chosen and verdict in ("agree", "unexplained") else out


def _nulls(likelihood: Likelihood, state: ModelState, settings: Settings, found: VerdictData) -> tuple[Compared, ...]:
    """Simulations of the refined model: several if the first one also shows a deviation of the recording.

    Several too if hidden states link samples, because simulations then differ from each other.
    """
    loud = disagreements(found.near, found.alpha)
    linked = any(e.latent in LINKING for e in state.linking)
    several = bool(loud) and (linked or any(found.is_simulated(c) for c in loud))
    nulls = 3  # simulations, if one is not enough
    more = range(1, nulls) if several else range(0)
    return (found.floor, *(simulated(likelihood, state, settings, number) for number in more))


def revoked(likelihood: Likelihood, found: Verified, settings: Settings) -> Verified:
    """The verification without effects: the model as given."""
    start = begin(likelihood, fit_part(likelihood, settings)[0], settings.accepted(likelihood))
    return replace(found, state=start, after=found.before, floor=simulated(likelihood, start, settings))


def _echoes(likelihood: Likelihood, state: ModelState, settings: Settings) -> bool:
    """Whether a correlation at any lag remains after a memory of one frame."""
    coefficient = memory_of(state)
    echo = 0.1  # correlation at any lag that may remain after a memory of one frame
    return bool(coefficient) and memory_left(likelihood, state, coefficient, settings.seed) > echo


def _shaped(likelihood: Likelihood, state: ModelState, held: Part) -> bool:
    """Whether a pattern of pixels is a smooth law of place."""
    known = (state.pixel_variance > 0).reshape(likelihood.evidence.image)
    maps = [m for e, hidden in with_hidden(state.effects, PixelBias) if (m := hidden.map_of(e)) is not None]
    if not maps or not known.any():
        return False
    mixture = likelihood.mixture(state)
    surfaces = [v.mixture.of_main(v.mixture.surface).reshape(known.shape) for v in views(likelihood, mixture, held)]
    values = [m.values.astype(np.float64) for m in maps]
    return any(smooth(v, known) or any(tilted(v, known, s) for s in surfaces) for v in values)


def changes_in_time(state: ModelState, found: VerdictData, gain: float) -> bool:
    """Whether means of frames or pixels still change in time; laws in time are exact, so another cause remains.

    If frames are disturbed, or noise has a memory, these means change for that reason, and the answer is no.

    Parameters
    ----------
    state : ModelState
        The refined model.
    found : Findings
        Its panels.
    gain : float
        Gain of its effects on the judged samples, nats.
    """
    if state.bursts is not None or memory_of(state):
        return False
    loud = disagreements(found.near, found.alpha)
    left = (found.left(c) for c in loud if (c.statistic, c.axis) in (("trend", "time"), ("common_mode", "frame")))
    # Frames are correlated if a bias is constant, which also shows in the biases, or if it changes slowly
    same, stays = (
        max((found.left(c) for c in loud if c.statistic in some), default=0.0)
        for some in (("memory",), ("bias", "pattern"))
    )
    in_time = 0.005  # share of the effects' gain that may remain as a change of all frames in time
    return max(left, default=0.0) > in_time * gain or same > max(in_time * gain, stays)


def refined_model(scene: Scene, state: ModelState) -> Model:
    """The model of a scene with the effects of a state that act in it, and a measured scene as it is beside them."""
    effects: tuple[Effect, ...] = (*scene.model.effects, *scene.own(state.effects))
    rest = None if state.way is None else state.way.rest
    return replace(scene.model, effects=effects, scene=scene.measured_at_rest(effects, rest))


def simulated(likelihood: Likelihood, state: ModelState, settings: Settings, number: int = 0) -> Compared:
    """Panel of a simulation of a model. Its hidden states are estimated from the simulation, as from a recording.

    Parameters
    ----------
    likelihood, state, settings
        The recording, its effects, and the options.
    number : int
        Number of the simulation; each has another seed.
    """
    evidence = likelihood.evidence
    samples = np.empty_like(evidence.samples)
    first = settings.seed + 1 + _SIMULATIONS_APART * number
    for k, (frames, scene) in enumerate(zip(evidence.recordings, likelihood.scene.members, strict=True)):
        model = _as_recorded(_as_found(refined_model(scene, state), state), evidence.time_s[frames])
        begun = round(float(evidence.time_s[frames.start]) * model.recording.frame_rate_hz)
        samples[frames] = simulate_like(model, frames.stop - frames.start, seed=first + _SEEDS_APART * k, begun=begun)
    again = Likelihood(replace(evidence, samples=samples), likelihood.scene)
    # A simulation draws its own widths
    none = np.zeros_like(state.log_width)
    rest = None if state.way is None else state.way.rest
    steady = None if rest is None else UnsteadyWay(np.zeros(len(samples)), rest=rest)
    alike = replace(state, way=steady, log_width=none, log_width_error=none)
    found = latent_states(again, alike, fit_part(likelihood, settings)[0])
    return compare(again, found, held_out(likelihood, settings), seed=first)


def _as_recorded(model: Model, time_s: FloatArray) -> Model:
    """The model at the recording's own frame rate."""
    duration = float(time_s[-1] - time_s[0])
    if duration <= 0:
        return model
    return replace(model, recording=replace(model.recording, frame_rate_hz=(time_s.size - 1) / duration))


def _as_found(model: Model, state: ModelState) -> Model:
    """The model with maps from the recording instead of patterns that are drawn from a seed."""
    image = model.sensor.rows, model.sensor.cols

    def found(effect: Effect) -> Effect:
        hidden = effect.hidden
        if isinstance(hidden, PixelBias) and hidden.map_of(effect) is None:
            return hidden.with_map(effect, pattern_image(state.pixel_bias, image))
        if isinstance(hidden, PixelValue) and hidden.map_of(effect) is None:
            return hidden.with_map(effect, state.stuck_mm.reshape(image).astype(np.float32))
        return effect

    return replace(model, effects=tuple(found(e) for e in model.effects))


def simulate_like(model: Model, frames: int, *, seed: int, begun: int = 0) -> NDArray[np.uint16]:
    """Samples (frame, pixel) of a model from frame `begun` on, as `Evidence` holds them."""
    pixels = model.sensor.rows * model.sensor.cols
    samples = np.empty((begun + frames, pixels), dtype=np.uint16)
    caster = None if model.scene is not None else MovingPolygons(model)
    truth = cast_scene(model)
    for block in render_blocks(model, truth, n_frames=begun + frames, seed=seed, threads=2, caster=caster):
        samples[block.start : block.stop] = block.range_mm.reshape(-1, pixels)
    return samples[begun:]
