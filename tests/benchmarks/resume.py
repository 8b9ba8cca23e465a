"""Kill `tofmix estimate` with SIGKILL at random moments, go on with --resume, and count what came out.

Usage: python tests/benchmarks/resume.py [--runs 50] [--seed 1]

Each run is killed once, at a moment drawn evenly over the time that a whole run takes, start and end included; then
`--resume` finishes it. Runs are forks of one warm process, so that the moments fall into the work and not into the
imports. A result counts as identical if its bytes are those of an uninterrupted run, and a folder as clean if it then
holds the recording and the result alone.
"""

import argparse
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from faults.pool import Job, Outcome, Pool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=400)
    arguments = parser.parse_args()
    moments, counts = random.Random(arguments.seed), Counter[str]()  # noqa: S311  no secret
    with tempfile.TemporaryDirectory() as name, Pool(1) as pool:

        def run(*argv: str, kill_after_s: float | None = None) -> Outcome:
            return pool.run(Job(argv=argv, cwd=name, kill_after_s=kill_after_s))

        model, output = Path(name) / "small.toml", Path(name) / "a.layers.h5"
        text = run("simulate", "corridor", "--print-model").out
        model.write_text(text.replace("[sensor]\n", "[sensor]\nrows = 36\ncols = 44\n"))
        run("simulate", "small.toml", "--frames", str(arguments.frames), "-o", "a.h5")
        model.unlink()
        estimate = ("estimate", "a.h5", "--window", "40")
        whole = min(run(*estimate, "--overwrite").seconds for _ in range(3))
        expected = output.read_bytes()
        for _ in range(arguments.runs):
            output.unlink(missing_ok=True)
            ended = run(*estimate, kill_after_s=moments.uniform(0.0, 1.05 * whole))
            counts["killed" if ended.code < 0 else "had ended before"] += 1
            counts["left a journal"] += any(Path(name).glob(".*.journal"))
            unfinished = not output.exists()
            done = run(*estimate, "--resume")
            counts["of them went on from finished blocks"] += (
                unfinished and "blocks from the interrupted run" in done.err
            )
            counts["resumed"] += done.code == 0
            counts["identical"] += output.exists() and output.read_bytes() == expected
            counts["clean"] += {path.name for path in Path(name).iterdir()} == {"a.h5", "a.layers.h5"}
    print(f"| {arguments.runs} runs of {whole:.1f} s | |\n|---|---|")
    for what, count in counts.items():
        print(f"| {what} | {count} |")


if __name__ == "__main__":
    main()
