"""Options in the environment: those of the command line win, and names of no option are said."""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.cli.main import unknown_variables
from tofmix.errors import ExitCode

WALL = np.full((5, 2, 3), 1500, dtype=np.uint16)


def test_option_on_the_command_line_wins_over_one_in_the_environment_that_excludes_it(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "a.npy", WALL)
    monkeypatch.setenv("TOFMIX_IMPORT_SCALE", "0.25")
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert ", 0.25 mm a unit;" in done.out
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "b.h5", "--units", "mm")
    assert (done.code, done.err) == (0, "")
    assert ", 1 mm a unit;" in done.out
    monkeypatch.setenv("TOFMIX_IMPORT_UNITS", "mm")
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "c.h5")
    assert "--units and --scale both set the unit" in done.err


def options_of(path: Path) -> dict[str, object]:
    with h5py.File(path) as root:
        options: dict[str, object] = json.loads(root.attrs["options"])
        return options


def test_typed_paper_wins_over_options_of_the_environment_and_typed_options_over_its_paper(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "a.h5", boards(20))
    monkeypatch.setenv("TOFMIX_ESTIMATE_SIGMA", "tied")
    done = tofmix("estimate", tmp_path / "a.h5", "-o", tmp_path / "paper.h5", "--paper")
    assert done.code == 0, done.err
    assert options_of(tmp_path / "paper.h5")["sigma"] == "free"
    monkeypatch.setenv("TOFMIX_ESTIMATE_PAPER", "1")
    assert "--sigma and --paper exclude each other" in tofmix("estimate", tmp_path / "a.h5").err
    done = tofmix("estimate", tmp_path / "a.h5", "-o", tmp_path / "sigma.h5", "--sigma", "tied")
    assert done.code == 0, done.err
    assert options_of(tmp_path / "sigma.h5")["sigma"] == "tied"
    assert "paper" not in options_of(tmp_path / "sigma.h5")


@pytest.mark.parametrize(
    ("variable", "value", "typed"),
    [
        ("FALSE_ALARM", "0.01", ("--refine", "none")),
        ("BINS", "20", ("--counter", "kde")),
        ("REFINE", "none", ("--false-alarm", "0.01")),
    ],
)
def test_typed_option_wins_over_one_of_the_environment_that_belongs_to_another(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, typed: tuple[str, str]
) -> None:
    write_recording(tmp_path / "a.h5", boards(20))
    monkeypatch.setenv(f"TOFMIX_ESTIMATE_{variable}", value)
    done = tofmix("estimate", tmp_path / "a.h5", "-o", tmp_path / "out.h5", *typed)
    assert done.code == 0, done.err


def test_variables_of_no_option_are_named_and_those_of_options_are_not() -> None:
    names = ("TOFMIX_ESTIMATE_WORKERS", "TOFMIX_IMPORT_VALID_STATUS", "TOFMIX_READ_TIMEOUT", "PATH", "TOFMIX")
    assert unknown_variables(dict.fromkeys(names, "1")) == {}
    no_name, typed = "no option has this name", "is for the command line alone"
    wrong = {
        "TOFMIX_WORKERS": no_name,
        "TOFMIX_ESTIMATE_WORKER": no_name,
        "TOFMIX_ESTIMATE_OVERWRITE": f"--overwrite {typed}",
        "TOFMIX_SENSORS_TOML": f"--toml {typed}",
        "TOFMIX_MERGE_QUIET": f"--quiet {typed}",
    }
    assert unknown_variables(dict.fromkeys(wrong, "1")) == wrong


