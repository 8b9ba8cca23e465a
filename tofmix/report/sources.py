"""Interface of a layers file for the report.

`tofmix.io` has the files; anything else with these members does as well.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tofmix.flags import MixingLaw
from tofmix.layers import Layers, Provenance


class LayersSource(Protocol):
    """Layers of an image sequence, read window by window."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Windows, rows, columns."""

    @property
    def max_layers(self) -> int:
        """Length of the layer axis."""

    @property
    def window_start(self) -> NDArray[np.uint64]:
        """First frame of each window, (window,)."""

    @property
    def window_stop(self) -> NDArray[np.uint64]:
        """One past the last frame of each window, (window,)."""

    @property
    def provenance(self) -> Provenance:
        """Source and options of the layers."""

    @property
    def mixing_law(self) -> MixingLaw | None:
        """The law of mixing over all windows; None where it was not measured."""

    def read_window(self, window: int) -> Layers:
        """Layers of one window, of the leading shape (row, col)."""
