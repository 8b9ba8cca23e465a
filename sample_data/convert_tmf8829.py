"""Convert the TMF8829 sample log (an .npz of its numbers) to a tofmix recording.

Usage: python convert_tmf8829.py tmf8829_26frames.npz tmf8829_edge.h5

The noise curve is measured here, from the camera's own steady pixels: a pixel is
steady if all its samples lie within 50 mm of its median. The curve's points are
the medians, over the steady pixels of a range interval, of their standard
deviations, so that a minority of pixels on slopes and edges does not raise them.
Slow drift within the 0.85 s of the log is part of it: it spreads a pixel's samples.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tofmix.io.recording.recording_writer import RecordingWriter
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import Measurement

STEADY_MM = 50.0
INTERVALS_MM = (0.0, 400.0, 1200.0, 1800.0, 2400.0, 3000.0)

LICENCE = "MIT License, Copyright (c) 2026 AMS-OSRAM; full text in sample_data/LICENSE-tmf8829.txt"
SOURCE = (
    "github.com/ams-OSRAM/tmf8829_json_logfile_viewer, commit 4a7fc5d8a2d25015d3e7d6cce82842d8b33d52a7,"
    " file tmf8829_log_1770799073.json.gz"
)


def measure_noise(range_mm: NDArray[np.float64]) -> NoiseCurve:
    """Measure sigma(r) from steady pixels; range_mm is (frame, row, col)."""
    centre = np.median(range_mm, axis=0)
    steady = (np.abs(range_mm - centre) < STEADY_MM).all(axis=0)
    points = []
    for low, high in pairwise(INTERVALS_MM):
        chosen = steady & (centre >= low) & (centre < high)
        if chosen.any():
            spread = range_mm[:, chosen].std(axis=0, ddof=1)
            points.append((float(np.median(centre[chosen])), float(np.median(spread))))
    points.append((INTERVALS_MM[-1], points[-1][1]))
    return NoiseCurve(*np.array(points).T)


def field_of_view(angles_rad: NDArray[np.float64]) -> float:
    """Full angle, degrees, of pixels whose centres are at these angles: one more spacing than they span."""
    return float(np.degrees(angles_rad[-1] - angles_rad[0]) * len(angles_rad) / (len(angles_rad) - 1))


def convert(source: Path, target: Path) -> None:
    """Write the recording."""
    with np.load(source, allow_pickle=False) as log:
        range_mm = log["distance_mm"]
        signal = log["signal"].astype(np.float32)
        point = np.median(log["xyz_mm"], axis=0).astype(np.float64)
        time_s = (log["t_us"] - log["t_us"][0]) * 1e-6
        temperature = log["temperature_c"].astype(np.float32)
    middle = range_mm.shape[1] // 2
    sensor = Sensor(
        name="ams-OSRAM TMF8829 (direct time of flight, 16 x 16)",
        measurement=Measurement.PULSES,
        range_min_mm=0.0,
        fov_horizontal_deg=field_of_view(np.arctan2(point[middle, :, 0], point[middle, :, 2])),
        fov_vertical_deg=field_of_view(np.arctan2(point[:, middle, 1], point[:, middle, 2])),
        noise=measure_noise(range_mm.astype(np.float64)),
    )
    writer = RecordingWriter(
        target,
        shape=range_mm.shape,
        sensor=sensor,
        title="real frames of a TMF8829: a near object before two walls",
        attributes={"source": SOURCE, "license": LICENCE},
        has_temperature=True,
        overwrite=True,
    )
    with writer:
        writer.write(0, range_mm, time_s=time_s, amplitude=signal, temperature_c=temperature)


if __name__ == "__main__":
    convert(Path(sys.argv[1]), Path(sys.argv[2]))
