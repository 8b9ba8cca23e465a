"""The smallest magnitude of each effect that `tofmix reconcile` names in 95 % of the recordings, by frames and pixels.

    PYTHONPATH=tests python -m blind.smallest --output FOLDER [--kinds KIND ...] [--frames 60 200]
        [--pixels 24x32 48x64] [--recordings 20] [--sealed-seed N]

For each kind, number of frames and image, magnitudes of a grid are tried, each half a power of two below the one
before, from `clear` down; the grid is halved until two neighbours are left of which one is named often enough and the
other is not. A magnitude is named often enough if 95 % of its recordings, each of another device and scene, are given
that kind and no other; it is given up as soon as too many are not. Each recording is a line of
FOLDER/smallest.jsonl and is not done again, so the command may be stopped and started at will.
"""

import argparse
import json
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

from blind.cases import OPEN_SEED, Built, Case, build, strengths
from blind.score import RECONCILE, run
from blind.strength import KINDS, UNITS
from blind.summary import table
from blind.write import model_text, write_recording

SHARE = 0.95
STEPS = 16  # of half a power of two: down to a 256th of clear
_SLOTS = 3
_WITHOUT = "phase_wrapping"  # has no magnitude


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One kind, at one number of frames and one image."""

    kind: str
    frames: int
    rows: int
    cols: int

    def strength(self, step: int) -> float:
        """The magnitude of a step of the grid."""
        return float(strengths()[self.kind]["clear"] * 2.0 ** (-step / 2))

    def built(self, step: int, seed: int, master: int) -> Built:
        """A recording of a magnitude: the same device and scene at every step."""
        case = Case(
            name=f"{self.kind}-smallest-{seed}", sort="single", kinds=(self.kind,), level="clear", slot=seed % _SLOTS,
            seed=seed // _SLOTS, half="open",
        )  # fmt: skip
        camera = {"frames": self.frames, "rows": self.rows, "cols": self.cols}
        return build(case, master, strength=self.strength(step), camera=camera)


def search(cell: Cell, often: Callable[[Cell, int], bool]) -> int | None:
    """The last step of the grid that is named often enough, one step's neighbour not being so; None if none is.

    Parameters
    ----------
    cell : Cell
        What is searched for.
    often : callable
        Whether a step is named often enough; must not grow with the step.
    """
    if not often(cell, 0):
        return None
    low, high = 0, STEPS
    if often(cell, high):
        return high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if often(cell, middle) else (low, middle)
    return low


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """What was tried, kept in a file.

    Parameters
    ----------
    path : Path
        The file, a line for each recording.
    master : int
        Seed of devices and scenes.
    recordings : int
        Of each magnitude.
    name : callable
        What is named in the recording of a cell, step and seed; gets the master seed and a folder to work in too.
    """

    path: Path
    master: int
    recordings: int
    name: Callable[[Cell, int, int, int, Path], list[str]]

    def often(self, cell: Cell, step: int) -> bool:
        """Whether a step is named in enough of its recordings."""
        allowed = math.floor((1 - SHARE) * self.recordings + 1e-9)
        misses = 0
        for seed in range(self.recordings):
            misses += self._named(cell, step, seed) != [cell.kind]
            if misses > allowed:
                return False
        return True

    def _named(self, cell: Cell, step: int, seed: int) -> list[str]:
        key = [cell.kind, cell.frames, cell.rows, cell.cols, step, seed, self.master]
        for line in self._lines():
            if line["key"] == key:
                return list(line["named"])
        named = self.name(cell, step, seed, self.master, self.path.parent / "work")
        with self.path.open("a", encoding="utf-8") as out:
            out.write(json.dumps({"key": key, "strength": cell.strength(step), "named": named}) + "\n")
        return named

    def _lines(self) -> Iterator[dict[str, Any]]:
        if self.path.exists():
            for line in self.path.read_text(encoding="utf-8").splitlines():
                yield json.loads(line)


def reconciled(
    cell: Cell, step: int, seed: int, master: int, work: Path, *, command: tuple[str, ...] = RECONCILE
) -> list[str]:
    """What the command names, on a recording in a folder whose name says nothing."""
    built = cell.built(step, seed, master)
    folder = work / f"{crc32(built.case.name.encode()) ^ built.seeds[0]:08x}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        model, measured, result = folder / "model.toml", folder / "measured.h5", folder / "result"
        model.write_text(model_text(built.device, built.models[0], built.noise), encoding="utf-8")
        write_recording(measured, built.record(0), built.device, built.noise, variant=0)
        run([*command, str(model), str(measured), "-o", str(result)])
        said = json.loads((result / "gap.json").read_text(encoding="utf-8"))
        return [str(effect["kind"]) for effect in said["effects"]]
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main(arguments: list[str] | None = None) -> None:
    """Search, and print a line of the table as each is found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--kinds", nargs="*", default=[], help="kinds to search; all if left out")
    parser.add_argument("--frames", nargs="*", type=int, default=[60, 200])
    parser.add_argument("--pixels", nargs="*", default=["24x32", "48x64"], help="rows x columns")
    parser.add_argument("--recordings", type=int, default=20, help="of each magnitude")
    parser.add_argument("--sealed-seed", type=int, default=OPEN_SEED, help="master seed of devices and scenes")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    trials = Trials(
        path=options.output / "smallest.jsonl",
        master=options.sealed_seed,
        recordings=options.recordings,
        name=reconciled,
    )
    print(table(["kind", "unit", "frames", "pixels", "smallest", "faint"], []))
    for kind in options.kinds or [kind for kind in KINDS if kind != _WITHOUT]:
        for frames in options.frames:
            for pixels in options.pixels:
                rows, cols = (int(n) for n in pixels.split("x"))
                cell = Cell(kind=kind, frames=frames, rows=rows, cols=cols)
                step = search(cell, trials.often)
                smallest = "none" if step is None else f"{cell.strength(step):.2g}"
                at_most = "at most " if step == STEPS else ""
                line = [kind, UNITS[kind], frames, f"{rows} x {cols}", at_most + smallest, strengths()[kind]["faint"]]
                print("| " + " | ".join(str(x) for x in line) + " |", flush=True)


if __name__ == "__main__":
    main()
