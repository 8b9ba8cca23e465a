"""Arrays as text in a page: whole numbers, split into byte planes, deflated, in base64.

The page's script (``explorer_data.js``) reads them back. For files use `tofmix.io`;
this is for numbers that a person will look at, to the digits that are shown.
"""

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray

NOT_KNOWN = int(np.iinfo(np.int32).min)
"""Code for NaN and infinity."""

_MOST = int(np.iinfo(np.int32).max)
_BYTES = np.dtype(np.int32).itemsize

Spec = dict[str, str | int | float]
"""Name of an array, its length, and the unit in which it is stored."""


def pack_numbers(arrays: dict[str, tuple[NDArray[Any], float]]) -> tuple[list[Spec], str]:
    """Pack arrays of numbers.

    Parameters
    ----------
    arrays : dict of str to (array, float)
        Values of any shape, and the unit to which they are rounded; beyond 2^31 units they are cut off.

    Returns
    -------
    specs : list of dict
        In the order of the planes: ``name``, ``length``, ``unit``.
    text : str
        The base64 of the deflated planes: for each array four, from the lowest byte of int32 to the highest.
    """
    specs: list[Spec] = []
    planes = []
    for name, (values, unit) in arrays.items():
        whole = _whole(np.asarray(values, dtype=np.float64).ravel(), unit)
        specs.append({"name": name, "length": whole.size, "unit": unit})
        planes.append(whole.astype("<i4").view(np.uint8).reshape(-1, _BYTES).T.tobytes())
    return specs, text_of(zlib.compress(b"".join(planes), 6))


def _whole(values: FloatArray, unit: float) -> NDArray[np.int64]:
    finite = np.isfinite(values)
    # Times the inverse where that is whole: 0.01 has no exact double, and ties would round otherwise than in a table.
    inverse = round(1 / unit)
    scaled = np.where(finite, values, 0.0)
    scaled = scaled * inverse if np.isclose(inverse * unit, 1.0, rtol=1e-12) else scaled / unit
    whole = np.clip(np.rint(scaled), NOT_KNOWN + 1, _MOST).astype(np.int64)
    return np.where(finite, whole, NOT_KNOWN)


def pack_gaps(gaps: NDArray[np.uint16]) -> bytes:
    """Deflate gaps (rank, pixel) as two byte planes; run lengths alone, as nothing in them repeats but zeros."""
    deflater = zlib.compressobj(6, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    low, high = (gaps & 0xFF).astype(np.uint8), (gaps >> 8).astype(np.uint8)
    return deflater.compress(low.tobytes() + high.tobytes()) + deflater.flush()


def text_of(content: bytes) -> str:
    """Base64 of bytes."""
    return base64.b64encode(content).decode("ascii")
