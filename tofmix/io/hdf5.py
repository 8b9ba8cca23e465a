"""Common parts of all HDF5 files of tofmix: named dimensions, attributes, formats. `sensor_group` has the camera.

Files written here follow HDF5 dimension scales and CF-1.11, so that xarray and
netCDF-4 open them with named dimensions, and NeXus, so that its viewers find a
default signal. Every chunk has a checksum: without one, a flipped bit is read
back as a wrong number in silence.

Which of the tofmix formats an HDF5 file is, for commands that take any of them.

Files of results, layers or surfaces, open for reading: their datasets are held against `tofmix.io.schema`.
"""

import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Self, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.guard import guard
from tofmix.io.guard.hdf5_memory import reserve_memory
from tofmix.io.next_command import next_command
from tofmix.io.schema import LAYERS, RECORDING, SURFACES, Field
from tofmix.io.storage import AtomicFile, Sink
from tofmix.options import MAX_LAYERS_LIMIT
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE
from tofmix.wording import readable

FORMAT_VERSION = "1.0"
CONVENTIONS = "CF-1.11"

# Readable by h5dump of Debian 12 and by netCDF-C; "latest" is not.
_LIBVER = (h5py.h5f.LIBVER_V18, h5py.h5f.LIBVER_V110)


_COMMANDS = {
    RECORDING: ("recording", "estimate"),
    LAYERS: ("layers file", "report"),
    SURFACES: ("surfaces file", "export"),
}
"""Kind of file of each format, and the command that reads it."""


class FileWriter(ABC):
    """Writes a file of a tofmix format in parts; the file gets its name when the block ends without an exception.

    Parameters
    ----------
    path : Path
        The new file.
    title, history : str
        Root attributes.
    overwrite, inputs, temporary
        As for `AtomicFile`, also for its errors.
    """

    kind: ClassVar[str]

    def __init__(
        self,
        path: Path,
        *,
        title: str,
        history: str,
        overwrite: bool,
        inputs: tuple[Path, ...],
        temporary: Path | None = None,
    ) -> None:
        self._texts = {"title": title, "history": history}
        self._file = AtomicFile(path, overwrite=overwrite, inputs=inputs, temporary=temporary)

    def __enter__(self) -> Self:
        with ExitStack() as stack:  # undone if anything below fails
            stack.enter_context(self._file)
            self._root = stack.enter_context(create(self._file, kind=self.kind, **self._texts))
            self._begin(self._root)
            self._stack = stack.pop_all()
        return self

    @abstractmethod
    def _begin(self, root: h5py.File) -> None:
        """Make what is known before the first part."""

    def _end(self) -> None:  # noqa: B027  most have nothing to do
        """Write what is known after the last part."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            self._end()


@contextmanager
def create(file: AtomicFile, *, kind: str, title: str, history: str) -> Iterator[h5py.File]:
    """Open a new HDF5 file of a tofmix format over `file`, with its root attributes.

    `file` is committed when the block ends without an exception.
    """
    with _new_file(file.sink) as root:
        root.attrs["format"] = kind
        root.attrs["format_version"] = FORMAT_VERSION
        root.attrs["Conventions"] = CONVENTIONS
        root.attrs["title"] = readable(title)
        root.attrs["history"] = readable(history)
        yield root
    file.commit()


def image_of(write: Callable[[h5py.File], None]) -> bytes:
    """Return the bytes of a small HDF5 file that `write` fills, made in memory."""
    memory = io.BytesIO()
    with _new_file(memory) as root:
        write(root)
    return memory.getvalue()


def _new_file(sink: Sink | io.BytesIO) -> h5py.File:
    """Open a new file in which no object keeps the time of its making: the same content gives the same bytes.

    HDF5 before 2.0 stores it in groups by default, the root among them, and only a property of the file prevents this;
    h5py has it in its low-level interface.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fileobj_driver(h5py.h5fd.fileobj_driver, sink)
    access.set_libver_bounds(*_LIBVER)
    creation = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    creation.set_obj_track_times(False)
    reserve_memory()
    return h5py.File(h5py.h5f.create(b"tofmix", h5py.h5f.ACC_TRUNC, creation, access))


