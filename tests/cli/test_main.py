"""The command as a whole: help, reference, options in the environment, exit codes, signals, streams and the bar."""

import fcntl
import json
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import cli_page
import click
import h5py
import numpy as np
import pytest
from man_pages import man_pages
from support.commandline import Tofmix
from support.files import boards, wall_model, write_recording

from tofmix.cli.main import main, unknown_variables
from tofmix.cli.reporter import Progress
from tofmix.errors import EXIT_CODE_MEANINGS, ExitCode
from tofmix.io.importers import IMPORTERS
from tofmix.io.importers.folder import IMAGE_KINDS
from tofmix.io.next_command import foreign_fault, import_command

PROGRAM = (sys.executable, "-m", "tofmix")


def test_help_shows_how_to_start_and_the_exit_codes(tofmix: Tofmix) -> None:
    shown = tofmix.done("--help")
    assert "tofmix simulate three-boards -o boards.h5" in shown.out
    assert "_TOFMIX_COMPLETE=bash_source" in shown.out
    assert "TOFMIX_ESTIMATE_WORKERS=1" in shown.out
    for code, text in EXIT_CODE_MEANINGS.items():
        assert f"{int(code)}  {text}" in shown.out


@pytest.mark.parametrize("command", main.commands)
def test_help_of_each_command_has_examples(tofmix: Tofmix, command: str) -> None:
    shown = tofmix.done(command, "--help")
    assert f"Examples:\n    tofmix {command}" in shown.out
    assert "--quiet" in shown.out
    assert max(len(line) for line in shown.out.splitlines()) <= 100


