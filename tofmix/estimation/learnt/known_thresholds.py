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

KEPT = 32
"""Tables that are kept, a few kilobytes each: those used last."""

_known: OrderedDict[bytes, Thresholds] = OrderedDict()
_lock = Lock()


def known_thresholds(
    noise: PixelNoise,
    beam: Beam,
    ranges_mm: FloatArray,
    *,
    samples: tuple[int, int],
    rounding_mm: float = 0.0,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Thresholds:
    """The table of `calibrate`, from an earlier call of this process with the same noise where there was one.

    A table depends on nothing but what is given: its seed is fixed, and workers do not change it.

    Parameters
    ----------
    noise, beam, ranges_mm, samples, rounding_mm, workers, progress
        As for `calibrate`. `progress` is not called where the table is known.

    Returns
    -------
    Thresholds
        For `count_surfaces`.
    """
    key = hashlib.sha256(pickle.dumps((noise, beam, ranges_mm, samples, rounding_mm))).digest()
    with _lock:
        found = _known.get(key)
        if found is not None:
            _known.move_to_end(key)
            return found
    found = calibrate(
        noise, beam, ranges_mm, samples=samples, rounding_mm=rounding_mm, workers=workers, progress=progress
    )
    with _lock:
        _known[key] = found
        while len(_known) > KEPT:
            _known.popitem(last=False)
    return found
