"""Kill `tofmix estimate` with SIGKILL at random moments, go on with --resume, and count what came out.

Usage: python tests/benchmarks/resume.py [--runs 50] [--seed 1]

Each run is killed once, at a moment drawn evenly over the time that a whole run takes, start and end included; then
`--resume` finishes it. A result counts as identical if its bytes are those of an uninterrupted run, and a folder as
clean if it then holds the recording and the result alone.
"""

import argparse
import math
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

TOFMIX = [sys.executable, "-m", "tofmix"]


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=400)
    arguments = parser.parse_args()
    moments, counts = random.Random(arguments.seed), Counter[str]()  # noqa: S311  no secret
    with tempfile.TemporaryDirectory() as name:
        recording, output = Path(name) / "a.h5", Path(name) / "a.layers.h5"
        show = [*TOFMIX, "simulate", "corridor", "--print-model"]
        model = subprocess.run(show, check=True, capture_output=True, text=True).stdout
        small = Path(name) / "small.toml"
        small.write_text(model.replace("[sensor]\n", "[sensor]\nrows = 36\ncols = 44\n"))
        simulate = [*TOFMIX, "simulate", str(small), "--frames", str(arguments.frames), "-o", str(recording)]
        subprocess.run(simulate, check=True, stdout=subprocess.DEVNULL)
        small.unlink()
        estimate = [*TOFMIX, "estimate", str(recording), "--window", "40"]
        whole = math.inf
        for _ in range(3):  # the first may compile
            start = time.perf_counter()
            subprocess.run([*estimate, "--overwrite"], check=True, stdout=subprocess.DEVNULL)
            whole = min(whole, time.perf_counter() - start)
        expected = output.read_bytes()
        for _ in range(arguments.runs):
            output.unlink(missing_ok=True)
            running = subprocess.Popen(estimate, stdout=subprocess.DEVNULL)
            try:
                running.wait(moments.uniform(0.0, 1.05 * whole))
                counts["had ended before"] += 1
            except subprocess.TimeoutExpired:
                running.kill()
                running.wait()
                counts["killed"] += 1
            counts["left a journal"] += any(Path(name).glob(".*"))
            unfinished = not output.exists()
            done = subprocess.run([*estimate, "--resume"], capture_output=True, text=True, check=False)
            counts["of them went on from finished blocks"] += unfinished and "were there already" in done.stderr
            counts["resumed"] += done.returncode == 0
            counts["identical"] += output.exists() and output.read_bytes() == expected
            counts["clean"] += {path.name for path in Path(name).iterdir()} == {"a.h5", "a.layers.h5"}
    print(f"| {arguments.runs} runs of {whole:.1f} s | |\n|---|---|")
    for what, count in counts.items():
        print(f"| {what} | {count} |")


if __name__ == "__main__":
    main()
