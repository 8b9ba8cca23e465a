"""`tofmix surfaces`: from layers to a file, and what the other commands make of that file."""

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import plyfile
import pytest
from support import naive_png
from support.commandline import Estimated, Tofmix
from support.files import boards
from support.planes_found import board_and_wall, nothing_found, write_surfaces

from tofmix.errors import ExitCode
from tofmix.io.exporters import OF_SURFACES
from tofmix.io.verify import verify

FOV = {"fov_horizontal_deg": 14.0, "fov_vertical_deg": 12.0}
CONTRACT = Path(__file__).parents[3] / "shared" / "check_contract.py"


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    """Layers of two windows of two boards side by side, mixed in the middle columns."""
    return estimated(boards(80, 12, 14), window=40, attributes=FOV)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Made-up surfaces of one window."""
    return write_surfaces(tmp_path / "made.surfaces.h5", board_and_wall())


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """Made-up surfaces of three windows."""
    return write_surfaces(tmp_path / "three.surfaces.h5", board_and_wall(), nothing_found(), board_and_wall())


def test_surfaces_file_is_written_next_to_the_layers(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    shown = tofmix("surfaces", layers)
    out = tmp_path / "a.surfaces.h5"
    assert shown.code == 0, shown.err
    # A board of one range along all beams is a part of a sphere about the camera.
    line = rf"{re.escape(str(out))}: (\d+) surfaces \(2 smooth, no plane\), (\d+) edge lines? of (\d+) points?"
    line += r" \(median error 0\.\d{3} pixels\), range image 96 x 112 of each of 2 windows"
    line += r"; edges assume that shares are areas\n"
    found = re.fullmatch(line, shown.out)
    assert found, shown.out
    with h5py.File(out) as root:
        counts = len(root["n_pixels"]), len(np.unique(root["edge_line"])), len(root["edge_row"])
        assert tuple(int(n) for n in found.groups()) == counts
        assert root.attrs["source"] == "a.layers.h5"
        assert json.loads(root.attrs["options"]) == {"factor": 8}
        fine = root["range_fine"][0]
        assert np.count_nonzero(np.isnan(root["plane_offset_mm"][...])) == 2
    assert np.median(fine[:, :40]) == pytest.approx(1200.0, abs=20.0)
    assert np.median(fine[:, -40:]) == pytest.approx(3000.0, abs=20.0)
    assert verify(out).lines() == []
    if CONTRACT.exists():
        subprocess.run([sys.executable, CONTRACT, out], check=True)


def test_edge_between_two_boards_is_found_at_its_true_place(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    tofmix.done("surfaces", layers, "--factor", 4)
    with h5py.File(tmp_path / "a.surfaces.h5") as root:
        fine = root["range_fine"][0]
        assert fine.shape == (48, 56)
        assert root["range_fine"].attrs["factor"] == 4
    # Of columns 0 to 13, 6 has no light of the far board, 7 half of it, 8 nothing else.
    assert np.nanmax(fine[:, : 6 * 4]) < 1500
    assert np.nanmin(fine[:, 9 * 4 :]) > 2500


def test_surfaces_has_json_and_repeatable_bytes(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        shown = tofmix.done("surfaces", layers, "-o", tmp_path / name, "--factor", 3, "--json", "--quiet")
        said = json.loads(shown.out)
        assert said["output"] == str(tmp_path / name)
        assert (said["rows_fine"], said["cols_fine"], said["factor"], said["windows"]) == (36, 42, 3, 2)
        assert said["surfaces"] >= 4
        assert said["edge_points"] >= said["edge_lines"] > 0
        assert 0 < said["edge_stderr_median"] < 1
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_surfaces_refuses_files_and_outputs_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    out = ("-o", tmp_path / "x.surfaces.h5")
    for arguments, code, text in (
        ((layers, "--factor", 1), ExitCode.USAGE, "2<=x<=32"),
        ((layers, "--factor", 33), ExitCode.USAGE, "2<=x<=32"),
        ((tmp_path / "none.layers.h5", *out), ExitCode.BAD_INPUT, "none.layers.h5"),
        ((tmp_path / "a.h5", *out), ExitCode.BAD_INPUT, "tofmix estimate"),
        ((layers, "-o", tmp_path / "none" / "x.h5"), ExitCode.STORAGE, "no such folder"),
    ):
        tofmix("surfaces", *arguments).refused(code, text)
    assert sorted(tmp_path.iterdir()) == before


def test_search_error_exits_with_3_and_leaves_no_file(
    tofmix: Tofmix, layers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("fx: no beam passes")

    monkeypatch.setattr("tofmix.jobs.surfaces.reconstruct", refuse)
    refused = tofmix("surfaces", layers)
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err == f"tofmix: {layers}: window 0: fx: no beam passes\n"
    assert not (tmp_path / "a.surfaces.h5").exists()


@pytest.mark.parametrize("command", ["report", "map", "surfaces", "inspect", "compare", "estimate"])
def test_wrong_commands_name_the_command_for_a_surfaces_file(tofmix: Tofmix, path: Path, command: str) -> None:
    more = {
        "map": ("-o", path.with_name("a.yaml")),
        "surfaces": ("-o", path.with_name("b.h5")),
        "compare": (path,),
        "inspect": ("--pixel", "1,1"),
        "estimate": ("-o", path.with_name("b.h5")),
    }.get(command, ())
    refused = tofmix(command, path, *more)
    refused.refused(
        ExitCode.BAD_INPUT, f"is a surfaces file, not a {'recording' if command == 'estimate' else 'layers file'}"
    )
    remedy = refused.err.rpartition(": tofmix ")[2].split()
    tofmix.done(*remedy)


def test_info_describes_a_surfaces_file(tofmix: Tofmix, three: Path) -> None:
    described = json.loads(tofmix("info", three, "--json").out)
    assert described["kind"] == "surfaces"
    assert described["sizes"] == {
        "windows": 3,
        "rows": 6,
        "cols": 8,
        "max_layers": 3,
        "file_bytes": three.stat().st_size,
        "factor": 4,
        "rows_fine": 24,
        "cols_fine": 32,
    }
    assert described["found"] == {"surfaces": 4, "smooth_surfaces": 0, "edge_lines": 4, "edge_points": 14}
    assert described["made_from"]["source"] == "a.layers.h5"
    assert described["options"] == {"factor": 4}
    assert described["warnings"] == []
    assert "edge_lines" in tofmix("info", three).out


def test_smooth_surface_is_left_out_of_planes_and_verify_wants_both_nan(tofmix: Tofmix, path: Path) -> None:
    with h5py.File(path, "r+") as root:
        root["plane_offset_mm"][1] = np.nan
    assert "plane_offset_mm: broken: 0 mm or more, or NaN with its normal" in tofmix("verify", path).out
    with h5py.File(path, "r+") as root:
        root["plane_normal"][1] = np.nan
    tofmix.done("verify", path)
    shown = tofmix("export", path, "-o", path.with_name("a.json"), "--what", "planes")
    assert "1 surface with 1 polygon; 1 smooth surface left out: no plane" in shown.out
    assert len(json.loads(path.with_name("a.json").read_text())["surfaces"]) == 1
    assert json.loads(tofmix("info", path, "--json").out)["found"]["smooth_surfaces"] == 1


@pytest.mark.parametrize(
    ("name", "what", "line"),
    [
        ("a.geojson", None, "2 edge lines of 7 points"),
        ("a.json", None, "2 edge lines of 7 points"),
        ("a.json", "planes", "2 surfaces with 2 polygons"),
        ("a.obj", None, "2 edge lines of 7 points"),
        ("a.obj", "planes", "2 surfaces with 2 polygons"),
        ("a.ply", None, "2 edge lines of 7 points"),
        ("a.ply", "points", "672 points of 1 window"),
        ("a.pcd", None, "672 points of 1 window"),
        ("a.csv", None, "672 points of 1 window"),
        ("a.png", None, "range image 24 x 32, 672 with a range, 1 mm a count, 0 = none"),
        ("a.tif", "image", "range image 24 x 32, 672 with a range, 1 mm a count, 0 = none"),
    ],
)
def test_every_export_format_is_written(
    tofmix: Tofmix, path: Path, tmp_path: Path, name: str, what: str | None, line: str
) -> None:
    arguments = ("export", path, "-o", tmp_path / name, *(("--what", what) if what else ()))
    shown = tofmix.done(*arguments)
    assert shown.out == f"{tmp_path / name}: {line}\n"
    assert tofmix(*arguments).code == ExitCode.USAGE
    said = json.loads(tofmix(*arguments, "--overwrite", "--json").out)
    assert said["output"] == str(tmp_path / name)
    assert said["what"] in OF_SURFACES
    assert (said["what"] == what) or what is None


def test_export_of_one_window_has_its_surfaces(tofmix: Tofmix, three: Path, tmp_path: Path) -> None:
    tofmix.done("export", three, "-o", tmp_path / "all.ply")
    tofmix.done("export", three, "-o", tmp_path / "one.ply", "--window", 2)
    every, one = (plyfile.PlyData.read(tmp_path / f"{name}.ply")["vertex"].data for name in ("all", "one"))
    assert len(every) == 14
    assert set(one["window"]) == {2}
    assert set(one["line"]) == {2, 3}
    tofmix.done("export", three, "-o", tmp_path / "a.png", "--window", 2, "--scale", 0.5)
    counts, _ = naive_png.decode((tmp_path / "a.png").read_bytes())
    with h5py.File(three) as root:
        range_mm = root["range_fine"][2]
    np.testing.assert_array_equal(counts, np.where(np.isfinite(range_mm), np.rint(range_mm / 0.5), 0))
    none = tofmix.done("export", three, "-o", tmp_path / "none.geojson", "--window", 1)
    assert "the file is empty" in none.err


def test_impossible_exports_are_refused(tofmix: Tofmix, three: Path, layers: Path, tmp_path: Path) -> None:
    def out(name: str) -> tuple[str, Path]:
        return "-o", tmp_path / name

    before = sorted(tmp_path.iterdir())
    for arguments, code, text in (
        ((three, *out("a.las")), ExitCode.USAGE, "must end in one of .geojson"),
        ((three, *out("a.png"), "--what", "edges"), ExitCode.USAGE, "--what edges cannot be written as .png"),
        ((three, *out("a.png")), ExitCode.USAGE, "--window"),
        ((three, *out("a.ply"), "--window", 3), ExitCode.USAGE, "windows 0 to 2"),
        ((three, *out("a.ply"), "--layer", 1), ExitCode.USAGE, "--layer does not belong to a surfaces file"),
        ((three, *out("a.ply"), "--fov", "40x30"), ExitCode.USAGE, "--fov does not belong to a surfaces file"),
        ((three, *out("a.ply"), "--scale", 2), ExitCode.USAGE, "--scale does not belong to edges of a surfaces file"),
        ((three, *out("a.tif"), "--window", 0, "--scale", 0.01), ExitCode.BAD_INPUT, "another --scale"),
        ((layers, *out("a.geojson")), ExitCode.USAGE, f"{layers} has no edges: run tofmix surfaces {layers}"),
        ((layers, *out("a.ply"), "--what", "edges"), ExitCode.USAGE, "tofmix surfaces"),
        ((layers, *out("a.ply"), "--what", "image"), ExitCode.USAGE, "--what image cannot be written as .ply"),
    ):
        tofmix("export", *arguments).refused(code, text)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_report_shows_surfaces_of_the_same_layers_alone(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    surfaces, page = tmp_path / "a.surfaces.h5", tmp_path / "a.html"
    tofmix.done("surfaces", layers)
    tofmix.done("report", layers, "--surfaces", surfaces, "--window", 1, "--html", page)
    text = page.read_text()
    assert "Edges over the nearest layers" in text
    assert "Range below a pixel" in text

    tofmix("report", layers, "--surfaces", surfaces).refused(ExitCode.USAGE, "--surfaces needs --html")

    tofmix.done("estimate", tmp_path / "a.h5", "--window", 20, "-o", tmp_path / "b.layers.h5")
    shown = tofmix("report", tmp_path / "b.layers.h5", "--surfaces", surfaces, "--html", tmp_path / "b.html")
    shown.refused(ExitCode.BAD_INPUT, "made from another layers file")
    assert not (tmp_path / "b.html").exists()
