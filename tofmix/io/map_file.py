"""2-D maps for ROS's map_server: an image (PGM) and a text of the same name (YAML).

See http://wiki.ros.org/map_server, "Map format". Unknown cells are 205; with free_thresh 0.196 that is
(255 - 205) / 255 = 0.19608, just not free.
"""

import json
from pathlib import Path

import numpy as np

from tofmix.errors import UsageError
from tofmix.mapping.occupancy import FREE_THRESH, OCCUPIED_THRESH, FloorMap, State

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
