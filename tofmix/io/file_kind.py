"""Which of the tofmix formats an HDF5 file is, for commands that take any of them."""

from pathlib import Path

from tofmix.io import hdf5
from tofmix.io.guard import guard


def format_of(path: Path) -> str | None:
    """Root attribute ``format`` of an HDF5 file; None where it has none, as a recording from elsewhere may."""
    with guard.open_for_reading(path) as root, guard.reading(path, "format"):
        return hdf5.text_attribute(root, "format")


def is_foreign_hdf5(path: Path) -> bool:
    """Whether an HDF5 file is neither of a tofmix format nor has a dataset ``range``, as a recording does."""
    with guard.open_for_reading(path) as root, guard.reading(path, "format"):
        return hdf5.text_attribute(root, "format") is None and "range" not in root
