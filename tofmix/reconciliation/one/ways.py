"""The unsteady ways of surfaces that move, in a set of effects: found from samples, and integrated out.

`fitted_way` finds the course and the power of the noise beside given numbers of the effects, `way_nats` integrates the
course out of the log-likelihood for other numbers nearby.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from tofmix.arrays import FloatArray, IntArray
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.likelihood.memory import memory_of
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.unsteady_way import (
    PARTS,
    POWER_SPREAD,
    USUAL_POWER,
    Course,
    UnsteadyWay,
    course,
)
from tofmix.reconciliation.one.recordings import SearchTask


def fitted_way(task: SearchTask, state: ModelState, bias_mm: FloatArray) -> UnsteadyWay | None:
    """The unsteady way beside a state's effects, with its path; None where nothing moves.

    Parameters
    ----------
    task, state
        The recordings, and the model. The search begins at the state's own way, if it has one.
    bias_mm : (recording, pixel) float64
        Biases about which samples are taken.
    """
    like, turns = task.likelihood, 3
    mixture = like.scene.mixture(state.effects)
    if not mixture.rate.any():
        return None
    speeds = [mixture.of_frames(r.view.frames).typical_speed for r in task.recordings]
    if state.way is None:
        state = replace(state, way=UnsteadyWay(_first_course(task, mixture)))
    error = 0.0
    for turn in range(turns):
        if turn == 1:
            state = _with_power(task, _with_rest(task, state, bias_mm), bias_mm)
        mixture = like.mixture(state)
        ahead, error = np.zeros(mixture.since.size), 0.0
        for number, (recording, speed) in enumerate(zip(task.recordings, speeds, strict=True)):
            found = _course(task, number, state, mixture, bias_mm[number])
            if found is not None:
                ahead[recording.view.frames] = found.ahead_mm / speed
                error = max(error, math.sqrt(found.speed_variance) / abs(speed))
        now = UnsteadyWay(ahead) if state.way is None else state.way
        state = replace(state, way=now._replace(ahead_s=ahead, path_mm=None, speed_error=error))
    return None if state.way is None else _with_path(task, state.way, speeds)


def _with_path(task: SearchTask, way: UnsteadyWay, speeds: Sequence[float]) -> UnsteadyWay:
    path = np.zeros(way.ahead_s.size)
    for recording, speed in zip(task.recordings, speeds, strict=True):
        frames = recording.view.frames
        path[frames] = speed * (task.likelihood.evidence.time_s + way.ahead_s)[frames]
    return way._replace(path_mm=path)


def steadied(task: SearchTask, state: ModelState) -> ModelState:
    """The state with a way that changes with the speed of what moves, not with a path."""
    way = state.way
    if way is None or way.path_mm is None:
        return state
    mixture, ahead = task.likelihood.scene.mixture(state.effects), np.zeros(way.ahead_s.size)
    for recording in task.recordings:
        frames = recording.view.frames
        speed = mixture.of_frames(frames).typical_speed
        if speed:
            ahead[frames] = way.ahead_at(speed, task.likelihood.evidence.time_s)[frames]
    return replace(state, way=way._replace(ahead_s=ahead, path_mm=None))


def way_nats(task: SearchTask, state: ModelState, mixture: Mixture, bias_mm: FloatArray) -> float:
    """What the unevenness of ways changes in the log-likelihood, nats; `bias_mm` (recording, pixel) as above."""
    if state.way is None or not mixture.rate.any():
        return 0.0
    total = -0.5 * ((state.way.noise_power - USUAL_POWER) / POWER_SPREAD) ** 2 if state.way.noise_power else 0.0
    if state.way.rest is not None:
        moved = int((mixture.of_main(mixture.rate) != 0).sum())
        total -= 0.5 * math.log(2.0 * task.part[0].size * moved)  # the volume of a width that so many samples tell
    for number in range(len(task.recordings)):
        found = _course(task, number, state, mixture, bias_mm[number])
        total += 0.0 if found is None else found.nats
    return total + _lost_nats(task, mixture)


def _lost_nats(task: SearchTask, mixture: Mixture) -> float:
    """What unknown shares of lost samples change in the log-likelihood about those that are seen, nats."""
    beyond = task.likelihood.beyond(mixture)
    return sum(part.nats for part in task.likelihood.lost_in_parts(mixture, beyond)) if beyond.any() else 0.0


def _course(task: SearchTask, number: int, state: ModelState, mixture: Mixture, bias: FloatArray) -> Course | None:
    """The course of a recording; None where nothing moves in it."""
    recording = task.recordings[number]
    own, frames = mixture.of_frames(recording.view.frames), recording.view.frames
    speed, time_s = own.typical_speed, recording.view.evidence.time_s
    way_mm = abs(speed) * float(time_s[-1] - time_s[0])
    if not way_mm or state.way is None:
        return None
    nudge = 0.3  # of sigma, for slopes along the way
    step = nudge * float(np.median(own.of_main(own.sigma)[own.of_main(own.rate) != 0]))
    task.passes += 2
    part = recording.part[0], np.intersect1d(recording.part[1], _moving(own))  # others are the same on both sides
    below, above = (
        task.likelihood.sums(replace(mixture, since=mixture.since + ahead_mm / speed), state, part, bias=bias).by_frame[
            part[0], 0
        ]
        for ahead_mm in (-step, step)
    )
    memory = memory_of(state)
    worth = (1.0 - memory) / (1.0 + memory)
    slope = (above - below) / (2 * step) * worth
    information = _usual_information(own, recording.view.evidence.samples, speed) * worth
    here = state.way.ahead_at(speed, task.likelihood.evidence.time_s)[frames] * speed
    return course(here, slope, information, time_s, way_mm)


def _moving(mixture: Mixture) -> IntArray:
    """Pixels that see something move."""
    return np.flatnonzero((mixture.rate != 0).any(axis=(0, 1)))


def _usual_information(own: Mixture, samples: NDArray[np.uint16], speed: float) -> FloatArray:
    """Information (frame,) about the course, 1/mm2, of samples that lie where they are predicted."""
    moving = np.flatnonzero(own.of_main(own.rate) != 0)
    at = own.key[:, None], own.main[moving], moving
    told = (own.rate[at] / speed / own.sigma[at]) ** 2 * own.weight[at]
    told = np.where((samples[:, moving] > 0) & np.isfinite(told), told, 0.0)
    return np.asarray(told.sum(axis=1))


def _first_course(task: SearchTask, mixture: Mixture) -> FloatArray:
    """By how much what moves is ahead of its way in each frame, by medians, s."""
    out = np.zeros(task.part[0].size)
    for recording in task.recordings:
        own = mixture.of_frames(recording.view.frames)
        rate = own.of_main(own.rate)
        moving = np.flatnonzero(rate != 0)
        if not moving.size:
            continue
        samples = recording.view.evidence.samples[:, moving]
        off = own.near_turn(samples - own.main_means(moving)) / rate[moving]
        off = np.where(samples > 0, off, np.nan)  # and in frames in which the surface is not in sight
        told = np.flatnonzero(np.isfinite(off).any(axis=1))
        levels = np.zeros(len(samples))
        levels[told] = np.nanmedian(off[told], axis=1)
        time_s = recording.view.evidence.time_s
        most = 2.0 * PARTS[-1] * float(time_s[-1] - time_s[0])
        out[recording.view.frames] = np.where(np.abs(levels) < most, levels, 0.0)
    return out


def _with_rest(task: SearchTask, state: ModelState, bias_mm: FloatArray) -> ModelState:
    """The state with the most likely noise of what moves, if the widths of a measured scene hold its way."""
    like, way = task.likelihood, state.way
    if way is None or not like.scene.has_way:
        return state
    least, near = 0.1, 0.01  # of the widths of the scene, and to how much its logarithm is found
    most = 50_000  # samples, which tell a width to 0.003
    given = replace(state, log_width=task.null.log_width)  # without errors of widths, found about another noise
    moved = _moving(like.mixture(state))
    moved = moved[:: max(1, moved.size * task.part[0].size // most)]

    def loss(log_rest: float) -> float:
        other = like.mixture(replace(given, way=way._replace(rest=math.exp(log_rest))))
        parts = ((r.part[0], np.intersect1d(r.part[1], moved)) for r in task.recordings)
        return -sum(like.sums(other, state, p, bias=own).total for p, own in zip(parts, bias_mm, strict=True))

    found: Any = minimize_scalar(loss, bounds=(math.log(least), 0.0), method="bounded", options={"xatol": near})
    return replace(state, way=way._replace(rest=math.exp(found.x)))


def _with_power(task: SearchTask, state: ModelState, bias_mm: FloatArray) -> ModelState:
    """The state with the most likely power of the noise beyond the ranges of a measured scene.

    The widths of pixels are fitted beside it, so that powers are compared at the same noise of a typical sample.
    """
    like, way = task.likelihood, state.way
    given = like.mixture(state)
    if way is None or not like.beyond(given).any():
        return state
    grid = np.linspace(0.0, 3.0, 7)
    nats = []
    for power in grid:
        other = like.mixture(replace(state, way=way._replace(noise_power=float(power))))
        usual = np.log(other.sigma / given.sigma)[given.lit & (given.rate != 0)].mean()
        other = other.widened(np.asarray(-usual))
        own = sum(like.sums(other, state, r.part, bias=bias_mm[k]).total for k, r in enumerate(task.recordings))
        nats.append(own - 0.5 * ((power - USUAL_POWER) / POWER_SPREAD) ** 2)
    k = int(np.clip(np.argmax(nats), 1, grid.size - 2))
    low, middle, high = nats[k - 1 : k + 2]
    curve = max(2 * middle - low - high, 1e-9)
    power = grid[k] + (grid[1] - grid[0]) * np.clip(0.5 * (high - low) / curve, -1.0, 1.0)
    return replace(state, way=way._replace(noise_power=float(power)))
