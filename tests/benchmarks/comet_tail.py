"""Layers where there is nothing, and how many of the surfaces are found.

Usage: python tests/benchmarks/comet_tail.py [--pixels 12288] [--seeds 1 2 3 4 5] [--frames 100]

Prints a Markdown table; docs/results/limits.md has them in short. Asserts nothing.

The scenes: the two built-in ones with their own camera, and one of random boards for each seed with another camera
of about `--pixels` pixels. A layer is invented if it lies more than 3 sigma from every true surface of its pixel; in
brackets, how many of those lie between two surfaces. The plain average is one layer a pixel, the mean of its samples.
Of pixels with two surfaces or more, a surface is clear if its share is 0.1 or more and the pixel's next surface, and
range_max, are 3 sigma away or more, in sigmas of the wider; it is found if a layer lies within 1.5 sigma of it, so that
no layer counts for two.
"""

import argparse
import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.io.model_file import load_model
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import recording_sensor, render_blocks

CLEAR_SIGMAS = 3.0
FOUND_SIGMAS = 1.5
LEAST_SHARE = 0.1
BOARDS = 14
SEED = 73

CAMERA = """
[sensor]
name = "benchmark"
rows = {rows}
cols = {cols}
fov_horizontal_deg = 60.0
fov_vertical_deg = 46.0
range_min_mm = 300.0
range_max_mm = 9000.0
modulation_frequency_hz = 15.0e6
integration_time_ms = 2.0
default_integration_time_ms = 8.0
outlier_probability = 1.0e-4

[sensor.noise]
range_mm = [300.0, 1500.0, 3000.0, 6000.0, 9000.0]
sigma_mm = [6.0, 11.0, 24.0, 70.0, 150.0]
reference_integration_time_ms = 2.0
exponent = 0.5
"""

BOARD = """
[[surface]]
name = "board {number}"
center_mm = [{x:.1f}, {y:.1f}, {z:.1f}]
size_mm = [{width:.1f}, {height:.1f}]
yaw_deg = {yaw:.2f}
pitch_deg = {pitch:.2f}
reflectivity = {reflectivity:.2f}
"""

WALL = """
[[surface]]
name = "back wall"
center_mm = [0.0, 0.0, {z:.1f}]
size_mm = [7000.0, 12000.0]
yaw_deg = {yaw:.2f}
reflectivity = 0.7
"""


def random_scene(seed: int, pixels: int) -> str:
    """Text of a model file: boards of any size, place and tilt before a wall that does not fill the image."""
    rng = np.random.default_rng([SEED, seed])
    rows = max(round(math.sqrt(0.75 * pixels)), 1)
    text = CAMERA.format(rows=rows, cols=max(round(pixels / rows), 1))
    text += WALL.format(z=rng.uniform(5500.0, 7000.0), yaw=rng.uniform(-15.0, 15.0))
    for number in range(BOARDS):
        z = rng.uniform(900.0, 5000.0)
        text += BOARD.format(
            number=number,
            x=z * rng.uniform(-0.55, 0.55),
            y=z * rng.uniform(-0.4, 0.4),
            z=z,
            width=z * rng.uniform(0.1, 0.4),
            height=z * rng.uniform(0.1, 0.4),
            yaw=rng.uniform(-50.0, 50.0),
            pitch=rng.uniform(-35.0, 35.0),
            reflectivity=rng.uniform(0.2, 0.9),
        )
    return text


class Seen(NamedTuple):
    """True surfaces (pixel, layer): ranges, mm, NaN where there is none; noise there, mm; shares; open space."""

    range_mm: FloatArray
    sigma_mm: FloatArray
    share: FloatArray
    open_share: FloatArray


def seen_by_pixels(truth: Truth, noise: NoiseCurve) -> Seen:
    """Flatten the image."""
    count = truth.range_true.shape[-1]
    range_mm = truth.range_true.reshape(-1, count).astype(np.float64)
    sigma = np.where(np.isnan(range_mm), np.nan, noise.sigma(range_mm))
    share = np.nan_to_num(truth.weight_true.reshape(-1, count).astype(np.float64))
    return Seen(range_mm, sigma, share, truth.weight_no_return.ravel().astype(np.float64))


