"""Layers in the formats of other programs: one file a format, one line each here.

Point formats write every field of `tofmix.points.POINT_FIELDS`; image formats write
the ranges of one layer. All go through `tofmix.io.storage.AtomicFile`.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tofmix.errors import UsageError
from tofmix.io.exporters import csv_points, las, pcd, ply, png, tiff
from tofmix.io.exporters.image import RangeImage
from tofmix.io.storage import AtomicFile
from tofmix.points import LayerPoints

PointWriter = Callable[[AtomicFile, LayerPoints, str, Callable[[], None]], int]
"""Writes points and a title, calls back after each window, and returns how many points."""

ImageWriter = Callable[[AtomicFile, RangeImage], None]

POINT_WRITERS: dict[str, PointWriter] = {
    ".las": las.write_las,
    ".laz": las.write_laz,
    ".ply": ply.write,
    ".pcd": pcd.write,
    ".csv": csv_points.write,
}
IMAGE_WRITERS: dict[str, ImageWriter] = {".png": png.write, ".tif": tiff.write, ".tiff": tiff.write}


def check_suffix(path: Path) -> None:
    """Refuse an output whose name says no known format.

    Raises
    ------
    UsageError
        With the names that are known.
    """
    known = (*POINT_WRITERS, *IMAGE_WRITERS)
    if path.suffix.lower() not in known:
        raise UsageError(f"{path}: the name must end in one of {', '.join(known)}")


def export_points(
    path: Path,
    points: LayerPoints,
    *,
    title: str,
    progress: Callable[[int], object] | None = None,
    overwrite: bool = False,
    inputs: tuple[Path, ...] = (),
) -> int:
    """Write points in the format that the name's end says; return how many.

    Parameters
    ----------
    path : Path
        The new file, ending in a key of `POINT_WRITERS`.
    points : LayerPoints
        What to write; it is read twice where a header holds the count.
    title : str
        Where they are from; what is not ASCII becomes a question mark.
    progress : callable, optional
        Called with 1 after each window.
    overwrite, inputs
        As for `AtomicFile`.

    Raises
    ------
    UsageError
        As for `AtomicFile`, or if the format needs a library that is not installed.
    BadInputError
        If the format cannot hold the points.
    StorageError
        If the disk is full or fails.
    """
    with AtomicFile(path, overwrite=overwrite, inputs=inputs) as file:

        def written() -> None:
            file.check()
            if progress is not None:
                progress(1)

        count = POINT_WRITERS[path.suffix.lower()](file, points, _one_line(title), written)
        file.commit()
    return count


def export_image(path: Path, image: RangeImage, *, overwrite: bool = False, inputs: tuple[Path, ...] = ()) -> None:
    """Write one layer's ranges as a 16-bit image in the format that the name's end says.

    Raises
    ------
    UsageError, BadInputError, StorageError
        As for `export_points`.
    """
    with AtomicFile(path, overwrite=overwrite, inputs=inputs) as file:
        IMAGE_WRITERS[path.suffix.lower()](file, replace(image, title=_one_line(image.title)))
        file.commit()


def _one_line(title: str) -> str:
    """ASCII on one line: a file's name stands in headers of text, and must not end them."""
    return "".join(c if c.isprintable() else "?" for c in title).encode("ascii", "replace").decode()
