"""Data of the page's explorer: every pixel of some windows, packed, and the settings of its script.

The script reads the output of `explorer_json`. For one pixel in the terminal use `tofmix.report.pixels.pixels`.

Arrays are text in the page: whole numbers, split into byte planes, deflated, in base64; the page's script
(``explorer_data.js``) reads them back to the digits that are shown. Samples are sorted in each pixel and stored as
differences, half as large as the values, within limits of their size; the order of the frames is lost. For samples in
order use `tofmix.report.pixels.pixels.row_samples`.
"""

import base64
import json
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.bounds import WholeNumber, check_bounds
from tofmix.flags import STATUS_MEANINGS, Status, status_name
from tofmix.layers import Layers, LayersSource, Provenance
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.report.averaging import AveragedImage, average_window
from tofmix.report.figures.picture import ABOVE, BELOW, count_colours, count_label, range_shades
from tofmix.report.pixels.pixels import drifts, learnt_sensor
from tofmix.report.theme import DARK, LIGHT
from tofmix.sensor import NoiseCurve, Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class PageLimits:
    """Sizes of the explorer's data."""

    # Pixels of all windows of a page; one window is always there, unless it has more than `image_pixels`.
    pixels: WholeNumber = 60_000
    windows: WholeNumber = 50  # windows of a page, however small
    image_pixels: WholeNumber = 400_000  # pixels of an image beyond which a page has no explorer
    samples: WholeNumber = 4_000_000  # samples of all windows; of longer windows frames are left out
    least_frames: WholeNumber = 16  # samples a pixel below which none are shown: they show nothing
    # Most characters of the data: a page of one full image with pictures stays below 3 MB.
    characters: WholeNumber = 2_400_000
    sample_characters: WholeNumber = 200_000  # characters that samples may take however much the layers take

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_LIMITS = PageLimits()


NOT_KNOWN = int(np.iinfo(np.int32).min)
"""Code for NaN and infinity."""

_MOST = int(np.iinfo(np.int32).max)
_BYTES = np.dtype(np.int32).itemsize

Spec = dict[str, str | int | float]
"""Name of an array, its length, and the unit in which it is stored."""


def pack_numbers(arrays: dict[str, tuple[NDArray[Any], float]]) -> tuple[list[Spec], str]:
    """Pack arrays of numbers.

    Parameters
    ----------
    arrays : dict of str to (array, float)
        Values of any shape, and the unit to which they are rounded; beyond 2^31 units they are cut off.

    Returns
    -------
    specs : list of dict
        In the order of the planes: ``name``, ``length``, ``unit``.
    text : str
        The base64 of the deflated planes: for each array four, from the lowest byte of int32 to the highest.
    """
    specs: list[Spec] = []
    planes = []
    for name, (values, unit) in arrays.items():
        whole = _whole(np.asarray(values, dtype=np.float64).ravel(), unit)
        specs.append({"name": name, "length": whole.size, "unit": unit})
        planes.append(whole.astype("<i4").view(np.uint8).reshape(-1, _BYTES).T.tobytes())
    return specs, text_of(zlib.compress(b"".join(planes), 6))


def _whole(values: FloatArray, unit: float) -> NDArray[np.int64]:
    finite = np.isfinite(values)
    # Times the inverse where that is whole: 0.01 has no exact double, and ties would round otherwise than in a table.
    inverse = round(1 / unit)
    scaled = np.where(finite, values, 0.0)
    scaled = scaled * inverse if np.isclose(inverse * unit, 1.0, rtol=1e-12) else scaled / unit
    whole = np.clip(np.rint(scaled), NOT_KNOWN + 1, _MOST).astype(np.int64)
    return np.where(finite, whole, NOT_KNOWN)


def pack_gaps(gaps: NDArray[np.uint16]) -> bytes:
    """Deflate gaps (rank, pixel) as two byte planes; run lengths alone, as nothing in them repeats but zeros."""
    deflater = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    low, high = (gaps & 0xFF).astype(np.uint8), (gaps >> 8).astype(np.uint8)
    return deflater.compress(low.tobytes() + high.tobytes()) + deflater.flush()


def text_of(content: bytes) -> str:
    """Base64 of bytes."""
    return base64.b64encode(content).decode("ascii")


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedSamples:
    """Samples of a window.

    text, base64 of the deflated gaps (rank, pixel) uint16 in byte planes; counts (pixel,), valid samples of each;
    ranks, length of the first axis; frames_kept of frames; the k-th sample of a pixel is
    ``offset_mm + step_mm * sum(gaps[:k + 1])``.
    """

    text: str
    counts: NDArray[np.int64]
    ranks: int
    frames_kept: int
    frames: int
    step_mm: float
    offset_mm: float


