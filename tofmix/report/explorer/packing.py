"""Arrays and samples as text in a page, and the limits of their size.

Arrays as text in a page: whole numbers, split into byte planes, deflated, in base64.

The page's script (``explorer_data.js``) reads them back. For files use `tofmix.io`;
this is for numbers that a person will look at, to the digits that are shown.

Limits of the samples in a page.

The samples of a window for the page: sorted in each pixel and stored as differences, half as large as the values.

The order of the frames is lost; a histogram and a density do not need it. For
samples in order use `tofmix.report.pixels.pixels.row_samples`.
"""

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.bounds import WholeNumber, check_bounds
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.sensor import NoiseCurve


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
