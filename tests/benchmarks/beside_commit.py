"""CPU time of `estimate` beside that of another commit's package, on the same recordings.

    git worktree add ../earlier 94252c5f
    python tests/benchmarks/beside_commit.py ../earlier [--only "three_boards.h5;person"] [--rounds 5]

Two processes, each with the package of one checkout, estimate every recording in turns: the other's, this one's, the
other's, this one's. The first call of each compiles or loads kernels and is not counted. A call is `tofmix.estimate`
of the file with one worker, with the findings that it says. The table has the least CPU time of each, and the ratio of
the two, which a busy machine changes least. docs/results/performance.md and mixing.md hold copies. Asserts nothing.

Recordings: those of `sample_data`; one of 96 x 128 pixels and 100 frames of a plane, 15 % of the pixels with a second
surface, without amplitudes, with its noise curve and without; and scenes of round things (`curved.py`).
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import IO

TOP = Path(__file__).parents[2]
ROUND = ("sphere and cylinder", "person", "two columns")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
SEED = 20080922


def write_simulated(path: Path, *, has_curve: bool) -> None:
    """A plane at 2 to 3 m of 96 x 128 pixels; 15 % of these see another surface half a metre behind in 40 %."""
    import numpy as np

    import tofmix as tm

    rng = np.random.default_rng(SEED)
    curve = tm.NoiseCurve(np.array([500.0, 7500.0]), np.array([4.0, 40.0]))
    near = np.broadcast_to(np.linspace(2000.0, 3000.0, 128), (100, 96, 128))
    behind = (rng.random(near.shape[1:]) < 0.15) & (rng.random(near.shape) < 0.4)
    range_mm = near + 500.0 * behind
    range_mm = (range_mm + curve.sigma(range_mm) * rng.standard_normal(near.shape)).astype(np.float32)
    camera = tm.Sensor(name="plane", range_min_mm=0.0, range_max_mm=7500.0, noise=curve if has_curve else None)
    tm.from_array(range_mm, units="mm", sensor=camera).save(path)


def write_round(path: Path, name: str) -> None:
    """A scene of round things, 48 x 64 pixels and 100 frames, noise of a sample on the wall 20 mm."""
    sys.path.insert(0, str(TOP / "tests"))
    from support.round_things import SCENES, render

    things, reflectivity = SCENES[name]
    render(things, reflectivity, noise_mm=20.0, seed=1).recording.save(path)


def write_recordings(folder: Path, names: list[str]) -> dict[str, tuple[Path, str]]:
    """File and noise option of each recording, by name."""
    samples = TOP / "sample_data"
    cases = {
        "three_boards.h5": (samples / "three_boards.h5", "file"),
        "three_boards.h5, auto": (samples / "three_boards.h5", "auto"),
        "tmf8829_edge.h5": (samples / "tmf8829_edge.h5", ""),
        "hidden_effect.h5": (samples / "hidden_effect.h5", "file"),
        "plane": (folder / "plane.h5", "file"),
        "plane, learnt": (folder / "learnt.h5", "auto"),
        **{name: (folder / f"{name}.h5", "") for name in ROUND},
    }
    chosen = {name: case for name, case in cases.items() if not names or name in names}
    for name, (path, _) in chosen.items():
        if name in ROUND:
            write_round(path, name)
        elif path.parent == folder:
            write_simulated(path, has_curve=name == "plane")
    return chosen


class Package:
    """A process that estimates with the package of a checkout."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), "--serve"],
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(checkout)},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def seconds(self, path: Path, noise: str) -> float:
        """CPU time of one estimate, s."""
        sending, answers = self._process.stdin, self._process.stdout
        assert sending is not None
        assert answers is not None
        print(f"{path}\t{noise}", file=sending, flush=True)
        answer = answers.readline()
        if not answer:
            sys.exit(f"the process of a package ended at {path}")
        return float(answer)

    def end(self) -> None:
        """End the process."""
        self._process.communicate()


def serve(asked: IO[str]) -> None:
    """Estimate each file that is asked for, and print its CPU time."""
    import tofmix as tm

    warnings.simplefilter("ignore")
    for line in asked:
        path, noise = line.rstrip("\n").split("\t")
        start = time.process_time()
        tm.estimate(path, noise=noise or None, workers=1)
        print(time.process_time() - start, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, nargs="?", help="checkout of the other commit")
    parser.add_argument("--only", default="", help="recordings, names with semicolons between")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(sys.stdin)
        return
    if options.other is None:
        parser.error("a checkout of another commit is needed")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cases = write_recordings(folder, [part.strip() for part in options.only.split(";") if part.strip()])
        other, this = (Package(checkout.resolve(), folder) for checkout in (options.other, TOP))
        print("| recording | other, s of CPU | this, s of CPU | ratio |\n|---|---|---|---|")
        for label, case in cases.items():
            other.seconds(*case)
            this.seconds(*case)
            pairs = [(other.seconds(*case), this.seconds(*case)) for _ in range(options.rounds)]
            before, now = (min(times) for times in zip(*pairs, strict=True))
            print(f"| {label} | {before:.2f} | {now:.2f} | {now / before:.2f} |", flush=True)
        other.end()
        this.end()


if __name__ == "__main__":
    main()
