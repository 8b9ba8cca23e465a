"""Measured noise is a camera's if it changes with range within surfaces too; else the place is named."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.recordings import recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.hidden_states import begin
from tofmix.reconciliation.likelihood.joint import Recording, joint_likelihood
from tofmix.reconciliation.likelihood.likelihood import ModelState
from tofmix.reconciliation.measured_noise import Uneven, uneven_noise
from tofmix.reconciliation.settings import Settings, fit_part
from tofmix.sensor import NoiseCurve
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

SETTINGS = Settings(kinds=("range_offset",))
BOARD = Surface(name="board", center_mm=(-350.0, 0.0, 1800.0), size_mm=(600.0, 900.0), yaw_deg=10.0, reflectivity=0.4)
WALL = Surface(name="wall", center_mm=(0.0, 0.0, 3600.0), size_mm=(9000.0, 9000.0), reflectivity=0.7)
ON_BOARD_MM = 2500.0
"""Shorter ranges are the board's."""

Factor = Callable[[FloatArray], FloatArray]


@pytest.fixture(name="given")
def two_surfaces(small: Model) -> Recording:
    sensor = replace(small.sensor, rows=28, cols=36)
    model = replace(small, sensor=sensor, surfaces=(BOARD, WALL))
    return model, recorded(model)


def with_factor(given: Recording, factor: Factor) -> Recording:
    """The same recording, and the model with its noise curve times a factor of range."""
    model, evidence = given
    points = np.linspace(500.0, 6000.0, 400)
    curve = NoiseCurve(points, model.sensor.noise.sigma(points) * factor(points))
    return replace(model, sensor=replace(model.sensor, noise=curve)), evidence


def state_of(recording: Recording) -> ModelState:
    likelihood = joint_likelihood([recording])
    return begin(likelihood, fit_part(likelihood, SETTINGS)[0], SETTINGS.accepted(likelihood))


def uneven(given: Recording, factor: Factor, log_width: FloatArray | float = 0.0) -> Uneven | None:
    measured = with_factor(given, factor)
    state = state_of(measured)
    state = replace(state, log_width=state.log_width + log_width)
    return uneven_noise([given], [measured], state, SETTINGS.alpha)


@pytest.mark.parametrize(
    "law",
    [
        lambda r: np.full(r.shape, 1.6),
        lambda r: 1.3 * (r / 2000.0) ** 0.5,
        lambda r: np.sqrt(1 + (r / 3000.0) ** 4),
        lambda r: (r / 2000.0) ** -0.4,
    ],
    ids=["factor", "power", "two terms", "less with range"],
)
def test_noise_of_another_law_of_range_has_no_place(given: Recording, law: Factor) -> None:
    assert uneven(given, law) is None


@pytest.mark.parametrize(("board", "wall", "name"), [(1.5, 1.0, "board"), (1.0, 1.7, "wall")])
def test_noise_of_one_surface_is_placed_although_a_curve_of_range_fits(
    given: Recording, board: float, wall: float, name: str
) -> None:
    found = uneven(given, lambda r: np.where(r < ON_BOARD_MM, board, wall))
    assert found is not None
    assert found.place == f'on "{name}"'
    assert found.ratio == pytest.approx(max(board, wall), rel=0.01)
    assert found.elsewhere == pytest.approx(1.0, rel=0.01)
    assert f'on "{name}" it is {max(board, wall):.2f} times the model\'s, elsewhere 1.00 times' in found.sentence


def test_widths_of_pixels_that_differ_by_chance_have_no_place(given: Recording) -> None:
    widths = np.random.default_rng(3).normal(0.0, 0.2, 28 * 36)
    assert uneven(given, lambda r: np.full(r.shape, 1.2), widths) is None


def test_widths_that_differ_in_a_part_of_the_image_are_placed_there(given: Recording) -> None:
    widths = np.random.default_rng(3).normal(0.0, 0.1, (28, 36))
    widths[14:24, 18:30] += 0.5
    found = uneven(given, lambda r: np.full(r.shape, 1.0), widths.ravel())
    assert found is not None
    rows, cols = (part.split(" to ") for part in found.place.removeprefix("in rows ").split(", columns "))
    assert 13 <= int(rows[0]) <= int(rows[1]) <= 24
    assert 17 <= int(cols[0]) <= int(cols[1].rstrip(",")) <= 30
    assert found.ratio == pytest.approx(np.exp(0.5), rel=0.15)
