"""The smallest magnitude of each effect that `tofmix reconcile` names in 95 % of the recordings, by frames and pixels.

    PYTHONPATH=tests python tests/benchmarks/smallest.py --output FOLDER [--kinds KIND ...]
        [--cells 24x32x60 ...] [--recordings 16] [--sealed-seed N] [--table]

Recordings are those of the blind bench (`blind.cases`), each of another device and scene, cut to so many pixels and
frames; an effect is named if it is the only one that is. Reconciliation runs in this process, without the report, which
is most of the time of a small one. Each recording is a line of FOLDER/smallest.jsonl and is not done again, so the
command may be stopped and started at will; several may run on folders of their own with other --kinds. `--table`
prints what is there.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.cases import OPEN_SEED, strengths
from blind.smallest import Cell, Search
from blind.strength import KINDS, UNITS
from blind.summary import table
from blind.write import model_text, write_recording

from tofmix.io.model_file import load_model
from tofmix.io.recording.recording_file import open_recording
from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.settings import KINDS as TRIED
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model

CELLS = ("24x32x60", "24x32x240", "48x64x60")
_WITHOUT = "phase_wrapping"  # has no magnitude


def named(cell: Cell, octaves: float, seed: int, master: int, work: Path) -> list[str]:
    """What reconcile names in a recording."""
    built = cell.built(octaves, seed, master)
    folder = work / f"{crc32(built.case.name.encode()) ^ built.seeds[0]:08x}"
    folder.mkdir(parents=True)
    try:
        (folder / "model.toml").write_text(model_text(built.device, built.models[0], built.noise), encoding="utf-8")
        write_recording(folder / "measured.h5", built.record(0), built.device, built.noise, variant=0)
        model = load_model(str(folder / "model.toml"))
        found = reconcile(model, _evidence(model, folder / "measured.h5"), Settings(kinds=TRIED))
        return [effect.effect.kind for effect in found.named]
    finally:
        shutil.rmtree(folder)


def _evidence(model: Model, measured: Path) -> Evidence:
    every = slice(0, None)
    with open_recording(measured) as file:
        amplitude = file.read_amplitude(every, every) if file.has_amplitude else None
        return make_evidence(
            model,
            file.read_range(every, every),
            time_s=file.read_time(),
            amplitude=amplitude,
            temperature_c=file.read_temperature(),
        )


def trials(path: Path, cell: Cell, master: int) -> Iterator[dict[str, Any]]:
    """What was tried of a cell, in its order."""
    key = [cell.kind, cell.frames, cell.rows, cell.cols, master]
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        entry = json.loads(line)
        if entry["cell"] == key:
            yield entry


def searched(path: Path, cell: Cell, recordings: int, master: int) -> tuple[Search, int]:
    """The search of a cell with that many recordings; those that are not there yet are made."""
    search, done = Search(), 0
    for entry in list(trials(path, cell, master))[:recordings]:
        search.add(entry["octaves"], named=entry["named"] == [cell.kind])
        done += 1
    for seed in range(done, recordings):
        octaves = search.next()
        said = named(cell, octaves, seed, master, path.parent / "work")
        search.add(octaves, named=said == [cell.kind])
        entry = {
            "cell": [cell.kind, cell.frames, cell.rows, cell.cols, master],
            "seed": seed,
            "octaves": octaves,
            "strength": cell.strength(octaves),
            "named": said,
        }
        with path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(entry) + "\n")
        print(f"{cell.kind} {cell.rows}x{cell.cols}x{cell.frames} {entry['strength']:.3g} {said}", file=sys.stderr)
    return search, recordings


def _said(cell: Cell, search: Search) -> str:
    octaves, off = search.found()
    if octaves > 0:
        return f"more than {cell.strength(0.0):.2g}"
    return f"{cell.strength(octaves):.2g} ({cell.strength(octaves - off):.2g} to {cell.strength(octaves + off):.2g})"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--kinds", nargs="*", default=[], help="kinds to search; all if left out")
    parser.add_argument("--cells", nargs="*", default=list(CELLS), help="rows x columns x frames")
    parser.add_argument("--recordings", type=int, default=16, help="of each cell")
    parser.add_argument("--sealed-seed", type=int, default=OPEN_SEED, help="master seed of devices and scenes")
    parser.add_argument("--table", action="store_true", help="print what is there, and make nothing")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    path, rows = options.output / "smallest.jsonl", []
    for kind in options.kinds or [kind for kind in KINDS if kind != _WITHOUT]:
        row = []
        for name in options.cells:
            height, width, frames = (int(n) for n in name.split("x"))
            cell = Cell(kind=kind, frames=frames, rows=height, cols=width)
            there = len(list(trials(path, cell, options.sealed_seed)))
            if options.table and not there:
                row.append("-")
                continue
            wanted = min(there, options.recordings) if options.table else options.recordings
            search, done = searched(path, cell, wanted, options.sealed_seed)
            row.append(_said(cell, search) + ("" if done == options.recordings else f", of {done}"))
        rows.append([kind, UNITS[kind], strengths()[kind]["faint"], *row])
    print(table(["kind", "unit", "faint", *options.cells], rows))


if __name__ == "__main__":
    main()
