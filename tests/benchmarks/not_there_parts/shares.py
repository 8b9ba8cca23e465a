"""Edges where shares of samples are no areas: cameras that detect single photons, or keep the strongest return.

A near board of two edges before a wall, recorded without the package: the edges lean, and cross every share. The errors
of edge points are in pixels, across the edge.
"""

import argparse
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import tofmix as tm
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import Sensor
from tofmix.sensor_schema import ShareLaw
from tofmix.surfaces.found import Edges
from tofmix.surfaces.reconstruct import reconstruct

ROWS, COLS, FRAMES, PARTS, FOCAL = 48, 64, 100, 24, 80.0
NEAR_MM, FAR_MM, NEAR_SIGMA_MM, FAR_SIGMA_MM = 1500.0, 3500.0, 8.0, 15.0
SLOPE, PLACES = 0.13, (20.0, 44.0)
"""Columns of the board's edges in the middle row, and their change from row to row."""

LIGHT_NOISE, TEXTURE, NEAR_ENOUGH = 0.1, 0.05, 3.0

Values = NDArray[np.float64]


class Case(NamedTuple):
    """A law, and the light of board and wall."""

    name: str
    law: ShareLaw
    near: float
    far: float


CASES = (
    Case("area", ShareLaw.AREA, 1.0, 1.0),
    Case("detections, equal reflectivity", ShareLaw.DETECTIONS, NEAR_MM**-2, FAR_MM**-2),
    Case("detections, dark board", ShareLaw.DETECTIONS, 0.1 * NEAR_MM**-2, 0.9 * FAR_MM**-2),
    Case("detections, dark wall", ShareLaw.DETECTIONS, 0.9 * NEAR_MM**-2, 0.3 * FAR_MM**-2),
    Case("strongest, equal reflectivity", ShareLaw.STRONGEST, NEAR_MM**-2, FAR_MM**-2),
    Case("strongest, dark board", ShareLaw.STRONGEST, 0.1 * NEAR_MM**-2, 0.9 * FAR_MM**-2),
)


def shares() -> Values:
    """Share (row, col) of the board."""
    steps = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    row = np.arange(ROWS)[:, np.newaxis] + steps
    col = np.arange(COLS)[:, np.newaxis] + steps
    lean = SLOPE * (row - (ROWS - 1) / 2)[:, :, np.newaxis, np.newaxis]
    inside = (col > PLACES[0] + lean) & (col < PLACES[1] + lean)
    return np.asarray(inside.mean(axis=(1, 3)), np.float64)


def record(case: Case, *, seed: int, texture: float = TEXTURE, dims: bool = False) -> tm.Recording:
    """Draw the samples of a case; with `dims`, the amplitude of a detection too goes with the part that is covered."""
    draw = np.random.default_rng(seed)
    share = shares()
    grain = np.exp(texture * draw.standard_normal((2, ROWS, COLS)))
    light = np.stack([share * case.near, (1.0 - share) * case.far]) * grain * 1e9
    flicker = 1.0 + LIGHT_NOISE * draw.standard_normal((2, FRAMES, ROWS, COLS))
    returned = light[:, np.newaxis] * flicker
    if case.law is ShareLaw.STRONGEST:
        near = returned[0] > returned[1]
    else:
        parts = light if case.law is ShareLaw.DETECTIONS else np.stack([share, 1.0 - share])
        near = draw.random((FRAMES, ROWS, COLS)) < parts[0] / parts.sum(axis=0)
        if not dims:
            returned = np.stack([case.near, case.far])[:, np.newaxis, np.newaxis, np.newaxis] * 1e9 * flicker
            returned = returned * grain[:, np.newaxis]
    lens = Pinhole(fx=FOCAL, fy=FOCAL, cx=(COLS - 1) / 2, cy=(ROWS - 1) / 2)
    length = np.linalg.norm(lens.rays(*np.mgrid[0.0:ROWS, 0.0:COLS], shape=(ROWS, COLS)), axis=-1)
    range_mm = np.where(
        near,
        NEAR_MM * length + NEAR_SIGMA_MM * draw.standard_normal(near.shape),
        FAR_MM * length + FAR_SIGMA_MM * draw.standard_normal(near.shape),
    )
    camera = Sensor(name="edges", range_min_mm=100.0, range_max_mm=6000.0, projection=lens, measurement="pulses")  # type: ignore[arg-type]
    return tm.from_array(range_mm, units="mm", sensor=camera, amplitude=np.where(near, returned[0], returned[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Errors of edge points.

    Their median and root mean square, pixels, across the edge; the median of the stated errors; and the part within
    two of these.
    """

    median: float
    rms: float
    stated: float
    within: float
    points: int


def errors_of(edges: Edges) -> Errors:
    """Compare edge points with the board's edges."""
    place = edges.col - SLOPE * (edges.row - (ROWS - 1) / 2)
    off = np.stack([place - true for true in PLACES]) / np.hypot(1.0, SLOPE) * np.array([[1.0], [-1.0]])
    nearest = np.abs(off).argmin(axis=0)
    off = np.take_along_axis(off, nearest[np.newaxis], axis=0)[0]
    ours = np.abs(off) < NEAR_ENOUGH
    off, stated = off[ours], edges.stderr[ours]
    return Errors(
        median=float(np.median(off)),
        rms=float(np.sqrt(np.mean(off**2))),
        stated=float(np.nanmedian(stated)),
        within=float(np.mean(np.abs(off) < 2.0 * stated)),
        points=len(off),
    )


def edges_of(recording: tm.Recording, law: ShareLaw | None) -> Edges:
    """Estimate a recording whose law of shares is known, or not, and find its edges."""
    found = tm.estimate(recording.with_sensor(share_law=law))
    return reconstruct(found.window(0), found.sensor).edges


def print_shares(seeds: list[int]) -> None:
    """Print a row for each case, with and without its law."""
    print(
        "\n**Edges where shares are no areas** (pixels)\n\n| camera | law | median error | rms | stated | within two"
        " stated errors | stated, over that of areas |\n|---|---|---|---|---|---|---|"
    )
    usual = 1.0
    for case in CASES:
        for law in (None, case.law):
            found = [errors_of(edges_of(record(case, seed=seed), law)) for seed in seeds]
            row = np.mean([[one.median, one.rms, one.stated, one.within] for one in found], axis=0)
            if case is CASES[0]:
                usual = row[2]
            print(
                f"| {case.name} | {'not known' if law is None else law} | {row[0]:+.3f} | {row[1]:.3f} | {row[2]:.4f} |"
                f" {row[3]:.2f} | {row[2] / usual:.2f} |",
                flush=True,
            )


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    print_shares(parser.parse_args(arguments).seeds)
