"""Recordings from other programs' files: one file a kind of source, one line each here.

`open_source` recognises a source by its name, or by the content of a folder. Frames come one by one, so that a
recording of any length fits in memory; the module of a kind says if it cannot be read in parts.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from tofmix.errors import BadInputError, UsageError, os_error_text
from tofmix.io.importers import arrays, csv_source, folder, hdf5_source, matlab, rosbag, tiff
from tofmix.io.importers.base import FrameSource, SourceRequest, with_amplitude
from tofmix.io.importers.conversion import stream_of, stream_of_file
from tofmix.io.next_command import import_command
from tofmix.io.storage import check_input


@dataclass(frozen=True, slots=True, kw_only=True)
class Importer:
    """One kind of source.

    `names` are options of `SourceRequest` that it understands; where ``amplitude`` is not among them, the amplitudes
    are another source of the same kind.
    """

    suffixes: tuple[str, ...]
    open: Callable[[Path, SourceRequest], AbstractContextManager[FrameSource]]
    names: frozenset[str] = frozenset()


_OF_ARRAYS = frozenset({"topic", "amplitude", "axes", "shape", "time_unit_s"})

IMPORTERS: tuple[Importer, ...] = (
    Importer(suffixes=rosbag.SUFFIXES, open=rosbag.open_bag, names=frozenset({"topic", "amplitude", "camera_info"})),
    Importer(suffixes=(".tif", ".tiff"), open=tiff.open_pages, names=frozenset({"topic"})),
    Importer(suffixes=(".npy",), open=arrays.open_npy, names=frozenset({"axes", "shape"})),
    Importer(suffixes=(".npz",), open=arrays.open_npz, names=_OF_ARRAYS),
    Importer(suffixes=(".mat",), open=matlab.open_mat, names=_OF_ARRAYS),
    Importer(suffixes=(".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".nc"), open=hdf5_source.open_hdf5, names=_OF_ARRAYS),
    Importer(
        suffixes=csv_source.SUFFIXES, open=csv_source.open_csv, names=frozenset({"shape", "columns", "time_unit_s"})
    ),
)
_OPTIONS = {
    "topic": "dataset",
    "camera_info": "camera-info",
    "axes": "axes",
    "shape": "shape",
    "columns": "columns",
    "time_unit_s": "time-unit",
}
"""Options that some kinds of source alone understand, by their field of `SourceRequest`."""

_FOLDER = Importer(suffixes=(), open=folder.open_folder, names=frozenset({"topic"}))


def importer_for(path: Path) -> Importer:
    """Find the importer of a source."""
    try:
        is_folder = path.is_dir()
    except OSError as error:
        raise BadInputError(os_error_text(error, path)) from error
    if is_folder:
        return IMPORTERS[0] if rosbag.is_bag_folder(path) else _FOLDER
    check_input(path)
    if is_importable(path) and not path.stat().st_size:
        raise BadInputError(f"{path}: empty")
    for importer in IMPORTERS:
        if path.suffix.lower() in importer.suffixes:
            return importer
    if path.suffix.lower() in folder.IMAGE_KINDS:
        raise UsageError(f"{path} is one image; a recording needs a folder of images: {import_command(path.parent)}")
    known = ", ".join(suffix for importer in IMPORTERS for suffix in importer.suffixes)
    raise UsageError(f"{path}: not a known source; choose a folder of images, a ROS 2 bag, or a file of {known}")


def is_importable(path: Path) -> bool:
    """Whether a file is a source by its name."""
    return any(path.suffix.lower() in importer.suffixes for importer in IMPORTERS)


def takes_axes(path: Path) -> bool:
    """Whether a source is an array whose order of axes may be given."""
    return path.is_file() and "axes" in importer_for(path).names


@contextmanager
def open_source(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a source of frames."""
    importer = importer_for(path)
    for name, option in _OPTIONS.items():
        of_file = name == "topic" and request.topic in (path.name, path.stem)
        if getattr(request, name) and name not in importer.names and not of_file:
            raise UsageError(f"--{option} does not apply to {path}")
    if request.amplitude is None or "amplitude" in importer.names:
        with importer.open(path, request) as source:
            yield _checked(source, request, path)
        return
    other = Path(request.amplitude)
    alone = replace(request, amplitude=None)
    light = replace(alone, topic=None, valid_status=None, columns={}, as_amplitude=True)
    with importer.open(path, alone) as source, importer_for(other).open(other, light) as amplitude:
        yield with_amplitude(_checked(source, request, path), amplitude.check(other), other)


def _checked(source: FrameSource, request: SourceRequest, path: Path) -> FrameSource:
    """Return the source; refuse one whose name says that it holds no depths, and options that it has no use for."""
    source.check(path)
    if request.topic is None and source.stream is not None:
        _refuse_other_stream(source.stream, path)
    if request.valid_status is not None and not source.status_valid:
        raise UsageError(f"--valid-status does not apply to {path}: {source.kind}, without status codes")
    if request.time_unit_s is not None and not source.has_time:
        raise UsageError(f"--time-unit does not apply to {path}: {source.kind}, without times")
    return _of_shape(source, request, path)


def _refuse_other_stream(stream: str, path: Path) -> None:
    """Raise `BadInputError` if the name of a stream, or where it says nothing that of its file, is of no depths."""
    told = stream_of(stream)
    if told == "unknown":
        stream = path.resolve().name if path.is_dir() else path.stem
        told = stream_of_file(stream)
    if told == "other":
        raise BadInputError(
            f"{path}: {stream} holds no depths by its name, and no other frames were found; if it does hold them:"
            f" {import_command(path, '--dataset', stream)}"
        )


def _of_shape(source: FrameSource, request: SourceRequest, path: Path) -> FrameSource:
    """Return the source; raise `UsageError` if another shape than that of its images is requested."""
    rows, cols = source.shape[1:]
    if request.shape is not None and request.shape != (rows, cols):
        asked = "{}x{}".format(*request.shape)
        remedy = "leave the option out"
        if (
            request.axes is None
            and rows * cols != request.shape[0] * request.shape[1]
            and "axes" in importer_for(path).names
        ):
            remedy += ", or name the axes, such as --axes frame,zone,target"
        raise UsageError(f"--shape {asked}: {path} has images of {rows} x {cols} already; {remedy}")
    return source
