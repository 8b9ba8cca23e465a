"""Where effects are tried."""

import pytest
from support.effect_bench import Bench, Recorded


@pytest.fixture(scope="session")
def bench() -> Bench:
    """Where effects are tried."""
    return Bench()


@pytest.fixture(scope="session")
def plain_wall(bench: Bench) -> Recorded:
    """The wall without effects; 20 frames."""
    return bench.wall()
