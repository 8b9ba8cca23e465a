"""What suspicions see and are: one window with its layers, and the declaration of a suspicion.

A window has layers, their amplitudes, and layers whose samples come close in time. A suspicion is a flag, its words,
and the function that marks layers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.circle import unambiguous_range_mm
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.optics.projection import beam_directions_of
from tofmix.sensor import Sensor
from tofmix.suspicion.frame_kinds import NOISE_SIGMAS, FrameKind, find_frame_kinds, kinds_of_layers

CLUSTER_FIELDS = (
    "row",
    "col",
    "layer",
    "frames",
    "samples",
    "outside",
    "length",
    "first",
    "last",
)
"""Values of a layer whose samples come close in time.

Its place; frames that could show it; frames that do; how many of these lie outside the shortest interval; its length,
and its first and last frame, from the window's first.
"""

MOST_OUTSIDE = 0.2
"""Largest share of the samples that may lie outside the interval: they are taken for others' samples."""

LONGEST = 0.5
"""Share of the frames from which on a layer is no passing one: it is there for most of the time."""


class WindowSamples(NamedTuple):
    """What suspicions need of samples, beside layers.

    Parameters
    ----------
    clusters : (n, 9) float64
        `CLUSTER_FIELDS` of layers whose samples come close in time.
    memory : (4,) float64
        `MEMORY_FIELDS`.
    sampled : (n, 2 + frame) float32
        Row, column and samples, mm, one a frame, of some pixels with more than one layer
        (`tofmix.suspicion.frame_kinds`).
    """

    clusters: FloatArray
    memory: FloatArray
    sampled: Float32Array


MEMORY_FIELDS = ("products", "squares", "pairs", "most_pairs")
"""Sums over the pixels with a rare layer, of what tells the memory of samples from frame to frame.

Products of consecutive residuals of the pixel's main layer, and their squares; pairs of consecutive frames that both
show a rare layer, less those expected by chance within its interval; and the most of these.
"""

NO_CLUSTERS = np.zeros((0, len(CLUSTER_FIELDS)))
"""No layer comes close in time."""

NO_SAMPLES = np.zeros((0, 2), np.float32)
"""No pixel has more than one layer."""


def joined(pieces: Sequence[tuple[int, int, WindowSamples]]) -> WindowSamples:
    """Evidence of an image from that of its pieces, each with its first row and column."""
    clusters, memory, sampled = [NO_CLUSTERS], np.zeros(len(MEMORY_FIELDS)), [NO_SAMPLES]
    for row, col, part in pieces:
        lines = part.clusters.copy(), part.sampled.copy()
        for moved in lines:
            moved[:, :2] += row, col
        clusters.append(lines[0])
        sampled.append(lines[1])
        memory += part.memory
    return WindowSamples(np.concatenate(clusters), memory, np.concatenate(sampled[1:] or sampled))


class WindowScene(NamedTuple):
    """One window.

    Parameters
    ----------
    range_mm, sigma_mm, stderr_mm, weight : (row, col, layer) float64
        Of each layer; NaN where there is none. An unknown `stderr_mm` is `sigma_mm`.
    amplitude : (row, col, layer) float64 or None
        Of each layer, NaN where it is not known.
    directions : (row, col, 3) float64 or None
        Unit vectors along the beams; None where the camera's view is not known.
    turn_mm : float or None
        Length of the circle that a measured phase folds ranges to; None where nothing folds.
    clusters : (n, 9) float64
        `CLUSTER_FIELDS`.
    memory : (4,) float64
        `MEMORY_FIELDS`.
    kinds : tuple of FrameKind
        The kinds of frames, the main one first; empty where all frames are of one kind.
    circle_mm : float or None
        Length of the circle that ranges are on; None for a line.
    """

    range_mm: FloatArray
    sigma_mm: FloatArray
    stderr_mm: FloatArray
    weight: FloatArray
    amplitude: FloatArray | None
    directions: FloatArray | None
    turn_mm: float | None
    clusters: FloatArray
    memory: FloatArray
    kinds: tuple[FrameKind, ...] = ()
    circle_mm: float | None = None

    @property
    def present(self) -> NDArray[np.bool_]:
        """Layers (row, col, layer) that are there."""
        return np.isfinite(self.range_mm)

    @property
    def kind_of_layer(self) -> IntArray:
        """Kind (row, col, layer) of the frames that show each layer: its place in `kinds`, -1 if that is not known."""
        return kinds_of_layers(self.range_mm, self.sigma_mm, self.weight, self.kinds, circle_mm=self.circle_mm)

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Whether noise joins each layer to the next one of its pixel (row, col, layer - 1): one surface may be both.

        A surface that drifts, or whose noise is wider than its curve, is several layers.
        """
        with np.errstate(invalid="ignore"):
            noise = NOISE_SIGMAS * np.hypot(self.sigma_mm[..., :-1], self.sigma_mm[..., 1:])
            return np.asarray(np.diff(self.range_mm, axis=-1) <= noise)


def make_scene(
    layers: Layers, evidence: WindowSamples, sensor: Sensor, *, circle_mm: float | None = None
) -> WindowScene:
    """Make the scene of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col). Where they were unmixed, no sample is of one layer alone, and evidence of
        samples does not count.
    evidence : Evidence
        Of the same pixels.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    """
    sigma = layers.sigma.astype(np.float64)
    stderr = layers.range_stderr.astype(np.float64)
    clusters, memory, sampled = evidence
    light = None if layers.amplitude is None else layers.amplitude.astype(np.float64)
    if layers.mixing is not None:
        unmixed = layers.mixing == int(Mixing.PHASOR)
        clusters, sampled = (
            lines[~unmixed[lines[:, 0].astype(int), lines[:, 1].astype(int)]] for lines in (clusters, sampled)
        )
    rows, cols = layers.shape
    try:
        directions = None if sensor.optics is None else beam_directions_of(sensor.optics, (rows, cols))
    except ValueError:  # optics that cannot be: commands that need them refuse them
        directions = None
    return WindowScene(
        range_mm=layers.range.astype(np.float64),
        sigma_mm=sigma,
        stderr_mm=np.where(np.isfinite(stderr), stderr, sigma),
        weight=layers.weight.astype(np.float64),
        amplitude=light,
        directions=directions,
        turn_mm=_turn_mm(sensor) if circle_mm is None else circle_mm,
        clusters=clusters,
        memory=memory,
        kinds=find_frame_kinds(layers, sampled, least_pixels=LEAST_PIXELS, circle_mm=circle_mm),
        circle_mm=circle_mm,
    )


def _turn_mm(sensor: Sensor) -> float | None:
    """Unambiguous range of the camera's frequency, mm; None if it is not known."""
    return None if sensor.modulation_frequency_hz is None else unambiguous_range_mm(sensor.modulation_frequency_hz)


FALSE_MARKS = 0.002
"""Rate at which a suspicion marks what is not so: of surfaces, by their amplitude; of layers, by their frames."""

LEAST_PIXELS = math.ceil(math.log2(1.0 / FALSE_MARKS))
"""Fewest pixels that tell what nearly every pixel shows: each may show it by a chance of one half."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """One reason to doubt a layer.

    Parameters
    ----------
    name : str
        Its name in files: one of `flag_meanings`.
    flag : int
        Its bit in `suspect`.
    short : str
        A few words for tables.
    meaning : str
        A sentence for reports.
    mark : callable
        From a `WindowScene` to the layers (row, col, layer) that it suspects.
    """

    name: str
    flag: int
    short: str
    meaning: str
    mark: Callable[[WindowScene], BoolArray]
