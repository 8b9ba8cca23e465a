"""Model files and recordings as the contract wants them: plain text and plain h5py, nothing of the package."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from blind.camera import Device, Recording
from blind.geometry import Surface
from blind.reference import NoiseTable

_A_LINE = 64  # numbers: the package reads no lines of more than 1000 characters


def _toml(value: Any) -> str:  # noqa: ANN401  any TOML value
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if len(value) <= _A_LINE:
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    lines = [value[start : start + _A_LINE] for start in range(0, len(value), _A_LINE)]
    return "[\n" + "".join("  " + ", ".join(_toml(item) for item in line) + ",\n" for line in lines) + "]"


def _table(head: str, values: dict[str, Any]) -> str:
    return "\n".join([head, *(f"{key} = {_toml(value)}" for key, value in values.items())]) + "\n"


def model_text(
    device: Device,
    surfaces: list[Surface],
    noise: NoiseTable,
    *,
    seed: int = 1,
    effects: list[dict[str, Any]] | None = None,
) -> str:
    """A model file of the ideal camera before a scene; `effects` are [[effect]] tables."""
    sensor = {
        "profile": "sr3000",
        "rows": device.rows,
        "cols": device.cols,
        **_optics(device),
        "range_min_mm": device.range_min_mm,
        "range_max_mm": device.range_max_mm,
        "modulation_frequency_hz": device.frequency_hz,
        "integration_time_ms": device.integration_time_ms,
        "outlier_probability": device.outlier_probability,
    }
    curve = {
        "range_mm": [round(float(r), 3) for r in noise.range_mm],
        "sigma_mm": [round(float(s), 5) for s in noise.sigma_mm],
        "reference_integration_time_ms": device.integration_time_ms,
        "exponent": 0.5,
        **_by_amplitude(noise),
    }
    recording = {"frames": device.frames, "frame_rate_hz": device.frame_rate_hz, "seed": seed}
    parts = [_table("[sensor]", sensor), _table("[sensor.noise]", curve), _table("[recording]", recording)]
    for s in surfaces:
        values = {
            "name": s.name,
            "center_mm": s.center_mm,
            "size_mm": s.size_mm,
            "yaw_deg": s.yaw_deg,
            "pitch_deg": s.pitch_deg,
            "reflectivity": s.reflectivity,
        }
        parts.append(_table("[[surface]]", values))
    return "\n".join([*parts, effect_tables(effects or [])])


def _optics(device: Device) -> dict[str, Any]:
    """Where the pixels look, in the contract's terms."""
    if device.lens is None:
        return {"fov_horizontal_deg": device.fov_horizontal_deg, "fov_vertical_deg": device.fov_vertical_deg}
    k1, k2, k3 = device.lens.radial
    intrinsics = zip(("fx", "fy", "cx", "cy"), device.lens.pixels(device.rows, device.cols), strict=True)
    return {"projection": "pinhole", **dict(intrinsics), "distortion": [k1, k2, 0.0, 0.0, k3]}


def _by_amplitude(noise: NoiseTable) -> dict[str, list[float]]:
    """The three lists of noise by amplitude, if the camera has it."""
    table = noise.by_amplitude
    if table is None:
        return {}
    lists = {"reference_amplitude": table.reference, "amplitude": table.amplitude, "amplitude_factor": table.factor}
    return {key: [float(f"{value:.8g}") for value in values] for key, values in lists.items()}


def effect_tables(effects: list[dict[str, Any]]) -> str:
    """[[effect]] tables, to stand at the end of a model file."""
    return "\n".join(_table("[[effect]]", effect) for effect in effects)


def write_recording(path: Path, recording: Recording, device: Device, noise: NoiseTable, *, variant: int = 0) -> None:
    """Write a recording; the variant chooses among what the contract allows.

    0: uint16, `_FillValue` 0; 1: uint16, `_FillValue` 65535; 2: float32 with NaN;
    3: uint16 without `_FillValue`, 0 = invalid, no `time`.
    """
    with h5py.File(path, "w") as root:
        root.attrs["format"] = "tofmix-recording"
        root.attrs["format_version"] = "1.0"
        shape = recording.range_mm.shape
        for name, length in zip(("frame", "row", "col"), shape, strict=True):
            root.create_dataset(name, data=np.arange(length, dtype=np.int32)).make_scale(name)
        stored, fill = _stored(recording, variant)
        data = root.create_dataset(
            "range", data=stored, chunks=(shape[0], 8, shape[2]), compression="gzip", compression_opts=1, shuffle=True
        )
        data.attrs.update({"units": "mm", "long_name": "radial range"})
        if fill is not None:
            data.attrs["_FillValue"] = np.array([fill], dtype=stored.dtype)
        amplitude = root.create_dataset("amplitude", data=recording.amplitude, chunks=(shape[0], 8, shape[2]))
        amplitude.attrs.update({"units": "1", "long_name": "amplitude"})
        for dataset in (data, amplitude):
            for axis, name in enumerate(("frame", "row", "col")):
                dataset.dims[axis].attach_scale(root[name])
        if variant != 3:
            _per_frame(root, "time", recording.time_s.astype(np.float64), "s")
        if recording.temperature_c is not None:
            _per_frame(root, "temperature", recording.temperature_c.astype(np.float32), "degC")
        _write_sensor(root.create_group("sensor"), device, noise)


def _stored(recording: Recording, variant: int) -> tuple[Any, float | None]:
    if variant == 2:
        return recording.range_mm.astype(np.float32), float("nan")
    fill = 65535 if variant == 1 else 0
    whole = np.where(np.isnan(recording.range_mm), fill, recording.range_mm).astype(np.uint16)
    return whole, None if variant == 3 else fill


def _per_frame(root: h5py.File, name: str, values: Any, units: str) -> None:  # noqa: ANN401
    dataset = root.create_dataset(name, data=values)
    dataset.attrs.update({"units": units, "long_name": name})
    dataset.dims[0].attach_scale(root["frame"])


def _write_sensor(group: h5py.Group, device: Device, noise: NoiseTable) -> None:
    group.attrs.update(
        {
            "name": device.name,
            "modulation_frequency_hz": device.frequency_hz,
            "integration_time_ms": device.integration_time_ms,
            "range_min_mm": device.range_min_mm,
            "range_max_mm": device.range_max_mm,
            **_optics(device),
            "outlier_probability": device.outlier_probability,
        }
    )
    for name, values in (("noise_range", noise.range_mm), ("noise_sigma", noise.sigma_mm)):
        group.create_dataset(name, data=values).attrs["units"] = "mm"
    for key, numbers in _by_amplitude(noise).items():
        group.create_dataset(f"noise_{key}", data=np.array(numbers)).attrs["units"] = "1"


def read_recording(path: Path) -> Recording:
    """Read a recording that any program wrote: ranges float32, NaN where invalid."""
    with h5py.File(path, "r") as root:
        raw = root["range"][...]
        fill = root["range"].attrs.get("_FillValue")
        stored = raw.astype(np.float32)
        bad = ~np.isfinite(stored)
        if fill is not None:
            bad |= raw == np.ravel(fill)[0]
        elif raw.dtype.kind in "iu":
            bad |= raw == 0
        stored[bad] = np.nan
        frames = len(raw)
        amplitude = root["amplitude"][...] if "amplitude" in root else np.full(raw.shape, np.nan, np.float32)
        time_s = root["time"][...] if "time" in root else np.arange(frames, dtype=np.float64)
        temperature = root["temperature"][...] if "temperature" in root else None
    return Recording(range_mm=stored, amplitude=amplitude, time_s=time_s, temperature_c=temperature)
