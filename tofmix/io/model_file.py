"""Models (`*.toml`), from a file or built in."""

import math
from pathlib import Path, PurePath

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import IMAGE_RANK, Float32Array
from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.next_command import next_command
from tofmix.io.recording.recording_file import file_sha256
from tofmix.io.storage import check_input, read_text
from tofmix.io.surfaces_file import open_surfaces
from tofmix.simulation import BUILTIN_MODELS, builtin_text
from tofmix.simulation.measured_scene import WALKS, SceneParts, SceneTable, measured_scene
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import SceneReader, parse_model
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.reconstruct import link_layers
from tofmix.toml_table import MapReader, TomlTable
from tofmix.wording import counted

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

    return parse_model(text, source=name, read_map=maps_of_model(Path(name)), read_scene=scene_of_model(Path(name)))


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
    relative = _within(path, "pattern.npy")
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
    if shape is None and array.ndim != IMAGE_RANK:
        raise ValueError(f'"{path}": shape {array.shape} is not an image (row, col)')
    if shape is not None and array.shape != shape:
        raise ValueError(f'"{path}": shape {array.shape} differs from the image {shape}')
    return array.astype(np.float32)


def _within(path: str, such_as: str) -> PurePath:
    """The relative path of a file of a model; ValueError if it leaves the model's folder."""
    relative = PurePath(path)
    if not path or relative.is_absolute() or ".." in relative.parts:
        raise ValueError(f'"{path}": expected a path within the model\'s folder, such as "{such_as}"')
    return relative


def scene_of_model(file: Path) -> SceneReader:
    """Reader of the layers that a model names in ``[scene]``, and of their surfaces."""

    def read_scene(table: TomlTable) -> SceneParts:
        window = table.integer("window") if "window" in table else 0
        frame_noise = table.number("frame_noise") if "frame_noise" in table else 0.0
        every = table.integer("every") if "every" in table else 1
        if every < 1:
            raise table.error(f"{every} is not at least 1", "every")
        most_frame_noise = 10.0  # sigma
        if not 0.0 <= frame_noise <= most_frame_noise:
            raise table.error(f"{frame_noise:g} is not in [0, {most_frame_noise:g}] sigma", "frame_noise")
        walks = table.numbers("walks") if "walks" in table else ()
        if walks and (min(walks) < 0 or len(walks) != len(WALKS) or not math.isclose(sum(walks), 1.0, abs_tol=0.01)):
            raise table.error(f"expected {len(WALKS)} probabilities, which add up to 1", "walks")
        range_max_mm, most_mm = table.number("range_max_mm") if "range_max_mm" in table else 0.0, 65_000.0
        if not 0.0 <= range_max_mm <= most_mm:
            raise table.error(f"{range_max_mm:g} is not in [0, {most_mm:g}] mm", "range_max_mm")
        given = SceneTable(
            frame_noise=frame_noise,
            walks=walks,
            range_max_mm=range_max_mm,
            every=every,
            way_mm=table.number("way_mm") if "way_mm" in table else 0.0,
            layers_path=table.text("layers"),
            surfaces_path=table.text("surfaces") if "surfaces" in table else "",
        )
        path = _file_of(file.parent, given.layers_path, table, "layers")
        surfaces = _file_of(file.parent, given.surfaces_path, table, "surfaces")
        with open_layers(path) as layers:
            if not 0 <= window < layers.shape[0]:
                raise table.error(f"{window}: {path} has windows 0 to {layers.shape[0] - 1}", "window")
            try:
                return scene_of_window(layers, window, given, surfaces if given.surfaces_path else None)
            except (ValueError, BadInputError) as error:
                raise table.error(f"{path}: {error}", "layers") from None

    return read_scene


def _file_of(folder: Path, name: str, table: TomlTable, key: str) -> Path:
    """A file that ``[scene]`` names."""
    if not name and key not in table:
        return folder
    try:
        path = folder / _within(name, "first.layers.h5")
    except ValueError as error:
        raise table.error(str(error), key) from None
    if not path.is_file():
        raise table.error(f'"{name}": no such file beside the model', key)
    return path


def scene_of_window(layers: LayersFile, window: int, table: SceneTable, surfaces: Path | None = None) -> SceneParts:
    """The camera and the scene of a window of an open layers file; without a surfaces file, layers are linked here.

    Raises
    ------
    ValueError, BadInputError
        If the layers have several targets, no noise, or no directions of pixels; if surfaces are of other layers.
    """
    made, one = layers.provenance, layers.read_window(window)
    if made.targets:
        raise BadInputError(f"{counted(made.targets, 'target')} a frame; a scene needs one sample a pixel and frame")
    frames = int(layers.window_stop[window] - layers.window_start[window])
    numbers: NDArray[np.integer]
    if surfaces is not None:
        numbers = _numbers_of(surfaces, layers, window)
    elif layers.shape[1:] == (1, 1):
        numbers = np.full(one.range.shape, NO_SURFACE, dtype=np.int32)
    else:
        numbers = link_layers(one, made.sensor)
    return measured_scene(one, made.sensor, numbers, frames=frames, table=table)


def _numbers_of(path: Path, layers: LayersFile, window: int) -> NDArray[np.integer]:
    """The surface (row, col, layer) of each layer, from the surfaces file of these layers, numbered within it."""
    with open_surfaces(path) as file:
        if file.shape[0] <= window or file.shape[1:] != layers.shape[1:]:
            raise BadInputError(f"{path} is of other layers: {file.shape} windows, rows and columns")
        if file.provenance.source_sha256 != file_sha256(layers.path):
            raise BadInputError(f"{path} is of other layers: {next_command('surfaces', layers.path)}")
        numbers = file.read_image("surface", window)
    if numbers.shape != (*layers.shape[1:], layers.max_layers):
        raise BadInputError(f"{path} is of other layers: {numbers.shape[-1]} layers a pixel")
    return np.asarray(numbers)