def add_group(parent: h5py.Group, name: str) -> h5py.Group:
    """Add a group that does not keep the time of its making."""
    creation = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    creation.set_obj_track_times(False)
    return h5py.Group(h5py.h5g.create(parent.id, name.encode(), gcpl=creation))


def add_scale(group: h5py.Group, name: str, length: int) -> None:
    """Add a dimension scale `name` that counts from 0; its length may be 0."""
    scale = group.create_dataset(
        name, data=np.arange(length, dtype=np.uint32), chunks=(max(1, length),), fletcher32=True, **_growable((length,))
    )
    scale.attrs["units"] = "1"
    scale.attrs["long_name"] = f"{name} index"
    scale.make_scale(name)


def _growable(shape: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    """Setting of a dataset without a value: h5py refuses a chunk that is longer than the dataset could ever be."""
    return {"maxshape": tuple(max(1, n) for n in shape)} if 0 in shape else {}


PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


def add_field(
    group: h5py.Group,
    spec: Field,
    lengths: Mapping[str, int] | None = None,
    *,
    chunks: tuple[int, ...] | None = None,
    data: NDArray[np.generic] | None = None,
) -> h5py.Dataset:
    """Add the dataset that `spec` declares, attached to the dimension scales of `group` or of the root.

    Its shape is that of `data`, or given by the lengths of its dimensions; without `chunks` it is stored as one.
    """
    shape = tuple(lengths[dim] for dim in spec.dims) if lengths is not None else np.asarray(data).shape
    dataset = group.create_dataset(
        spec.name,
        shape=shape,
        dtype=spec.dtype,
        data=data,
        chunks=chunks or tuple(max(1, n) for n in shape),
        fillvalue=spec.fill,
        **_growable(shape),
        **PACKED,
    )
    dataset.attrs["units"] = spec.units
    dataset.attrs["long_name"] = spec.long_name
    if spec.fill is not None:
        dataset.attrs["_FillValue"] = np.array([spec.fill], dtype=spec.dtype)
    for axis, dim in enumerate(spec.dims):
        dataset.dims[axis].attach_scale(group[dim] if dim in group else group.file[dim])
    return dataset


def add_nexus_view(root: h5py.File, *, name: str, signal: str, axes: tuple[str, ...]) -> None:
    """Add /entry/NAME, soft links to the signal that NeXus viewers show."""
    root.attrs["NX_class"] = "NXroot"
    root.attrs["default"] = "entry"
    entry = add_group(root, "entry")
    entry.attrs["NX_class"] = "NXentry"
    entry.attrs["default"] = name
    view = add_group(entry, name)
    view.attrs["NX_class"] = "NXdata"
    view.attrs["signal"] = signal
    view.attrs["axes"] = list(axes)
    for link in (signal, *axes):
        view[link] = h5py.SoftLink(f"/{link}")


def text_attribute(item: h5py.Group | h5py.Dataset, key: str) -> str | None:
    """Return a text attribute of fixed or variable length; None if it is missing."""
    value = item.attrs.get(key)
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else None


def check_format(root: h5py.File, path: Path, *, kind: str, required: bool) -> None:
    """Refuse a file of another tofmix format, or of a later version of it."""
    found = text_attribute(root, "format")
    if found is None and not required:
        return
    if found != kind and found in _COMMANDS:
        what, command = _COMMANDS[found]
        remedy = next_command("surfaces" if (found, kind) == (LAYERS, SURFACES) else command, path)
        raise BadInputError(f"{path} is a {what}, not a {_COMMANDS[kind][0]}: {remedy}")
    if found is None and "range" in root and "n_modes" not in root:
        raise BadInputError(f"{path}: not a layers file; if it is a recording: {next_command('estimate', path)}")
    if found != kind:
        raise BadInputError(f"{path}: expected a {kind} file, its format attribute is {found!r}")
    version = text_attribute(root, "format_version") or ""
    if version.split(".")[0] != FORMAT_VERSION.split(".", maxsplit=1)[0]:
        raise BadInputError(f"{path}: format_version {version!r}; this version reads {FORMAT_VERSION}")


def fill_value(dataset: h5py.Dataset) -> NDArray[np.generic] | None:
    """Return `_FillValue` as an array of length 1; None if it is missing.

    Raises
    ------
    BadInputError
        If it is not a number; the text does not name the file.
    """
    value = dataset.attrs.get("_FillValue")
    if value is None:
        return None
    fill = np.asarray(value).reshape(-1)[:1]
    if fill.size == 0 or fill.dtype.kind not in "iuf":
        raise BadInputError(f"{dataset.name.lstrip('/')}: _FillValue: expected a number, got {value!r}")
    return fill


def format_of(path: Path) -> str | None:
    """Root attribute ``format`` of an HDF5 file; None where it has none, as a recording from elsewhere may."""
    with guard.open_for_reading(path) as root, guard.reading(path, "format"):
        return text_attribute(root, "format")


def is_foreign_hdf5(path: Path) -> bool:
    """Whether an HDF5 file is neither of a tofmix format nor has a dataset ``range``, as a recording does."""
    with guard.open_for_reading(path) as root, guard.reading(path, "format"):
        return text_attribute(root, "format") is None and "range" not in root


T = TypeVar("T")


@contextmanager
def open_result(path: Path, *, kind: str, make: Callable[[h5py.File, Path], T]) -> Iterator[T]:
    """Open a file of a format, and return the result of `make` for its header."""
    with guard.open_for_reading(path) as root:
        yield read_header(root, path, kind=kind, make=make)


def read_header(
    root: h5py.File, path: Path, *, kind: str, make: Callable[[h5py.File, Path], T], required: bool = True
) -> T:
    """The result of `make` for the header of an open file, whose format is checked first."""
    with guard.reading(path, "header"):
        check_format(root, path, kind=kind, required=required)
        return make(root, path)


class ResultFile:
    """An open file of results, which must have the datasets of `fields`.

    `main` is the dataset (window, row, col, layer) of which the others have the lengths.
    """

    def __init__(self, root: h5py.File, path: Path, fields: Iterable[Field], main: str) -> None:
        self.path = path
        self._fields = {spec.name: spec for spec in fields}
        self._datasets = {name: _typed(root, spec, path) for name, spec in self._fields.items()}
        shape = self._datasets[main].shape
        self.shape: tuple[int, int, int] = shape[:3]
        self.max_layers = int(shape[3])
        if max(shape[1:3]) > MOST_PIXELS_A_SIDE or shape[0] > MOST_FRAMES or shape[3] > MAX_LAYERS_LIMIT:
            raise BadInputError(
                f"{path}: {main}: shape {shape}; no more than {MOST_FRAMES} windows of {MOST_PIXELS_A_SIDE} pixels"
                f" a side and {MAX_LAYERS_LIMIT} layers"
            )
        if 0 in shape:
            raise BadInputError(f"{path}: {main}: shape {shape} holds no layer")

    def _check_lengths(self, more: Mapping[str, int]) -> None:
        """Refuse a dataset that has not the lengths of its dimensions."""
        windows, rows, cols = self.shape
        lengths = {"window": windows, "row": rows, "col": cols, "layer": self.max_layers, **more}
        for name, spec in self._fields.items():
            shape, expected = self._datasets[name].shape, tuple(lengths[dim] for dim in spec.dims)
            if shape != expected:
                raise BadInputError(f"{self.path}: {name}: shape {shape}, expected {spec.dims} = {expected}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the datasets, in their order."""
        return tuple(self._datasets)

    def read_dataset(self, name: str, *part: slice | int) -> NDArray[Any]:
        """Read one dataset, or a part along its first dimensions, without a look at its values."""
        with guard.reading(self.path, name):
            return np.asarray(self._datasets[name][part])


def _typed(root: h5py.File, spec: Field, path: Path) -> h5py.Dataset:
    """A dataset of its type and of as many dimensions as it has names of them."""
    dataset = guard.checked_dataset(root, spec.name, path)
    if dataset.ndim != len(spec.dims) or dataset.dtype != np.dtype(spec.dtype):
        got = f"{dataset.dtype} of shape {dataset.shape}"
        raise BadInputError(f"{path}: {spec.name}: expected {spec.dtype} {spec.dims}, got {got}")
    return dataset
