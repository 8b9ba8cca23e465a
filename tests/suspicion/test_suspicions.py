"""Marks on scenes that are made up layer by layer, and on their way through the files."""

import json
import math
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.cameras import camera_of

import tofmix
from tofmix.arrays import BoolArray, FloatArray
from tofmix.cli.main import main
from tofmix.errors import DoubtWarning
from tofmix.io.verify import verify
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of
from tofmix.suspicion.evidence import log_chance
from tofmix.suspicion.folded import mark_folded
from tofmix.suspicion.near_return import mark_near_return
from tofmix.suspicion.passing import mark_passing
from tofmix.suspicion.scattered_light import mark_scattered
from tofmix.suspicion.scene import NO_CLUSTERS, WindowScene

TURN_MM = 7495.0
OPTICS = Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)


def scene(
    range_mm: FloatArray,
    amplitude: FloatArray | None = None,
    *,
    view: bool = True,
    weight: float = 0.5,
    clusters: FloatArray = NO_CLUSTERS,
    memory: FloatArray | None = None,
) -> WindowScene:
    """Layers (row, col, layer) with a sigma of 10 mm and a standard error of 1 mm."""
    there = np.isfinite(range_mm)
    return WindowScene(
        range_mm=range_mm,
        sigma_mm=np.where(there, 10.0, np.nan),
        stderr_mm=np.where(there, 1.0, np.nan),
        weight=np.where(there, weight, np.nan),
        amplitude=amplitude,
        directions=beam_directions_of(OPTICS, range_mm.shape[:2]) if view else None,
        turn_mm=TURN_MM,
        clusters=clusters,
        memory=np.zeros(4) if memory is None else memory,
    )


def light(range_mm: FloatArray, albedo: FloatArray | float) -> FloatArray:
    return np.asarray(1000.0 * albedo * (1000.0 / range_mm) ** 2)


def boards(shape: tuple[int, int] = (24, 32)) -> tuple[FloatArray, FloatArray]:
    """A wall, NaN, with two boards before it: ranges and albedos (row, col)."""
    range_mm, albedo = np.full(shape, np.nan), np.full(shape, 0.6)
    for rows, cols, away, white in ((slice(2, 10), slice(2, 10), 1800, 0.8), (slice(12, 20), slice(18, 28), 2700, 0.4)):
        range_mm[rows, cols], albedo[rows, cols] = away, white
    return range_mm, albedo


def folded_wall(view: bool, wall_mm: float = 9800.0) -> tuple[WindowScene, BoolArray]:
    near, albedo = boards()
    cosine = beam_directions_of(OPTICS, near.shape)[..., 2]
    is_wall: BoolArray = np.isnan(near)
    true = np.where(is_wall, wall_mm, near) / cosine
    range_mm = np.mod(true, TURN_MM)
    made = scene(range_mm[..., np.newaxis], light(true, albedo)[..., np.newaxis], view=view)
    return made, is_wall


@pytest.mark.parametrize("view", [True, False])
def test_folded_wall_is_marked_and_boards_are_not(view: bool) -> None:
    made, is_wall = folded_wall(view)
    marked = mark_folded(made)[..., 0]
    assert marked[is_wall].all()
    assert not marked[~is_wall].any()


def test_walls_that_are_near_or_flat_are_not_marked_as_folded() -> None:
    made, _ = folded_wall(view=True, wall_mm=4000.0)
    assert not mark_folded(made).any()
    made, _ = folded_wall(view=True)
    assert not mark_folded(made._replace(amplitude=None)).any()
    assert not mark_folded(made._replace(turn_mm=None)).any()
    near, albedo = boards()
    cosine = beam_directions_of(OPTICS, near.shape)[..., 2]
    range_mm = np.where(np.isnan(near), 2300.0, near) / cosine
    amplitude = light(range_mm, np.where(np.isnan(near), 0.03, albedo))
    assert not mark_folded(scene(range_mm[..., np.newaxis], amplitude[..., np.newaxis])).any()


