"""The status of a pixel, and its kind of mixing: one definition for code, files and documentation."""

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
    Status.DEGENERATE: "the layers are valid, but the samples do not determine their errors (singular information)",
}


class Mixing(IntEnum):
    """Kind of mixing of a pixel's samples (CF flag values)."""

    ONE_SURFACE = 0
    EVENTS = 1
    PHASOR = 2
    UNDECIDED = 3


MOST_UNDECIDED = 0.5
"""Most probability of a layer in a pixel whose mixing is undecided."""

MIXING_MEANINGS: dict[Mixing, str] = {
    Mixing.ONE_SURFACE: "the pixel sees one surface, or none",
    Mixing.EVENTS: "each sample shows one of several surfaces",
    Mixing.PHASOR: "samples are phasor sums of several surfaces; the layers are unmixed with the help of neighbours",
    Mixing.UNDECIDED: "samples may be phasor sums of surfaces that cannot be determined; the layers are those of"
    " events",
}


def mixing_name(value: int) -> str:
    """``one_surface`` for 0 and so on, as in the files' ``flag_meanings``; ``mixing_9`` for a value without a name."""
    return Mixing(value).name.lower() if value in tuple(Mixing) else f"mixing_{value}"


def status_name(value: int) -> str:
    """``too_few_samples`` for 1 and so on, as in the files' ``flag_meanings``; ``status_9`` without a name."""
    return Status(value).name.lower() if value in tuple(Status) else f"status_{value}"
