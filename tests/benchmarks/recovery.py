"""Surfaces found and range errors, on scenes whose truth is known and on the real sample recording.

Usage: python tests/benchmarks/recovery.py [--seeds 11 12 13]

Prints Markdown tables; docs/results/limits.md has them in short. Asserts nothing.
"""

import argparse
from pathlib import Path

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.learnt.recordings import learn_noise
from tofmix.io.model_file import load_model
from tofmix.io.recording.recording_file import open_recording
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.render import recording_sensor, render_blocks

SAMPLE = Path(__file__).parents[2] / "sample_data" / "tmf8829_edge.h5"


def simulated(name: str, seed: int) -> tuple[Truth, Layers, Sensor]:
    """Truth and layers of one recording of a built-in scene."""
    model = load_model(name)
    truth = cast_scene(model)
    blocks = render_blocks(model, truth, n_frames=100, seed=seed)
    samples = np.concatenate([block.range_mm for block in blocks])
    sensor = recording_sensor(model)
    return truth, estimate_layers(ArrayRecording(samples, sensor), workers=2), sensor


def between(layers: Layers, truth: Truth, sensor: Sensor) -> BoolArray:
    """Which layers lie more than 3 sigma from every true surface: invented ones."""
    assert sensor.noise is not None
    away = np.abs(layers.range[0][..., :, None] - truth.range_true[..., None, :])
    away /= sensor.noise.sigma(truth.range_true.astype(np.float64))[..., None, :]
    nearest = np.nanmin(np.where(np.isnan(away), np.inf, away), axis=-1)
    return np.asarray(np.isfinite(layers.range[0]) & (nearest > 3))


def scene(name: str, seeds: list[int]) -> None:
    """Print one row a seed."""
    for seed in seeds:
        truth, layers, sensor = simulated(name, seed)
        found = layers.n_modes[0]
        least = np.nanmin(np.where(np.isnan(truth.weight_true), np.inf, truth.weight_true), axis=-1)
        three = (truth.n_modes == 3) & (least >= 0.1)
        one = truth.n_modes == 1
        errors = "-"
        right = three & (found == 3)
        if right.any():
            mean = (layers.range[0][right][:, :3] - truth.range_true[right]).mean(axis=0)
            errors = ", ".join(f"{value:+.1f}" for value in mean)
        share = f"{(found[three] == 3).mean():.3f} of {three.sum()}" if three.any() else "-"
        invented = 1000 * between(layers, truth, sensor).sum() / np.isfinite(layers.range).sum()
        print(
            f"| {name} | {seed} | {share} | {errors} | {(found[one] == 1).mean():.4f} of {one.sum()} | {invented:.2f} |"
        )


def real_recording(*, learnt: bool) -> None:
    """Print what comes out of the real sample recording, with the file's noise curve or the learnt noise."""
    print("noise learnt, as without an option:" if learnt else "the file's noise curve, as by --noise file:")
    with open_recording(SAMPLE) as file:
        recording = file
        if learnt:
            recording = file.with_sensor(learn_noise(file, window_frames=file.frames, workers=2).sensor)
        layers = estimate_layers(recording, workers=2)
        frames = recording.read_range(slice(None), slice(None))
    samples = np.sort(frames, axis=0)
    gaps = np.diff(samples, axis=0)
    edge = gaps.max(axis=0) > 1000
    at = gaps.argmax(axis=0) + 1
    lesser = np.minimum(at, len(samples) - at)
    wanted = edge & (lesser >= 3)
    ranges = layers.range[0]
    far_apart = np.nanmax(ranges, axis=-1) - np.nanmin(ranges, axis=-1) > 1000
    away = np.nanmax(np.abs(ranges - np.median(samples, axis=0)[..., None]), axis=-1)
    print(
        f"pixels with two depths, the lesser with 3 samples or more: {wanted.sum()}; found: {far_apart[wanted].sum()}"
    )
    print(f"other pixels: {(~edge).sum()}; no layer 150 mm from the median: {(away[~edge] <= 150).sum()}")
    print(f"pixels by number of surfaces: {np.bincount(layers.n_modes.ravel()).tolist()}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13])
    seeds = parser.parse_args().seeds
    columns = ("scene", "seed", "three surfaces found", "mean range error a board, mm", "one surface found")
    print(f"| {' | '.join(columns)} | invented, per 1000 |")
    print("|---" * 6 + "|")
    for name in ("three-boards", "corridor"):
        scene(name, seeds)
    print()
    real_recording(learnt=False)
    print()
    real_recording(learnt=True)


if __name__ == "__main__":
    main()
