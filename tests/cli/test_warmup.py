"""`tofmix warmup`: afterwards nothing is compiled, whatever the options."""

from pathlib import Path

import pytest
from commandline import Tofmix
from files import boards, write_recording

from tofmix.jit import cache_folder


def test_it_prints_the_folder_and_the_number_of_kernels(tofmix: Tofmix) -> None:
    outcome = tofmix("warmup")
    assert outcome.code == 0, outcome.err
    assert outcome.out == f"{cache_folder()}: {len(_compiled())} compiled kernels\n"


def _compiled() -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in cache_folder().rglob("*.nbc")}


@pytest.mark.compiled("there is nothing to compile")
def test_after_it_no_option_of_estimate_compiles_a_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    assert tofmix("warmup").code == 0
    before = _compiled()
    recording = write_recording(tmp_path / "a.h5", boards())
    for options in (
        ["--sigma", "tied"], ["--sigma", "free", "--refine", "none"], ["--counter", "cpdf"], ["--counter", "fourier"],
        ["--max-layers", "1"], ["--outliers", "0.01"], ["--window", "7"],
    ):  # fmt: skip
        assert tofmix("estimate", recording, *options, "--overwrite").code == 0
        assert _compiled() == before, options


@pytest.mark.compiled("there is nothing to compile")
def test_after_it_measuring_noise_and_simulating_compile_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    assert tofmix("warmup").code == 0
    before = _compiled()
    recording = write_recording(tmp_path / "a.h5", boards(60, 8, 12))
    assert tofmix("estimate", recording, "--noise", "auto", "--outliers", "auto").code == 0
    assert tofmix("simulate", "corridor", "--frames", "2", "-o", tmp_path / "c.h5").code == 0
    assert _compiled() == before


@pytest.mark.compiled("there is nothing to compile")
def test_after_it_reconciling_compiles_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    model, measured = tmp_path / "model.toml", tmp_path / "measured.h5"
    model.write_text(
        '[sensor]\nprofile = "sr4000"\nrows = 8\ncols = 10\n[recording]\nframes = 40\n'
        '[[surface]]\nname = "board"\ncenter_mm = [-300.0, 0.0, 1500.0]\nsize_mm = [500.0, 500.0]\n'
    )
    assert tofmix("simulate", model, "-o", measured).code == 0
    assert tofmix("warmup").code == 0
    before = _compiled()
    model.write_text(model.read_text() + '[[effect]]\nkind = "quantisation"\nstep_mm = 9.0\n')
    done = tofmix("reconcile", model, measured, "-o", tmp_path / "gap", "--effects", "interference,range_offset")
    assert done.code == 0, done.err
    assert _compiled() == before
