"""Apply all suspicions to one window: the entry for everything that has layers and evidence of a whole image."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.registry import SUSPICIONS
from tofmix.suspicion.scene import CLUSTER_FIELDS, Evidence, make_scene

_COLUMN = {name: place for place, name in enumerate(CLUSTER_FIELDS)}


def judge(
    layers: Layers, evidence: Evidence, sensor: Sensor, *, first_frame: int = 0, circle_mm: float | None = None
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


def amplitude_of(layers: Layers, evidence: Evidence) -> NDArray[np.float32] | None:
    """Amplitude (row, col, layer) of a window's layers, NaN where each sample is of all of them; None: not known."""
    if evidence.amplitude is None or layers.mixing is None:
        return evidence.amplitude
    sums = (layers.mixing == int(Mixing.PHASOR))[..., np.newaxis]
    return np.where(sums | ~np.isfinite(layers.range), np.float32(np.nan), evidence.amplitude)


def judge_windows(
    layers: Layers, evidence: Sequence[Evidence], sensor: Sensor, *, first_frames: Sequence[int],
    circle_mm: float | None = None,
) -> Layers:  # fmt: skip
    """Layers (window, row, col) with their amplitudes, if they are known, and marks, if there is any."""
    flags = np.zeros(layers.range.shape, np.uint8)
    frames = np.zeros((*flags.shape, 2), np.uint32)
    light = []
    for window, (found, first) in enumerate(zip(evidence, first_frames, strict=True)):
        part = Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
        flags[window], frames[window] = judge(part, found, sensor, first_frame=first, circle_mm=circle_mm)
        light.append(amplitude_of(part, found))
    known = [values for values in light if values is not None]
    if known:
        layers = replace(layers, amplitude=np.stack(known))
    if not flags.any():
        return layers
    return replace(layers, suspect=flags, suspect_frames=frames if (flags & PASSING.flag).any() else None)
