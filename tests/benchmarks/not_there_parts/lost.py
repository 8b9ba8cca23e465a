"""A box that returns no valid sample, or few, before a wall; and samples that all pixels lose by chance.

The box is black, or saturates its pixels: its own samples are never valid, and a few samples of its pixels are those of
the wall behind it. A map must not take the space behind the box as free.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from support.cameras import camera_of

from tofmix.arrays import Float32Array
from tofmix.estimation.blocks.sequence import estimate_windows
from tofmix.layers import Layers
from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, plan_grid
from tofmix.mapping.occupancy import State, map_beams
from tofmix.recording import ArrayRecording

SHAPE = (36, 48)  # pixels
BOX = (slice(8, 30), slice(18, 30))
FOV_DEG = (48.0, 36.0)  # one degree a pixel
WALL_MM, BOX_MM, SIGMA_MM = 4000.0, 1500.0, 30.0
CELL_MM = 50.0
SENSOR = camera_of(
    [1000.0, 7500.0], [SIGMA_MM] * 2, reach_mm=(300.0, 7500.0), fov_deg=FOV_DEG, outlier_probability=1e-4
)


@dataclass(frozen=True, kw_only=True)
class Case:
    """Shares of the samples that are lost: in the pixels of the box, and in all others."""

    name: str
    in_box: float
    elsewhere: float = 0.0


CASES = (
    Case(name="no box", in_box=0.0),
    Case(name="box, no sample valid", in_box=1.0),
    Case(name="box, 5 % valid", in_box=0.95),
    Case(name="box, 20 % valid", in_box=0.8),
    Case(name="all pixels lose 30 %", in_box=0.3, elsewhere=0.3),
    Case(name="all pixels lose 60 %", in_box=0.6, elsewhere=0.6),
    Case(name="box, 5 % valid; others lose 30 %", in_box=0.95, elsewhere=0.3),
)


def directions() -> NDArray[np.float64]:
    """Azimuth and elevation (2, row, col) of the pixels' centres, rad."""
    row, col = np.indices(SHAPE)
    return np.radians(np.stack([col - (SHAPE[1] - 1) / 2, row - (SHAPE[0] - 1) / 2]))


def recorded(case: Case, frames: int, seed: int) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Samples (frame, row, col) of a flat wall, NaN where lost; and which are lost."""
    rng = np.random.default_rng([seed, frames])
    azimuth, elevation = directions()
    wall = WALL_MM / (np.cos(azimuth) * np.cos(elevation))
    samples = wall + SIGMA_MM * rng.standard_normal((frames, *SHAPE))
    share = np.full(SHAPE, case.elsewhere)
    share[BOX] = case.in_box
    lost = rng.random(samples.shape) < share
    return np.where(lost, np.nan, np.rint(samples)).astype(np.float32), lost


def estimated(samples: Float32Array) -> Layers:
    """Layers (row, col) of all frames."""
    found = estimate_windows(ArrayRecording(samples, SENSOR)).layers
    return Layers(**{spec.name: getattr(found, spec.name)[0] for spec in found.fields})


def behind_box(grid: VoxelGrid) -> NDArray[np.bool_]:
    """Voxels (x, y, z) that lie wholly behind the box, and before the wall."""
    out = np.ones(grid.shape, bool)
    for corner in np.ndindex(2, 2, 2):
        ends = (grid.centres_mm(axis) + (corner[axis] - 0.5) * CELL_MM for axis in range(3))
        x, y, z = np.meshgrid(*ends, indexing="ij")  # ahead, to the left, up
        col = np.degrees(np.arctan2(-y, x)) + SHAPE[1] / 2
        row = np.degrees(np.arctan2(-z, np.hypot(x, y))) + SHAPE[0] / 2
        out &= (row > BOX[0].start) & (row < BOX[0].stop) & (col > BOX[1].start) & (col < BOX[1].stop)
        distance = np.sqrt(x**2 + y**2 + z**2)
        out &= (distance > BOX_MM) & (distance < WALL_MM - CELL_MM)
    return out


def mapped(layers: Layers) -> tuple[int, int, int]:
    """Free voxels behind the box, all voxels there, and free voxels of the whole map."""
    beams = beams_from_layers(layers, SENSOR)
    grid = plan_grid(beams, Pose(), cell_mm=CELL_MM, height_mm=(-600.0, 600.0))
    free = map_beams(beams, Pose(), grid, workers=2).states() == int(State.FREE)
    there = behind_box(grid)
    return int((free & there).sum()), int(there.sum()), int(free.sum())


def row(case: Case, frames: int, seed: int) -> str:
    """One line of the table."""
    samples, lost = recorded(case, frames, seed)
    layers = estimated(samples)
    assert layers.invalid_share is not None
    wrong = float(np.abs(layers.invalid_share - lost.mean(axis=0)).max())
    box = np.zeros(SHAPE, bool)
    box[BOX] = True
    first = layers.probability[..., 0]
    free, of, everywhere = mapped(layers)
    inside = "-" if np.isnan(first[box]).all() else f"{np.nanmedian(first[box]):.3f}"
    return (
        f"| {case.name} | {frames} | {wrong:.1g} | {int((layers.n_modes[box] > 0).sum())} of {int(box.sum())} |"
        f" {inside} | {np.nanquantile(first[~box], 0.01):.4f} | {free} of {of} | {everywhere} |"
    )


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="not_there.py lost", description=__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[25, 100])
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args(arguments)
    print(
        "| scene | frames | error of `invalid_share` | box pixels with a layer | their probability (median) |"
        " probability elsewhere (1 %) | free voxels behind the box | free voxels |\n|---|---|---|---|---|---|---|---|"
    )
    for case in CASES:
        for frames in chosen.frames:
            print(row(case, frames, chosen.seed), flush=True)


if __name__ == "__main__":
    main([])