def test_help_imports_no_large_library() -> None:
    program = (
        "import sys\n"
        "from tofmix.cli.main import run\n"
        "try:\n    run(['--help'])\n"
        "except SystemExit:\n    pass\n"
        "print([m for m in ('numba', 'scipy', 'h5py', 'numpy', 'matplotlib') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


def test_the_bare_command_prints_its_help_as_help_does(tofmix: Tofmix) -> None:
    bare, asked = tofmix(), tofmix("--help")
    assert (bare.code, asked.code) == (ExitCode.USAGE, 0)
    assert (bare.out, bare.err) == ("", asked.out)
    assert bare.err.count("\n") > 30


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["estimate"],
        ["estimate", "a.h5", "--nonsense"],
        ["estimate", "a.h5", "--window", "0"],
        ["estimate", "a.h5", "--sigma", "loose"],
        ["simulate", "corridor"],
        ["simulate", "corridor", "-o"],
        ["report", "a.h5", "--window", "-1"],
    ],
)
def test_usage_errors_leave_with_2(tofmix: Tofmix, arguments: list[str]) -> None:
    outcome = tofmix(*arguments)
    assert outcome.code == ExitCode.USAGE
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("tofmix: ")


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), ExitCode.STORAGE, "out of memory; close other programs"),
        (OSError(28, "No space left on device", "x.h5"), ExitCode.STORAGE, "x.h5: No space left on device"),
        (click.ClickException("no\nsuch"), ExitCode.USAGE, "no such"),
    ],
)
def test_any_error_prints_one_line_and_returns_its_exit_code(
    tofmix: Tofmix, monkeypatch: pytest.MonkeyPatch, error: Exception, code: ExitCode, said: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("tofmix.cli.main._discard", lambda _: None)  # pytest's own
    for command in main.commands.values():
        monkeypatch.setattr(command, "callback", fail)
    outcome = tofmix("warmup")
    assert outcome.code == code
    assert outcome.err.startswith(f"tofmix: {said}")
    assert outcome.err.count("\n") == 1


def test_variables_of_the_environment_do_not_switch_commands(tofmix: Tofmix, monkeypatch: pytest.MonkeyPatch) -> None:
    # TOFMIX_VERSION is what a CI job would call the version it installs.
    monkeypatch.setenv("TOFMIX_VERSION", "1")
    monkeypatch.setenv("TOFMIX_SIMULATE_LIST", "1")
    assert tofmix("simulate", "corridor").code == ExitCode.USAGE


def _to(stdout: int | IO[str]) -> "subprocess.CompletedProcess[str]":
    command = [*PROGRAM, "simulate", "--list"]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


def test_a_full_stdout_is_a_storage_error_and_a_closed_pipe_no_traceback() -> None:
    with Path("/dev/full").open("w") as full:
        done = _to(full)
    assert done.returncode == ExitCode.STORAGE
    assert done.stderr == "tofmix: standard output: No space left on device\n"
    reader, writer = os.pipe()
    os.close(reader)
    done = _to(writer)
    os.close(writer)
    assert done.returncode == 128 + signal.SIGPIPE
    assert done.stderr == ""


def test_full_stderr_keeps_the_exit_code(tmp_path: Path) -> None:
    program = "from tofmix.cli.main import run; run(['info', 'none.h5'])"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-c", program], stderr=full, cwd=tmp_path, check=False)
    assert done.returncode == ExitCode.BAD_INPUT


@pytest.mark.parametrize("then", [None, ValueError("cannot be closed")])
def test_memory_error_of_any_library_is_one_line(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, then: Exception | None
) -> None:
    def none(*_: object, **__: object) -> None:
        try:
            raise MemoryError
        finally:
            if then is not None:
                raise then

    monkeypatch.setattr("tofmix.io.guard.guard.StructureChecker.check", none)
    path = write_recording(tmp_path / "a.h5", boards())
    result = tofmix("info", path)
    assert result.code == ExitCode.STORAGE
    assert result.err.startswith("tofmix: out of memory; ")
    assert result.err.count("\n") == 1


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
    tofmix.done("estimate", tmp_path / "a.h5", "-o", tmp_path / "paper.h5", "--paper")
    assert options_of(tmp_path / "paper.h5")["sigma"] == "free"
    monkeypatch.setenv("TOFMIX_ESTIMATE_PAPER", "1")
    assert "--sigma and --paper exclude each other" in tofmix("estimate", tmp_path / "a.h5").err
    tofmix.done("estimate", tmp_path / "a.h5", "-o", tmp_path / "sigma.h5", "--sigma", "tied")
    assert options_of(tmp_path / "sigma.h5")["sigma"] == "tied"
    assert "paper" not in options_of(tmp_path / "sigma.h5")


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
    tofmix.done("estimate", write_recording(tmp_path / "a.h5", boards(20)))
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
    done.refused(ExitCode.USAGE, said)
    assert "MODULATION" not in done.err


def test_unknown_variable_is_said_in_one_line_and_the_command_runs(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "a.npy", WALL)
    monkeypatch.setenv("TOFMIX_IMPORT_UNIT", "mm")
    done = tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    assert done.err == "tofmix: not used: TOFMIX_IMPORT_UNIT, in the environment: no option has this name\n"


@pytest.mark.slow
def test_file_names_that_are_no_utf_8_are_read_and_written(tmp_path: Path) -> None:
    """One process runs all commands; the name comes to it as the shell gives it."""
    name = b"m\xfcll".decode("utf-8", "surrogateescape")
    np.save(tmp_path / "a.npy", np.rint(np.random.default_rng(1).normal(1500.0, 4.0, (30, 3, 4))).astype("u2"))
    (tmp_path / "a.npy").rename(tmp_path / f"{name}.npy")
    commands = """
        import NAME.npy -o NAME.h5 --fov 40x30
        estimate NAME.h5
        verify NAME.h5 NAME.layers.h5
        info NAME.layers.h5
        report NAME.layers.h5 --recording NAME.h5 --html NAME.html
        export NAME.layers.h5 -o NAME.ply
        compare NAME.layers.h5 NAME.layers.h5 --html NAME-twice.html
        map NAME.layers.h5 -o NAME.yaml
    """
    program = (
        "import sys\nfrom support.commandline import succeed\n"
        "for line in sys.argv[1].strip().splitlines():\n    succeed(*line.replace('NAME', sys.argv[2]).split())\n"
    )
    here = os.pathsep.join(str(Path(__file__).parents[up]) for up in (1, 2))
    strict = os.environ | {"PYTHONIOENCODING": "utf-8:strict", "PYTHONPATH": here}  # as in a terminal of UTF-8
    done = subprocess.run(
        [sys.executable, "-c", program, commands, name], cwd=tmp_path, env=strict, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob(f"{name}*"))) > 6


DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "reference/cli.md"
OPTIONS = [
    (name, option)
    for name, command in main.commands.items()
    for option in command.params
    if isinstance(option, click.Option)
]


def printed(**environment: str) -> bytes:
    """What the command of the page prints."""
    command: list[str | Path] = [sys.executable, DOCS / "generators/cli_page.py"]
    return subprocess.run(command, capture_output=True, check=True, env=os.environ | environment).stdout


def test_the_page_has_every_option_and_depends_on_no_terminal() -> None:
    if PAGE.read_bytes() != printed():
        pytest.fail(f"docs/reference/cli.md is not what the commands say; write it anew: {cli_page.COMMAND}")
    page = PAGE.with_name("exit-codes.md").read_text(encoding="utf-8")
    assert page == cli_page.exit_codes(), f"run: {cli_page.EXIT_CODES_COMMAND}"
    assert all(f"| {int(code)} | " in page for code in EXIT_CODE_MEANINGS)
    narrow = printed(COLUMNS="40", TERM="dumb", TOFMIX_ESTIMATE_MAX_LAYERS="9", FORCE_COLOR="1", LC_ALL="C")
    assert narrow == printed()
    assert len(OPTIONS) > 50
    offenders = [f"{command} {option.opts[-1]}" for command, option in OPTIONS if _misprinted(command, option)]
    assert not offenders, "\n".join(offenders)
    for _, option in OPTIONS:
        if not option.is_flag:
            assert option.name == option.opts[-1].removeprefix("--").replace("-", "_")


