"""Real recordings against their own first third as the scene: nothing changed, so nothing is to be named.

The recordings and groups are those of `same`: frames in another order, and running medians over 3 and 5 of these. In
place of a model of a wall, the first third is estimated, as `tofmix reconcile --self` does.
"""

from typing import Any

import numpy as np
from benchmarks.measured_parts import same
from benchmarks.measured_parts.of_itself import of_itself

CASES = 300
"""100 permuted, 100 medians over 3, 100 medians over 5."""

order, table = same.order, same.table


def judged(number: int, seed: int) -> dict[str, Any] | None:
    """The result of one case; None where its recording is missing."""
    group, name = same.GROUPS[number % 3], list(same.RECORDINGS)[number // 3 % len(same.RECORDINGS)]
    rng = np.random.default_rng([seed, number])
    try:
        samples = same.RECORDINGS[name](rng)[: same.MOST_FRAMES]
    except FileNotFoundError:
        return None
    samples = same.in_group(same.part_of(samples, rng), group, rng)
    return {"number": number, "group": group, "name": name, "frames": len(samples), **of_itself(samples)}
