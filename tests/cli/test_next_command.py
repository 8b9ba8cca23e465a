"""Errors name the command that takes the file."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode
from tofmix.io.importers import IMPORTERS
from tofmix.io.importers.folder import IMAGE_KINDS
from tofmix.io.next_command import foreign_fault, import_command


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


def test_missing_array_is_reported_as_missing(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("estimate", tmp_path / "x.npy")
    assert (done.code, "No such file" in done.err) == (ExitCode.BAD_INPUT, True)


def test_a_recording_is_for_estimate_and_layers_for_report(tofmix: Tofmix, tmp_path: Path) -> None:
    recording, layers = write_recording(tmp_path / "a.h5", boards()), tmp_path / "a.layers.h5"
    assert tofmix("estimate", recording).code == 0
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


def test_hdf5_of_another_layout_names_import(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "depth.mat", "w") as root:
        root["depth"] = boards()
    done = tofmix("estimate", tmp_path / "depth.mat")
    assert done.code == ExitCode.BAD_INPUT
    assert f"tofmix import {tmp_path / 'depth.mat'} -o {tmp_path / 'depth.h5'}" in done.err


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


def test_recording_given_as_model_is_refused_with_the_next_command(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards())
    done = tofmix("simulate", recording, "-o", tmp_path / "b.h5")
    assert done.code == ExitCode.BAD_INPUT
    assert done.err == f"tofmix: {recording} is an HDF5 file, not a model: tofmix info {recording}\n"


def test_array_of_four_axes_needs_the_axes_option(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["zones"] = np.ones((9, 2, 3, 4), dtype="u2")
    done = tofmix("import", tmp_path / "a.h5", "-o", tmp_path / "b.h5")
    assert done.code == ExitCode.BAD_INPUT
    assert "name the axes, such as --axes frame,target,row,col" in done.err


def test_import_that_keeps_one_target_names_its_file_after_it(tmp_path: Path) -> None:
    kept = import_command(tmp_path / "zones.h5", "--target", "nearest")
    assert kept.endswith(f"-o {tmp_path / 'zones_nearest.h5'}")
    assert import_command(tmp_path / "zones.h5", "--units", "m").endswith(f"-o {tmp_path / 'zones_mm.h5'}")
