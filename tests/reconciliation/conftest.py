"""Small scenes of three boards, and recordings of them with and without effects, made by the simulator."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from support.reconcile_errors import scene
from support.recordings import Record, recorded

from tofmix.reconciliation.evidence import Evidence
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model


@pytest.fixture(scope="session")
def model() -> Model:
    """Two boards and a slanted wall before a camera of 20 x 24 pixels, 120 frames."""
    return scene(rows=20, cols=24)


@pytest.fixture(scope="session")
def small() -> Model:
    """The same scene before a camera of 14 x 18 pixels, 80 frames: a third of the samples."""
    return scene(rows=14, cols=18, frames=80)


@pytest.fixture(scope="session")
def record(model: Model) -> Record:
    """Simulate the model, or another one, with effects that the model lacks."""

    def make(*effects: Effect, seed: int = 5, of: Model = model) -> Evidence:
        return recorded(of, *effects, seed=seed)

    return make


@pytest.fixture(scope="session")
def in_the_open(model: Model) -> Callable[[Effect], tuple[Model, Evidence]]:
    """Two boards before open space, with an effect; the model does not have it."""
    bare = replace(model, surfaces=model.surfaces[:2])

    def make(effect: Effect) -> tuple[Model, Evidence]:
        return bare, recorded(bare, effect, seed=3)

    return make
