"""Rules of marks, for any data; `tofmix verify` applies them beside those of `tofmix.invariants`."""

from collections.abc import Iterator

import numpy as np

from tofmix.arrays import BoolArray
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
        yield Rule(SUSPECT.name, f"sums of {', '.join(map(str, flags))}", _any(unknown))
        yield Rule(SUSPECT.name, "0 past n_modes", _any((layers.suspect > 0) & ~present))
        passing = (layers.suspect & PASSING.flag) > 0
    if layers.suspect_frames is None:
        yield Rule(SUSPECT_FRAMES.name, "there where layers pass", _any(passing))
        return
    first, last = layers.suspect_frames[..., 0], layers.suspect_frames[..., 1]
    yield Rule(SUSPECT_FRAMES.name, "the first is not after the last", _any(first > last))
    yield Rule(SUSPECT_FRAMES.name, "0 for layers that do not pass", _any((last > 0) & ~passing))


def _any(broken: BoolArray) -> BoolArray:
    """Pixels that break a rule in any layer."""
    return np.asarray(broken.any(-1))
