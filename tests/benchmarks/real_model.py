"""Write the model of the real recording: planes through the ranges of pixels that were picked by eye.

Run as `python tests/benchmarks/real_model.py sample_data/tmf8829_edge_model.toml`; prints what the planes miss, and how
far the surfaces drift. A surface is a plane through the median ranges of the pixels that were picked for it; where it
ends is read off the image. Noise curve and p(c_r) are those that `tofmix estimate --noise auto --outliers auto`
measures. The recording names no end of the working range: 5 m is beyond all that it shows. `--map FRAMES` adds what the
planes miss in each pixel, measured over the first frames, as a map beside the model (`fixed_pattern`).
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tofmix.estimation.noise.measurement import MeasuredNoise, measure_noise
from tofmix.io.model_file import load_model
from tofmix.io.recording.recording_file import open_recording
from tofmix.simulation.casting.cast import cast_scene

Array = NDArray[Any]
Box = tuple[float, float, float, float]  # rows from, to, columns from, to

RECORDING = Path(__file__).parents[2] / "sample_data" / "tmf8829_edge.h5"
ENDLESS_MM = 10000.0
RANGE_MAX_MM = 5000.0
FAR_MM = 150.0  # a sample that is farther from the model is of another surface
SLOPE_EDGE = (2.75, 2.75)  # a pixel on the border between the two slopes


@dataclass(frozen=True, slots=True)
class Seen:
    """A surface in the image: pixels that are surely of it, and its ends; without ends it goes on behind the others."""

    name: str
    pixels: tuple[tuple[int, int, int, int], ...]
    ends: Box | None = None


SEEN = (
    Seen("object", ((4, 15, 6, 11),), (3.5, 16.5, 4.5, 11.5)),
    Seen("top of the object", ((2, 4, 7, 12),), (1.5, 3.5, 6.5, 11.5)),
    Seen("arm", ((10, 12, 12, 16), (12, 13, 12, 15)), (9.5, 12.5, 11.5, 16.5)),
    Seen("end of the arm", ((12, 14, 12, 14),), (12.5, 13.5, 11.5, 13.5)),
    Seen("near slope", ((0, 1, 0, 6), (1, 2, 0, 5), (2, 3, 0, 4), (3, 4, 0, 3), (4, 5, 0, 2), (5, 6, 0, 1))),
    Seen("far slope", ((1, 2, 5, 7), (2, 3, 4, 6), (3, 4, 3, 5), (4, 5, 2, 4), (5, 6, 1, 4), (6, 7, 0, 3))),
    Seen("left wall", ((8, 9, 1, 5), (9, 11, 1, 4), (11, 12, 0, 3), (12, 13, 0, 2)), (-1.5, 12.5, -1.5, 4.5)),
    Seen("right wall", ((1, 9, 12, 16), (14, 16, 12, 16), (14, 16, 3, 5))),
    Seen("upper panel", ((0, 2, 9, 12),), (-1.5, 1.5, 8.5, 11.5)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """The camera's image as the model files have it."""

    rows: int
    cols: int
    fov_horizontal_deg: float
    fov_vertical_deg: float

    def beams(self, row: Array, col: Array) -> Array:
        """Unit beams (..., 3) at rows and columns; whole numbers are pixels' centres."""
        elevation = np.radians((row - (self.rows - 1) / 2) * self.fov_vertical_deg / self.rows)
        azimuth = np.radians((col - (self.cols - 1) / 2) * self.fov_horizontal_deg / self.cols)
        flat = np.cos(elevation)
        return np.stack([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat], axis=-1)


def fitted_plane(beam: Array, range_mm: Array) -> Array:
    """The plane q (3,), q . beam = 1 / range, through ranges (n,) along beams (n, 3); a few far off hardly count."""
    start, *_ = np.linalg.lstsq(beam * range_mm[:, None], np.ones(len(beam)), rcond=None)

    def misfit(q: Array) -> Array:
        return np.asarray((1 / (beam @ q) - range_mm) / 10.0)

    return np.asarray(least_squares(misfit, start, loss="soft_l1", x_scale=1e-4).x)


def drift_mm(samples: Array) -> float:
    """What a straight line through the frames' medians of samples (frame, pixel) changes from first to last."""
    frame = np.arange(len(samples))
    return float(np.polyfit(frame, np.median(samples - np.median(samples, axis=0), axis=1), 1)[0] * frame[-1])


