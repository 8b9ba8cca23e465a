"""Marks on their way: from samples to a layers file, the same in Python, and out of exports."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import tofmix
from tofmix.cli.main import main
from tofmix.errors import DoubtWarning
from tofmix.io.verify import verify
from tofmix.sensor import NoiseCurve, Sensor

FRAMES, START, STOP = 100, 20, 32


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tofmix.Estimate]:
    """Something that passes before a wall at 3 m from frame 20 on, until frame 32, in 36 of 64 pixels."""
    rng = np.random.default_rng(3)
    range_mm = np.full((2 * FRAMES, 8, 8), 3000.0)
    range_mm[START:STOP, 1:7, 1:7] = 1500.0
    range_mm += rng.normal(0, 10, range_mm.shape)
    noise = NoiseCurve(np.array([1000.0]), np.array([10.0]))
    sensor = Sensor(
        name="made up",
        fov_horizontal_deg=40.0,
        fov_vertical_deg=40.0,
        range_min_mm=100.0,
        range_max_mm=7000.0,
        noise=noise,
    )
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