def pack_samples(
    recording: SampleSource,
    *,
    start: int,
    stop: int,
    noise: NoiseCurve | None,
    characters: int,
    windows: int = 1,
    limits: PageLimits = DEFAULT_LIMITS,
    block_samples: int = 1 << 21,
    most_steps: int = 65_000,  # from the lowest sample to the highest
) -> PackedSamples | None:
    """Read and pack the samples of frames [start, stop).

    Parameters
    ----------
    recording : SampleSource
        The samples.
    start, stop : int
        Frames of the window.
    noise : NoiseCurve, optional
        sigma(r): samples that are no whole mm are rounded well below it.
    characters : int
        Most characters of the text; a longer text is avoided by coarser rounding.
    windows : int
        Windows that share the limit of samples.
    limits : PageLimits
        How much a page holds. None returns where fewer than `limits.least_frames` samples a pixel would fit.
    block_samples : int
        Samples read at once, at 4 bytes each. It changes no value.
    """
    each = samples_a_frame(recording)
    start, stop = start * each, stop * each
    frames = stop - start
    _, rows, cols = recording.shape
    kept = min(frames, limits.samples // windows // (rows * cols))
    if kept < min(frames, limits.least_frames):
        return None
    chosen = np.linspace(start, stop - 1, kept).round().astype(np.int64)
    samples = np.sort(_read(recording, chosen, block_samples), axis=0)  # NaN last
    counts = np.isfinite(samples).sum(axis=0)
    lowest, highest = _ends(samples)
    offset = min(0.0, math.floor(lowest))
    step = _step(samples, noise)
    while True:
        while (highest - offset) / step > most_steps:
            step *= 2
        deflated = pack_gaps(_gaps(samples, offset, step))
        if len(deflated) <= characters * 3 // 4 or step > highest - offset:
            break
        step *= 2
    return PackedSamples(
        text=text_of(deflated),
        counts=counts,
        ranks=kept,
        frames_kept=kept,
        frames=frames,
        step_mm=step,
        offset_mm=offset,
    )


def _read(recording: SampleSource, chosen: NDArray[np.int64], block_samples: int) -> Float32Array:
    """Samples (frame, pixel) of the chosen frames, read a block of whole chunks at a time."""
    _, rows, cols = recording.shape
    first, frames = int(chosen[0]), int(chosen[-1] - chosen[0]) + 1
    step = max(1, recording.row_step)
    band = step * max(1, block_samples // (step * cols * frames))
    depth = max(1, block_samples // (min(band, rows) * cols))
    samples = np.empty((len(chosen), rows, cols), dtype=np.float32)
    for row in range(0, rows, band):
        rows_read = slice(row, min(row + band, rows))
        for frame in range(first, first + frames, depth):
            block = slice(frame, min(frame + depth, first + frames))
            wanted = (chosen >= block.start) & (chosen < block.stop)
            if wanted.any():
                samples[wanted, rows_read] = recording.read_range(block, rows_read)[chosen[wanted] - frame]
    return samples.reshape(len(chosen), rows * cols)


def _ends(samples: Float32Array) -> tuple[float, float]:
    finite = samples[np.isfinite(samples)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _step(
    samples: Float32Array,
    noise: NoiseCurve | None,
    *,
    steps_a_sigma: float = 20.0,  # samples are rounded to a twentieth of sigma or finer
) -> float:
    """1 mm for whole millimetres; else a power of ten, at most a twentieth of the least sigma."""
    finite = samples[np.isfinite(samples)]
    if bool((finite == np.rint(finite)).all()):
        return 1.0
    sigma = 1.0 if noise is None else float(noise.sigma_mm.min())
    return float(10.0 ** math.floor(math.log10(sigma / steps_a_sigma)))


def _gaps(samples: Float32Array, offset: float, step: float) -> NDArray[np.uint16]:
    """Differences of sorted samples in steps, from the offset on; 0 past the last one."""
    known = np.isfinite(samples)
    values: FloatArray = np.where(known, samples, offset).astype(np.float64)
    whole = np.rint((values - offset) / step).astype(np.int32)
    gaps = np.diff(whole, axis=0, prepend=0)
    return np.where(known, gaps, 0).astype(np.uint16)


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
    arrays["averaged"] = (mean.range_mm, 0.1)  # in 0.1 mm
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
        least_density = 1.0e-4  # part of a shape's peak below which its line is not visible
        seen = shape.z[shape.density > least_density * shape.density.max()]
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
    angle_digits = 6  # of an angle in rad: 0.01 mm at 10 m
    return [[round(float(angle), angle_digits) for angle in line] for line in angles]


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