def invented(layers_mm: FloatArray, seen: Seen) -> tuple[int, int]:
    """Number of the layers (pixel, layer) more than 3 sigma from every surface, and of those between two surfaces."""
    away = (layers_mm[:, :, None] - seen.range_mm[:, None, :]) / seen.sigma_mm[:, None, :]
    far = np.isfinite(layers_mm) & ~(np.abs(away) <= CLEAR_SIGMAS).any(axis=2)
    between = far & (away > 0).any(axis=2) & (away < 0).any(axis=2)
    return int(far.sum()), int(between.sum())


def clear_surfaces(seen: Seen, range_max_mm: float, sigma_max_mm: float) -> BoolArray:
    """Which surfaces of pixels with several have share enough and neighbours far enough."""
    wider = np.maximum(seen.sigma_mm[:, 1:], seen.sigma_mm[:, :-1])
    gap = np.diff(seen.range_mm, axis=1) / wider
    apart = ~(gap < CLEAR_SIGMAS)
    clear = (seen.share >= LEAST_SHARE) & ((range_max_mm - seen.range_mm) / sigma_max_mm >= CLEAR_SIGMAS)
    clear[:, 1:] &= apart
    clear[:, :-1] &= apart
    several = np.isfinite(seen.range_mm).sum(axis=1, keepdims=True) > 1
    return np.asarray(clear & several)


def found_surfaces(layers_mm: FloatArray, seen: Seen) -> BoolArray:
    """Which surfaces have a layer near them."""
    away = np.abs(layers_mm[:, :, None] - seen.range_mm[:, None, :]) / seen.sigma_mm[:, None, :]
    return np.asarray((away <= FOUND_SIGMAS).any(axis=1))


class Scores(NamedTuple):
    """Hits and trials of one scene, in the order of the table."""

    invented: int
    between: int
    layers: int
    averaged: int
    averaged_between: int
    pixels: int
    found: int
    clear: int
    one: int
    alone: int


def record(model: Model, truth: Truth, frames: int, seed: int) -> Float32Array:
    """Samples (frame, row, col)."""
    blocks = render_blocks(model, truth, n_frames=frames, seed=seed)
    return np.concatenate([block.range_mm for block in blocks]).astype(np.float32)


def score(model: Model, frames: int, seed: int) -> Scores:
    """Record, estimate and count."""
    truth, sensor = cast_scene(model), recording_sensor(model)
    samples = record(model, truth, frames, seed)
    layers = estimate_layers(ArrayRecording(samples, sensor), workers=2)
    found_mm = layers.range[0].reshape(-1, layers.max_layers).astype(np.float64)
    mean_mm = samples.reshape(frames, -1).mean(axis=0, dtype=np.float64)[:, None]
    noise, top = sensor.noise, sensor.range_max_mm
    assert noise is not None
    assert top is not None
    seen = seen_by_pixels(truth, noise)
    clear = clear_surfaces(seen, top, float(noise.sigma(top)))
    alone = (truth.n_modes.ravel() == 1) & (seen.open_share == 0.0)
    one = layers.n_modes[0].ravel() == 1
    return Scores(
        *invented(found_mm, seen),
        int(np.isfinite(found_mm).sum()),
        *invented(mean_mm, seen),
        len(mean_mm),
        int((found_surfaces(found_mm, seen) & clear).sum()),
        int(clear.sum()),
        int((one & alone).sum()),
        int(alone.sum()),
    )


def row(name: str, scores: Scores) -> None:
    """Print one row."""
    s = scores
    found = f"{s.found / s.clear:.4f} of {s.clear}" if s.clear else "-"
    print(
        f"| {name} | {1000 * s.invented / s.layers:.2f} ({s.between}) of {s.layers}"
        f" | {1000 * s.averaged / s.pixels:.2f} ({s.averaged_between}) | {found}"
        f" | {s.one / max(s.alone, 1):.4f} of {s.alone} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=12288, help="pixels of a random scene")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--frames", type=int, default=100)
    chosen = parser.parse_args()
    columns = (
        "scene",
        "invented, per 1000 layers (between)",
        "plain average (between)",
        "clear surfaces found",
        "one surface found as one",
    )
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    models = {name: load_model(name) for name in ("three-boards", "corridor")}
    for seed in chosen.seeds:
        models[f"random {seed}"] = parse_model(random_scene(seed, chosen.pixels), source=f"random {seed}")
    every = []
    for number, (name, model) in enumerate(models.items()):
        every.append(score(model, chosen.frames, 1000 * SEED + number))
        row(name, every[-1])
    row("all", Scores(*(sum(values) for values in zip(*every, strict=True))))


if __name__ == "__main__":
    main()
