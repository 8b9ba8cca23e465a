"""Models (`*.toml`), from a file or built in."""

from pathlib import Path, PurePath

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.errors import BadInputError
from tofmix.io.next_command import next_command
from tofmix.io.storage import check_input, read_text
from tofmix.simulation.builtin import BUILTIN_MODELS, builtin_text
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.toml_table import MapReader

_IMAGE_RANK = 2  # (row, col)

_HDF5 = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file: its format specification, III.A."""


def load_model_text(name: str) -> str:
    """Text of the model file `name`, or of the built-in model of that name; a file of that name wins."""
    if name in BUILTIN_MODELS and not Path(name).is_file():
        return builtin_text(name)
    if not Path(name).exists():
        known = ", ".join(BUILTIN_MODELS)
        raise BadInputError(f"{name}: no such model file, and not a built-in model ({known})")
    if _is_hdf5(Path(name)):
        raise BadInputError(f"{name} is an HDF5 file, not a model: {next_command('info', Path(name))}")
    return read_text(Path(name))


def _is_hdf5(path: Path) -> bool:
    """Whether a file begins like HDF5; the reader refuses a file that cannot be read."""
    try:
        check_input(path)
        with path.open("rb") as file:
            return file.read(len(_HDF5)) == _HDF5
    except (OSError, BadInputError):
        return False


def load_model(name: str) -> Model:
    """Read the model `name`; see `load_model_text`."""
    text = load_model_text(name)
    if not Path(name).is_file():
        return parse_model(text, source=name)

    return parse_model(text, source=name, read_map=maps_of_model(Path(name)))


def maps_of_model(file: Path) -> MapReader:
    """Reader of the maps of a model or of a camera's file."""

    def read_map(path: str, shape: tuple[int, int] | None) -> Float32Array:
        return _read_map(file.parent, path, shape)

    return read_map


def _read_map(folder: Path, path: str, shape: tuple[int, int] | None) -> Float32Array:
    """Read a map (row, col) that a model names; without `shape`, of any image.

    Its path is relative to the model's folder and does not leave it: a model and its maps are moved, and sent, as one
    folder.

    Raises
    ------
    ValueError
        If the path is absolute or leaves the folder, or there is no such array.
    """
    relative = PurePath(path)
    if not path or relative.is_absolute() or ".." in relative.parts:
        raise ValueError(f'"{path}": expected a path within the model\'s folder, such as "pattern.npy"')
    try:
        # Mapped, so that a header that declares terabytes costs nothing
        array = np.load(folder / relative, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise ValueError(f'"{path}": {error.strerror or error}') from None
    except (ValueError, EOFError) as error:
        raise ValueError(f'"{path}": not an .npy file of numbers: {error}') from None
    if not isinstance(array, np.ndarray):
        raise ValueError(f'"{path}": expected one array in an .npy file')  # noqa: TRY004  a file's fault
    if array.dtype.kind != "f":
        raise ValueError(f'"{path}": expected float32, got {array.dtype}')
    if shape is None and array.ndim != _IMAGE_RANK:
        raise ValueError(f'"{path}": shape {array.shape} is not an image (row, col)')
    if shape is not None and array.shape != shape:
        raise ValueError(f'"{path}": shape {array.shape} differs from the image {shape}')
    return array.astype(np.float32)