def test_dark_paint_on_a_surface_is_not_marked_as_folded() -> None:
    """A chessboard, and boards of two paints, slanted: the dark parts continue the bright ones."""
    row, col = np.mgrid[:24, :32]
    range_mm, albedo = boards()
    beams = beam_directions_of(OPTICS, range_mm.shape)
    wall = 2600.0 / (beams @ np.array([0.5, 0.1, np.sqrt(0.74)]))
    is_wall: BoolArray = np.isnan(range_mm)
    dark = (row // 6 + col // 6) % 2 == 0
    near = np.where(is_wall, wall, range_mm / beams[..., 2])
    painted = np.where(is_wall & dark, 0.06, np.where(is_wall, 0.8, albedo))
    assert not mark_folded(scene(near[..., np.newaxis], light(near, painted)[..., np.newaxis])).any()
    holes = np.where(is_wall & dark, 8900.0 / beams[..., 2], near)  # the dark squares are holes before a far wall
    lit = light(holes, np.where(is_wall, 0.6, albedo))
    marked = mark_folded(scene(np.mod(holes, TURN_MM)[..., np.newaxis], lit[..., np.newaxis]))[..., 0]
    assert marked[is_wall & dark].all()
    assert not marked[~(is_wall & dark)].any()


def ghost(amplitude: float, bright: float = 4000.0) -> WindowScene:
    """Eight by eight zones with a layer at 1.2 m, bright in one of them, before a wall at 2.6 m."""
    range_mm = np.stack([np.full((8, 8), 1200.0), np.full((8, 8), 2600.0)], axis=-1)
    strength = np.full((8, 8), amplitude)
    strength[3, 4] = bright
    return scene(range_mm, np.stack([strength, light(range_mm[..., 1], 0.6)], axis=-1))


def test_scattered_light_is_marked_wholly() -> None:
    marked = mark_scattered(ghost(6.0))
    assert marked[..., 0].sum() == 63
    assert not marked[3, 4, 0]
    assert not marked[..., 1].any()
    made, third = ghost(6.0), np.full((8, 8, 1), np.nan)
    assert made.amplitude is not None
    range_mm, amplitude = (np.concatenate([part, third], axis=-1) for part in (made.range_mm, made.amplitude))
    range_mm[6, 6] = 1200.0, 1238.0, 2600.0
    amplitude[6, 6, 1:] = 6.0, amplitude[6, 6, 1]
    split = scene(range_mm, amplitude)
    marked = mark_scattered(split)
    assert marked[6, 6].tolist() == [True, True, False]


@pytest.mark.parametrize(("frames", "samples"), [(8, 2), (9, 3), (10, 5)])
def test_chance_of_an_interval_is_that_of_all_sets(frames: int, samples: int) -> None:
    sets = list(combinations(range(frames), samples))
    for length in range(samples, frames):
        exact = sum(chosen[-1] - chosen[0] + 1 <= length for chosen in sets) / len(sets)
        assert log_chance(frames, samples, 0, length) == pytest.approx(min(0.0, math.log(2.0 * exact)), abs=1e-9)
        outside = sum(
            any(chosen[k + samples - 2] - chosen[k] + 1 <= length for k in range(2)) for chosen in sets
        ) / len(sets)
        assert log_chance(frames, samples, 1, length) >= min(0.0, math.log(4.0 * outside)) - 1e-9


def passing(samples: float, length: float, memory: FloatArray | None = None, *, standing: bool = False) -> bool:
    """Whether a layer before a wall, of `samples` of 100 frames in an interval of `length`, is marked as passing."""
    range_mm = np.full((5, 5, 2), np.nan)
    range_mm[..., 1] = 3000.0
    range_mm[2, 2, 0] = 1500.0
    made = scene(range_mm, weight=0.9)
    if standing:
        made.range_mm[2, 3, 0], made.weight[2, 3, 0], made.sigma_mm[2, 3, 0] = 1500.0, 0.9, 10.0
    made.weight[2, 2] = 0.1, 0.9
    cluster = np.array([[2, 2, 0, 100, samples, 0, length, 30, 30 + length - 1]], float)
    marked = mark_passing(made._replace(clusters=cluster, memory=np.zeros(4) if memory is None else memory))
    return bool(marked[2, 2, 0])


def test_samples_close_in_time_are_passing_unless_noise_or_a_standing_surface_explains_them() -> None:
    assert passing(10, 12)
    assert not passing(3, 40)
    assert passing(4, 4)
    assert not passing(4, 4, np.array([0.9, 1.0, 0.0, 0.0]))
    assert not passing(10, 12, standing=True)


@pytest.mark.parametrize(("close", "marked"), [(1, 0), (60, 60)])
def test_where_many_layers_pass_less_evidence_marks_one(close: int, marked: int) -> None:
    rng = np.random.default_rng(1)
    range_mm = np.full((20, 20, 2), 5000.0)
    range_mm[..., 0] = rng.uniform(500.0, 4500.0, (20, 20))
    made = scene(range_mm)
    made.weight[:] = 0.03, 0.97
    pixel = rng.permutation(300)[:close]
    # Three samples in four of 100 frames: chance puts them there in 0.4 % of the layers that are there all the time
    cluster = np.column_stack([*np.divmod(pixel, 20), *np.tile([0, 100, 3, 0, 4, 20, 23], (close, 1)).T]).astype(float)
    found = mark_passing(made._replace(clusters=cluster))
    assert found.sum() == marked
    assert found[np.divmod(pixel, 20)][:, 0].sum() == marked


@pytest.mark.parametrize(("apart_mm", "is_passing"), [(30.0, False), (300.0, True)])
def test_layers_of_a_wall_that_drifts_are_not_passing_and_layers_apart_are(apart_mm: float, is_passing: bool) -> None:
    range_mm = 3000.0 + apart_mm * np.arange(3.0) + np.zeros((3, 3, 1))
    made = scene(range_mm)
    made.weight[:] = 0.3, 0.4, 0.3
    clusters = np.array(
        [[1, 1, layer, 100, 30, 0, 32, first, first + 31] for layer, first in ((0, 0), (1, 34), (2, 68))], float
    )
    marked = mark_passing(made._replace(clusters=clusters))
    assert marked[1, 1].tolist() == [is_passing] * 3


def test_cover_glass_is_a_near_return_and_a_net_far_away_is_not() -> None:
    behind = np.full((8, 8), 1500.0)
    near = mark_near_return(scene(np.stack([np.full((8, 8), 25.0), behind], axis=-1)))
    assert near[..., 0].all()
    assert not near[..., 1].any()
    assert not mark_near_return(scene(np.stack([np.full((8, 8), 1000.0), behind], axis=-1))).any()
    assert not mark_near_return(scene(np.full((8, 8, 1), 76.0), weight=1.0)).any()


FRAMES, START, STOP = 100, 20, 32


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tofmix.Estimate]:
    """Something that passes before a wall at 3 m from frame 20 on, until frame 32, in 36 of 64 pixels."""
    rng = np.random.default_rng(3)
    range_mm = np.full((2 * FRAMES, 8, 8), 3000.0)
    range_mm[START:STOP, 1:7, 1:7] = 1500.0
    range_mm += rng.normal(0, 10, range_mm.shape)
    sensor = camera_of([1000.0], [10.0], reach_mm=(100.0, 7000.0), fov_deg=(40.0, 40.0))
    recording = tofmix.from_array(range_mm, units="mm", sensor=sensor)
    folder = tmp_path_factory.mktemp("passing")
    path = recording.save(folder / "passing.h5")
    result = CliRunner().invoke(main, ["estimate", str(path), "--window", str(FRAMES)])
    assert result.exit_code == 0, result.output
    with pytest.warns(DoubtWarning, match="in a part of the frames"):
        layers = tofmix.estimate(recording, window=FRAMES)
    return folder / "passing.layers.h5", layers


