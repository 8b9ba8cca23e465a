"""Edges as the lines of a Wavefront OBJ text, in space."""

from collections.abc import Sequence

from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.edge_lines import EdgeLine
from tofmix.version import __version__

VERTEX = "v {:.6f} {:.6f} {:.6f}"
"""A vertex, metres, to a micrometre."""


def write(file: AtomicFile, lines: Sequence[EdgeLine], title: str) -> None:
    """Write one object a line; points at which the beam does not meet the plane part it."""
    text = [f"# {title}", f"# written by tofmix {__version__}", "# metres: x to the right, y down, z away"]
    first = 1  # OBJ counts vertices from 1
    for line in lines:
        text.append(f"o line_{line.line}_near_{line.near}_far_{line.far}")
        for run in line.runs():
            count = run.stop - run.start
            text += [VERTEX.format(*place) for place in line.place_m[run].tolist()]
            numbers = " ".join(str(first + k) for k in range(count))
            text.append(f"{'l' if count > 1 else 'p'} {numbers}")
            first += count
    file.sink.write("\n".join([*text, ""]).encode("ascii"))
