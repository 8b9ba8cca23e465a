"""Thresholds that this process has drawn before: the same noise is not calibrated twice."""

import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.counting import Thresholds
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.thresholds import calibrate


class KnownThresholds:
    """Tables by the noise they were drawn for; those used last are kept, a few kilobytes each.

    A table depends on nothing but what it is drawn for: its seed is fixed, and workers do not change it.

    Parameters
    ----------
    draw : callable
        Draws a table, as `calibrate` does.
    most : int
        Tables that are kept.
    """

    def __init__(self, draw: Callable[..., Thresholds] = calibrate, *, most: int = 32) -> None:
        self._draw, self._most = draw, most
        self._tables: OrderedDict[bytes, Thresholds] = OrderedDict()
        self._lock = Lock()

    def __call__(
        self,
        noise: PixelNoise,
        beam: Beam,
        ranges_mm: FloatArray,
        *,
        samples: tuple[int, int],
        own: FloatArray | None = None,
        rounding_mm: float = 0.0,
        workers: int = 1,
        progress: Callable[[int, int], None] | None = None,
    ) -> Thresholds:
        """The table of the noise, drawn or known. `progress` is not called where it is known.

        Parameters
        ----------
        noise, beam, ranges_mm, samples, own, rounding_mm, workers, progress
            As for `calibrate`.

        Returns
        -------
        Thresholds
            For `count_surfaces`.
        """
        key = hashlib.sha256(pickle.dumps((noise, beam, ranges_mm, samples, own, rounding_mm))).digest()
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        table = self._draw(
            noise,
            beam,
            ranges_mm,
            samples=samples,
            own=own,
            rounding_mm=rounding_mm,
            workers=workers,
            progress=progress,
        )
        with self._lock:
            self._tables[key] = table
            while len(self._tables) > self._most:
                self._tables.popitem(last=False)
        return table


known_thresholds = KnownThresholds()
"""Those of this process."""
