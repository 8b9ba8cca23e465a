"""Recordings that the simulator makes, and the outcome of reconciling them.

A recording, and an outcome, is made once in a process: tests that ask for the same share it. Each gets samples of its
own, so that it may change them.
"""

import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

Record: TypeAlias = Callable[..., Evidence]
"""What the fixture `record` of tests/reconciliation returns."""

MAKE: Mapping[str, Callable[..., Effect]] = EFFECTS
"""How tests make effects."""

_Made = TypeVar("_Made")
_MADE: dict[bytes, Any] = {}


def _once(make: Callable[..., _Made], *arguments: object) -> _Made:
    """What a function returns, called once for the same arguments: those of the same pickle."""
    key = pickle.dumps((make.__qualname__, arguments))
    if key not in _MADE:
        _MADE[key] = make(*arguments)
    made: _Made = _MADE[key]
    return made


def recorded(model: Model, *hidden: Effect, seed: int = 5, frames: int | None = None) -> Evidence:
    """Simulate a recording of the model with these effects instead of its own, held against the model.

    `model`: does not say that it has the effects, unless it has.
    `hidden`: all effects of the recording.
    `seed`: of the recording.
    `frames`: as many as the model says if left out.
    """
    made = _once(simulated, model, hidden, seed, model.recording.frames if frames is None else frames)
    return replace(made, samples=made.samples.copy())


def simulated(model: Model, hidden: tuple[Effect, ...], seed: int, frames: int) -> Evidence:
    """What `recorded` returns, simulated anew and not kept."""
    real = replace(model, effects=hidden)
    (block,) = render_blocks(real, cast_scene(real), n_frames=frames, seed=seed, block_frames=frames)
    range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
    return make_evidence(model, range_mm, time_s=block.time_s)


def reconciled(model: Model, *hidden: Effect, seed: int = 5, **settings: Any) -> Reconciliation:  # noqa: ANN401  of Settings
    """The outcome of reconciling the model with a recording of it that has these effects instead of its own.

    `model`: as `reconcile` gets it.
    `hidden`: all effects of the recording.
    `seed`: of the recording.
    `settings`: fields of `Settings`.
    """
    return _once(_reconciled, model, hidden, seed, Settings(**settings))


def _reconciled(model: Model, hidden: tuple[Effect, ...], seed: int, settings: Settings) -> Reconciliation:
    return reconcile(model, recorded(model, *hidden, seed=seed), settings)
