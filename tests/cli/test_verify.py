"""`tofmix verify`: exit codes, one line a fault, JSON."""

import json
from pathlib import Path

import h5py
import pytest
from support.commandline import Estimated, Tofmix
from support.files import boards

from tofmix.errors import ExitCode


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(40), window=20)


def test_verify_of_valid_files_exits_with_0(tofmix: Tofmix, layers: Path) -> None:
    done = tofmix("verify", layers, layers.with_name("a.h5"))
    assert done.code == ExitCode.DONE
    assert done.out == (
        f"{layers}: layers, 17 datasets read; no fault\n"
        f"{layers.with_name('a.h5')}: recording, 1 dataset read; no fault\n"
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


MODEL = """
[sensor]
profile = "sr3000"
rows = 6
cols = 8
[recording]
frames = 12
[[surface]]
name = "board"
center_mm = [0.0, 0.0, 2000.0]
size_mm = [1500.0, 1500.0]
[[effect]]
kind = "fixed_pattern"
pixel_sigma_mm = 3.0
column_sigma_mm = 1.0
row_sigma_mm = 1.0
[[effect]]
kind = "interference"
probability = 0.2
sigma_mm = 50.0
[[effect]]
kind = "motion"
surface = "board"
velocity_mm_s = 100.0
"""


def test_every_dataset_that_is_written_has_checksums(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    assert tofmix("simulate", tmp_path / "model.toml", "-o", tmp_path / "a.h5").code == 0
    assert tofmix("estimate", tmp_path / "a.h5", "--window", 6).code == 0
    for name, expected in (("a.h5", "truth/range_true_frames"), ("a.layers.h5", "sensor/noise_sigma")):
        datasets: dict[str, bool] = {}

        def see(path: str, item: h5py.Group | h5py.Dataset, found: dict[str, bool] = datasets) -> None:
            if isinstance(item, h5py.Dataset):
                found[path] = bool(item.fletcher32)

        with h5py.File(tmp_path / name) as root:
            root.visititems(see)
        assert expected in datasets
        assert [path for path, guarded in datasets.items() if not guarded] == []
        assert tofmix("verify", tmp_path / name).code == 0
