"""Apply all suspicions to one window: the entry for everything that has layers and evidence of a whole image."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.registry import SUSPICIONS
from tofmix.suspicion.scene import CLUSTER_FIELDS, WindowSamples, make_scene

_COLUMN = {name: place for place, name in enumerate(CLUSTER_FIELDS)}


def judge(
    layers: Layers, evidence: WindowSamples, sensor: Sensor, *, first_frame: int = 0, circle_mm: float | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
    """Judge the layers of one window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), after unmixing.
    evidence : Evidence
        Of the same pixels, from `tofmix.suspicion.evidence`.
    sensor : Sensor
        The camera.
    first_frame : int
        First frame of the window.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.

    Returns
    -------
    ((row, col, layer) uint8, (row, col, layer, 2) uint32)
        Flags of `tofmix.suspicion.registry`, added up; first and last frame of passing layers, 0 elsewhere.
    """
    scene = make_scene(layers, evidence, sensor, circle_mm=circle_mm)
    flags = np.zeros(scene.range_mm.shape, np.uint8)
    frames = np.zeros((*flags.shape, 2), np.uint32)
    for suspicion in SUSPICIONS:
        flags[suspicion.mark(scene)] |= np.uint8(suspicion.flag)
    for line in scene.clusters:
        place = tuple(int(line[_COLUMN[name]]) for name in ("row", "col", "layer"))
        if flags[place] & PASSING.flag:
            frames[place] = [first_frame + int(line[_COLUMN[name]]) for name in ("first", "last")]
    return flags, frames


def judge_windows(
    layers: Layers,
    evidence: Sequence[WindowSamples],
    sensor: Sensor,
    *,
    first_frames: Sequence[int],
    circle_mm: float | None = None,
) -> Layers:
    """Layers (window, row, col) with their marks, if there is any: `judge` on each window."""
    flags = np.zeros(layers.range.shape, np.uint8)
    frames = np.zeros((*flags.shape, 2), np.uint32)
    for window, (found, first) in enumerate(zip(evidence, first_frames, strict=True)):
        part = Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
        flags[window], frames[window] = judge(part, found, sensor, first_frame=first, circle_mm=circle_mm)
    if not flags.any():
        return layers
    return replace(layers, suspect=flags, suspect_frames=frames if (flags & PASSING.flag).any() else None)
