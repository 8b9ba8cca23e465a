"""Data of the page's explorer: every pixel of some windows, packed, and the settings of its script.

The script reads the output of `explorer_json`. For one pixel in the terminal use `tofmix.report.pixels.pixels`.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from tofmix.flags import STATUS_MEANINGS, Status, status_name
from tofmix.layers import Layers, Provenance
from tofmix.recording import SampleSource
from tofmix.report.averaging import AveragedImage, average_window
from tofmix.report.explorer.packing import DEFAULT_LIMITS, PackedSamples, PageLimits, pack_numbers, pack_samples
from tofmix.report.figures.rasters import ABOVE, BELOW, count_colours, count_label, range_shades
from tofmix.report.pixels.pixels import drifts, learnt_sensor
from tofmix.report.sources import LayersSource
from tofmix.report.theme import DARK, LIGHT
from tofmix.sensor import Sensor

_PIXEL_UNITS = {
    "n_modes": 1.0,
    "n_peaks": 1.0,
    "status": 1.0,
    "n_samples": 1.0,
    "weight_no_return": 1e-4,
    "weight_outlier": 1e-7,
}
_LAYER_UNITS = {
    "range": 0.01,
    "range_stderr": 0.01,
    "weight": 1e-4,
    "weight_stderr": 1e-4,
    "sigma": 0.01,
    "probability": 1e-6,
}
_AVERAGED_UNIT_MM = 0.1
"""Resolution of averaged ranges in a page, mm."""

_LEAST_DENSITY = 1.0e-4
"""Part of a shape's peak below which its line is not visible."""
_ANGLE_DIGITS = 6  # of an angle in rad: 0.01 mm at 10 m


@dataclass(frozen=True, slots=True, kw_only=True)
class Explorer:
    """The data of the explorer.

    text, JSON for a ``script`` element; note, the windows and samples in it.
    """

    text: str
    note: str


def make_explorer(
    layers_file: LayersSource,
    *,
    recording: SampleSource | None,
    window: int,
    layers: Layers,
    averaged: AveragedImage,
    scale: tuple[float, float],
    limits: PageLimits = DEFAULT_LIMITS,
) -> Explorer | None:
    """Pack windows for the page; None for an image of more than `limits.image_pixels`.

    `window` is shown first, with its `layers` and `averaged` image; `scale` are the limits of the colours, mm. Without
    a `recording` there are no samples.
    """
    if layers.n_modes.size > limits.image_pixels:
        return None
    chosen = windows_around(layers_file, window, with_samples=recording is not None, limits=limits)
    windows = [
        _pack_window(layers_file, number, recording, (layers, averaged) if number == window else None)
        for number in chosen
    ]
    samples = None
    if recording is not None:
        left = limits.characters - sum(len(held["data"]) for held in windows)
        characters = max(limits.sample_characters, left) // len(windows)
        for held in windows:
            start, stop = held["frames"]
            noise = layers_file.provenance.sensor.noise
            samples = pack_samples(
                recording,
                start=start,
                stop=stop,
                noise=noise,
                characters=characters,
                windows=len(windows),
                limits=limits,
            )
            held["samples"] = None if samples is None else _pack_samples(samples)
    most = max(held["most_layers"] for held in windows)
    content = _settings(layers_file, scale, most) | {"shown": window, "windows": windows}
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    notes = (
        _windows_note(chosen, layers_file.shape[0]),
        _samples_note(samples, recorded=recording is not None),
        _drift_note(layers_file.provenance, shown=samples is not None),
    )
    return Explorer(text=text, note=" ".join(note for note in notes if note))


