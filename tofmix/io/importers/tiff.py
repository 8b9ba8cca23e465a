"""TIFF by tifffile: a stack of pages, one a frame, read page by page.

The text of a range image: what `tofmix export`, ImageJ and writers of OME-XML state there of its counts.

The form of our own is that of `tofmix.io.exporters.image.RangeImage.description`.

References
----------
ImageJ's ``FileInfo``: ``cf=0`` is a straight line, whose value is ``c0 + c1 * count`` in ``vunit``. OME's data model
has no unit of the counts: a channel's name may end in it, or an annotation have the key ``unit``.
"""

import json
import math
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, UsageError
from tofmix.io.importers.base import (
    IMAGE_DIMENSIONS,
    DepthAxis,
    Frame,
    FrameSource,
    SourceRequest,
    check_frame,
    check_numbers,
    check_size,
    complaints_are_errors,
    foreign,
    unused,
)
from tofmix.io.importers.conversion import depths_among, stream_of
from tofmix.io.next_command import import_command, need
from tofmix.io.recording.range_check import unit_in_name, unit_mm_of

_COUNT = re.compile(r"1 count = ([0-9.eE+-]+) (mm|cm|m)\b")
_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_STRAIGHT_LINE = "0"  # ImageJ's number of this function


class Stated(NamedTuple):
    """Fields of a `FrameSource` that a text states; no unit where it does not say."""

    unit_mm: float | None
    depth_axis: DepthAxis
    scale_factor: float = 1.0
    add_offset: float = 0.0

    def words(self) -> str:
        """A count in words."""
        if self.unit_mm is None and (self.scale_factor, self.add_offset) == (1.0, 0.0):
            return f"no unit, along {self.depth_axis}"
        offset = f" + {self.add_offset:g}" if self.add_offset else ""
        unit = "units" if self.unit_mm is None else f"x {self.unit_mm:g} mm"
        return f"{self.scale_factor:g}{offset} {unit}, along {self.depth_axis}"


def stated_in(text: str | None, channel: str = "") -> Stated:
    """Read the text of an image, and the name of its channel."""
    text = text or ""
    found = _COUNT.search(text)
    try:
        unit_mm = None if found is None else float(found[1]) * _UNITS_MM[found[2]]
    except ValueError:
        unit_mm = None
    if unit_mm is not None:
        return Stated(unit_mm, "ray" if "radial range" in text else "z")
    if text.startswith("ImageJ="):
        return _of_imagej(imagej_keys(text))
    root = ome_root(text)
    if root is not None:
        return Stated(unit_in_name(channel) or _annotated_unit_mm(root), "z")
    return Stated(None, "z")


def check_stated(stated: Stated, first: Stated, what: object, of_first: object, *, unit_given: bool) -> None:
    """Refuse an image whose text states other numbers than that of the first one.

    A given unit takes the place of the stated ones.
    """
    if unit_given:
        stated, first = stated._replace(unit_mm=None), first._replace(unit_mm=None)
    if stated != first:
        raise BadInputError(
            f"{what}: its text states {stated.words()}, that of {of_first} {first.words()}; import images of one scale"
            " at a time"
        )


def imagej_keys(text: str) -> dict[str, str]:
    """Keys of ImageJ's text, one a line."""
    return {key.strip(): value.strip() for key, _, value in (line.partition("=") for line in text.splitlines())}


def _of_imagej(keys: dict[str, str]) -> Stated:
    unit_mm = unit_mm_of(keys.get("vunit", ""))
    try:
        factor, offset = float(keys.get("c1", "1")), float(keys.get("c0", "0"))
    except ValueError:
        return Stated(unit_mm, "z")
    usable = keys.get("cf") == _STRAIGHT_LINE and math.isfinite(factor) and factor > 0 and math.isfinite(offset)
    return Stated(unit_mm, "z", factor, offset) if usable and unit_mm is not None else Stated(unit_mm, "z")


