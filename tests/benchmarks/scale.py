"""Memory and throughput of `tofmix estimate` on long recordings, by layout, memory limit, workers and stride.

Usage: python tests/benchmarks/scale.py [--frames 20000] [--window 100] [--only default,300MB] [--no-kernels]

The recording is 144 x 176 pixels of the built-in three boards; its first 100 frames are repeated, which changes neither
the work of a window nor the size of a chunk. "of the kernel" is the throughput beside that of the same kernels on
samples in memory, with the same number of workers and nothing read or written, measured just before. With
--no-kernels the layers of one window are given again and again: what is left is reading, packing and writing.
"""

import argparse
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from tofmix.arrays import Float32Array
from tofmix.estimation.blocks.sequence import estimate_cells
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import plan_grid, plan_windows
from tofmix.io.model_file import load_model
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.render import recording_sensor, render_blocks

BLOCK_FRAMES = 100


@dataclass(frozen=True)
class Case:
    """One line of the table."""

    name: str
    frames: float
    """Frames over --frames."""
    rows: int
    cols: int
    chunks: tuple[int, int, int]
    arguments: tuple[str, ...] = ()
    stride: float = 1.0
    """Stride over the window."""


TALL = (BLOCK_FRAMES, 8, 22)
CASES = (
    Case("default", 1, 144, 176, TALL),
    Case("300MB", 1, 144, 176, TALL, ("--memory", "300MB")),
    Case("very tall chunks, 300MB", 1, 144, 176, (2000, 8, 22), ("--memory", "300MB")),
    Case("frame by frame, 300MB", 1, 144, 176, (1, 144, 176), ("--memory", "300MB")),
    Case("5 x the frames, 36 x 44 pixels, 300MB", 5, 36, 44, (BLOCK_FRAMES, 36, 44), ("--memory", "300MB")),
    Case("stride of half a window", 0.5, 144, 176, TALL, (), 0.5),
    Case("one worker", 0.5, 144, 176, TALL, ("--workers", "1")),
    Case("two workers", 0.5, 144, 176, TALL, ("--workers", "2")),
)


def scene() -> tuple[Float32Array, Sensor]:
    """Frames of the three boards, and their camera."""
    model = load_model("three-boards")
    block = next(iter(render_blocks(model, cast_scene(model), n_frames=BLOCK_FRAMES, seed=1)))
    return block.range_mm.astype(np.float32), recording_sensor(model)


def write(path: Path, samples: Float32Array, sensor: Sensor, n_frames: int, case: Case) -> None:
    """Write a recording of repeated frames; equal chunks are compressed once."""
    frames = min(case.chunks[0], n_frames)
    part = np.resize(samples[:, : case.rows, : case.cols], (frames, case.rows, case.cols)).astype("u2")
    with h5py.File(path, "w") as root:
        dataset = root.create_dataset(
            "range",
            (n_frames, case.rows, case.cols),
            "u2",
            chunks=(frames, *case.chunks[1:]),
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            fletcher32=True,
        )
        dataset[:frames] = part
        first = [dataset.id.get_chunk_info(k).chunk_offset for k in range(dataset.id.get_num_chunks())]
        packed = {offset: dataset.id.read_direct_chunk(offset)[1] for offset in first}
        repeat = max(1, BLOCK_FRAMES // frames)
        if repeat > 1:  # chunks of few frames: repeat a whole block of them
            dataset[: repeat * frames] = np.resize(
                samples[:, : case.rows, : case.cols], (repeat * frames, *part.shape[1:])
            )
            first = [dataset.id.get_chunk_info(k).chunk_offset for k in range(dataset.id.get_num_chunks())]
            packed = {offset: dataset.id.read_direct_chunk(offset)[1] for offset in first}
        for start in range(repeat * frames, n_frames, repeat * frames):
            for offset, data in packed.items():
                if start + offset[0] < n_frames:
                    dataset.id.write_direct_chunk((start + offset[0], *offset[1:]), data)
        group = root.create_group("sensor")
        group.attrs.update({"range_min_mm": sensor.range_min_mm, "range_max_mm": sensor.range_max_mm})
        assert sensor.noise is not None
        group["noise_range"], group["noise_sigma"] = sensor.noise.range_mm, sensor.noise.sigma_mm


def in_memory(samples: Float32Array, sensor: Sensor, case: Case, window: int, workers: int) -> float:
    """Samples a second of the kernels alone."""
    n = 6 * window if case.rows > 100 else 60 * window
    recording = ArrayRecording(np.resize(samples[:, : case.rows, : case.cols], (n, case.rows, case.cols)), sensor)
    windows = plan_windows(n, window=window)
    grid = plan_grid(windows, (case.rows, case.cols), row_step=min(8, case.rows))
    start = time.perf_counter()
    for _ in estimate_cells(recording, grid, EstimateOptions(), lambda _: None, workers=workers):
        pass
    return windows.count * window * case.rows * case.cols / (time.perf_counter() - start)


def measure(command: Sequence[str]) -> tuple[float, float, float]:
    """Seconds, processor seconds and peak resident MB of one run."""
    start = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    # Not ru_maxrss: it starts from what this process has.
    peak, status = 0, Path(f"/proc/{child.pid}/status")
    while child.poll() is None:
        found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
        peak = max(peak, int(found[1]) if found else 0)
        time.sleep(0.01)
    if child.returncode != 0:
        sys.exit(f"failed: {' '.join(command)}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - start, busy, peak * 1024 / 1e6


def without_kernels(layers: Path, arguments: list[str]) -> None:
    """Run the command line with kernels that know the answer."""
    from tofmix.cli.main import run
    from tofmix.estimation.blocks import sequence
    from tofmix.io.layers.layers_file import open_layers

    with open_layers(layers) as file:
        known = file.read_window(0)

    def recall(samples: Float32Array, *_: object) -> Layers:
        rows, cols = samples.shape[1:]
        return Layers(**{spec.name: getattr(known, spec.name)[-rows:, -cols:] for spec in LAYER_FIELDS})

    sequence.layer_pixels = recall  # type: ignore[assignment,attr-defined]
    run(arguments)


def main() -> None:
    if sys.argv[1:2] == ["--recall"]:
        without_kernels(Path(sys.argv[2]), sys.argv[3:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--window", type=int, default=100)
    parser.add_argument("--only", default="", help="names of cases, by comma")
    parser.add_argument("--folder", type=Path, help="where the recordings lie; a temporary one without it")
    parser.add_argument("--no-kernels", action="store_true")
    arguments = parser.parse_args()
    only = {name for name in arguments.only.split(",") if name}
    samples, sensor = scene()
    last = "core s a window" if arguments.no_kernels else "of the kernel"
    print(f"| recording and options | frames | s | cores | peak MB | M samples/s | {last} |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        program, known = ["-m", "tofmix"], Path(name) / "known.layers.h5"
        if arguments.no_kernels:
            write(known.with_name("known.h5"), samples, sensor, BLOCK_FRAMES, CASES[0])
            measure([sys.executable, "-m", "tofmix", "estimate", str(known.with_name("known.h5")), "-o", str(known)])
            program = [__file__, "--recall", str(known)]
        for case in CASES:
            if only and case.name not in only:
                continue
            path, n_frames = Path(name) / "long.h5", int(arguments.frames * case.frames)
            write(path, samples, sensor, n_frames, case)
            workers = 1 if case.name == "one worker" else 2
            kernel = 0.0 if arguments.no_kernels else in_memory(samples, sensor, case, arguments.window, workers)
            stride = max(1, int(arguments.window * case.stride))
            command = [
                sys.executable,
                *program,
                "estimate",
                str(path),
                "--overwrite",
                "--window",
                str(arguments.window),
                "--stride",
                str(stride),
                "--workers",
                str(workers),
                *case.arguments,
            ]
            seconds, busy, memory = measure(command)
            windows = plan_windows(n_frames, window=arguments.window, stride=stride)
            rate = windows.count * arguments.window * case.rows * case.cols / seconds
            share = busy / windows.count if arguments.no_kernels else rate / kernel
            print(
                f"| {case.name} | {n_frames:,} | {seconds:.1f} | {busy / seconds:.2f} | {memory:.0f} |"
                f" {rate / 1e6:.2f} | {share:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