def test_file_and_python_mark_the_passing_layers(made: tuple[Path, tofmix.Estimate]) -> None:
    path, layers = made
    with h5py.File(path) as file:
        suspect, frames = file["suspect"][...], file["suspect_frames"][...]
        assert file["suspect"].attrs["flag_masks"].tolist() == [1, 2, 4, 8]
    assert (suspect[0, 1:7, 1:7, 0] == 4).sum() >= 35
    assert not suspect[1].any()
    assert (suspect > 0).sum() <= 36
    assert frames[0, 3, 3, 0].tolist() == [START, STOP - 1]
    assert layers.suspect is not None
    np.testing.assert_array_equal(layers.suspect, suspect)
    np.testing.assert_array_equal(layers.suspect_frames, frames)


def test_verify_accepts_marks_and_notices_wrong_ones(made: tuple[Path, tofmix.Estimate], tmp_path: Path) -> None:
    path, _ = made
    assert verify(path).ok
    for name, value in (("suspect", 16), ("suspect_frames", 7)):
        wrong = tmp_path / f"{name}.layers.h5"
        wrong.write_bytes(path.read_bytes())
        with h5py.File(wrong, "r+") as file:
            place = (1, 0, 0, 0)
            file[name][place] = value
        assert not verify(wrong).ok


@pytest.mark.parametrize("command", [["export", "points.csv"], ["map", "map.yaml"], ["surfaces", "fine.surfaces.h5"]])
def test_commands_leave_suspect_layers_out_and_say_so(
    command: list[str], made: tuple[Path, tofmix.Estimate], tmp_path: Path
) -> None:
    path, _ = made
    call = [command[0], str(path), "-o", str(tmp_path / command[1])]
    without = CliRunner().invoke(main, call)
    assert without.exit_code == 0, without.output
    assert "suspect layers left out (--suspect takes them)" in without.output
    taken = CliRunner().invoke(main, [*call, "--suspect", "--overwrite"])
    assert taken.exit_code == 0, taken.output
    assert "left out" not in taken.output


def test_report_and_info_count_marks(made: tuple[Path, tofmix.Estimate]) -> None:
    path, layers = made
    count = int((np.asarray(layers.suspect) > 0).sum())
    report = json.loads(CliRunner().invoke(main, ["report", str(path), "--json"]).stdout)
    assert report["layers_by_suspicion"]["passing"] == count
    assert "in a part of the frames" in CliRunner().invoke(main, ["report", str(path)]).stdout
    info = json.loads(CliRunner().invoke(main, ["info", str(path), "--json"]).stdout)
    assert info["suspect_layers"]["passing"] == count


@pytest.mark.parametrize("names", ["suspect,suspect_frames", "all"])
def test_exported_points_have_the_frames_of_passing_layers(
    names: str, made: tuple[Path, tofmix.Estimate], tmp_path: Path
) -> None:
    path, _ = made
    output = tmp_path / "points.csv"
    result = CliRunner().invoke(main, ["export", str(path), "-o", str(output), "--suspect", "--fields", names])
    assert result.exit_code == 0, result.output
    points = np.genfromtxt(output, delimiter=",", names=True)
    marked = points["suspect"] > 0
    assert 35 <= marked.sum() <= 36
    assert set(points["suspect_frames_first"][marked]) <= set(range(START, START + 3))
    assert set(points["suspect_frames_last"][marked]) <= set(range(STOP - 3, STOP))
    assert not points["suspect_frames_first"][~marked].any()
    assert not points["suspect_frames_last"][~marked].any()
