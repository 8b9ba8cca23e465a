"""Recordings as foreign programs write them: plain h5py, nothing of ours."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

NOISE = {"noise_range": [500.0, 5000.0], "noise_sigma": [15.0, 15.0]}


def write_recording(
    path: Path,
    samples: NDArray[Any],
    *,
    attributes: dict[str, Any] | None = None,
    noise: dict[str, Any] | None = NOISE,
    fill: float | None = None,
    units: str | None = None,
    **settings: Any,  # noqa: ANN401  what h5py takes
) -> Path:
    """Write a minimal recording: a dataset `range` and a group `sensor`."""
    with h5py.File(path, "w") as root:
        dataset = root.create_dataset("range", data=samples, **settings)
        if fill is not None:
            dataset.attrs["_FillValue"] = np.array([fill], dtype=samples.dtype)
        if units is not None:
            dataset.attrs["units"] = units
        sensor = root.create_group("sensor")
        sensor.attrs.update({"range_min_mm": 300.0, "range_max_mm": 7500.0} | (attributes or {}))
        for name, values in (noise or {}).items():
            sensor.create_dataset(name, data=values)
    return path


def boards(frames: int = 30, rows: int = 4, cols: int = 6, dtype: str = "u2") -> NDArray[Any]:
    """Samples of two boards side by side, mixed in the middle columns."""
    rng = np.random.default_rng(5)
    far = rng.random((frames, rows, cols)) < np.clip((np.arange(cols) - cols / 2 + 1) / 2, 0, 1)
    return (np.where(far, 3000, 1200) + rng.normal(0, 15, far.shape)).astype(dtype)


def wall_model(rows: int, cols: int, frames: int) -> str:
    """A model of one wall, 3 m ahead of the SR-4000."""
    return f"""\
[sensor]
profile = "sr4000"
rows = {rows}
cols = {cols}
[recording]
frames = {frames}
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


def contents(path: Path) -> dict[str, Any]:
    """The datasets and attributes at the root of a file."""
    with h5py.File(path) as root:
        return {name: item[...] for name, item in root.items() if isinstance(item, h5py.Dataset)} | dict(root.attrs)