def test_export_takes_options_of_the_environment_where_they_belong(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert tofmix("estimate", write_recording(tmp_path / "a.h5", boards(20))).code == 0
    monkeypatch.setenv("TOFMIX_EXPORT_SCALE", "2")
    monkeypatch.setenv("TOFMIX_EXPORT_FOV", "50x40")
    done = tofmix("export", tmp_path / "a.layers.h5", "-o", tmp_path / "a.ply")
    assert (done.code, done.err) == (0, "")
    assert "50 x 40 degrees, equal angles" in done.out
    done = tofmix("export", tmp_path / "a.layers.h5", "-o", tmp_path / "a.png")
    assert (done.code, done.err) == (0, "")
    assert "2 mm a count" in done.out
    done = tofmix("export", tmp_path / "a.layers.h5", "-o", tmp_path / "b.png", "--fov", "50x40")
    assert "--fov does not belong to .png" in done.err


@pytest.mark.parametrize("text", ["ten", "-3", "nan", "0"])
def test_time_limit_that_is_no_number_of_seconds_is_said(text: str) -> None:
    assert unknown_variables({"TOFMIX_READ_TIMEOUT": text}) == {
        "TOFMIX_READ_TIMEOUT": f"{text!r} is no number of seconds above 0"
    }


def test_each_long_name_of_an_option_is_a_variable(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez(tmp_path / "a.npz", near=WALL, far=2 * WALL)
    for name in ("DATASET", "TOPIC"):
        with monkeypatch.context() as environment:
            environment.setenv(f"TOFMIX_IMPORT_{name}", "far")
            done = tofmix("import", tmp_path / "a.npz", "-o", tmp_path / f"{name}.h5")
        assert done.code == 0, done.err
        with h5py.File(tmp_path / f"{name}.h5") as root:
            assert (root["range"][()] == 2 * WALL).all()


def test_typed_lens_wins_over_one_of_the_environment(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "a.npy", WALL)
    arguments = ("import", tmp_path / "a.npy", "--depth-axis", "z", "--overwrite", "-o", tmp_path / "a.h5")
    lenses = {"INTRINSICS": "40,40,1,0.5", "FOV": "30x20"}
    for variable, other in (("INTRINSICS", "FOV"), ("FOV", "INTRINSICS")):
        with monkeypatch.context() as environment:
            environment.setenv(f"TOFMIX_IMPORT_{variable}", lenses[variable])
            done = tofmix(*arguments, f"--{other.lower()}", lenses[other])
        assert done.code == 0, done.err
        assert ("fx 40 fy 40" in done.out) == (other == "INTRINSICS")
        assert ("30 x 20 degrees" in done.out) == (other == "FOV")
    done = tofmix(*arguments, "--fov", lenses["FOV"], "--intrinsics", lenses["INTRINSICS"])
    assert done.code == ExitCode.USAGE
    assert "--intrinsics and --fov both set the lens; give one of them" in done.err


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("SHAPE", "3x2", "leave the option out (TOFMIX_IMPORT_SHAPE in the environment)"),
        ("UNITS", "ell", "(TOFMIX_IMPORT_UNITS in the environment) See tofmix import"),
        ("FOV", "wide", "such as 70x55 (TOFMIX_IMPORT_FOV in the environment)"),
    ],
)
def test_error_names_the_variable_that_sets_the_option(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, said: str
) -> None:
    np.save(tmp_path / "a.npy", WALL)
    monkeypatch.setenv(f"TOFMIX_IMPORT_{variable}", value)
    monkeypatch.setenv("TOFMIX_IMPORT_MODULATION_FREQUENCY", "2e7")
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert done.code == ExitCode.USAGE
    assert said in done.err
    assert "MODULATION" not in done.err


def test_unknown_variable_is_said_in_one_line_and_the_command_runs(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "a.npy", WALL)
    monkeypatch.setenv("TOFMIX_IMPORT_UNIT", "mm")
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert done.code == 0
    assert done.err == "tofmix: not used: TOFMIX_IMPORT_UNIT, in the environment: no option has this name\n"


@pytest.mark.slow
def test_file_names_that_are_no_utf_8_are_read_and_written(tmp_path: Path) -> None:
    name = b"m\xfcll".decode("utf-8", "surrogateescape")
    np.save(tmp_path / "a.npy", np.rint(np.random.default_rng(1).normal(1500.0, 4.0, (30, 3, 4))).astype("u2"))
    (tmp_path / "a.npy").rename(tmp_path / f"{name}.npy")
    strict = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}  # as in a terminal of UTF-8
    for arguments in (
        ("import", f"{name}.npy", "-o", f"{name}.h5", "--fov", "40x30"),
        ("estimate", f"{name}.h5"),
        ("verify", f"{name}.h5", f"{name}.layers.h5"),
        ("info", f"{name}.layers.h5"),
        ("report", f"{name}.layers.h5", "--recording", f"{name}.h5", "--html", f"{name}.html"),
        ("export", f"{name}.layers.h5", "-o", f"{name}.ply"),
        ("compare", f"{name}.layers.h5", f"{name}.layers.h5", "--html", f"{name}-twice.html"),
        ("map", f"{name}.layers.h5", "-o", f"{name}.yaml"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "tofmix", *arguments], cwd=tmp_path, env=strict, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr
