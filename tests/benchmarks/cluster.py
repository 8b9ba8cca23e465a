"""A dask.distributed cluster on this machine (a scheduler and two workers of one thread) beside two local workers.

Usage: python tests/benchmarks/cluster.py [--frames 2000]

Both compute the same recording; the second cluster run loses a worker half way. Results must be equal to the byte.
The processes of the cluster are started before the clock, as those of a real one.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

TOFMIX = [sys.executable, "-m", "tofmix"]
DASK = [sys.executable, "-m", "distributed.cli.dask_"]


def start(stack: ExitStack, folder: Path, *command: str) -> "subprocess.Popen[bytes]":
    """Start a process that ends with the stack."""
    log = stack.enter_context((folder / "log").open("ab"))
    process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


def timed(command: list[str]) -> float:
    """Seconds of one run."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=2000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        recording, file = str(folder / "a.h5"), str(folder / "scheduler.json")
        simulate = ["simulate", "three-boards", "--frames", str(arguments.frames), "-o", recording]
        subprocess.run([*TOFMIX, *simulate], check=True, stdout=subprocess.DEVNULL)
        estimate = [*TOFMIX, "estimate", recording, "--window", "100", "--overwrite"]
        subprocess.run([*TOFMIX, "warmup"], check=True, stdout=subprocess.DEVNULL)
        python, scheduler, worker = DASK[0], DASK[2] + "scheduler", DASK[2] + "worker"
        start(
            stack,
            folder,
            python,
            "-m",
            scheduler,
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            file,
        )
        workers = [
            start(
                stack,
                folder,
                python,
                "-m",
                worker,
                "--scheduler-file",
                file,
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                "--local-directory",
                str(folder / "scratch"),
            )
            for _ in range(2)
        ]
        while not Path(file).exists():
            time.sleep(0.1)
        small = str(folder / "small.h5")
        subprocess.run([*TOFMIX, "simulate", "three-boards", "-o", small], check=True, stdout=subprocess.DEVNULL)
        timed([*TOFMIX, "estimate", small, "--scheduler", file])  # workers import and load the kernels
        local = timed([*estimate, "--workers", "2", "-o", str(folder / "local")])
        cluster = timed([*estimate, "--scheduler", file, "-o", str(folder / "cluster")])
        running = subprocess.Popen(
            [*estimate, "--scheduler", file, "-o", str(folder / "killed")], stdout=subprocess.DEVNULL
        )
        time.sleep(cluster / 2)
        workers[0].kill()
        code = running.wait()
        local_bytes, cluster_bytes, killed_bytes = (
            (folder / part).read_bytes() for part in ("local", "cluster", "killed")
        )
        print("| | s | |\n|---|---|---|")
        print(f"| two local workers | {local:.1f} | |")
        print(f"| two workers of a cluster | {cluster:.1f} | {100 * (cluster / local - 1):+.0f} % |")
        print(f"identical: {local_bytes == cluster_bytes}")
        print(f"identical with a worker killed half way: {local_bytes == killed_bytes}, exit code {code}")


if __name__ == "__main__":
    main()
