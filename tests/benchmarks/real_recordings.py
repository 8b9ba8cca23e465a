"""The real recordings of tests/benchmarks/real.py, and pixels spliced from two of one surface.

`sample_data/tmf8829_edge.h5` is part of the project. The others are read from a folder of their own, and nothing of
them is copied: two have no licence for that.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmarks.clusters import Judged, Kind, judge_recording, members

import tofmix
from tofmix.api.recordings import Recording
from tofmix.arrays import FloatArray, IntArray
from tofmix.sensor import Sensor

PROJECT = Path(__file__).parents[2]
FOLDER = PROJECT.parent / "shared" / "real"
"""Where the data are looked for by default."""

WINDOW_FRAMES = 100
"""Frames of the VL53L0X that make a pixel: 2 s, within which its drift of 0.5 mm in minutes does not show."""

FACE_GATE_MM = (1000.0, 8000.0)
"""Working range of the scanned single-photon detector, by its data's README."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RealRecording:
    """A real recording and the issue's aims for it."""

    name: str
    """The sensor."""
    recording: Recording
    """Samples, with all that is known of the sensor."""
    most_split: float
    """Aim: share of single pixels with more than one layer, at most."""
    least_double: float | None = None
    """Aim: share of double pixels with exactly two layers, at least; None where there are no double pixels."""

    def samples(self) -> FloatArray:
        """Samples (frame, pixel), mm."""
        range_mm = self.recording.range_mm
        return range_mm.reshape(len(range_mm), -1).astype(np.float64)

    def judged(self) -> Judged:
        """What the rule of `clusters` says of the pixels."""
        sensor = self.recording.sensor
        low = sensor.range_min_mm if sensor.range_max_mm is not None else None
        return judge_recording(self.samples(), range_min_mm=low, range_max_mm=sensor.range_max_mm)


def tmf8829() -> RealRecording:
    """An object before two walls; 15 pixels see two surfaces with at least 3 samples each."""
    recording = tofmix.open(PROJECT / "sample_data" / "tmf8829_edge.h5")
    assert isinstance(recording, Recording)
    return RealRecording(name="TMF8829", recording=recording, most_split=0.015, least_double=1.0)


def vl53l0x(folder: Path) -> RealRecording:
    """One target; windows of `WINDOW_FRAMES` frames, one after the other, are pixels."""
    series = np.load(folder / "vl53l0x" / "vl53l0x_static_1h.npz")["distance_mm"]
    cols = 26  # the windows as an image that is about square
    rows = series.size // (WINDOW_FRAMES * cols)
    samples = series[: rows * cols * WINDOW_FRAMES].reshape(rows * cols, WINDOW_FRAMES).T
    image = samples.reshape(WINDOW_FRAMES, rows, cols)
    recording = tofmix.from_array(image, units="mm", sensor=Sensor(name="VL53L0X"))
    return RealRecording(name="VL53L0X, windows of 100", recording=recording, most_split=0.005)


def vl53l8cx(folder: Path) -> RealRecording:
    """Foam at 480 mm."""
    samples = np.load(folder / "vl53l8cx" / "vl53l8cx_48cm_27frames.npz")["distance_mm"]
    recording = tofmix.from_array(samples, units="mm", sensor=Sensor(name="VL53L8CX"))
    return RealRecording(name="VL53L8CX", recording=recording, most_split=0.02)


def face(folder: Path) -> RealRecording:
    """A face before a wall, by single photons; pixels have 8 to 592 of them."""
    data = np.load(folder / "mit_face" / "mit_face_4x4.npz")
    counts = data["samples_a_pixel"].astype(np.int64)
    low, high = FACE_GATE_MM
    sensor = Sensor(name="scanned single-photon detector", range_min_mm=low, range_max_mm=high)
    image = padded(np.split(data["samples"].astype(np.float64), np.cumsum(counts.ravel())[:-1]))
    recording = tofmix.from_array(image.reshape(-1, *counts.shape), units="mm", sensor=sensor)
    return RealRecording(name="a face, single photons", recording=recording, most_split=0.015, least_double=0.95)


LOADERS: dict[str, Callable[[Path], RealRecording]] = {
    "tmf8829": lambda _: tmf8829(),
    "vl53l0x": vl53l0x,
    "vl53l8cx": vl53l8cx,
    "mit_face": face,
}
"""By the name of their folder."""


