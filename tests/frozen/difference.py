"""Where two outcomes differ: arrays value by value, texts line by line, and numbers within texts as numbers."""

import difflib
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from frozen.outcome import Outcome

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
_MOST_LINES = 12
"""Lines of a text that are shown."""


def differences(reference: Outcome, new: Outcome, *, relative: float = 0.0) -> Iterator[str]:
    """Lines that say what differs, none if nothing does.

    `reference`, `new`: of the same case.
    `relative`: numbers are equal if they differ by at most this share of the reference's. 0: to the last bit, and texts
      to the last character.
    Yields str: a line for each array, several for a text.
    """
    for name in sorted(reference.keys() - new.keys()):
        yield f"{name}: missing"
    for name in sorted(new.keys() - reference.keys()):
        yield f"{name}: new"
    for name in sorted(reference.keys() & new.keys()):
        a, b = reference[name], new[name]
        if isinstance(a, list) != isinstance(b, list):
            yield f"{name}: text and array"
        elif isinstance(a, list) and isinstance(b, list):
            yield from (f"{name}: {line}" for line in _of_texts(a, b, relative))
        else:
            yield from (f"{name}: {line}" for line in _of_arrays(np.asarray(a), np.asarray(b), relative))


def _of_arrays(a: NDArray[np.generic], b: NDArray[np.generic], relative: float) -> Iterator[str]:
    if (a.dtype, a.shape) != (b.dtype, b.shape):
        yield f"{a.dtype} {a.shape} has become {b.dtype} {b.shape}"
        return
    if a.dtype.kind not in "fiub":
        if a.tobytes() != b.tobytes():
            yield f"values of {a.dtype} differ"
        return
    x, y = a.astype(np.float64), b.astype(np.float64)
    both_nan = np.isnan(x) & np.isnan(y)
    unequal = (x != y) & ~both_nan
    if not unequal.any():
        return
    apart = np.abs(x - y)[unequal]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = apart / np.abs(x[unequal])
    if relative and np.all(share <= relative):
        return
    at = tuple(int(axis) for axis in np.argwhere(unequal)[np.argmax(np.nan_to_num(share, nan=np.inf))])
    yield (
        f"{np.count_nonzero(unequal)} of {a.size} differ, by up to {np.nanmax(np.append(apart, 0.0)):.3g}"
        f" ({np.nanmax(np.append(share, 0.0)):.3g} of the value); at {at} {a[at]} has become {b[at]}"
    )


def _of_texts(a: list[str], b: list[str], relative: float) -> Iterator[str]:
    if a == b:
        return
    if relative and len(a) == len(b) and all(_alike(x, y, relative) for x, y in zip(a, b, strict=True)):
        return
    lines = [line for line in difflib.unified_diff(a, b, n=0, lineterm="") if line[:3] not in {"---", "+++", "@@ "}]
    yield from (line[:200] for line in lines[:_MOST_LINES])
    if len(lines) > _MOST_LINES:
        yield f"and {len(lines) - _MOST_LINES} lines more"


def _alike(a: str, b: str, relative: float) -> bool:
    """Whether lines are the same but for numbers, and these nearly the same."""
    if a == b:
        return True
    if _NUMBER.split(a) != _NUMBER.split(b):
        return False
    pairs = zip(map(float, _NUMBER.findall(a)), map(float, _NUMBER.findall(b)), strict=True)
    return all(abs(x - y) <= relative * abs(x) for x, y in pairs)
