"""The errors that users meet, each with its exit code.

Raise one of these wherever the fault lies outside the program: the command line
prints its text as one line on stderr and leaves with its exit code. Any other
exception is a bug in tofmix and exits with 1.
"""

from enum import IntEnum
from pathlib import Path


class ExitCode(IntEnum):
    """The exit codes of every command of ``tofmix``."""

    DONE = 0
    BUG = 1
    USAGE = 2
    BAD_INPUT = 3
    STORAGE = 4
    SOME_FAILED = 5
    DIFFERENT = 6
    INTERRUPTED = 130
    CLOSED_PIPE = 141
    TERMINATED = 143


EXIT_CODE_MEANINGS: dict[ExitCode, str] = {
    ExitCode.DONE: "done",
    ExitCode.BUG: "a bug in tofmix; please report it",
    ExitCode.USAGE: "usage: an unknown option or value, or an output that exists (pass --overwrite)",
    ExitCode.BAD_INPUT: "bad input: a missing, damaged or unfit recording, layers file or model",
    ExitCode.STORAGE: "disk or I/O: the output cannot be written, or a cluster cannot be reached",
    ExitCode.SOME_FAILED: "some of several recordings failed; the others are done",
    ExitCode.DIFFERENT: "compare: the two results differ",
    ExitCode.INTERRUPTED: "interrupted (Ctrl-C)",
    ExitCode.CLOSED_PIPE: "the program that reads the output has ended",
    ExitCode.TERMINATED: "terminated (SIGTERM)",
}
EXIT_CODE_REMEDIES: dict[ExitCode, str] = {
    ExitCode.DONE: "",
    ExitCode.BUG: "Report it with the command, the line on stderr, and `tofmix info FILE --json`.",
    ExitCode.USAGE: "`tofmix COMMAND --help` lists the options. An unknown name of a built-in sensor "
    "(`sensors`, `--noise`) is a usage error; where a file is possible (`simulate`, `import --sensor`) it is bad"
    " input.",
    ExitCode.BAD_INPUT: "The line on stderr names file, dataset, reason and remedy. No file was changed.",
    ExitCode.STORAGE: "Free the disk, or choose another folder. `tofmix estimate --resume` continues.",
    ExitCode.SOME_FAILED: "stderr has a line for each failed recording. Run the command again with `--resume`.",
    ExitCode.DIFFERENT: "The table on stdout counts the differences. `--allow` accepts a share of differing pixels.",
    ExitCode.INTERRUPTED: "The process ends by SIGINT, so that a shell loop around it stops. `--resume` continues;"
    " `reconcile` writes the best so far after one Ctrl-C, and nothing after two.",
    ExitCode.CLOSED_PIPE: "No error: `tofmix report ... | head -1` ends in this way.",
    ExitCode.TERMINATED: "The process ends by SIGTERM. Partial outputs are removed. `--resume` continues.",
}
"""The remedy, or a remark, for each exit code: docs/reference/exit-codes.md shows them."""


class TofmixError(Exception):
    """A fault that the user can mend. Its text is one line: file, dataset, reason and remedy."""

    exit_code = ExitCode.BUG


class UsageError(TofmixError):
    """An invalid call, for example an output that exists."""

    exit_code = ExitCode.USAGE


class BadInputError(TofmixError):
    """An input file is missing, damaged, or of the wrong kind."""

    exit_code = ExitCode.BAD_INPUT


class DoubtWarning(UserWarning):
    """A doubt about samples, their noise or the layers, from `tofmix.open` and `tofmix.estimate`."""


class StorageError(TofmixError):
    """A file could not be written: no space, no permission, no such folder."""

    exit_code = ExitCode.STORAGE


def os_error_text(error: OSError, path: Path | str) -> str:
    """``path: reason`` of an operating system error, without its number."""
    return f"{path}: {error.strerror or error}"
