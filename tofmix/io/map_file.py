"""Maps in files: 2-D ones for ROS, 3-D ones as points or arrays.

2-D maps for ROS's map_server are an image (PGM) and a text of the same name (YAML). See http://wiki.ros.org/map_server,
"Map format". Unknown cells are 205; with free_thresh 0.196 that is (255 - 205) / 255 = 0.19608, just not free.

3-D maps are the occupied voxels as points (PLY), or the whole grid as plain arrays (NPZ).
"""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from tofmix.errors import UsageError
from tofmix.mapping.occupancy import FREE_THRESH, OCCUPIED_THRESH, FloorMap, State, VoxelMap

_MISSING_EXTRA = "PLY needs plyfile: pip install 'tofmix[export]', or write .npz"


def check_voxel_path(path: Path) -> None:
    """Refuse a name of no known format, and PLY without its library."""
    if path.suffix not in (".ply", ".npz"):
        raise UsageError(f"{path}: voxels are written as .ply or .npz")
    if path.suffix == ".ply":
        _plyfile()


def encode_voxels(voxels: VoxelMap, path: Path, *, comment: str) -> bytes:
    """Encode a 3-D map in the format of the extension; the same map gives the same bytes.

    PLY: a vertex for each occupied voxel, its centre x, y, z in metres (float32), and its `probability` and
    `log_odds` of being occupied; little-endian binary, with a line of comment. NPZ: `log_odds` (x, y, z) float32, 0
    where nothing is known; `origin_mm` (3,), the corner of least x, y and z;
    `cell_mm`; `occupied_thresh` and `free_thresh`, probabilities.
    """
    check_voxel_path(path)
    return _npz(voxels) if path.suffix == ".npz" else _ply(voxels, comment)


def _npz(voxels: VoxelMap) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        log_odds=voxels.log_odds,
        origin_mm=voxels.grid.origin_mm,
        cell_mm=np.float64(voxels.grid.cell_mm),
        occupied_thresh=np.float64(OCCUPIED_THRESH),
        free_thresh=np.float64(FREE_THRESH),
    )
    return buffer.getvalue()


def _ply(voxels: VoxelMap, comment: str) -> bytes:
    plyfile = _plyfile()
    cells = np.nonzero(voxels.states() == int(State.OCCUPIED))
    names = ("x", "y", "z", "probability", "log_odds")
    vertices = np.empty(len(cells[0]), dtype=[(name, "<f4") for name in names])
    for axis, name in enumerate(names[:3]):
        vertices[name] = voxels.grid.centres_mm(axis)[cells[axis]] / 1000.0
    vertices["probability"], vertices["log_odds"] = voxels.probability()[cells], voxels.log_odds[cells]
    # The header of a PLY file is ASCII.
    line = " ".join(comment.split()).encode("ascii", "backslashreplace").decode("ascii")
    comments = [line, f"occupied voxels of {voxels.grid.cell_mm / 1000.0:g} m"]
    element = plyfile.PlyElement.describe(vertices, "vertex")
    buffer = io.BytesIO()
    plyfile.PlyData([element], byte_order="<", comments=comments).write(buffer)
    return buffer.getvalue()


def _plyfile() -> Any:  # noqa: ANN401  the library ships no types
    try:
        import plyfile
    except ImportError as error:
        raise UsageError(_MISSING_EXTRA) from error
    return plyfile


PIXEL: dict[State, int] = {State.OCCUPIED: 0, State.UNKNOWN: 205, State.FREE: 254}
"""Grey value of each state, as map_saver writes them."""


def map_paths(path: Path) -> tuple[Path, Path]:
    """Paths of the image and of the text of a map."""
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{path}: the name of a map must end in .yaml; its image gets the same name with .pgm")
    return path.with_suffix(".pgm"), path


def encode_map(map_: FloorMap, path: Path, *, comment: str) -> dict[Path, bytes]:
    """Encode a map for `atomic_group.write_atomic_group`: first the image, then the text that names it, .yaml or .yml.

    `comment` is one line about where the map is from.
    """
    image, text = map_paths(path)
    return {
        image: _pgm(map_),
        text: _yaml(map_, image.name, comment).encode(errors="surrogateescape"),
    }  # the image's own name


def _pgm(map_: FloorMap) -> bytes:
    """Return the image: its columns run along x, its first row is that of the greatest y."""
    grey = np.zeros(len(State), dtype=np.uint8)
    for state, value in PIXEL.items():
        grey[state] = value
    width, height = map_.cells.shape
    # Not by grey[cells]: NumPy 2.4 dies of signal 11 where it has no memory for the buffer that it casts cells in.
    return f"P5\n{width} {height}\n255\n".encode() + grey.take(map_.cells).T[::-1].tobytes()


def _yaml(map_: FloorMap, image: str, comment: str) -> str:
    x, y = (round(value / 1000.0, 9) for value in map_.origin_mm)
    lines = (
        f"# {' '.join(comment.split())}",
        f"image: {json.dumps(image)}",
        "mode: trinary",
        f"resolution: {round(map_.cell_mm / 1000.0, 9)!r}",
        f"origin: [{x!r}, {y!r}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESH!r}",
        f"free_thresh: {FREE_THRESH!r}",
    )
    return "".join(f"{line}\n" for line in lines)
