"""Many runs at once, a recording that claims to be huge, and a thousand recordings in one process."""

import gc
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
from support.files import NOISE, boards, write_recording

from faults.inject import Report
from faults.pool import Job, Pool
from faults.same import same_content

TOFMIX = (sys.executable, "-m", "tofmix")


def side_by_side(runs: int, *, report: Report = print) -> str:
    """Estimate one recording several times at once, in one folder; the results must be the same bytes."""
    with tempfile.TemporaryDirectory(prefix="load-") as name:
        folder = Path(name)
        write_recording(folder / "recording.h5", boards(200, 16, 20))

        def estimate(number: int) -> int:
            command = [*TOFMIX, "estimate", "recording.h5", "-o", f"{number}.layers.h5", "--window", "10"]
            return subprocess.run(command, cwd=name, stdout=subprocess.DEVNULL, check=False).returncode

        with ThreadPoolExecutor(runs) as threads:
            codes = list(threads.map(estimate, range(runs)))
        outputs = [folder / f"{number}.layers.h5" for number in range(runs)]
        same = len({path.read_bytes() for path in outputs}) == 1 if not any(codes) else False
        left = {path.name for path in folder.iterdir()} - {path.name for path in outputs} - {"recording.h5"}
    if not same or left:
        report(f"side by side: codes {codes}, the same {same}, left {left}")
    return f"{runs} runs side by side: exit codes {sorted(set(codes))}, the same bytes: {same}, files left: {len(left)}"


def huge(pool: Pool, *, seconds: float = 30.0, report: Report = print) -> list[str]:
    """Recordings of 50 GB that are small on disk: refused, or read in little memory until they are told to stop."""
    lines = []
    with tempfile.TemporaryDirectory(prefix="load-") as name:
        for kind in ("in chunks", "in one piece"):
            path = Path(name) / f"{kind.replace(' ', '_')}.h5"
            _declare(path, chunked=kind == "in chunks")
            for command in (("info",), ("estimate", "--window", "100", "--memory", "400MB")):
                argv = (command[0], path.name, *command[1:])
                outcome = pool.run(
                    Job(argv=argv, cwd=name, kill_after_s=seconds, kill_signal=15, timeout_s=20.0, cpu_s=600)
                )
                text = {0: "done", -15: "stopped as it was told"}.get(outcome.code, f"exit code {outcome.code}")
                lines.append(f"50 GB {kind}, {command[0]}: {text}, {outcome.extra_bytes / 1e6:.0f} MB")
                left = [file.name for file in Path(name).iterdir() if "journal" not in file.name and file != path]
                if outcome.hung or outcome.code not in (0, 2, 3, -15) or outcome.extra_bytes > 400e6 or left:
                    report(f"{lines[-1]} {left} {outcome.err[-300:]}")
            for file in Path(name).iterdir():
                file.unlink()
    return lines


def _declare(path: Path, *, chunked: bool) -> None:
    """Write a recording of 50 GB of which nothing but the header is on the disk."""
    shape = (986_000, 144, 176)
    with h5py.File(path, "w") as root:
        if chunked:
            root.create_dataset("range", shape=shape, dtype="u2", chunks=(100, 8, 176), compression="gzip")
        else:
            creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            creation.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            creation.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            space = h5py.h5s.create_simple(shape)
            h5py.h5d.create(root.id, b"range", h5py.h5t.NATIVE_UINT16, space, creation)
        sensor = root.create_group("sensor")
        sensor.attrs.update({"range_min_mm": 300.0, "range_max_mm": 7500.0})
        for key, values in NOISE.items():
            sensor[key] = values


def soak(count: int, *, report: Report = print) -> str:
    """Estimate and report many small recordings in one process; return how its memory went."""
    with tempfile.TemporaryDirectory(prefix="load-") as name:
        command = [sys.executable, "-m", "faults.load", str(count)]
        path = os.pathsep.join([str(Path(__file__).parents[1]), str(Path(__file__).parents[2])])
        done = subprocess.run(
            command, cwd=name, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": path}
        )
    if done.returncode:
        report(f"soak: {done.stderr[-2000:]}")
        return f"soak: exit code {done.returncode}"
    seen = json.loads(done.stdout.splitlines()[-1])
    first, last = seen[len(seen) // 5], seen[-1]
    grown = last["bytes"] - first["bytes"]
    if grown > MOST_GROWTH_BYTES or last["files"] > first["files"] or last["threads"] > first["threads"]:
        report(f"soak: {first} -> {last}")
    return (
        f"{last['run']} recordings in one process: {first['bytes'] / 1e6:.1f} MB after {first['run']},"
        f" {last['bytes'] / 1e6:.1f} MB after all; open files {first['files']} -> {last['files']},"
        f" threads {first['threads']} -> {last['threads']}"
    )


MOST_GROWTH_BYTES = 8_000_000
"""A leak of one recording's samples (0.2 MB) in each run would be 160 MB in 800 runs."""


def _soak(count: int) -> None:
    """Run in a process of its own."""
    from tofmix.cli.main import run

    here, seen = Path(), []
    for number in range(1, count + 1):
        recording = write_recording(Path("a.h5"), boards(100, 16, 20) + number % 7)
        for argv in (["estimate", "a.h5", "--window", "50", "--overwrite"], ["report", "a.layers.h5"]):
            try:
                run(argv)
            except SystemExit as leave:
                if leave.code:
                    raise
        recording.unlink()
        if number % max(1, count // 20) == 0:
            gc.collect()
            resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
            files = len(list(Path("/proc/self/fd").iterdir()))
            seen.append({"run": number, "bytes": resident, "files": files, "threads": threading.active_count()})
    if sorted(path.name for path in here.iterdir()) != ["a.layers.h5"]:
        raise AssertionError(sorted(here.iterdir()))
    print(json.dumps(seen))


def worker_killed(*, report: Report = print) -> str:
    """Kill a worker of a cluster of two, with SIGKILL, while it computes; the result must be what one process makes."""
    program = (
        "import sys, threading, time, os, signal, subprocess\n"
        "from distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:\n"
        "        argv = [sys.executable, '-m', 'tofmix', 'estimate', 'a.h5', '-o', 'b.layers.h5', '--window', '10',\n"
        "                '--scheduler', cluster.scheduler_address]\n"
        "        run = subprocess.Popen(argv)\n"
        "        while run.poll() is None and not os.path.exists('.b.layers.h5.journal'):\n"
        "            time.sleep(0.02)\n"
        "        time.sleep(float(sys.argv[1]))\n"
        "        print('computing' if run.poll() is None else 'too late')\n"
        "        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)\n"
        "        sys.exit(run.wait())\n"
    )
    with tempfile.TemporaryDirectory(prefix="load-") as name:
        folder = Path(name)
        write_recording(folder / "a.h5", boards(2000, 32, 40))
        alone = subprocess.run([*TOFMIX, "estimate", "a.h5", "--window", "10"], cwd=name, check=False)
        codes, same, met = [alone.returncode], [], 0
        for after_s in (0.0, 0.3, 1.0):
            done = subprocess.run(
                [sys.executable, "-c", program, str(after_s)], cwd=name, capture_output=True, text=True, check=False
            )
            codes.append(done.returncode)
            met += "computing" in done.stdout
            made = folder / "b.layers.h5"
            same.append(made.exists() and same_content(folder / "a.layers.h5", made))
            made.unlink(missing_ok=True)
            if not same[-1]:
                report(f"a worker killed: {done.stderr[-1000:]}")
    if not met:
        report("a worker killed: each time the run had ended before")
    return (
        f"a cluster's worker killed {len(same)} times, {met} of them while the run went on:"
        f" exit codes {sorted(set(codes))}, the same result: {all(same)}"
    )


if __name__ == "__main__":
    _soak(int(sys.argv[1]))
