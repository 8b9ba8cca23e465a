"""Layers and surfaces in the formats of other programs: one writer a format, one line each here.

Point formats write every field of their points; image formats write ranges in 16 bits. Edges and planes are of surfaces
files. All go through `tofmix.io.storage.AtomicFile`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tofmix.errors import UsageError
from tofmix.io.exporters import clouds, edge_lines, image, outlines
from tofmix.io.exporters.edge_lines import EdgeLine
from tofmix.io.exporters.image import RangeImage
from tofmix.io.exporters.outlines import Outline
from tofmix.io.storage import AtomicFile
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.points import PointSource

PointWriter = Callable[[AtomicFile, PointSource, str, Callable[[], None]], int]
"""Writes points and a title, calls back after each block, and returns how many points."""

ImageWriter = Callable[[AtomicFile, RangeImage], None]

EdgeWriter = Callable[[AtomicFile, Sequence[EdgeLine], str], None]

PlaneWriter = Callable[[AtomicFile, SurfacesFile, Sequence[Outline], str], None]

POINT_WRITERS: dict[str, PointWriter] = {
    ".las": clouds.write_las,
    ".laz": clouds.write_laz,
    ".ply": clouds.write_ply,
    ".pcd": clouds.write_pcd,
    ".csv": clouds.write_csv,
}
IMAGE_WRITERS: dict[str, ImageWriter] = {".png": image.write_png, ".tif": image.write_tiff, ".tiff": image.write_tiff}
EDGE_WRITERS: dict[str, EdgeWriter] = {
    ".geojson": edge_lines.write_geojson,
    ".json": edge_lines.write_geojson,
    ".obj": edge_lines.write_obj,
    ".ply": edge_lines.write_ply,
}
PLANE_WRITERS: dict[str, PlaneWriter] = {".json": outlines.write_json, ".obj": outlines.write_obj}

POINTS, IMAGE, EDGES, PLANES = "points", "image", "edges", "planes"

OF_LAYERS: dict[str, tuple[str, ...]] = {POINTS: tuple(POINT_WRITERS), IMAGE: tuple(IMAGE_WRITERS)}
"""Contents of a layers file, and the extensions of their formats."""

OF_SURFACES: dict[str, tuple[str, ...]] = {
    EDGES: tuple(EDGE_WRITERS),
    PLANES: tuple(PLANE_WRITERS),
    IMAGE: tuple(IMAGE_WRITERS),
    POINTS: (".ply", ".pcd", ".csv"),
}
"""Contents of a surfaces file, and the extensions of their formats; the first with an extension is its default."""


def choose_what(path: Path, what: str | None, known: dict[str, tuple[str, ...]]) -> str:
    """Return the content to write to a file: `what`, or that of the extension.

    `known` are `OF_LAYERS` or `OF_SURFACES`, which have the contents as keys.
    """
    suffix = path.suffix.lower()
    fitting = [one for one, suffixes in known.items() if suffix in suffixes]
    if not fitting:
        ends = dict.fromkeys(end for of_one in known.values() for end in of_one)
        more = ""
        if known is OF_LAYERS and any(suffix in of_one for of_one in OF_SURFACES.values()):
            more = f"; {suffix} is a format of edges and planes; tofmix surfaces finds them"
        raise UsageError(f"{path}: the name must end in one of {', '.join(ends)}{more}")
    if what is not None and what not in known:
        raise UsageError(f"--what {what} needs a surfaces file, written by tofmix surfaces; this is a layers file")
    if what is not None and what not in fitting:
        raise UsageError(f"--what {what} cannot be written as {suffix}; its formats: {', '.join(known[what])}")
    return what or fitting[0]


def export_points(
    path: Path,
    points: PointSource,
    *,
    title: str,
    progress: Callable[[int], object] | None = None,
    overwrite: bool = False,
    inputs: tuple[Path, ...] = (),
) -> int:
    """Write points in the format of the extension, a key of `POINT_WRITERS`; return their number.

    The points are read twice if a header holds their number; characters of the title other than ASCII become question
    marks. `progress` is called with 1 after each block; `overwrite` and `inputs` are those of `AtomicFile`.
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
    """Write ranges as a 16-bit image in the format of the extension.

    Raises
    ------
    BadInputError
        If a range does not fit into 16 bits; the text names no file.
    """
    with AtomicFile(path, overwrite=overwrite, inputs=inputs) as file:
        IMAGE_WRITERS[path.suffix.lower()](file, replace(image, title=_one_line(image.title)))
        file.commit()


def export_edges(
    path: Path, lines: Sequence[EdgeLine], *, title: str, overwrite: bool = False, inputs: tuple[Path, ...] = ()
) -> None:
    """Write edges in the format of the extension, a key of `EDGE_WRITERS`."""
    with AtomicFile(path, overwrite=overwrite, inputs=inputs) as file:
        EDGE_WRITERS[path.suffix.lower()](file, lines, _one_line(title))
        file.commit()


def export_planes(
    path: Path, source: SurfacesFile, outlines: Sequence[Outline], *, title: str, overwrite: bool = False
) -> None:
    """Write surfaces as planes with outlines in the format of the extension, a key of `PLANE_WRITERS`."""
    with AtomicFile(path, overwrite=overwrite, inputs=(source.path,)) as file:
        PLANE_WRITERS[path.suffix.lower()](file, source, outlines, _one_line(title))
        file.commit()


def _one_line(title: str) -> str:
    """ASCII on one line: a text header contains the name of a file, which must not end the header."""
    return "".join(c if c.isprintable() else "?" for c in title).encode("ascii", "replace").decode()
