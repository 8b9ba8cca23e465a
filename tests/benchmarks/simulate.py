"""Wall time and peak memory of `tofmix simulate`, file to file: without effects, with them, and over 10,000 frames.

Usage: PYTHONPATH=tests python tests/benchmarks/simulate.py [--repeat 3] [--frames 10000]

The best of several runs, kernels compiled before. Start-up is the same command for one pixel and one frame; the other
rows have it subtracted. Processor seconds, of all threads, tell what a busy machine's wall time does not. The moving
board and the long runs are made once, the latter at two lengths, so that a memory that grows would show; they need
about 1 GB in the temporary folder.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from support.costs import cost, least_cost

SCENE = "three-boards"
ONE_PIXEL = """
[sensor]
profile = "sr3000"
rows = 1
cols = 1
[[surface]]
center_mm = [0.0, 0.0, 2000.0]
size_mm = [900.0, 900.0]
"""
LIGHT = """
[[effect]]
kind = "vignetting"
corner_factor = 1.3
[[effect]]
kind = "multipath"
surface = "middle board"
share = 0.05
extra_path_mm = 900.0
[[effect]]
kind = "flying_pixels"
probability = 0.2
[[effect]]
kind = "scattering"
share = 0.02
[[effect]]
kind = "pixel_crosstalk"
share = 0.01
"""
CORRELATION = """
[[effect]]
kind = "wiggling"
amplitude_mm = 12.0
phase_rad = 0.3
[[effect]]
kind = "temporal_correlation"
coefficient = 0.3
[[effect]]
kind = "interference"
probability = 0.1
sigma_mm = 60.0
burst_frames = 5
[[effect]]
kind = "saturation"
full_well_amplitude = 900.0
[[effect]]
kind = "phase_wrapping"
unambiguous_range_mm = 7494.8
"""
MOTION = """
[[effect]]
kind = "motion"
surface = "near board"
velocity_mm_s = 2.0
"""

MOVING = "all 10 and a moving board"


def command(model: str, frames: int) -> list[str]:
    """Simulate beside the model."""
    program = [sys.executable, "-m", "tofmix", "simulate", model, "--frames", str(frames)]
    return [*program, "-o", str(Path(model).with_name("out.h5")), "--overwrite"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--frames", type=int, default=10_000, help="length of the long runs")
    options = parser.parse_args()
    from tofmix.simulation import builtin_text

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        models = {"one pixel": ONE_PIXEL}
        for label, effects in {
            "no effect": "",
            "5 light effects": LIGHT,
            "5 correlation effects": CORRELATION,
            "all 10": LIGHT + CORRELATION,
            MOVING: LIGHT + CORRELATION + MOTION,
        }.items():
            models[label] = builtin_text(SCENE) + effects
        paths = {}
        for number, (label, text) in enumerate(models.items()):
            paths[label] = str(folder / f"{number}.toml")
            Path(paths[label]).write_text(text)
        cost(command(paths["one pixel"], 1))  # compiles what is not compiled yet
        start = least_cost(command(paths.pop("one pixel"), 1), options.repeat)
        moving = paths.pop(MOVING)
        print("| 144 x 176 pixels | frames | s beyond start-up | processor s | peak MB |\n|---|---|---|---|---|")
        print(f"| start-up: one pixel | 1 | ({start.seconds:.2f}) | ({start.processor:.2f}) | {start.peak_mb:.0f} |")
        rows = [(label, 100, least_cost(command(path, 100), options.repeat)) for label, path in paths.items()]
        for label in ("no effect", "all 10"):
            rows += [(label, n, cost(command(paths[label], n))) for n in (options.frames // 10, options.frames)]
        rows.append((MOVING, 100, cost(command(moving, 100))))
        for label, frames, run in rows:
            wall, processor = run.seconds - start.seconds, run.processor - start.processor
            print(f"| {label} | {frames} | {wall:.2f} | {processor:.2f} | {run.peak_mb:.0f} |")


if __name__ == "__main__":
    main()
