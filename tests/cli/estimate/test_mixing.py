"""`tofmix estimate --mixing`: the same bytes whoever computes, what is said, and what other commands make of it."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.lock_in import small, write_sums

from tofmix.api.estimates import Estimate
from tofmix.errors import ExitCode
from tofmix.flags import Mixing


@pytest.fixture(scope="module")
def sums(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two windows of phasor sums, with a few pixels that stay undecided."""
    return write_sums(tmp_path_factory.mktemp("sums") / "a.h5", small(4).recording)


WINDOWS = ("--window", 20, "--noise", "file")


@pytest.mark.slow
def test_bytes_do_not_depend_on_workers_shards_or_a_resumed_run(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    whole = tmp_path / "whole.h5"
    done = tofmix("estimate", sums, *WINDOWS, "-o", whole, "--workers", 1)
    assert done.code == 0, done.err
    assert tofmix("estimate", sums, *WINDOWS, "-o", tmp_path / "two.h5", "--workers", 2).code == 0
    parts = []
    for number in (1, 2):
        parts.append(tmp_path / f"{number}.part")
        made = tofmix("estimate", sums, *WINDOWS, "-o", parts[-1], "--shard", f"{number}/2")
        assert made.code == 0, made.err
    merged = tofmix("merge", *parts, "-o", tmp_path / "merged.h5")
    assert "mixing: 100 % of the samples at edges are phasor sums" in merged.err
    assert tofmix("estimate", sums, *WINDOWS, "-o", whole, "--resume").code == 0
    for name in ("two.h5", "merged.h5"):
        assert (tmp_path / name).read_bytes() == whole.read_bytes()


def test_mixing_law_is_printed_and_stored(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    done = tofmix("estimate", sums, *WINDOWS, "-o", out, "--json")
    said = json.loads(done.out)
    assert said["mixing"]["phasor_share"] == pytest.approx(1.0, abs=0.03)
    with h5py.File(out) as root:
        assert root["phasor_pixels"][...].sum() == said["mixing"]["pixels"] > 100
        mixing = root["mixing"]
        assert mixing.attrs["flag_meanings"] == "one_surface events phasor undecided"
        mixed = mixing[...] == int(Mixing.PHASOR)
        assert mixed.sum() > 200
        assert (root["n_modes"][...][mixed] >= 1).all()
        assert sum(said["pixels_by_surfaces"][2:]) == (root["n_modes"][...] > 1).sum()
        unsure = root["n_modes"][...][mixing[...] == int(Mixing.UNDECIDED)]
    assert said["undecided_by_surfaces"] == np.bincount(unsure, minlength=7).tolist()
    assert unsure.size > 0
    line = tofmix("estimate", sums, *WINDOWS, "-o", out, "--resume").out
    assert line.endswith(f"; {unsure.size} undecided, not counted\n")
    counted = [int(count.replace(",", "")) for count in re.findall(r" \d: (\d[\d,]*\d|\d)", line)]
    assert sum(counted) + unsure.size == sum(said["pixels_by_surfaces"])
    assert f"undecided       {unsure.size:>10}" in tofmix("report", out).out
    assert tofmix("verify", out).code == 0
    assert "phasor sums" in tofmix("info", out).out


def test_recordings_without_amplitudes_have_one_warning_and_no_mixing(tofmix: Tofmix, tmp_path: Path) -> None:
    plain = write_sums(tmp_path / "a.h5", small(1).recording, amplitude=False)
    done = tofmix("estimate", plain, "--noise", "file")
    assert [line for line in done.err.splitlines() if "flying pixels" in line]
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert "mixing" not in root
    refused = tofmix("estimate", plain, "--mixing", "phasor", "--overwrite")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err == (
        f"tofmix: {plain}: no amplitudes, which --mixing phasor needs; import the recording with --amplitude\n"
    )
    assert tofmix("estimate", plain, "--paper", "--mixing", "phasor", "--overwrite").code == ExitCode.USAGE


def test_export_omits_undecided_pixels_without_the_option(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    assert tofmix("estimate", sums, *WINDOWS, "-o", out).code == 0
    with h5py.File(out) as root:
        undecided = root["mixing"][...] == int(Mixing.UNDECIDED)
        extra = int(np.isfinite(root["range"][...])[undecided].sum())
    assert extra > 0
    without, with_them = (
        json.loads(tofmix("export", out, "-o", tmp_path / f"{k}.ply", *option, "--json").out)["points"]
        for k, option in enumerate(((), ("--undecided",)))
    )
    assert with_them - without == extra


@pytest.mark.slow
def test_api_gives_the_values_that_the_command_writes(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    import tofmix as tm

    out = tmp_path / "a.h5"
    assert tofmix("estimate", sums, *WINDOWS, "-o", out).code == 0
    made = tm.estimate(sums, window=20, noise="file")
    saved = made.save(tmp_path / "b.h5")
    assert tofmix("compare", out, saved).code == 0
    back = tm.open(out)
    assert isinstance(back, Estimate)
    np.testing.assert_array_equal(back.mixing, made.mixing)
    np.testing.assert_array_equal(back.phasor_share, made.phasor_share)


@pytest.mark.slow
def test_inspect_prints_and_draws_the_kind_of_mixing(tofmix: Tofmix, sums: Path, tmp_path: Path) -> None:
    out, events = tmp_path / "a.h5", tmp_path / "events.h5"
    assert tofmix("estimate", sums, *WINDOWS, "-o", out).code == 0
    assert tofmix("estimate", sums, *WINDOWS, "-o", events, "--mixing", "events").code == 0
    with h5py.File(out) as root:
        row, col = np.argwhere(root["mixing"][1] == int(Mixing.PHASOR))[0].tolist()
    place = ("--pixel", f"{row},{col}", "--window", 1, "--neighbours", 0)
    assert "\n  mixing: phasor\n" in tofmix("inspect", out, *place).out
    assert json.loads(tofmix("inspect", out, *place, "--json").out)["pixels"][0]["mixing"] == "phasor"
    assert "mixing" not in tofmix("inspect", events, *place).out
    assert "mixing" not in json.loads(tofmix("inspect", events, *place, "--json").out)["pixels"][0]
    heights = []
    for number, (layers, options) in enumerate(
        ((out, ("--recording", sums)), (out, ()), (events, ("--recording", sums)))
    ):
        figure = tmp_path / f"{number}.svg"
        shown = tofmix("inspect", layers, *place, *options, "-o", figure)
        assert shown.code == 0, shown.err
        heights.append(float(figure.read_text().partition('height="')[2].partition("pt")[0]))
    assert heights[0] > heights[1] + 200
    assert heights[1] == heights[2]