def surface_table(seen: Seen, view: View, samples: Array) -> str:
    """The [[surface]] of what is seen in samples (frame, row, col)."""
    range_mm = np.median(samples, axis=0)
    picked = np.zeros(range_mm.shape, dtype=bool)
    for top, bottom, left, right in seen.pixels:
        picked[top:bottom, left:right] = True
    row, col = np.nonzero(picked)
    plane = fitted_plane(view.beams(row, col), range_mm[picked])
    away = 1 / (view.beams(row, col) @ plane)
    rms, drift = np.std(away - range_mm[picked]), drift_mm(samples[:, picked])
    print(f"{seen.name}: {picked.sum()} pixels, rms {rms:.1f} mm, drift {drift:+.1f} mm")
    normal = plane / np.linalg.norm(plane)
    yaw, pitch = np.arcsin(normal[0]), np.arctan2(-normal[1], normal[2])
    axes = np.array(
        [[np.cos(yaw), np.sin(yaw) * np.sin(pitch), -np.sin(yaw) * np.cos(pitch)], [0.0, np.cos(pitch), np.sin(pitch)]]
    )
    low, high = _ends(seen, view, plane, axes)
    center = plane / (plane @ plane) + axes.T @ ((low + high) / 2)
    return "\n".join(
        [
            "[[surface]]",
            f'name = "{seen.name}"',
            f"center_mm = {np.round(center, 1).tolist()}",
            f"size_mm = {np.round(high - low, 1).tolist()}",
            f"yaw_deg = {np.degrees(yaw):.2f}",
            f"pitch_deg = {np.degrees(pitch):.2f}",
            "",
        ]
    )


def _ends(seen: Seen, view: View, plane: Array, axes: Array) -> tuple[Array, Array]:
    """Ends of the rectangle along its two axes, mm from the foot of the plane's perpendicular."""
    low, high = np.array([-ENDLESS_MM / 2] * 2), np.array([ENDLESS_MM / 2] * 2)
    if seen.ends is not None:
        top, bottom, left, right = seen.ends
        beam = view.beams(np.array([top, top, bottom, bottom]), np.array([left, right, left, right]))
        u, v = axes @ (beam / (beam @ plane)[:, None]).T
        low, high = np.array([u[[0, 2]].mean(), v[[0, 1]].mean()]), np.array([u[[1, 3]].mean(), v[[2, 3]].mean()])
    elif seen.name.endswith("slope"):
        beam = view.beams(*np.array(SLOPE_EDGE))
        (high if seen.name == "near slope" else low)[1] = axes[1] @ beam / (beam @ plane)
    return low, high


def sensor_table(view: View, noise: MeasuredNoise, name: str) -> str:
    """The [sensor] of the camera, its noise as the recording shows it."""
    return "\n".join(
        [
            "[sensor]",
            f'name = "{name}"',
            f"rows = {view.rows}",
            f"cols = {view.cols}",
            f"fov_horizontal_deg = {view.fov_horizontal_deg:.3f}",
            f"fov_vertical_deg = {view.fov_vertical_deg:.3f}",
            "range_min_mm = 0.0",
            f"range_max_mm = {RANGE_MAX_MM}  # beyond all that the recording shows",
            "integration_time_ms = 1.0  # not known: the noise is that of this recording, whatever it was",
            f"outlier_probability = {noise.outlier_probability:.5f}",
            "",
            "[sensor.noise]",
            f"range_mm = {np.round(noise.curve.range_mm, 1).tolist()}",
            f"sigma_mm = {np.round(noise.curve.sigma_mm, 3).tolist()}",
            "reference_integration_time_ms = 1.0",
            "exponent = 0.5",
            "",
        ]
    )


def misfit_map(model: Path, range_mm: Array) -> Array:
    """What the model misses (row, col), mm: the median over frames of the samples near the pixel's main surface."""
    truth = cast_scene(load_model(str(model)))
    share = np.where(np.isfinite(truth.range_true), truth.weight_true, -1.0)
    main = np.take_along_axis(truth.range_true, share.argmax(axis=-1)[..., None], axis=-1)[..., 0]
    off = range_mm - main
    near = np.abs(off) < FAR_MM
    seen = near.any(axis=0)
    print(f"{(~near.all(axis=0)).sum()} pixels have samples more than {FAR_MM:.0f} mm from the model's main surface")
    return np.where(seen, np.nanmedian(np.where(near | ~seen, off, np.nan), axis=0), 0.0).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("output", type=Path)
    parser.add_argument("--map", type=int, metavar="FRAMES", help="first frames from which a map is measured")
    options = parser.parse_args()
    with open_recording(RECORDING) as file:
        every = slice(0, None)
        sensor, noise, time_s = file.sensor, measure_noise(file), file.read_time()
        range_mm = file.read_range(every, every).astype(np.float64)
    assert time_s is not None
    assert sensor.fov_horizontal_deg is not None
    assert sensor.fov_vertical_deg is not None
    frames, rows, cols = range_mm.shape
    view = View(
        rows=rows, cols=cols, fov_horizontal_deg=sensor.fov_horizontal_deg, fov_vertical_deg=sensor.fov_vertical_deg
    )
    rate_hz = (frames - 1) / (time_s[-1] - time_s[0])
    parts = [
        "# What tmf8829_edge.h5 shows, as planes: made by tests/benchmarks/real_model.py from the recording itself.\n",
        sensor_table(view, noise, sensor.name),
        f"[recording]\nframes = {frames}\nframe_rate_hz = {rate_hz:.3f}\nseed = 1\n",
        *(surface_table(seen, view, range_mm) for seen in SEEN),
    ]
    options.output.write_text("\n".join(parts), encoding="utf-8")
    if options.map:
        name = f"{options.output.stem}.npy"
        np.save(options.output.with_name(name), misfit_map(options.output, range_mm[: options.map]))
        parts.append(f'[[effect]]\nkind = "fixed_pattern"\nmap = "{name}"\n')
        options.output.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
