"""Shares and ranges against closed forms, polygons, slow twins and rays through a pinhole."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import cast_twin, lens
from support.recordings import MAKE
from support.sizes import sized

from tofmix.errors import BadInputError
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import cell_nodes
from tofmix.sensors import CompleteCamera, load_profile
from tofmix.simulation.casting import cast, cast_cells, cast_kernel
from tofmix.simulation.casting.cast import MIN_SHARE, MovingCaster, cast_scene
from tofmix.simulation.casting.cast_kernel import scene_arrays
from tofmix.simulation.casting.polygon_cast import MovingPolygons, PolygonCaster
from tofmix.simulation.effects.base import Context
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

Floats = NDArray[np.float64]
MakeModel = Callable[..., Model]
CastTwin = Callable[..., tuple[Floats, Floats]]
PIXEL = np.radians(47.0 / 176)
ROW = np.radians(39.0 / 144)
SHARE = 0.001  # the contract
WALL = Surface(name="wall", center_mm=(0, 0, 4000), size_mm=(4000, 4000))
P_R = 1.0e-4


def by_surface(truth: Truth, row: int, col: int, surfaces: int) -> tuple[Floats, Floats]:
    """One pixel's area shares (S + 1,), the last that of no return, and ranges (S,) in the model's order."""
    share, ranges = np.zeros(surfaces + 1), np.full(surfaces, np.nan)
    for layer in range(truth.n_modes[row, col]):
        k = truth.surface[row, col, layer]
        share[k], ranges[k] = truth.weight_true[row, col, layer], truth.range_true[row, col, layer]
    share[-1] = truth.weight_no_return[row, col]
    return share / (1 - P_R), ranges


@pytest.mark.usefixtures("kernel_casts")
def test_vertical_edges_have_the_closed_form_share(make_model: MakeModel) -> None:
    """An edge along the grid, at 60 positions and on sub-beams, where a regular 32 x 32 is off by up to 0.016."""
    left = -0.5 * PIXEL
    for share in [*np.linspace(0.003, 0.997, sized(60, 6)), 1 / 64, 0.5, 31 / 32, 0.5 + 1 / 64]:
        x = 2000 * np.tan(left + share * PIXEL)
        board = Surface(name="board", center_mm=(x - 500, 0, 2000), size_mm=(1000, 1000))
        truth = cast_scene(make_model(board, WALL))
        expected = np.tile([share, 1 - share, 0], (9, 1))
        found = [by_surface(truth, row, 5, 2)[0] for row in range(9)]
        np.testing.assert_allclose(found, expected, atol=SHARE / 2)
        assert (truth.n_modes[:, :5] == 1).all()
        assert (truth.n_modes[:, 6:] == 1).all()


@pytest.mark.usefixtures("kernel_casts")
@pytest.mark.parametrize("share", [0.013, 1 / 64, 0.26, 0.5, 0.7421])
def test_horizontal_edges_have_the_closed_form_share(make_model: MakeModel, share: float) -> None:
    y = 2000 * np.tan((share - 0.5) * ROW)
    board = Surface(name="board", center_mm=(0, y - 500, 2000), size_mm=(1000, 1000))
    truth = cast_scene(make_model(board))
    for col in range(11):
        az = (col - 5 + np.linspace(-0.5, 0.5, 2001)) * PIXEL
        expected = np.mean(np.clip(np.arctan(y * np.cos(az) / 2000) / ROW + 0.5, 0, 1))
        np.testing.assert_allclose(by_surface(truth, 4, col, 1)[0], [expected, 1 - expected], atol=SHARE / 2)


@pytest.mark.usefixtures("kernel_casts")
@pytest.mark.parametrize("width_mm", [0.05, 0.5, 3.0])
def test_a_wire_thinner_than_any_grid_is_not_missed(make_model: MakeModel, width_mm: float) -> None:
    wire = Surface(name="wire", center_mm=(1.234, 0, 2000), size_mm=(width_mm, 1000))
    expected = width_mm / 2000 / PIXEL
    truth = cast_scene(make_model(wire, WALL))
    shares = [by_surface(truth, row, 5, 2)[0][0] for row in range(9)]
    np.testing.assert_allclose(shares, expected, atol=SHARE)
    assert np.mean(shares) == pytest.approx(expected, rel=0.3)


@pytest.mark.usefixtures("kernel_casts")
@pytest.mark.parametrize("seed", range(8))
def test_random_boards_agree_with_the_twin(make_model: MakeModel, cast_twin: CastTwin, seed: int) -> None:
    """One pixel of 6 degrees, four boards at any angle through it: edges, creases, occlusion, range limit."""
    rng = np.random.default_rng(seed)
    boards = [
        Surface(
            name=str(k),
            center_mm=(rng.uniform(-120, 120), rng.uniform(-120, 120), rng.uniform(1500, 3500)),
            size_mm=(rng.uniform(50, 400), rng.uniform(50, 400)),
            yaw_deg=rng.uniform(-180, 180),
            pitch_deg=rng.uniform(-180, 180),
        )
        for k in range(4)
    ]
    model = make_model(*boards, rows=1, cols=1, fov_horizontal_deg=6.0, fov_vertical_deg=6.0, range_max_mm=3300.0)
    share, ranges = by_surface(cast_scene(model), 0, 0, 4)
    expected_share, expected_range = cast_twin(model, 0, 0)
    np.testing.assert_allclose(share, expected_share, atol=SHARE)
    seen = (share[:4] > 0.01) & (expected_share[:4] > 0.01)
    assert seen.any()
    np.testing.assert_allclose(ranges[seen], expected_range[seen], atol=3.0)


@pytest.mark.usefixtures("kernel_casts")
def test_crease_of_intersecting_boards_agrees_with_the_twin(make_model: MakeModel, cast_twin: CastTwin) -> None:
    a = Surface(name="a", center_mm=(2.0, 0, 2000), size_mm=(1000, 1000), yaw_deg=50)
    b = Surface(name="b", center_mm=(2.0, 0, 2000), size_mm=(1000, 1000), yaw_deg=-40, pitch_deg=5)
    model = make_model(a, b)
    truth = cast_scene(model)
    for row, col in [(0, 5), (4, 5), (8, 5)]:
        share, ranges = by_surface(truth, row, col, 2)
        expected_share, expected_range = cast_twin(model, row, col)
        np.testing.assert_allclose(share, expected_share, atol=SHARE)
        np.testing.assert_allclose(ranges, expected_range, atol=0.1)
        assert truth.n_modes[row, col] == 2


@pytest.mark.usefixtures("kernel_casts")
def test_beyond_the_range_limit_there_is_no_return(make_model: MakeModel, cast_twin: CastTwin) -> None:
    wall = Surface(name="wall", center_mm=(0, 0, 3000), size_mm=(4000, 4000), yaw_deg=40)
    model = make_model(wall, range_max_mm=3000.0)
    truth = cast_scene(model)
    # yaw turns +u towards -z, so that the wall's right half is the nearer one
    assert (truth.n_modes[:, :5] == 0).all()
    assert (truth.n_modes[:, 6:] == 1).all()
    for row in (0, 4):
        np.testing.assert_allclose(by_surface(truth, row, 5, 1)[0], cast_twin(model, row, 5)[0], atol=SHARE)
    assert np.nanmax(truth.range_true) <= 3000


@pytest.mark.usefixtures("kernel_casts")
def test_signs_of_yaw_and_pitch_and_corners_of_a_board(make_model: MakeModel) -> None:
    yawed = cast_scene(make_model(replace(WALL, yaw_deg=20))).range_true[..., 0]
    assert (np.diff(yawed, axis=1) < 0).all()  # the right side comes nearer
    pitched = cast_scene(make_model(replace(WALL, pitch_deg=20))).range_true[..., 0]
    assert (np.diff(pitched, axis=0) > 0).all()  # the lower side goes away
    # A board over columns 6 and 7 and rows 1 to 3 alone: right and up of the centre.
    x = 2000 * np.tan(np.array([0.5, 2.5]) * PIXEL)
    y = 2000 * np.tan(np.array([-3.4, -0.6]) * ROW)
    center, size = (x.mean(), y.mean(), 2000.0), (np.ptp(x), np.ptp(y))
    truth = cast_scene(make_model(Surface(name="board", center_mm=center, size_mm=size)))
    expected = np.zeros((9, 11))
    expected[1:4, 6:8] = 1
    np.testing.assert_array_equal(truth.n_modes, expected)  # edges on pixel borders add no surface to a neighbour


@pytest.mark.usefixtures("kernel_casts")
def test_amplitudes_and_outliers_scale_with_their_causes(make_model: MakeModel) -> None:
    wide = replace(WALL, size_mm=(9000, 9000))
    truth = cast_scene(make_model(wide, rows=8, cols=9, fov_horizontal_deg=60.0, fov_vertical_deg=50.0))
    cos_az = np.array([_mean_secant(np.radians(60 / 9), col - 4) for col in range(9)])
    cos_el = np.array([_mean_secant(np.radians(50 / 8), row - 3.5) for row in range(8)])
    np.testing.assert_allclose(truth.range_true[..., 0], 4000 * np.outer(cos_el, cos_az), rtol=1e-4)
    board = Surface(name="b", center_mm=(0, 0, 2000), size_mm=(900, 900), yaw_deg=30, reflectivity=0.4)
    truth = cast_scene(make_model(board, integration_time_ms=2.4))
    assert truth.amplitude[4, 5, 0] == pytest.approx(1000 * 0.4 * np.cos(np.pi / 6) / 4 * 2, rel=1e-3)
    truth = cast_scene(make_model(WALL, outlier_probability=0.25))
    np.testing.assert_allclose(truth.weight_true, 0.75)


def _mean_secant(step: float, number: float) -> float:
    """Mean of 1 / cos over a cell, by its antiderivative asinh(tan)."""
    low, high = (number - 0.5) * step, (number + 0.5) * step
    return float((np.arcsinh(np.tan(high)) - np.arcsinh(np.tan(low))) / (high - low))


@pytest.mark.usefixtures("kernel_casts")
def test_weights_sum_to_one_and_layers_run_from_near_to_far(three_boards: tuple[Model, Truth]) -> None:
    _, truth = three_boards
    total = np.nansum(truth.weight_true, axis=2) + truth.weight_no_return + P_R
    np.testing.assert_allclose(total, 1, atol=1e-6)
    layer = np.arange(truth.range_true.shape[2])
    past = layer >= truth.n_modes[..., np.newaxis]
    for stack in (truth.range_true, truth.weight_true):
        np.testing.assert_array_equal(np.isnan(stack), past)
    np.testing.assert_array_equal(truth.surface == -1, past)
    assert (truth.amplitude[past] == 0).all()
    steps = np.diff(truth.range_true, axis=2)
    assert (steps[~np.isnan(steps)] > 0).all()
    assert np.nanmin(truth.weight_true) >= MIN_SHARE * (1 - P_R) * (1 - 1e-6)
    assert [str(a.dtype) for a in (truth.n_modes, truth.range_true, truth.weight_true)] == [
        "uint8",
        "float32",
        "float32",
    ]


@pytest.mark.usefixtures("kernel_casts")
def test_boards_are_seen_from_both_sides_in_the_models_order(make_model: MakeModel) -> None:
    a = Surface(name="a", center_mm=(-490, 10, 2000), size_mm=(1000, 900), pitch_deg=10)
    b = Surface(name="b", center_mm=(0, 300, 3000), size_mm=(2000, 600), yaw_deg=10)
    one, other = cast_scene(make_model(a, b, WALL)), cast_scene(make_model(WALL, b, a))
    np.testing.assert_array_equal(one.range_true, other.range_true)
    np.testing.assert_array_equal(one.weight_true, other.weight_true)
    board = Surface(name="a", center_mm=(-490, 10, 2000), size_mm=(1000, 900), pitch_deg=10)
    front, back = cast_scene(make_model(board)), cast_scene(make_model(replace(board, pitch_deg=190)))
    np.testing.assert_allclose(front.range_true, back.range_true, rtol=1e-6)
    np.testing.assert_allclose(front.weight_true, back.weight_true, atol=1e-4)
    behind = cast_scene(make_model(replace(board, center_mm=(0, 0, -2000))))
    assert not behind.n_modes.any()
    poster = Surface(name="poster", center_mm=(10, 7, 4000), size_mm=(90, 80))
    truth = cast_scene(make_model(poster, WALL))
    assert truth.n_modes.max() == 2
    assert truth.surface[4, 5, 0] == 0
    hidden = cast_scene(make_model(WALL, poster))
    assert (hidden.surface == 0).all()


@pytest.mark.usefixtures("kernel_casts")
def test_an_edge_on_board_and_an_empty_scene_return_nothing(make_model: MakeModel) -> None:
    edge_on = Surface(name="a", center_mm=(0, 0, 2000), size_mm=(500, 500), yaw_deg=90)
    for model in (make_model(edge_on), make_model()):
        truth = cast_scene(model)
        assert truth.range_true.shape == (9, 11, 1)
        assert not truth.n_modes.any()
        np.testing.assert_allclose(truth.weight_no_return, 1 - P_R, rtol=1e-6)


@pytest.mark.usefixtures("kernel_casts")
def test_too_many_surfaces_are_refused(make_model: MakeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    count = sized(400, 6)
    monkeypatch.setattr(cast, "MAX_LAYERS", sized(255, 3))
    slats = [
        Surface(name=f"{k}", center_mm=(8.0 / count * k - 4, 0, 2000 + k), size_mm=(4.0 / count, 500))
        for k in range(count)
    ]
    with pytest.raises(BadInputError, match=r"pixel \(\d, 5\) sees \d+ surfaces"):
        cast_scene(make_model(*slats))
    monkeypatch.setattr(cast, "MAX_SURFACES", count - 1)
    with pytest.raises(BadInputError, match=f"{count} surfaces"):
        cast_scene(make_model(*slats))


@pytest.mark.usefixtures("kernel_casts")
@pytest.mark.parametrize("seed", range(4))
def test_rows_are_those_of_the_twin(make_model: MakeModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    boards = [
        Surface(
            name=str(k),
            center_mm=tuple(rng.uniform((-120, -90, 1500), (120, 90, 3800))),
            size_mm=tuple(rng.uniform(20, 400, 2)),
            yaw_deg=rng.uniform(-70, 70),
            pitch_deg=rng.uniform(-50, 50),
        )
        for k in range(3)
    ]
    model = make_model(*boards, *([WALL, replace(WALL, name="the same plane")] if seed % 2 else []))
    scene, size = scene_arrays(model), (PIXEL, ROW)
    azimuths = (np.arange(11) - 5) * PIXEL
    wanted = rng.random(11) < 0.8
    for row in (-2, 0, 3):
        found, twin = (np.zeros((11, len(model.surfaces), 3)) for _ in range(2))
        cast_kernel.cast_row(row * ROW, azimuths, *size, scene, wanted, found)
        cast_twin.cast_row(row * ROW, azimuths, *size, scene, wanted, twin)
        np.testing.assert_allclose(found[..., 0], twin[..., 0], atol=0.02)  # an edge along the grid: 1 / 64
        np.testing.assert_allclose(found[..., 1:], twin[..., 1:], atol=0.02 * 4000)
        whole = (twin[..., 0] == 1).any(axis=1)
        np.testing.assert_allclose(found[whole], twin[whole], rtol=1e-6)  # or a crease crosses it
        assert not found[~wanted].any()


LENS: dict[str, Any] = {"fx": 18.0, "fy": 17.0, "cx": 5.6, "cy": 3.9, "distortion": (-0.1, 0.02, 0.003, -0.002, 0.0)}
BOARDS = (
    Surface(name="right", center_mm=(200, 100, 2000), size_mm=(900, 700), yaw_deg=30, pitch_deg=10),
    Surface(name="left", center_mm=(-300, -200, 2500), size_mm=(900, 700), yaw_deg=-30, pitch_deg=10),
    Surface(name="wall", center_mm=(0, 0, 4000), size_mm=(3000, 3000)),
)


def camera(**changes: Any) -> CompleteCamera:  # noqa: ANN401  keys of a pinhole
    """9 x 11 pixels of about 3 degrees each, through a lens."""
    return replace(load_profile("sr3000"), rows=9, cols=11, projection=Pinhole(**(LENS | changes)))


def brute_force(model: Model, row: int, col: int, side: int = 250) -> tuple[Floats, Floats]:
    """Shares (S,) of a pixel's solid angle, and mean ranges (S,), of side x side rays over the pixel's square."""
    pinhole = model.sensor.projection
    assert isinstance(pinhole, Pinhole)
    part = (np.arange(side) + 0.5) / side - 0.5
    down, across = np.meshgrid(row + part, col + part, indexing="ij")
    beam, weight = lens.beams(
        down, across, fx=pinhole.fx, fy=pinhole.fy, cx=pinhole.cx, cy=pinhole.cy, distortion=pinhole.distortion
    )
    ranges = [np.full((side, side), np.inf)]
    for surface in model.surfaces:
        u, v, n = surface.rotation().T
        center = np.array(surface.center_mm)
        with np.errstate(divide="ignore"):
            t = (center @ n) / (beam @ n)
        point = beam * t[..., np.newaxis] - center
        hit = (abs(point @ u) <= surface.size_mm[0] / 2) & (abs(point @ v) <= surface.size_mm[1] / 2)
        ranges.append(np.where(hit & (t > 0) & (t <= model.sensor.range_max_mm), t, np.inf))
    first, nearest = np.argmin(ranges, axis=0) - 1, np.min(ranges, axis=0)
    met = [weight[first == k].sum() for k in range(len(model.surfaces))]
    mean = [(weight * nearest)[first == k].sum() / met[k] if met[k] else np.nan for k in range(len(met))]
    return np.array(met) / weight.sum(), np.array(mean)


@pytest.mark.usefixtures("kernel_casts")
@pytest.mark.slow
def test_shares_and_ranges_agree_with_brute_force_rays() -> None:
    model = Model(sensor=camera(), surfaces=BOARDS)
    truth = cast_scene(model)
    pixels = [(row, col) for row in range(9) for col in range(11)]
    several = 0
    for row, col in pixels[:: sized(5, 9)]:
        share, ranges = np.zeros(3), np.full(3, np.nan)
        for layer in range(truth.n_modes[row, col]):
            k = truth.surface[row, col, layer]
            share[k], ranges[k] = truth.weight_true[row, col, layer] / (1 - P_R), truth.range_true[row, col, layer]
        expected_share, expected_range = brute_force(model, row, col)
        np.testing.assert_allclose(share, expected_share, atol=SHARE)
        seen = (share > 0.01) & (expected_share > 0.01)
        several += int(seen.sum() > 1)
        np.testing.assert_allclose(ranges[seen], expected_range[seen], atol=0.5)
        total = share.sum() + truth.weight_no_return[row, col] / (1 - P_R)
        assert total == pytest.approx(1.0, abs=1e-6)
    assert several >= 3


@pytest.mark.usefixtures("kernel_casts")
def test_the_kernel_agrees_with_its_twin() -> None:
    model = Model(sensor=camera(), surfaces=BOARDS)
    scene = scene_arrays(model)
    for row in (0, 4, 7):
        nodes = cell_nodes(model.sensor.optics, row, (9, 11))
        wanted = np.ones(11, dtype=np.bool_)
        wanted[3] = False
        kernel, twin = np.zeros((11, 3, 3)), np.zeros((11, 3, 3))
        cast_cells.cast_cells(nodes, scene, wanted, kernel)
        cast_twin.cast_cells(nodes, scene, wanted, twin)
        np.testing.assert_allclose(kernel[..., 0], twin[..., 0], atol=0.01)
        assert not kernel[3].any()


@pytest.mark.usefixtures("kernel_casts")
def test_moving_surfaces_are_cast_as_still_ones_at_their_places() -> None:
    effect = MAKE["motion"](surface="right", velocity_mm_s=300.0)
    model = Model(sensor=camera(), surfaces=BOARDS, effects=(effect,), recording=RecordingSettings(frames=3))
    caster = MovingCaster(model)
    for time_s in sized((0.0, 0.7), (0.7,)):
        still = cast_scene(replace(model, surfaces=model.placed(time_s), effects=())).padded(caster.layers)
        moved = caster.cast(time_s)
        np.testing.assert_array_equal(moved.range_true, still.range_true)
        np.testing.assert_array_equal(moved.weight_true, still.weight_true)


@pytest.mark.usefixtures("kernel_casts")
def test_moving_surfaces_cast_by_areas_are_those_cast_by_beams() -> None:
    effect = MAKE["motion"](surface="right", velocity_mm_s=300.0)
    model = Model(sensor=camera(), surfaces=BOARDS, effects=(effect,), recording=RecordingSettings(frames=3))
    beams, areas = (caster(model).cast(0.7) for caster in (MovingCaster, MovingPolygons))
    found, wanted = (dense(truth, len(BOARDS))[0] for truth in (areas, beams))
    np.testing.assert_allclose(found, wanted, atol=0.01)


@pytest.mark.usefixtures("kernel_casts")
def test_vignetting_follows_the_angle_off_the_axis() -> None:
    """The pixel in the farthest corner has the factor; the axis may lie anywhere in the image."""
    sensor = camera()
    context = Context(sensor=sensor, surfaces=(), seed=1)
    light = MAKE["vignetting"](corner_factor=3.0).prepare(context, 1).reshape(9, 11)
    row, col = np.mgrid[:9, :11].astype(float)
    cosine = lens.beams(row, col, **LENS)[0][..., 2]
    assert light.min() == pytest.approx(1 / 3)
    np.testing.assert_allclose(light, cosine ** (-np.log(3.0) / np.log(cosine.min())), rtol=1e-9)
    assert np.unravel_index(light.argmax(), light.shape) == (4, 6)


def camera_polygon(**changes: object) -> CompleteCamera:
    """26 x 34 pixels of 0.6 degrees."""
    settings: dict[str, object] = {"rows": 26, "cols": 34, "fov_horizontal_deg": 20.4, "fov_vertical_deg": 15.6}
    return replace(load_profile("sr3000"), **(settings | changes))  # type: ignore[arg-type]


def dense(truth: Truth, surfaces: int) -> tuple[Floats, Floats]:
    """Shares (surface + 1, row, col), the last of no return, and ranges (surface, row, col), NaN where none is."""
    share = np.zeros((surfaces + 1, *truth.n_modes.shape))
    range_mm = np.full((surfaces, *truth.n_modes.shape), np.nan)
    share[-1] = truth.weight_no_return
    for layer in range(truth.range_true.shape[2]):
        for number in range(surfaces):
            here = truth.surface[..., layer] == number
            share[number][here] = truth.weight_true[..., layer][here]
            range_mm[number][here] = truth.range_true[..., layer][here]
    return share, range_mm


def boards(rng: np.random.Generator, count: int, size_mm: float = 500.0) -> tuple[Surface, ...]:
    """Boards that hide parts of each other, and cut through each other."""
    return tuple(
        Surface(
            name=f"board {k}",
            size_mm=(float(rng.uniform(0.3, 1) * size_mm), float(rng.uniform(0.3, 1) * size_mm)),
            center_mm=tuple(rng.uniform((-300, -200, 1500), (300, 200, 2200)).tolist()),
            yaw_deg=float(rng.normal(0, 25)),
            pitch_deg=float(rng.normal(0, 25)),
        )
        for k in range(count)
    )


def compare(model: Model, share: float, range_mm: float) -> None:
    """Hold the shares, and the ranges of what fills over 1 % of a pixel, of both casts against each other."""
    one, other = (dense(t, len(model.surfaces)) for t in (PolygonCaster(model.sensor).cast(model), cast_scene(model)))
    assert np.abs(one[0] - other[0]).max() < share
    seen = other[0][:-1] > 0.01
    assert np.abs(one[1] - other[1])[seen].max() < range_mm


@pytest.mark.compiled("thousands of pixels are cut")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "optics", [None, Pinhole(fx=90.0, fy=90.0, cx=17.0, cy=12.0, distortion=(-0.1, 0.02, 0.0, 0.0, 0.0))]
)
def test_shares_and_ranges_are_those_of_beams(seed: int, optics: Pinhole | None) -> None:
    sensor = camera_polygon() if optics is None else camera_polygon(projection=optics)
    model = Model(sensor=sensor, surfaces=boards(np.random.default_rng(seed), 4))
    compare(model, share=0.0015, range_mm=0.3)


@pytest.mark.compiled("thousands of pixels are cut")
def test_surfaces_in_one_plane_beyond_the_range_or_none_are_seen_as_the_model_says() -> None:
    first = Surface(name="first", center_mm=(0, 0, 2000), size_mm=(300, 300))
    second = replace(first, name="second", center_mm=(100, 0, 2000))
    for surfaces in ((first, second), (second, first)):
        compare(Model(sensor=camera_polygon(), surfaces=surfaces), share=0.001, range_mm=0.01)
    model = Model(
        sensor=camera_polygon(range_max_mm=2030.0),
        surfaces=(Surface(name="wall", center_mm=(0, 0, 2000), size_mm=(9000, 9000), yaw_deg=3.0),),
    )
    compare(model, share=0.0015, range_mm=0.1)
    truth = PolygonCaster(camera_polygon()).cast(Model(sensor=camera_polygon()))
    assert not truth.n_modes.any()


@pytest.mark.compiled("thousands of pixels are cut")
def test_shares_change_evenly_with_the_place_of_a_surface() -> None:
    """A thousandth of a millimetre changes no share by more than its part of a pixel, and never by a beam's."""
    board = Surface(name="board", center_mm=(10, 5, 1500), size_mm=(200, 150), yaw_deg=3.0, pitch_deg=7.0)
    caster = PolygonCaster(camera_polygon())

    def shares(x: float) -> Floats:
        moved = replace(board, center_mm=(x, 5.0, 1500.0))
        return np.asarray(dense(caster.cast(Model(sensor=camera_polygon(), surfaces=(moved,))), 1)[0][0])

    here = [shares(10 + 0.001 * k) for k in range(12)]
    steps = np.abs(np.diff(here, axis=0))
    pixel_mm = 1500 * np.radians(0.6)
    assert 0.5 * 0.001 / pixel_mm < steps.max() < 1.5 * 0.001 / pixel_mm
