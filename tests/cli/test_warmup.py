"""`tofmix warmup`: afterwards nothing is compiled, whatever the options."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from numba.core import event
from support.commandline import Tofmix, succeed
from support.files import boards, write_recording
from support.lock_in import small, write_sums

from tofmix.compiled.kept import SUFFIX, cache_folder
from tofmix.pipeline import kernels
from tofmix.reconciliation import workflow

KERNELS = 24
"""Kernels that commands call: other kernels are compiled inside these."""

FOLDER = cache_folder()


def _count() -> int:
    assert FOLDER is not None
    return sum(1 for _ in FOLDER.glob(f"*{SUFFIX}"))


def test_warmup_compiles_all_and_prints_folder_kernels_and_size(
    tofmix: Tofmix, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it compiles, the other tests hold."""
    compiled: list[str] = []
    monkeypatch.setattr(kernels, "compile_all", lambda: compiled.append("all commands but reconcile"))
    monkeypatch.setattr(
        workflow, "warm_up", lambda model: compiled.append(f"reconcile: {len(model.surfaces)} surfaces")
    )
    before = _count()
    outcome = tofmix.done("warmup")
    assert compiled == ["all commands but reconcile", "reconcile: 3 surfaces"]
    said = re.fullmatch(rf"{re.escape(str(FOLDER))}: (\d+) compiled kernels?, (\d+\.\d) MB\n", outcome.out)
    assert said is not None, outcome.out
    assert before <= int(said[1]) <= _count()  # other tests may compile some at the same time
    assert float(said[2]) < 100.0


@contextmanager
def nothing_compiled() -> Iterator[None]:
    """Hold that the block compiles no kernel in this process."""
    with event.install_recorder("numba:compile") as record:
        yield
    assert not [str(found.data) for _, found in record.buffer]


@pytest.fixture(scope="module")
def warm() -> None:
    """What the command compiles is there once for all tests of this file; none of them compiles anything."""
    succeed("warmup")
    assert FOLDER is not None
    assert _count() >= KERNELS
    assert sum(path.stat().st_size for path in FOLDER.glob(f"*{SUFFIX}")) > 1e6


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.compiled("there is nothing to compile")
def test_after_warmup_no_option_of_estimate_compiles_a_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards())
    for options in (
        ["--sigma", "tied"],
        ["--sigma", "free", "--refine", "none"],
        ["--counter", "cpdf"],
        ["--counter", "fourier"],
        ["--max-layers", "1"],
        ["--outliers", "0.01"],
        ["--window", "7"],
    ):
        with nothing_compiled():
            tofmix.done("estimate", recording, *options, "--overwrite")


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.compiled("there is nothing to compile")
def test_after_warmup_measuring_noise_and_simulating_compile_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(60, 8, 12))
    stepped = write_recording(tmp_path / "stepped.h5", 25 * (boards(60, 8, 12) // 25))
    with nothing_compiled():
        for one in (recording, stepped):
            tofmix.done("estimate", one, "--noise", "auto", "--outliers", "auto")
        tofmix.done("simulate", "corridor", "--frames", "2", "-o", tmp_path / "c.h5")


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.compiled("there is nothing to compile")
def test_after_warmup_edges_maps_and_moving_scenes_compile_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    model, recording, layers = (tmp_path / name for name in ("model.toml", "a.h5", "a.layers.h5"))
    scene = (
        '[sensor]\nprofile = "sr4000"\nrows = 16\ncols = 16\n{lens}[recording]\nframes = 30\n'
        '[[surface]]\nname = "board"\ncenter_mm = [0.0, 0.0, 1500.0]\nsize_mm = [400.0, 300.0]\n'
        '[[surface]]\nname = "wall"\ncenter_mm = [0.0, 0.0, 3000.0]\nsize_mm = [9000.0, 9000.0]\n'
        '[[effect]]\nkind = "motion"\nsurface = "board"\nvelocity_mm_s = 1.0\n'
    )
    for lens in ("", 'projection = "pinhole"\nfx = 20.0\nfy = 20.0\ncx = 7.5\ncy = 7.5\n'):
        model.write_text(scene.format(lens=lens))
        with nothing_compiled():
            for command in (
                ("simulate", model, "-o", recording, "--overwrite"),
                ("estimate", recording, "-o", layers, "--overwrite"),
                ("surfaces", layers, "--overwrite"),
                ("map", layers, "-o", tmp_path / "map.yaml", "--cell", 100, "--overwrite"),
                (
                    "inspect",
                    layers,
                    "--recording",
                    recording,
                    "--pixel",
                    "8,8",
                    "--over-frames",
                    "--overwrite",
                    "-o",
                    tmp_path / "pixel.svg",
                ),
                ("report", layers, "--recording", recording, "--html", tmp_path / "page.html", "--overwrite"),
            ):
                tofmix.done(*command)


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.compiled("there is nothing to compile")
def test_after_warmup_edges_of_unmixed_shares_compile_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    sums, layers = write_sums(tmp_path / "sums.h5", small(11).recording), tmp_path / "sums.layers.h5"
    with nothing_compiled():
        tofmix.done("estimate", sums)
        tofmix.done("surfaces", layers)


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
@pytest.mark.compiled("there is nothing to compile")
def test_after_warmup_reconciling_compiles_no_kernel(tofmix: Tofmix, tmp_path: Path) -> None:
    model, measured = tmp_path / "model.toml", tmp_path / "measured.h5"
    model.write_text(
        '[sensor]\nprofile = "sr4000"\nrows = 8\ncols = 10\n[recording]\nframes = 40\n'
        '[[surface]]\nname = "board"\ncenter_mm = [-300.0, 0.0, 1500.0]\nsize_mm = [500.0, 500.0]\n'
    )
    tofmix.done("simulate", model, "-o", measured)
    text = model.read_text()
    for effect in (
        'kind = "quantisation"\nstep_mm = 9.0\n',
        'kind = "motion"\nsurface = "board"\nvelocity_mm_s = 1.0\n',
        'kind = "scattering"\nshare = 0.05\n',
    ):
        model.write_text(f"{text}[[effect]]\n{effect}")
        with nothing_compiled():
            done = tofmix(
                "reconcile",
                model,
                measured,
                "-o",
                tmp_path / "gap",
                "--overwrite",
                "--effects",
                "interference,range_offset,temporal_correlation",
                "--max-effects",
                1,
            )
        assert done.code == 0, done.err
