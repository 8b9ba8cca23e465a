"""The status of a pixel: one definition for code, files and documentation."""

from enum import IntEnum


class Status(IntEnum):
    """Outcome of the estimator for one pixel in one window (CF flag values).

    Compare arrays with ``int(member)``: NumPy takes a member for a number of 64 bits, and casts the whole array.
    """

    OK = 0
    TOO_FEW_SAMPLES = 1
    NOT_CONVERGED = 2
    NO_SURFACE = 3
    DEGENERATE = 4


STATUS_MEANINGS: dict[Status, str] = {
    Status.OK: "the layers, if any, are a converged fit",
    Status.TOO_FEW_SAMPLES: "fewer valid samples than --min-samples; nothing was fitted",
    Status.NOT_CONVERGED: "EM stopped at --max-iter; the layers are its last values",
    Status.NO_SURFACE: "the samples show no surface: no return, or outliers alone",
    Status.DEGENERATE: "the layers stand, but the samples cannot tell their errors (singular information)",
}


def status_name(value: int) -> str:
    """``too_few_samples`` for 1 and so on, as in the files' ``flag_meanings``."""
    return Status(value).name.lower()
