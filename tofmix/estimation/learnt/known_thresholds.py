"""A cache of thresholds in this process: those of one noise are drawn once."""

import dataclasses
import hashlib
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.bootstrap import calibrate
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.thresholds import GainThresholds


class KnownThresholds:
    """Thresholds by all that they depend on; those used last are kept, a few kilobytes each.

    The seed of a bootstrap is fixed, and its workers do not change it. So its arguments are the key.

    Parameters
    ----------
    draw : callable
        Draws a table, as `calibrate` does.
    most : int
        Tables that are kept.
    """

    def __init__(self, draw: Callable[..., GainThresholds] = calibrate, *, most: int = 32) -> None:
        self._draw, self._most = draw, most
        self._tables: OrderedDict[bytes, GainThresholds] = OrderedDict()
        self._lock = Lock()

    def __call__(
        self,
        noise: PixelNoise,
        beam: Beam,
        ranges_mm: FloatArray,
        *,
        samples: tuple[int, int],
        pixel_effects: FloatArray | None = None,
        rounding_mm: float = 0.0,
        workers: int = 1,
        progress: Callable[[int, int], None] | None = None,
    ) -> GainThresholds:
        """Return the thresholds of the noise, drawn or known. `progress` is called where they are drawn.

        Parameters
        ----------
        noise, beam, ranges_mm, samples, pixel_effects, rounding_mm, workers, progress
            As for `calibrate`.

        Returns
        -------
        Thresholds
            For `count_surfaces`.
        """
        key = _digest((noise, beam, ranges_mm, samples, pixel_effects, rounding_mm))
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        table = self._draw(
            noise,
            beam,
            ranges_mm,
            samples=samples,
            pixel_effects=pixel_effects,
            rounding_mm=rounding_mm,
            workers=workers,
            progress=progress,
        )
        with self._lock:
            self._tables[key] = table
            while len(self._tables) > self._most:
                self._tables.popitem(last=False)
        return table


def _digest(value: tuple[Any, ...]) -> bytes:
    """SHA-256 of all numbers in tuples, dataclasses and arrays."""
    found = hashlib.sha256()

    def take(value: Any) -> None:  # noqa: ANN401  any part of the arguments
        if isinstance(value, np.ndarray):
            found.update(repr((value.dtype.str, value.shape)).encode())
            found.update(np.ascontiguousarray(value).tobytes())
        elif dataclasses.is_dataclass(value):
            take(tuple(getattr(value, field.name) for field in dataclasses.fields(value)))
        elif isinstance(value, tuple):
            found.update(f"{len(value)}:".encode())
            for part in value:
                take(part)
        elif value is None or isinstance(value, bool | int | float | str | np.generic):
            found.update(f"{value!r};".encode())
        else:
            raise TypeError(f"a {type(value).__name__} has no digest")

    take(value)
    return found.digest()


known_thresholds = KnownThresholds()
"""The cache of this process."""
