"""3-D maps: occupied voxels as points (PLY), or the whole grid as plain arrays (NPZ)."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from tofmix.errors import UsageError
from tofmix.mapping.occupancy import FREE_THRESH, OCCUPIED_THRESH, State, VoxelMap

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
