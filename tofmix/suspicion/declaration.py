"""What a suspicion is: a flag, its words, and the function that marks layers."""

from collections.abc import Callable
from dataclasses import dataclass

from tofmix.arrays import BoolArray
from tofmix.suspicion.scene import WindowScene

FALSE_MARKS = 0.002
"""Rate at which a suspicion marks what is not so: of surfaces, by their amplitude; of layers, by their frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """One reason to doubt a layer.

    Parameters
    ----------
    name : str
        Its name in files: one of `flag_meanings`.
    flag : int
        Its bit in `suspect`.
    short : str
        A few words for tables.
    meaning : str
        A sentence for reports.
    mark : callable
        From a `WindowScene` to the layers (row, col, layer) that it suspects.
    """

    name: str
    flag: int
    short: str
    meaning: str
    mark: Callable[[WindowScene], BoolArray]
