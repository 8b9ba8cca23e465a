"""Minutes of a zone sensor that lies still for four hours, against the minutes ten before them as the scene.

The means of the minutes wander by some mm, so that a bias is true where two minutes differ. In a second group the
samples of the whole record are shuffled: there, nothing differs.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from benchmarks.measured_parts.judging import counted
from benchmarks.measured_parts.of_itself import of_itself
from benchmarks.real_recordings import FOLDER

RATE_HZ = 55.0
MINUTE = int(60 * RATE_HZ)
LATER = 10
PAIRS = 230
CASES = 2 * PAIRS
"""As recorded, and shuffled."""

CLEAR_ERRORS, CLEAR_SIGMA = 4.0, 0.2
"""A difference that is to be named: standard errors of the difference, and standard deviations of a sample."""

NO_ERRORS = 2.0
"""A difference below which no constant bias is to be named, in standard errors."""

CONSTANT = frozenset(
    {"range_offset", "surface_pose", "surface_offset", "fixed_pattern", "tap_mismatch", "wiggling", "amplitude_walk"}
)
"""Names of a bias that does not change with time."""

BIASES = CONSTANT | {"temperature_drift", "motion"}


def judged(number: int, seed: int) -> dict[str, Any] | None:
    """The result of one pair of minutes; None where the record is missing."""
    path = FOLDER / "vl53l0x" / "vl53l0x_static_4h.npz"
    if not path.exists():
        return None
    series = np.load(path)["range_mm"].astype(np.float64)
    shuffled, pair = number % 2 == 1, spread_out(number // 2)
    if shuffled:
        series = np.random.default_rng(seed).permutation(series)
    first, second = (series[k * MINUTE : (k + 1) * MINUTE] for k in (pair, pair + LATER))
    difference = float(second.mean() - first.mean())
    error = float(np.sqrt(first.var() / first.size + second.var() / second.size))
    found = of_itself(np.concatenate([first, second])[:, None, None], MINUTE, times_s=np.arange(2 * MINUTE) / RATE_HZ)
    return {
        "number": number,
        "shuffled": shuffled,
        "pair": pair,
        "difference_mm": round(difference, 3),
        "errors": round(abs(difference) / error, 1),
        "sigmas": round(abs(difference) / float(first.std()), 2),
        **found,
    }


def spread_out(number: int) -> int:
    """The pair of a case, such that the first cases are spread over all hours."""
    return number * 101 % PAIRS


def order(count: int) -> Sequence[int]:
    """The first cases: as recorded and shuffled take turns."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Pairs that differ, pairs that do not, and shuffled ones."""
    real = [line | {"bias": bool(BIASES & set(line["named"]))} for line in done if not line["shuffled"]]
    clear = [line for line in real if line["errors"] > CLEAR_ERRORS and line["sigmas"] > CLEAR_SIGMA]
    same = [line | {"constant": bool(CONSTANT & set(line["named"]))} for line in real if line["errors"] < NO_ERRORS]
    mixed = [line | {"any": bool(line["named"])} for line in done if line["shuffled"]]
    yield "| | pairs | aim |"
    yield "|---|---|---|"
    yield f"{counted('differ clearly: a bias named', clear, 'bias')} 90 % |"
    yield f"{counted('do not differ: a constant bias named', same, 'constant')} 0 |"
    yield f"{counted('shuffled: named', mixed, 'any')} 2 of 230 |"
    yield f"| longest run, s | {max((line['seconds'] for line in done), default=0)} | 120 |"