def ome_root(text: str) -> ET.Element | None:
    """OME-XML of an image's text; None where it has none."""
    if "<OME" not in text:
        return None
    try:
        return ET.fromstring(text)  # noqa: S314  tifffile read it; entities of its own are refused by expat
    except ET.ParseError:
        return None


def tag(item: ET.Element) -> str:
    """Name of an element, without its namespace."""
    return item.tag.rpartition("}")[2]


def _annotated_unit_mm(root: ET.Element) -> float | None:
    for item in root.iter():
        if tag(item) == "M" and (item.get("K") or "").strip().lower() in ("unit", "units"):
            return unit_mm_of(item.text or "")
    return None


_LOGGER = "tifffile"


@contextmanager
def open_pages(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a TIFF of one page a frame."""
    with _opened(path) as pages:
        first = _page(pages, 0, path)
        check_numbers(first.dtype, path)
        with complaints_are_errors(_LOGGER, path), foreign(path):
            count = len(pages)
        with complaints_are_errors(_LOGGER, path), foreign(path):
            text = str(pages[0].description or "")
        channels = _channels(text)
        channel, notes = _depth_channel(channels, count, path, request)
        chosen = [page for page in range(count) if page // channels.stride % len(channels.names) == channel]
        stated = stated_in(text, channels.names[channel])
        yield FrameSource(
            kind="multi-page TIFF",
            shape=(len(chosen), first.shape[0], first.shape[1]),
            dtype=first.dtype,
            **stated._asdict(),
            frames=_frames(pages, chosen, first, stated, path, request),
            stream=channels.names[channel],
            notes=notes,
        )


class _Channels(NamedTuple):
    """Names of the channels, and the number of pages from one of them to the next."""

    names: list[str]
    stride: int


def _channels(text: str) -> _Channels:
    """Channels of an OME-TIFF, of tifffile's own or of ImageJ's; one without a name where the text has none."""
    one = _Channels([""], 1)
    if text.startswith("{"):
        return _of_tifffile(text)
    if text.startswith("ImageJ="):
        count = imagej_keys(text).get("channels", "1")
        return _Channels([""] * int(count), 1) if count.isdecimal() and int(count) > 1 else one
    root = ome_root(text)
    pixels = None if root is None else next((item for item in root.iter() if tag(item) == "Pixels"), None)
    if pixels is None:
        return one
    sizes = {axis: int(size) if (size := pixels.get(f"Size{axis}", "1")).isdecimal() else 1 for axis in "ZCT"}
    order = pixels.get("DimensionOrder", "XYCZT")[2:]  # the fastest axis first
    names = [item.get("Name", "") for item in pixels if tag(item) == "Channel"]
    before = order[: order.find("C")] if "C" in order else ""
    names = [*names, *[""] * max(0, sizes["C"] - len(names))][: max(1, sizes["C"])]
    return _Channels(names, max(1, math.prod(sizes.get(axis, 1) for axis in before)))


def _of_tifffile(text: str) -> _Channels:
    """Channels of the JSON that tifffile writes: the axis ``C``, or else all axes of pages but the first."""
    one = _Channels([""], 1)
    try:
        keys = json.loads(text)
        shape = [int(size) for size in keys["shape"]]
        axes = str(keys.get("axes", ""))
        named = keys.get("Channel", {}).get("Name", [])
    except (ValueError, TypeError, KeyError, AttributeError):
        return one
    if len(axes) != len(shape):
        axes = "Q" * len(shape)
    pages = [(axis, size) for axis, size in zip(axes, shape, strict=True) if axis not in "YXS"]
    pages = pages if set("YX") <= set(axes) else pages[:-IMAGE_DIMENSIONS]
    pages = [(axis, size) for axis, size in pages if size > 1]
    place = next((k for k, (axis, _) in enumerate(pages) if axis == "C"), None)
    if place is None:
        return _Channels([""] * math.prod(size for _, size in pages[1:]), 1)
    names = [str(name) for name in named] if isinstance(named, list) else []
    count = pages[place][1]
    return _Channels([*names, *[""] * count][:count], math.prod(size for _, size in pages[place + 1 :]))


def _depth_channel(channels: _Channels, count: int, path: Path, request: SourceRequest) -> tuple[int, tuple[str, ...]]:
    """Number of the channel of the depths, and a note on other channels."""
    shown = [name or f"channel {k}" for k, name in enumerate(channels.names)]
    if len(shown) > 1 and count % (len(shown) * channels.stride):
        raise BadInputError(f"{path}: {count} pages, not a multiple of its {len(shown)} channels")
    if request.topic in shown:
        chosen = [shown.index(request.topic)]
    elif request.topic is not None and (len(shown) > 1 or request.topic not in (path.name, path.stem)):
        raise UsageError(f"--dataset does not apply to {path} unless it names a channel there: {', '.join(shown)}")
    elif len(shown) == 1:
        chosen = [0]
    elif request.as_amplitude:
        chosen = [k for k, name in enumerate(shown) if stream_of(name) == "other"]
    else:
        chosen = [channels.names.index(name) for name in depths_among([name for name in channels.names if name])]
    if len(chosen) != 1:
        raise BadInputError(
            f"{path}: {len(shown)} channels ({', '.join(shown)}), not one sequence of depths; choose one:"
            f" {import_command(path, '--dataset', shown[chosen[0] if chosen else 0])}"
        )
    left = [name for k, name in enumerate(shown) if k != chosen[0]]
    return chosen[0], (unused(path, "channels", left),) if left else ()


def single_text(path: Path) -> str | None:
    """The ``ImageDescription`` of a TIFF."""
    with _opened(path) as pages, complaints_are_errors(_LOGGER, path), foreign(path):
        return str(pages[0].description or "")


def read_single(path: Path) -> NDArray[Any]:
    """Read a TIFF of one page, (row, col)."""
    with _opened(path) as pages:
        with complaints_are_errors(_LOGGER, path), foreign(path):
            count = len(pages)
        if count != 1:
            raise BadInputError(f"{path}: {count} pages, expected one in a folder of frames")
        return _page(pages, 0, path)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    tifffile = need("tifffile", extra="images", what="TIFF")
    with ExitStack() as stack:
        with complaints_are_errors(_LOGGER, path), foreign(path):
            file = stack.enter_context(tifffile.TiffFile(path))
        yield file.pages


def _page(pages: Any, number: int, path: Path) -> NDArray[Any]:  # noqa: ANN401  tifffile's own
    what = f"{path}: page {number}"
    with complaints_are_errors(_LOGGER, what), foreign(what):
        declared = pages[number]
        shape = tuple(int(length) for length in declared.shape)
    check_size(shape or (0,), what)
    with complaints_are_errors(_LOGGER, what), foreign(what):
        page = np.asarray(declared.asarray())
    if page.ndim != IMAGE_DIMENSIONS:
        raise BadInputError(f"{what}: expected grey (row, col), got shape {page.shape}")
    return page


def _frames(
    pages: Any,  # noqa: ANN401  tifffile's own
    numbers: list[int],
    first: NDArray[Any],
    stated: Stated,
    path: Path,
    request: SourceRequest,
) -> Iterator[Frame]:
    for number in numbers:
        what = f"{path}: page {number}"
        image = check_frame(_page(pages, number, path), first.shape, first.dtype, what)
        with complaints_are_errors(_LOGGER, what), foreign(what):
            text = str(pages[number].description or "") if number != numbers[0] else ""
        own = stated_in(text)
        if own != stated_in(""):  # a format's text of all pages stands in the first one alone
            check_stated(own, stated, what, f"page {numbers[0]}", unit_given=request.unit_mm is not None)
        yield Frame(depth=image)
