"""A wall that fills a small image, recorded with effects that its model lacks."""

from dataclasses import replace

import pytest
from support.reconcile_errors import scene
from support.recordings import recorded
from support.search_tasks import MakeTask

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.settings import Settings
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@pytest.fixture(scope="session")
def wall() -> Model:
    """A wall before a camera of 8 x 10 pixels, 60 frames."""
    surface = Surface(name="wall", center_mm=(0, 0, 2200), size_mm=(5200, 4200), reflectivity=0.7)
    return replace(scene(rows=8, cols=10, frames=60), surfaces=(surface,), effects=())


@pytest.fixture(scope="session")
def make_task(wall: Model) -> MakeTask:
    """The task of a search for some kinds, with effects in the recording."""

    def make(kinds: tuple[str, ...], *hidden: Effect, of: Model = wall) -> SearchTask:
        return SearchTask(joint_likelihood([(of, recorded(of, *hidden))]), Settings(kinds=kinds))

    return make
