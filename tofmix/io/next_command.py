"""Remedies at the end of errors: the command that mends a fault, and the installation of a missing library.

Commands are as a user types them. Libraries that only some formats need are optional extras of the package.
"""

import shlex
from importlib import import_module
from pathlib import Path
from typing import Any

from tofmix.errors import UsageError


def need(module: str, *, extra: str, what: str) -> Any:  # noqa: ANN401  a module
    """Import a library, or raise an error with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".", maxsplit=1)[0]
        raise UsageError(f"{what} needs {name}: pip install 'tofmix[{extra}]'") from error


_ARRAYS = (".npy", ".npz", ".mat")
_TABLES = (".csv", ".tsv")
_IMAGES = (".png", ".tif", ".tiff")
_IN_FOLDERS = (".png",)
"""Images that hold one frame: their folder is a source, a single file is not."""
_BAGS = (".bag", ".mcap", ".db3")


def import_command(path: Path, *options: str) -> str:
    """``tofmix import`` of a file to a new one in the same folder, with some options; its name has the target kept."""
    kept = options[options.index("--target") + 1] if "--target" in options else "mm"
    named = path if path.name else path.absolute()  # the current folder is "."
    target = path.parent / (f"{named.stem}_{kept}.h5" if named.suffix == ".h5" else f"{named.stem or 'images'}.h5")
    return shlex.join(["tofmix", "import", str(path), *options, "-o", str(target)])


def next_command(name: str, path: Path, *options: str) -> str:
    """Another command on a file; `export` writes to a new one in the same folder."""
    if name == "export" and not options:
        options = ("-o", str(path.parent / f"{path.name.removesuffix('.h5')}.ply"))
    return shlex.join(["tofmix", name, str(path), *options])


def folder_fault(path: Path) -> str:
    """Error for a folder in the place of an HDF5 file: its kind, and the command that reads it."""
    try:
        names = [entry.name.lower() for entry in path.iterdir()]
    except OSError:
        names = []
    if "gap.json" in names:
        return f"{path} is a folder of reconcile, not HDF5: {next_command('info', path)}"
    if "metadata.yaml" in names:
        return f"{path} is a bag, not HDF5: {import_command(path)}"
    if any(name.endswith(_IMAGES) for name in names):
        return f"{path} is a folder of images, not HDF5: {import_command(path)}"
    return f"{path}: a folder, not a file"


def foreign_fault(path: Path) -> str | None:
    """Error for a file with an extension of `tofmix import`; None for others."""
    suffix = path.suffix.lower()
    for suffixes, kind in ((_ARRAYS, "an array"), (_TABLES, "a table"), (_IMAGES, "an image"), (_BAGS, "a bag")):
        if suffix in suffixes:
            source = path.parent if suffix in _IN_FOLDERS else path
            return f"{path} is {kind}, not HDF5: {import_command(source)}"
    return None
