"""Layers that the samples show and the scene may not have: scattered, folded, passing and near returns.

Each suspicion is a file with one declaration, and its line in `SUSPICIONS`, in the order of their flags. `evidence`
gathers from the samples, pixel by pixel, what a layers file does not keep; `judge` applies all suspicions to a window,
when all its pixels are known. Layers stay as they are: a mark is a flag beside them. `tofmix verify` applies the rules
of marks beside those of `tofmix.invariants`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tofmix.invariants import Rule, in_any_layer
from tofmix.layers import SUSPECT, SUSPECT_FRAMES, Layers
from tofmix.sensor import Sensor
from tofmix.suspicion.folded import FOLDED
from tofmix.suspicion.near_return import NEAR_RETURN
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.scattered_light import SCATTERED_LIGHT
from tofmix.suspicion.scene import CLUSTER_FIELDS, Suspicion, WindowSamples, make_scene

SUSPICIONS: tuple[Suspicion, ...] = (
    SCATTERED_LIGHT,
    FOLDED,
    PASSING,
    NEAR_RETURN,
)
"""All suspicions; files have the flags and names, reports the words."""


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
    first_frame : int
        First frame of the window.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.

    Returns
    -------
    ((row, col, layer) uint8, (row, col, layer, 2) uint32)
        Flags of `tofmix.suspicion`, added up; first and last frame of passing layers, 0 elsewhere.
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
    kind_of_layer = scene.kind_of_layer
    for number, kind in enumerate(scene.kinds[1:], start=1):
        frames[kind_of_layer == number] = first_frame + kind.frames[0], first_frame + kind.frames[-1]
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


def suspect_rules(layers: Layers) -> Iterator[Rule]:
    """Apply every rule on marks to layers (window, row, col).

    Yields
    ------
    Rule
        With `broken` (window, row, col); all false where it holds. Nothing where no layer is marked.
    """
    present = np.arange(layers.max_layers) < layers.n_modes[..., np.newaxis]
    passing = np.zeros(layers.range.shape, bool)
    if layers.suspect is not None:
        flags = [suspicion.flag for suspicion in SUSPICIONS]
        unknown = (layers.suspect & ~np.uint8(sum(flags))) > 0
        yield Rule(SUSPECT.name, f"sums of {', '.join(map(str, flags))}", in_any_layer(unknown))
        yield Rule(SUSPECT.name, "0 past n_modes", in_any_layer((layers.suspect > 0) & ~present))
        passing = (layers.suspect & PASSING.flag) > 0
    if layers.suspect_frames is None:
        yield Rule(SUSPECT_FRAMES.name, "there where layers pass", in_any_layer(passing))
        return
    first, last = layers.suspect_frames[..., 0], layers.suspect_frames[..., 1]
    yield Rule(SUSPECT_FRAMES.name, "the first is not after the last", in_any_layer(first > last))
    yield Rule(SUSPECT_FRAMES.name, "0 for layers that do not pass", in_any_layer((last > 0) & ~passing))


def count_suspects(suspect: NDArray[np.uint8] | None) -> dict[str, int]:
    """Layers of each suspicion by its name; `suspect` is None where no layer is marked."""
    return {
        suspicion.name: 0 if suspect is None else int(np.count_nonzero(suspect & suspicion.flag))
        for suspicion in SUSPICIONS
    }
