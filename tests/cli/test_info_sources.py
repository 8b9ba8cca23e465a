"""`tofmix info` of what is no file of ours: arrays, CSV, other HDF5, bags, a folder of images, a gap folder."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import naive_png
from support.bags import DEPTH, new_bag
from support.commandline import Tofmix

from tofmix.errors import ExitCode

GAP = {
    "verdict": "explained",
    "effects": [{"kind": "wiggling", "parameters": {"amplitude_mm": 11.8}, "stderr": {}, "heldout_gain_nats": 1.0}],
    "where": [{"axis": "range", "interval": [2000.0, 2450.0], "statistic": "bias", "size": -10.9, "unit": "mm"}],
    "gap": {"before": 9.4, "after": 1.1, "floor": 1.0, "closed": 0.988},
    "next_steps": ["record a second surface"],
}


def write(folder: Path, kind: str) -> Path:
    """A source of 5 frames of 4 x 6 pixels."""
    samples = np.full((5, 4, 6), 1500, "u2")
    path = folder / f"source.{kind}"
    if kind == "npy":
        np.save(path, samples)
    elif kind == "csv":
        lines = ["frame,row,col,range_mm", "0,0,0,1500", *(f"{frame},3,5,1500" for frame in range(5))]
        path.write_text("\n".join(lines))
    elif kind == "h5":
        with h5py.File(path, "w") as root:
            root["entry/data"] = samples
    elif kind == "png":
        path = folder / "images"
        path.mkdir()
        for number, image in enumerate(samples):
            (path / f"{number}.png").write_bytes(naive_png.encode(image))
    else:
        with new_bag(folder, kind) as (bag, path):
            for number, image in enumerate(samples):
                bag.image(DEPTH, image, stamp_ns=10**9 + number)
    return path


@pytest.mark.parametrize("kind", ["npy", "csv", "h5", "png", "mcap"])
def test_a_source_is_described_with_the_command_that_imports_it(tofmix: Tofmix, tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, kind)
    done = tofmix("info", path, "--json")
    assert done.code == 0, done.err
    described = json.loads(done.out)
    assert described["kind"] == "source"
    assert (described["sizes"]["frames"], described["sizes"]["rows"], described["sizes"]["cols"]) == (5, 4, 6)
    assert described["depths"]["along"] == ("z" if kind in ("png", "mcap") else "the beam")
    assert described["depths"]["unit_mm"] == (1.0 if kind in ("mcap", "csv") else None)
    assert f"tofmix import {path} -o" in described["warnings"][-1]["text"]
    assert "unit_mm" in tofmix("info", path).out


def test_gap_folder_is_summarised(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "gap.json").write_text(json.dumps(GAP))
    done = tofmix("info", tmp_path)
    assert done.code == 0, done.err
    for text in ("reconciliation", "explained", "wiggling", "11.8", "0.988", "record a second surface"):
        assert text in done.out
    assert json.loads(tofmix("info", tmp_path, "--json").out)["found"]["verdict"] == "explained"


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"verdict": 1}', "[" * 100_000, '{"verdict": "agree", "effects": []}']
)
def test_invalid_gap_folder_is_refused_in_one_line(tofmix: Tofmix, tmp_path: Path, text: str) -> None:
    (tmp_path / "gap.json").write_text(text)
    refused = tofmix("info", tmp_path)
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err.count("\n") == 1
    assert "gap.json" in refused.err


def test_a_file_of_no_known_kind_is_refused(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3")
    refused = tofmix("info", tmp_path / "a.xyz")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err.count("\n") == 1