def windows_around(
    layers_file: LayersSource, window: int, *, with_samples: bool, limits: PageLimits = DEFAULT_LIMITS
) -> range:
    """Windows that a page has room for: `window`, and as many of its neighbours in time as fit.

    `with_samples`, the samples of all windows count too.
    """
    windows, rows, cols = layers_file.shape
    count = limits.pixels // (rows * cols)
    if with_samples:
        frames = int(layers_file.window_stop[window] - layers_file.window_start[window])
        count = min(count, limits.samples // (rows * cols * max(1, frames)))
    count = max(1, min(windows, count, limits.windows))
    first = min(max(0, window - count // 2), windows - count)
    return range(first, first + count)


def _pack_window(
    layers_file: LayersSource,
    number: int,
    recording: SampleSource | None,
    known: tuple[Layers, AveragedImage] | None,
) -> dict[str, Any]:
    start, stop = int(layers_file.window_start[number]), int(layers_file.window_stop[number])
    if known is None:
        layers = layers_file.read_window(number)
        mean = average_window(layers_file, number, layers, recording)
    else:
        layers, mean = known
    arrays = {name: (getattr(layers, name), unit) for name, unit in _PIXEL_UNITS.items()}
    arrays["averaged"] = (mean.range_mm, _AVERAGED_UNIT_MM)
    present = np.arange(layers.max_layers) < layers.n_modes[..., np.newaxis]
    arrays |= {name: (getattr(layers, name)[present], unit) for name, unit in _LAYER_UNITS.items()}
    specs, text = pack_numbers(arrays)
    most = int(layers.n_modes.max(initial=0))
    return {
        "window": number,
        "frames": [start, stop],
        "most_layers": most,
        "arrays": specs,
        "data": text,
        "samples": None,
    }


def _pack_samples(samples: PackedSamples) -> dict[str, Any]:
    specs, text = pack_numbers({"counts": (samples.counts, 1.0)})
    return {
        "data": samples.text,
        "ranks": samples.ranks,
        "step": samples.step_mm,
        "offset": samples.offset_mm,
        "counts": {"arrays": specs, "data": text},
    }


def _settings(layers_file: LayersSource, scale: tuple[float, float], most: int) -> dict[str, Any]:
    sensor = layers_file.provenance.sensor
    curve = sensor.noise
    _, rows, cols = layers_file.shape
    return {
        "rows": rows,
        "cols": cols,
        "scale": [float(round(limit)) for limit in scale],
        "shades": range_shades(),
        "below": BELOW,
        "above": ABOVE,
        "counts": {"light": count_colours(most, LIGHT), "dark": count_colours(most, DARK)},
        "countLabels": [count_label(n) for n in range(len(count_colours(most, LIGHT)))],
        "statuses": {int(s): [status_name(s).replace("_", " "), STATUS_MEANINGS[s]] for s in Status},
        "tooFew": int(Status.TOO_FEW_SAMPLES),
        "rangeMax": sensor.range_max_mm,
        "circle": layers_file.provenance.unambiguous_range_mm,
        "angles": _angles(sensor, (rows, cols)),
        "noise": None if curve is None else [curve.range_mm.tolist(), curve.sigma_mm.tolist()],
        **_learnt(layers_file.provenance),
    }


def _learnt(
    provenance: Provenance,
    *,
    shape_points: int = 161,  # of a noise shape in a page
) -> dict[str, Any]:
    """How components are drawn under learnt noise; nothing of a Gaussian.

    It is the shape, [first z, step, densities], and whether there is a background to leave out of the view.
    """
    sensor = learnt_sensor(provenance)
    if sensor is None or sensor.noise is None:
        return {}
    said: dict[str, Any] = {"background": True} if sensor.noise.background is not None else {}
    shape = sensor.noise.shape
    if shape is not None:
        seen = shape.z[shape.density > _LEAST_DENSITY * shape.density.max()]
        z = np.linspace(seen[0], seen[-1], shape_points)
        said["shape"] = [round(float(z[0]), 4), float(z[1] - z[0]), [round(float(p), 5) for p in shape.pdf(z)]]
    return said


def _angles(sensor: Sensor, shape: tuple[int, int]) -> list[list[float]] | None:
    """Angles of the middle row's pixels across, and of the middle column's down, rad; None if not known."""
    rows, cols = shape
    try:
        optics = sensor.optics
        if optics is None:
            return None
        across = optics.rays((rows - 1) / 2, np.arange(cols), shape=shape)
        down = optics.rays(np.arange(rows), (cols - 1) / 2, shape=shape)
    except ValueError:  # numbers that no camera has; `info` says which
        return None
    angles = np.arctan2(across[:, 0], across[:, 2]), np.arctan2(down[:, 1], np.hypot(down[:, 0], down[:, 2]))
    return [[round(float(angle), _ANGLE_DIGITS) for angle in line] for line in angles]


def _windows_note(chosen: range, windows: int) -> str:
    if len(chosen) == windows:
        return "" if windows == 1 else f"All {windows} windows are in this page."
    held = f"window {chosen[0]}" if len(chosen) == 1 else f"windows {chosen[0]} to {chosen[-1]}"
    return f"This page holds {held} of 0 to {windows - 1}; --window chooses others."


def _drift_note(provenance: Provenance, *, shown: bool) -> str:
    if not shown or not drifts(provenance):
        return ""
    return (
        "If the ranges of a pixel drift within the window, its samples spread more than its component; tofmix"
        " inspect draws the drift."
    )


def _samples_note(samples: PackedSamples | None, *, recorded: bool) -> str:
    if not recorded:
        return "Samples and their density are shown with --recording."
    if samples is None:
        return "The image is too large for samples in this page; tofmix inspect shows the samples of any pixel."
    rounded = "" if samples.step_mm == 1 else f" Samples are rounded to {samples.step_mm:g} mm."
    if samples.frames_kept == samples.frames:
        return rounded.strip()
    return f"Of the {samples.frames:,} frames of a window, {samples.frames_kept:,} are shown.{rounded}"
