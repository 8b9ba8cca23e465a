"""Rules of marks, for any data; `tofmix verify` applies them beside those of `tofmix.invariants`."""

from collections.abc import Iterator

import numpy as np

from tofmix.invariants import Rule
from tofmix.layers import SUSPECT, SUSPECT_FRAMES, Layers
from tofmix.suspicion.passing import PASSING
from tofmix.suspicion.registry import SUSPICIONS


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
        yield Rule(SUSPECT.name, f"sums of {', '.join(map(str, flags))}", unknown.any(-1))
        yield Rule(SUSPECT.name, "0 past n_modes", ((layers.suspect > 0) & ~present).any(-1))
        passing = (layers.suspect & PASSING.flag) > 0
    if layers.suspect_frames is None:
        yield Rule(SUSPECT_FRAMES.name, "there where layers pass", passing.any(-1))
        return
    first, last = layers.suspect_frames[..., 0], layers.suspect_frames[..., 1]
    yield Rule(SUSPECT_FRAMES.name, "the first is not after the last", (first > last).any(-1))
    yield Rule(SUSPECT_FRAMES.name, "0 for layers that do not pass", ((last > 0) & ~passing).any(-1))
