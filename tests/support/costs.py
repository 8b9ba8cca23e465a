"""What commands and calls cost."""

import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple


class Cost(NamedTuple):
    """Wall seconds, processor seconds and peak resident MB."""

    seconds: float
    processor: float
    peak_mb: float


def cost(command: Sequence[str]) -> Cost:
    """Run a command once; it ends this program if it fails."""
    start = time.perf_counter()
    null = os.open(os.devnull, os.O_WRONLY)
    child = os.posix_spawn(command[0], list(command), os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, null, 1)])
    os.close(null)
    _, status, usage = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f"failed: {' '.join(command)}")
    return Cost(time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def least_cost(command: Sequence[str], repeat: int) -> Cost:
    """The fastest of several runs, and the most memory of any."""
    seconds, processor, peak = zip(*(cost(command) for _ in range(repeat)), strict=True)
    return Cost(min(seconds), min(processor), max(peak))


def least_s(
    *work: Callable[[], object], rounds: int = 3, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """Least seconds of each call, taken side by side."""
    seconds = [float("inf")] * len(work)
    for _ in range(rounds):
        for k, step in enumerate(work):
            start = clock()
            step()
            seconds[k] = min(seconds[k], clock() - start)
    return seconds
