"""`tofmix verify`: exit codes, one line a fault, JSON."""

import json
from pathlib import Path

import h5py
import pytest
from commandline import Tofmix
from files import boards, write_recording

from tofmix.errors import ExitCode


@pytest.fixture
def layers(tofmix: Tofmix, tmp_path: Path) -> Path:
    assert tofmix("estimate", write_recording(tmp_path / "a.h5", boards(40)), "--window", 20).code == 0
    return tmp_path / "a.layers.h5"


def test_whole_files(tofmix: Tofmix, layers: Path) -> None:
    done = tofmix("verify", layers, layers.with_name("a.h5"))
    assert done.code == ExitCode.DONE
    assert done.out == (
        f"{layers}: layers, 16 datasets read; nothing is wrong\n"
        f"{layers.with_name('a.h5')}: recording, 1 datasets read; nothing is wrong\n"
    )
    assert "range: without checksum" in done.err


def test_a_fault_has_its_line_and_its_exit_code(tofmix: Tofmix, layers: Path) -> None:
    with h5py.File(layers, "r+") as root:
        root["weight"][0, 1, 2, 0] = 0.5
        root["weight"][1, 1, 2, 0] = 0.5
    refused = tofmix("verify", layers)
    assert refused.code == ExitCode.BAD_INPUT
    rule = "sums to 1 with weight_no_return and weight_outlier"
    assert refused.out == f"{layers}: weight: broken: {rule} (window 0, row 1, col 2 and 1 more)\n"
    assert refused.err == ""
    described = json.loads(tofmix("verify", layers, layers.with_name("a.h5"), "--json").out)
    assert not described["ok"]
    assert [file["ok"] for file in described["files"]] == [False, True]
    assert described["files"][0]["faults"][0]["count"] == 2
    assert tofmix("verify", layers, layers.with_name("a.h5")).code == ExitCode.SOME_FAILED
    assert tofmix("verify", layers, layers.with_name("none.h5")).code == ExitCode.BAD_INPUT


def test_names_in_a_file_do_not_reach_the_terminal_raw(tofmix: Tofmix, layers: Path) -> None:
    with h5py.File(layers, "r+") as root:
        root["range"].attrs["units"] = "\x1b[31m\nm"
    assert "\x1b" not in tofmix("verify", layers).out
    assert tofmix("verify", layers).out.count("\n") == 1
