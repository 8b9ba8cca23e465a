"""A small drone that flies towards a wall, against a model in which the wall stands where the flight starts.

Each frame is some 30 mm nearer than the one before. So `motion` is right, or `unexplained` with the change located in
time; noise, random values or lost samples that stand for it are wrong. The recordings (VL53L5CX, 8 x 8 zones at 15 Hz;
ETH-PBL, Matrix_ToF_Drones, GPL-3.0) are for development only: without them the part is left out.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from benchmarks.measured_parts.judging import reconciled
from benchmarks.real_recordings import FOLDER

from tofmix.arrays import Float32Array, FloatArray
from tofmix.optics.projection import beam_directions_of
from tofmix.sensor import NoiseCurve
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface

FLIGHTS = ("A0", "A1", "A2", "A3", "A4")
VALID = (5, 9)  # status of a zone
NOISES: dict[str, tuple[float, ...]] = {
    "5 to 40 mm": (5.0, 8.0, 15.0, 40.0),
    "15 mm": (15.0,) * 4,
    "20 to 160 mm": (20.0, 40.0, 80.0, 160.0),
}
"""Sigma of the model at 200, 1000, 2000 and 4000 mm: the sensor's is not published."""

STRETCHES = ("approach", "whole flight")
CASES = len(FLIGHTS) * len(STRETCHES) * len(NOISES)
_STOOD = 30  # frames at the start, before it takes off
_LEFT_MM = 60.0  # from the start: it flies


def _model(start_mm: float, frames: int, sigma: tuple[float, ...]) -> Model:
    sensor = CompleteCamera(
        name="VL53L5CX",
        rows=8,
        cols=8,
        fov_horizontal_deg=45.0,
        fov_vertical_deg=45.0,
        range_min_mm=20.0,
        range_max_mm=4000.0,
        integration_time_ms=20.0,
        default_integration_time_ms=20.0,
        reference_integration_time_ms=20.0,
        exponent=0.5,
        outlier_probability=1e-3,
        noise=NoiseCurve(np.array([200.0, 1000.0, 2000.0, 4000.0]), np.array(sigma)),
    )
    wall = Surface(name="wall", center_mm=(0.0, 0.0, start_mm), size_mm=(8000.0, 8000.0), reflectivity=0.7)
    return Model(sensor=sensor, surfaces=(wall,), recording=RecordingSettings(frames=frames, frame_rate_hz=15.0))


def _flight(name: str, stretch: str) -> tuple[FloatArray, FloatArray, float]:
    """Depths (frame, row, col), mm, NaN where invalid; times, s; and the distance of the wall at the start, mm."""
    data = np.load(FOLDER / "vl53l5cx_flights" / f"{name}.npz")
    distance = data["true_distance_mm"]
    start = float(np.median(distance[:_STOOD]))
    part = slice(0, len(distance))
    if stretch == "approach":
        nearest = int(np.argmin(distance))
        part = slice(int(np.flatnonzero(distance[:nearest] > start - _LEFT_MM)[-1]), nearest)
    depth = np.where(np.isin(data["status"], VALID), data["range_mm"].astype(np.float64), np.nan)
    time_s = data["time_s"]
    return depth[part], time_s[part] - time_s[part][0], start


def judged(number: int, seed: int) -> dict[str, Any] | None:  # noqa: ARG001  nothing is drawn
    """The result of one case; None without the recordings."""
    noise, rest = list(NOISES)[number // (len(FLIGHTS) * 2)], number % (len(FLIGHTS) * 2)
    stretch, name = STRETCHES[rest // len(FLIGHTS)], FLIGHTS[rest % len(FLIGHTS)]
    try:
        depth, time_s, start = _flight(name, stretch)
    except FileNotFoundError:
        return None
    model = _model(start, len(depth), NOISES[noise])
    ahead = beam_directions_of(model.sensor.optics, model.sensor.shape)[..., 2]
    ranges: Float32Array = (depth / ahead).astype(np.float32)
    found = reconciled(model, ranges, time_s=time_s)
    located = any(place["axis"] == "time" and place["statistic"] == "trend" for place in found["where"][:2])
    right = found["named"] == ["motion"] or (not found["named"] and located)
    return {"number": number, "name": name, "stretch": stretch, "noise": noise, "right": right, **found}


def order(count: int) -> Sequence[int]:
    """The first cases: approaches with the first noise, then whole flights, then the other noises."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Right answers by stretch and noise."""
    if not done:
        yield "Left out: the recordings are not on this machine; their licence does not let the project hold them."
        return
    yield "| | sigma of the model | right | aim | names |"
    yield "|---|---|---|---|---|"
    for stretch in STRETCHES:
        for noise in NOISES:
            own = [line for line in done if (line["stretch"], line["noise"]) == (stretch, noise)]
            names = ", ".join(sorted({kind for line in own for kind in line["named"]}))
            if own:
                yield f"| {stretch} | {noise} | {sum(line['right'] for line in own)} of {len(own)} | all | {names} |"