def real_recordings(folder: Path, names: tuple[str, ...], skip: Callable[[str], None]) -> Iterator[RealRecording]:
    """Load those that there are; `skip` is told each one that is missing."""
    for name in names:
        try:
            yield LOADERS[name](folder)
        except FileNotFoundError as error:
            skip(f"{name}: skipped, {error.filename} is missing")


def padded(pixels: list[FloatArray]) -> FloatArray:
    """Samples (frame, pixel) of pixels with different numbers of samples, NaN past the last."""
    out = np.full((max(x.size for x in pixels), len(pixels)), np.nan)
    for pixel, x in enumerate(pixels):
        out[: x.size, pixel] = x
    return out


class Spliced(NamedTuple):
    """A recording with some pixels that were joined from two single ones."""

    recording: Recording
    spliced: IntArray
    """Numbers of these pixels; all others are single ones as they were."""
    clear: IntArray
    """Numbers of the single pixels beside no faint further cluster."""
    distance: float
    """Mean distance of the two surfaces, in half-widths, of the shifts that were applied."""


class SinglePixels:
    """The single pixels of a real recording, to be spliced.

    `real`: the recording.
    """

    def __init__(self, real: RealRecording) -> None:
        samples, judged = real.samples(), real.judged()
        chosen = judged.pixels(Kind.SINGLE)
        self.faint = judged.faint[chosen]
        self.sensor, self.step_mm = real.recording.sensor, judged.step_mm
        self.pixels = [samples[np.isfinite(samples[:, pixel]), pixel] for pixel in chosen]
        ends = [judged.clusters[pixel][0] for pixel in chosen]
        near = [
            members(x, own.low_mm, own.high_mm, judged.half_width_mm) for x, own in zip(self.pixels, ends, strict=True)
        ]
        # The mean of a cluster's samples: medians of whole mm are too coarse for a distance.
        self.centre_mm = np.array([x[inside].mean() for x, inside in zip(self.pixels, near, strict=True)])

    def splice(
        self, *, sigma_mm: float, distance: float, share: float, pixels: int, mixed: float, rng: np.random.Generator
    ) -> Spliced:
        """Make a recording of one row in which a share `mixed` of the pixels see two surfaces.

        A frame of such a pixel shows the one or the other by chance. The second surface has the share `share`; it is
        the nearer or the farther one by chance. Shifts keep to the recording's steps, their mean is the distance.

        `sigma_mm`: unit of the distance: half the width of the central 68 % of single pixels.
        `distance`: distance of the two surfaces, in sigma.
        """
        count = round(mixed * pixels)
        place = rng.permutation(pixels)[:count]
        rest = np.setdiff1d(np.arange(pixels), place)
        out: list[FloatArray] = [np.empty(0)] * pixels
        drawn = self._draw(rest.size, rng)
        for pixel, which in zip(rest, drawn, strict=True):
            out[pixel] = self.pixels[which]
        shifts = np.empty(count)
        for k, (pixel, one) in enumerate(zip(place, self._draw(count, rng), strict=True)):
            other = int(rng.integers(len(self.pixels) - 1))
            other += other >= one
            shift = rng.choice([-1.0, 1.0]) * distance * sigma_mm + self.centre_mm[one] - self.centre_mm[other]
            if self.step_mm > 0:
                shift = self.step_mm * np.floor(shift / self.step_mm + rng.random())
            n = min(self.pixels[one].size, self.pixels[other].size)
            second = rng.permutation(n) < round(share * n)
            out[pixel] = np.where(second, self.pixels[other][:n] + shift, self.pixels[one][:n])
            shifts[k] = abs(shift + self.centre_mm[other] - self.centre_mm[one])
        recording = tofmix.from_array(padded(out)[:, None, :], units="mm", sensor=self.sensor)
        return Spliced(recording, np.sort(place), rest[~self.faint[drawn]], float(shifts.mean() / sigma_mm))

    def _draw(self, count: int, rng: np.random.Generator) -> IntArray:
        """Numbers of pixels, each once where there are enough."""
        return rng.permutation(np.resize(rng.permutation(len(self.pixels)), count))
