"""The command that mends a fault, as a user types it: errors end in one of these."""

import shlex
from pathlib import Path

_ARRAYS = (".npy", ".npz", ".mat", ".csv")
_IMAGES = (".png", ".tif", ".tiff")
_BAGS = (".bag", ".mcap", ".db3")


def import_command(path: Path, *options: str) -> str:
    """``tofmix import`` of a file to a new one beside it, with some options."""
    target = path.with_name(f"{path.stem}_mm.h5" if path.suffix == ".h5" else f"{path.stem or path.name}.h5")
    return shlex.join(["tofmix", "import", str(path), *options, "-o", str(target)])


def next_command(name: str, path: Path, *options: str) -> str:
    """Another command on a file."""
    return shlex.join(["tofmix", name, str(path), *options])


def foreign_kind(path: Path) -> str | None:
    """What the ending of a file says it is, where `tofmix import` makes a recording of it."""
    suffix = path.suffix.lower()
    for suffixes, kind in ((_ARRAYS, "an array"), (_IMAGES, "an image"), (_BAGS, "a bag")):
        if suffix in suffixes:
            return kind
    return None
