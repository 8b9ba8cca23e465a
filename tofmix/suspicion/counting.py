"""Counts of marks."""

import numpy as np
from numpy.typing import NDArray

from tofmix.suspicion.registry import SUSPICIONS


def count_suspects(suspect: NDArray[np.uint8] | None) -> dict[str, int]:
    """Layers of each suspicion by its name; `suspect` is None where no layer is marked."""
    return {
        suspicion.name: 0 if suspect is None else int(np.count_nonzero(suspect & suspicion.flag))
        for suspicion in SUSPICIONS
    }
