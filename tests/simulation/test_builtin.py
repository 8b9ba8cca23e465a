"""What the built-in models promise."""

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.simulation.builtin import BUILTIN_MODELS, builtin_description, builtin_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.truth import Truth


@pytest.mark.parametrize("name", BUILTIN_MODELS)
def test_every_built_in_model_reads_and_is_described_in_one_line(name: str) -> None:
    model = parse_model(builtin_text(name), source=name)
    assert model.text == builtin_text(name)
    assert model.surfaces
    description = builtin_description(name)
    assert 20 < len(description) < 110
    assert not description.startswith("#")


def test_three_boards_is_recorded_as_in_the_paper(three_boards: tuple[Model, Truth]) -> None:
    model, truth = three_boards
    assert truth.n_modes.shape == (144, 176)
    assert (model.sensor.integration_time_ms, model.recording.frames) == (1.2, 100)


def test_column_92_sees_three_boards_and_its_neighbours_fewer(three_boards: tuple[Model, Truth]) -> None:
    _, truth = three_boards
    shares = np.nan_to_num(truth.weight_true[:, 92])
    good = (truth.n_modes[:, 92] == 3) & (shares >= 0.1).all(axis=1)
    assert good.sum() >= 40
    assert good[72]  # the paper's pixel, in the middle row
    neighbours = truth.n_modes[good][:, [91, 93]]
    assert set(np.unique(neighbours)) <= {1, 2}
    np.testing.assert_allclose(truth.range_true[good, 92].mean(axis=0), [2400, 3600, 4800], rtol=0.02)
    assert np.ptp(shares[good], axis=0).min() > 0.1  # the shares change from row to row


def test_three_boards_has_every_kind_of_pixel(three_boards: tuple[Model, Truth]) -> None:
    _, truth = three_boards
    count = np.bincount(truth.n_modes.ravel(), minlength=4)
    assert count[0] > 1000
    assert count[1] > 10_000
    assert count[2] > 200
    assert ((truth.weight_no_return > 0.1) & (truth.n_modes > 0)).sum() > 50


def test_corridor_has_walls_a_board_in_an_opening_and_open_space() -> None:
    model = parse_model(builtin_text("corridor"), source="corridor")
    truth = cast_scene(model)
    seen = np.unique(truth.surface)
    np.testing.assert_array_equal(seen, np.arange(-1, len(model.surfaces)))
    row = 80
    names = [model.surfaces[k].name if k >= 0 else "open" for k in truth.surface[row, :, 0]]
    order = [name for k, name in enumerate(names) if k == 0 or name != names[k - 1]]
    assert order[0] == "left wall"
    assert order[-1] == "right wall"
    # parallax shows a strip of open space on the board's other side too
    assert order[order.index("board in the opening") :][1:3] == ["open", "end wall, right of the opening"]
    assert (truth.n_modes == 0).sum() > 1000


def test_unknown_model_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(BadInputError, match='"three-bords" is not a built-in model; did you mean "three-boards"'):
        builtin_text("three-bords")


def cast(name: str) -> tuple[Model, Truth]:
    model = parse_model(builtin_text(name), source=name)
    return model, cast_scene(model)


def test_slanted_wall_has_every_range_once_and_edges_of_every_depth() -> None:
    model, truth = cast("slanted-wall")
    assert [surface.name for surface in model.surfaces] == ["wall", "board"]
    assert not truth.weight_no_return.any()
    top = truth.range_true[10, :, 0]
    assert (np.diff(top) < 0).all()  # the wall alone, nearer to the right
    assert top[0] - top[-1] > 3000
    step = np.diff(truth.range_true, axis=2)[truth.n_modes == 2]
    assert step.size > 200
    assert step.min() < 1500
    assert step.max() > 3000


def test_near_far_is_lit_by_its_near_board() -> None:
    model, truth = cast("near-far")
    assert not truth.weight_no_return.any()
    near, far = (truth.amplitude[(truth.surface == k).any(axis=2) & (truth.n_modes == 1), 0] for k in (0, 1))
    assert 150 < near.mean() / far.mean() < 300
    assert min(near.size, far.size) > 5000
    assert (truth.n_modes == 2).sum() > 200
    assert [surface.name for surface in model.surfaces] == ["bright board", "dark wall"]


def test_corner_has_creases_and_no_steps() -> None:
    _, truth = cast("corner")
    assert not truth.weight_no_return.any()
    assert set(np.unique(truth.n_modes)) == {1, 2, 3}
    step = np.diff(truth.range_true, axis=2)
    assert np.nanmax(step) < 50
    assert (truth.n_modes > 1).sum() > 200
    np.testing.assert_array_equal(np.unique(truth.surface), [-1, 0, 1, 2])
