"""A small scene of three boards, and recordings of it with and without effects, made by the simulator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from reconcile_errors import FRAMES, scene
from recordings import Record

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.simulation.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks


@pytest.fixture(scope="session")
def model() -> Model:
    """Two boards and a slanted wall before a camera of 20 x 24 pixels."""
    return scene(rows=20, cols=24)


@pytest.fixture(scope="session")
def record(model: Model) -> Record:
    """Simulate the model, or another one, with effects that it does not say it has."""

    def make(*effects: Effect, seed: int = 5, of: Model = model) -> Evidence:
        real = replace(of, effects=effects)
        (block,) = render_blocks(real, cast_scene(real), n_frames=FRAMES, seed=seed, block_frames=FRAMES)
        range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
        return make_evidence(of, range_mm, time_s=block.time_s)

    return make


@pytest.fixture(scope="session")
def in_the_open(model: Model) -> Callable[[Effect], tuple[Model, Evidence]]:
    """Two boards before open space, with an effect; the model does not have it."""
    bare = replace(model, surfaces=model.surfaces[:2])

    def make(effect: Effect) -> tuple[Model, Evidence]:
        real = replace(bare, effects=(effect,))
        (block,) = render_blocks(real, cast_scene(real), n_frames=FRAMES, seed=3, block_frames=FRAMES)
        range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
        return bare, make_evidence(bare, range_mm, time_s=block.time_s)

    return make
