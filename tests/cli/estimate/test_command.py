"""`tofmix estimate`: from a recording to a layers file, with every option."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode
from tofmix.io.recording.recording_file import file_sha256


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "a.h5", boards(40))


def _read(path: Path) -> dict[str, Any]:
    with h5py.File(path) as root:
        return {name: item[...] for name, item in root.items() if isinstance(item, h5py.Dataset)} | dict(root.attrs)


def test_estimate_finds_the_surfaces_of_the_model(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    outcome = tofmix("estimate", recording)
    assert outcome.code == 0, outcome.err
    found = _read(tmp_path / "a.layers.h5")
    assert outcome.out.startswith(f"{tmp_path / 'a.layers.h5'}: 4 x 6 pixels, 1 window of 40 frames")
    np.testing.assert_allclose(found["range"][0, :, 0, 0], 1200, atol=15)
    np.testing.assert_allclose(found["range"][0, :, -1, 0], 3000, atol=25)
    assert np.all(found["n_modes"][0, :, 3] == 2)
    assert found["source"] == "a.h5"
    assert found["source_sha256"] == file_sha256(recording)
    options = json.loads(found["options"])
    assert options == {
        "sigma": "prior",
        "refine": "likelihood",
        "false_alarm": 0.001,
        "counter": "kde",
        "gamma": 0.02,
        "epsilon": 0.01,
        "max_layers": 6,
        "max_iter": 50,
        "tol": 0.001,
        "min_samples": 3,
        "noise": "file",
        "outliers": "file",
        "window": 40,
        "stride": 40,
    }


def test_bytes_do_not_depend_on_workers_memory_or_time(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    for name, extra in (("x", ["--workers", 1]), ("y", ["--workers", 3, "--memory", "250MB"]), ("z", [])):
        assert tofmix("estimate", recording, "-o", tmp_path / name, "--window", 15, "--stride", 5, *extra).code == 0
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes() == (tmp_path / "z").read_bytes()


def test_frames_after_the_last_window_are_left_out_with_a_note(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    outcome = tofmix("estimate", recording, "--window", 15)
    assert "2 windows of 15 frames" in outcome.out
    assert "10 frames after the last whole window left out" in outcome.err
    found = _read(tmp_path / "a.layers.h5")
    assert found["window_stop"].tolist() == [15, 30]
    assert found["frames_left_out"] == 10


@pytest.mark.parametrize(
    ("option", "value", "changes"),
    [
        ("--sigma", "free", "sigma"),
        ("--max-layers", 1, "n_modes"),
        ("--noise", "sr3000", "sigma"),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("--sigma", "tied", "sigma"),
                ("--gamma", 0.9, "n_peaks"),
                ("--max-iter", 1, "n_iter"),
                ("--tol", 1e-12, "n_iter"),
                ("--min-samples", 41, "status"),
                ("--epsilon", 5.0, "n_peaks"),
            )
        ),
    ],
)
def test_every_option_of_estimate_changes_its_layers(
    tofmix: Tofmix, recording: Path, tmp_path: Path, option: str, value: object, changes: str
) -> None:
    # Counted by likelihood, surfaces so far apart are at their end after two steps.
    more = ["--refine", "none"] if option == "--tol" else []
    tofmix("estimate", recording, "-o", tmp_path / "plain", *more)
    outcome = tofmix("estimate", recording, "-o", tmp_path / "changed", option, value, *more)
    assert outcome.code == 0, outcome.err
    plain, changed = _read(tmp_path / "plain"), _read(tmp_path / "changed")
    assert not np.array_equal(plain[changes], changed[changes], equal_nan=True)
    assert plain["options"] != changed["options"]


@pytest.mark.slow
@pytest.mark.compiled("a frequency over 1600 pixels")
def test_higher_false_alarm_rate_gives_more_second_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    path = write_recording(tmp_path / "a.h5", rng.normal(1200, 22, (40, 40, 40)).astype("u2"))
    counts = []
    for false_alarm in (1e-5, 0.1):
        assert tofmix("estimate", path, "--overwrite", "--false-alarm", false_alarm).code == 0
        counts.append(np.sum(_read(tmp_path / "a.layers.h5")["n_modes"] > 1))
    assert counts[0] < 5
    assert counts[1] > 60
    assert tofmix("estimate", path, "--overwrite", "--refine", "none").code == 0
    found = _read(tmp_path / "a.layers.h5")
    # A component may lose its samples to another in the fit.
    assert np.mean(found["n_modes"] == found["n_peaks"]) > 0.99
    assert np.sum(found["n_modes"] > 1) > 60
    assert tofmix("estimate", path, "--refine", "none", "--false-alarm", 0.01).code == ExitCode.USAGE


def test_noise_profile_replaces_a_missing_curve(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(), noise=None)
    outcome = tofmix("estimate", path, "--noise", "sr3000")
    assert outcome.code == 0
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert json.loads(root.attrs["options"])["noise"] == "sr3000"


@pytest.mark.parametrize("shape", [(20, 1, 16), (20, 16, 1), (20, 1, 1), (3, 2, 2), (25, 480, 3)])
def test_estimate_accepts_other_image_sizes(tofmix: Tofmix, tmp_path: Path, shape: tuple[int, int, int]) -> None:
    path = write_recording(tmp_path / "a.h5", np.full(shape, 1500, "u2"))
    assert tofmix("estimate", path).code == 0
    assert _read(tmp_path / "a.layers.h5")["range"].shape == (1, *shape[1:], 6)


def test_invalid_samples_are_skipped_and_counted(tofmix: Tofmix, tmp_path: Path) -> None:
    samples = boards().astype("f4")
    samples[:, 0, 0] = np.nan
    samples[:10, 1, 1] = np.nan
    path = write_recording(tmp_path / "a.h5", samples)
    assert tofmix("estimate", path).code == 0
    found = _read(tmp_path / "a.layers.h5")
    assert found["status"][0, 0, 0] == 1
    assert found["n_samples"][0, 1, 1] == 20


@pytest.mark.parametrize(
    ("extra", "code", "reason"),
    [
        (["--window", 41], ExitCode.USAGE, "longer than the recording's 40"),
        (["--noise", "sr9000"], ExitCode.USAGE, "unknown profile 'sr9000'"),
        (["--max-layers", 33], ExitCode.USAGE, "33 is not in the range 1<=x<=32"),
        (["--gamma", "nan"], ExitCode.USAGE, "gamma"),
        (["-o", "/proc/none/a.h5"], ExitCode.STORAGE, "no such folder"),
        (["--memory", "much"], ExitCode.USAGE, "'much' is not a size; write 300MB or 1.5GB"),
        (["--memory", "10MB"], ExitCode.USAGE, "'10MB' is too small; give at least 250MB"),
        (["--shard", "3/2"], ExitCode.USAGE, "'3/2' is not a part I/N"),
        (["--shard", "1/2", "--scheduler", "tcp://none:1"], ExitCode.USAGE, "--scheduler exclude each other"),
        (["--stride", 5], ExitCode.USAGE, "--stride needs --window"),
        (["-o", ""], ExitCode.USAGE, "the path is empty"),
    ],
)
def test_estimate_refuses_options_with_their_exit_code(
    tofmix: Tofmix, recording: Path, tmp_path: Path, extra: list[object], code: int, reason: str
) -> None:
    outcome = tofmix("estimate", recording, *extra)
    assert outcome.code == code
    assert reason in outcome.err
    assert outcome.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_existing_output_is_kept_without_overwrite(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    (tmp_path / "a.layers.h5").write_text("old")
    assert tofmix("estimate", recording).code == ExitCode.USAGE
    assert (tmp_path / "a.layers.h5").read_text() == "old"
    assert tofmix("estimate", recording, "-o", recording, "--overwrite").code == ExitCode.USAGE
    assert tofmix("estimate", recording, "--overwrite").code == 0


def test_damage_found_during_reading_leaves_no_output(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(400), chunks=(100, 4, 6), fletcher32=True)
    with h5py.File(path) as root:
        offset = root["range"].id.get_chunk_info(3).byte_offset
    data = bytearray(path.read_bytes())
    data[offset + 5] ^= 255
    path.write_bytes(data)
    outcome = tofmix("estimate", path, "--window", 100)
    assert outcome.code == ExitCode.BAD_INPUT
    assert outcome.err.startswith(f"tofmix: {path}: range: cannot be read")
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_layers_file_passes_the_format_checker(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    contract = Path(__file__).parents[4] / "shared" / "check_contract.py"
    if not contract.exists():
        pytest.skip("the contract's checker is not beside this checkout")
    tofmix("estimate", recording, "--window", 15)
    subprocess.run([sys.executable, contract, tmp_path / "a.layers.h5"], check=True)


def test_paper_option_writes_the_papers_algorithm_and_refuses_options_that_it_does_not_have(
    tofmix: Tofmix, recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "paper.layers.h5"
    done = tofmix("estimate", recording, "-o", out, "--paper", "--gamma", "0.1")
    assert done.code == 0, done.err
    with h5py.File(out) as file:
        options = json.loads(file.attrs["options"])
        assert (options["paper"], options["gamma"], options["sigma"]) == (True, 0.1, "free")
        assert set(np.unique(file["n_iter"][:])) <= {0, 50}
    for option in (("--sigma", "tied"), ("--refine", "likelihood"), ("--tol", "0.01"), ("--wrap",)):
        refused = tofmix("estimate", recording, "-o", tmp_path / "no.h5", "--paper", *option)
        assert refused.code == 2
        assert f"{option[0]} and --paper exclude each other" in refused.err