def _misprinted(command: str, option: click.Option) -> bool:
    """Whether the row of an option is not what its help and its default say."""
    section = cli_page.reference().split(f"\n## tofmix {command}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if f"`{option.opts[-1]}`" in line and line.startswith("| `-")]
    # A default that is no constant stands at the end of the help and has its own column on the page.
    text, _, default = (option.help or "").removesuffix("]").partition("  [default: ")
    shown = str(option.default) if option.show_default else default
    return not (text and rows and rows[0].endswith(f"| {text} |") and f"| {shown} |" in rows[0])


SCRIPT = Path(__file__).parents[2] / "docs/generators/man_pages.py"


def shown(page: Path) -> str:
    """A page as man shows it, without bold and underlined letters, and in one line."""
    groff = shutil.which("groff") or ""
    done = subprocess.run([groff, "-man", "-Tascii", "-ww", page], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return " ".join(re.sub(r"\x1b\[[\d;]*m|.\x08", "", done.stdout).split())


def test_manual_pages_list_commands_options_examples_and_exit_codes() -> None:
    pages = man_pages()
    assert set(pages) == {"tofmix.1", *(f"tofmix-{name}.1" for name in main.commands)}
    for name, command in main.commands.items():
        page = pages[f"tofmix-{name}.1"].replace("\\-", "-")
        missing = [o for p in command.params for o in p.opts if o.startswith("-") and f"\\fB{o}\\fR" not in page]
        assert missing == []
        assert f"tofmix {name}" in page.split(".SH EXAMPLES")[1]
    page = man_pages()["tofmix.1"].replace("\\-", "-")
    assert all(f"\\fBtofmix-{name}\\fR(1)" in page for name in main.commands)
    assert all(f"\\fB{int(code)}\\fR\n{text}" in page for code, text in EXIT_CODE_MEANINGS.items())


def test_script_of_manual_pages_writes_a_folder_or_prints_its_usage(tmp_path: Path) -> None:
    subprocess.run([sys.executable, SCRIPT, tmp_path / "man"], check=True)
    assert {p.name: p.read_text() for p in (tmp_path / "man").iterdir()} == man_pages()
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "usage" in done.stderr


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff here")
def test_groff_shows_backslashes_dots_and_dashes_as_they_are(tmp_path: Path) -> None:
    page = tmp_path / "tofmix.1"
    page.write_text(man_pages()["tofmix.1"])
    text = shown(page)
    assert 'eval "$(_TOFMIX_COMPLETE=bash_source tofmix)"' in text
    assert "--overwrite" in text


@pytest.mark.parametrize(
    ("name", "kind", "target"),
    [
        ("x.npy", "an array", "x.h5"),
        ("x.csv", "a table", "x.h5"),
        ("run 1.bag", "a bag", "'run 1.h5'"),
        ("depth.tiff", "an image", "depth.h5"),
    ],
)
def test_a_foreign_file_names_its_import(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, kind: str, target: str
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "x.npy", boards())
    (tmp_path / "x.npy").rename(tmp_path / name)
    done = tofmix("estimate", name)
    quoted = f"'{name}'" if " " in name else name
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {name} is {kind}, not HDF5: tofmix import {quoted} -o {target}\n"


def test_an_image_names_the_import_of_its_folder(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "d_1.png").touch()
    monkeypatch.chdir(tmp_path)
    done = tofmix("estimate", "run/d_1.png")
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == "tofmix: run/d_1.png is an image, not HDF5: tofmix import run -o run.h5\n"
    monkeypatch.chdir(tmp_path / "run")
    for given, said in (("d_1.png", "d_1.png is an image"), (".", ". is a folder of images")):
        done = tofmix("estimate", given)
        assert done.code == ExitCode.BAD_INPUT
        assert done.err == f"tofmix: {said}, not HDF5: tofmix import . -o run.h5\n"


def test_every_kind_of_source_is_known_to_the_errors_of_other_commands() -> None:
    known_elsewhere = {".mat", ".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".nc", ".txt"}  # may be HDF5, or anything
    sources = {suffix for importer in IMPORTERS for suffix in importer.suffixes} | IMAGE_KINDS.keys()
    unknown = [suffix for suffix in sources if foreign_fault(Path(f"a{suffix}")) is None]
    assert set(unknown) <= known_elsewhere


def test_errors_of_missing_and_foreign_files_name_the_next_command(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("estimate", tmp_path / "x.npy")
    assert (done.code, "No such file" in done.err) == (ExitCode.BAD_INPUT, True)
    with h5py.File(tmp_path / "depth.mat", "w") as root:
        root["depth"] = boards()
    done = tofmix("estimate", tmp_path / "depth.mat")
    done.refused(ExitCode.BAD_INPUT, f"tofmix import {tmp_path / 'depth.mat'} -o {tmp_path / 'depth.h5'}")
    recording = write_recording(tmp_path / "a.h5", boards())
    done = tofmix("simulate", recording, "-o", tmp_path / "b.h5")
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {recording} is an HDF5 file, not a model: tofmix info {recording}\n"
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["zones"] = np.ones((9, 2, 3, 4), dtype="u2")
    done = tofmix("import", tmp_path / "a.h5", "-o", tmp_path / "b.h5")
    done.refused(ExitCode.BAD_INPUT, "name the axes, such as --axes frame,target,row,col")


def test_a_recording_is_for_estimate_and_layers_for_report(tofmix: Tofmix, tmp_path: Path) -> None:
    recording, layers = write_recording(tmp_path / "a.h5", boards()), tmp_path / "a.layers.h5"
    tofmix.done("estimate", recording)
    for command in (("report",), ("inspect", "--pixel", "1,1"), ("export", "-o", tmp_path / "a.csv")):
        done = tofmix(command[0], recording, *command[1:])
        assert done.code == ExitCode.BAD_INPUT
        assert (
            done.err == f"tofmix: {recording}: not a layers file; if it is a recording: tofmix estimate {recording}\n"
        )
    with h5py.File(recording, "a") as root:
        root.attrs["format"], root.attrs["format_version"] = "tofmix-recording", "1.0"
    done = tofmix("report", recording)
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {recording} is a recording, not a layers file: tofmix estimate {recording}\n"
    done = tofmix("estimate", layers)
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {layers} is a layers file, not a recording: tofmix report {layers}\n"


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("d_1.png", " is a folder of images, not HDF5: tofmix import {0} -o {0}.h5"),
        ("metadata.yaml", " is a bag, not HDF5: tofmix import {0} -o {0}.h5"),
        ("gap.json", " is a folder of reconcile, not HDF5: tofmix info {0}"),
        ("notes.txt", ": a folder, not a file"),
    ],
)
def test_folder_is_reported_as_a_folder(tofmix: Tofmix, tmp_path: Path, inside: str, said: str) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / inside).touch()
    done = tofmix("estimate", folder)
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {folder}{said.format(folder)}\n"


def test_import_that_keeps_one_target_names_its_file_after_it(tmp_path: Path) -> None:
    kept = import_command(tmp_path / "zones.h5", "--target", "nearest")
    assert kept.endswith(f"-o {tmp_path / 'zones_nearest.h5'}")
    assert import_command(tmp_path / "zones.h5", "--units", "m").endswith(f"-o {tmp_path / 'zones_mm.h5'}")


FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}
AT_COMMIT = """
import os, sys, time
from tofmix.io.storage import AtomicFile
number = int(sys.argv[1])
def stop(self):
    print(*os.listdir(self.path.parent), sep="\\n", flush=True)
    os.kill(os.getpid(), number)
    time.sleep(60)
AtomicFile.commit = stop
from tofmix.cli.start import run
sys.argv[:] = ["tofmix", *sys.argv[2:]]
run()
"""


@pytest.fixture
def folder(tofmix: Tofmix, tmp_path: Path) -> Path:
    recording = write_recording(tmp_path / "a.h5", boards(40), attributes=FOV)
    tofmix.done("estimate", recording, "--window", 20)
    np.save(tmp_path / "a.npy", boards(40))
    return tmp_path


@pytest.mark.parametrize(
    ("number", "arguments"),
    [
        pytest.param(
            signal.SIGINT,
            ("simulate", "near-far", "--frames", "3", "-o", "out.h5"),
            marks=[pytest.mark.compiled("a whole scene in another process"), pytest.mark.slow],
        ),
        (signal.SIGTERM, ("import", "a.npy", "-o", "out.h5", "--sensor", "sr3000")),
        pytest.param(
            signal.SIGINT, ("export", "a.layers.h5", "-o", "out.ply", "--window", "0"), marks=pytest.mark.slow
        ),
        pytest.param(signal.SIGTERM, ("map", "a.layers.h5", "-o", "out.yaml", "--cell", "500"), marks=pytest.mark.slow),
    ],
)
def test_signal_ends_each_command_without_leftovers(
    folder: Path, arguments: tuple[str, ...], number: signal.Signals
) -> None:
    before = sorted(folder.iterdir())
    program = [sys.executable, "-c", AT_COMMIT, str(int(number)), *arguments]
    start = time.monotonic()
    done = subprocess.run(program, capture_output=True, text=True, check=False, cwd=folder, timeout=120)
    assert done.returncode == -number, done.stderr
    assert ".tofmix-partial" in done.stdout  # it was there
    assert sorted(folder.iterdir()) == before
    assert done.stderr == ("tofmix: interrupted\n" if number == signal.SIGINT else "")
    assert time.monotonic() - start < 60  # and not when the block has ended


def test_ctrl_c_before_imports_gives_no_traceback(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys\nfrom tofmix.cli.start import run\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'tofmix.cli.main':\n            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Stop())\nrun()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == -signal.SIGINT
    assert done.stderr == ""


MODEL = wall_model(4, 6, 20)


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A terminal of no size, as serial lines and some containers have: its two ends."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 0, 0, 0, 0))
    yield ours, theirs
    for end in (ours, theirs):
        os.close(end)


def _shown(terminal: tuple[int, int], *arguments: object) -> str:
    """What a command writes on the terminal that is its stderr."""
    command = [sys.executable, "-m", "tofmix", *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=terminal[1], check=False, timeout=120)
    assert done.returncode == 0
    os.set_blocking(terminal[0], False)
    try:
        return os.read(terminal[0], 1 << 16).decode()
    except BlockingIOError:  # nothing was written
        return ""


@pytest.mark.slow
def test_progress_bar_moves_on_a_terminal_without_a_width(terminal: tuple[int, int], tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    shown = _shown(terminal, "simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5")
    assert "simulate:   0%" in shown
    assert shown.endswith("\r")  # wiped out
    assert max(len(line) for line in shown.split("\r")) <= 80


def test_quiet_keeps_results_and_warnings_and_drops_notes(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(45))
    loud = tofmix("estimate", recording, "--window", 20)
    quiet = tofmix("estimate", recording, "--window", 20, "-q", "--resume")
    assert "blocks from the interrupted run" in tofmix("estimate", recording, "--window", 20, "--resume").err
    assert quiet.out == loud.out
    assert "blocks from the interrupted run" not in quiet.err
    assert "5 frames after the last whole window left out" in quiet.err


@pytest.mark.parametrize("command", ["simulate", "estimate", "import", "surfaces", "merge"])
def test_hdf5_is_not_written_under_the_name_of_another_kind(tofmix: Tofmix, tmp_path: Path, command: str) -> None:
    source = write_recording(tmp_path / "a.h5", boards(20))
    refused = tofmix(command, source, "-o", tmp_path / "b.png")
    refused.refused(ExitCode.USAGE, "b.png: the file will be HDF5, so its name must not end in .png; choose .h5")


def test_each_writing_command_describes_its_output_in_json(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    twice = tofmix("simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5", "--repeat", 2, "--json")
    first, second = (json.loads(line) for line in twice.out.splitlines())
    assert first == {
        "output": str(tmp_path / "a_001.h5"),
        "frames": 20,
        "rows": 4,
        "cols": 6,
        "seed": 1,
        "averaged": False,
    }
    assert second["seed"] == 2
    layers = tmp_path / "a_001.layers.h5"
    tofmix.done("estimate", tmp_path / "a_001.h5")
    points = json.loads(tofmix("export", layers, "-o", tmp_path / "a.csv", "--json").out)
    assert points == {"output": str(tmp_path / "a.csv"), "points": 24, "windows": 1}
    map_of = json.loads(tofmix("map", layers, "-o", tmp_path / "a.yaml", "--json").out)
    assert map_of["map"]["path"] == str(tmp_path / "a.yaml")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_its_script(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tofmix"],
        env=os.environ | {"_TOFMIX_COMPLETE": f"{shell}_source"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "_TOFMIX_COMPLETE" in done.stdout


def test_where_stderr_is_no_terminal_a_line_a_minute_says_how_far(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr("tofmix.cli.reporter.time.monotonic", lambda: now[0])
    with Progress(4000, "estimate", "px") as bar:
        for now[0] in (30.0, 61.0, 90.0, 130.0):
            bar.update(1000)
    expected = "tofmix: estimate: 2,000 of 4,000 px (50 %)\ntofmix: estimate: 4,000 of 4,000 px (100 %)\n"
    assert capsys.readouterr().err == expected
