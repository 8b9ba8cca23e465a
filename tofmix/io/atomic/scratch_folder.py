"""A folder for unpacked data in the temporary folder; it is removed with the run, even if the run is killed.

A killed run cannot remove its own. As it is locked while its run lives, the next one that needs a folder removes it.
"""

import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tofmix.errors import StorageError, os_error_text
from tofmix.io.atomic.locks import remove_unlocked, try_lock
from tofmix.io.atomic.partial_output import forget_partial_output, note_partial_output

_PREFIX = "tofmix-scratch-"
YOUNG_S = 60.0
"""A folder may be this old and not locked yet."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder that is removed when the block ends, or the process."""
    root = Path(tempfile.gettempdir())
    _clear(root)
    try:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=root))
        note_partial_output(folder, resumable=False)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise StorageError(os_error_text(error, root)) from error
    try:
        try_lock(descriptor)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)
        forget_partial_output(folder)


def _clear(root: Path) -> None:
    """Remove folders of dead runs of this user."""
    for folder in root.glob(f"{_PREFIX}*"):
        remove_unlocked(folder, stat.S_ISDIR, os.O_RDONLY | os.O_DIRECTORY, _remove, age_s=YOUNG_S)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
