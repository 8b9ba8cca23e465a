"""Points as binary PCD 0.7. A header of text and the packed records: no library is needed."""

from collections.abc import Callable

import numpy as np

from tofmix.io.atomic.storage import AtomicFile
from tofmix.points import PointSource
from tofmix.version import __version__


def write(file: AtomicFile, points: PointSource, title: str, written: Callable[[], None]) -> int:
    """Write the points as an unorganised cloud; comments name the units."""
    count = points.count()
    kinds = [np.dtype(spec.dtype) for spec in points.fields]
    lines = ["# .PCD v0.7 - Point Cloud Data file format", f"# {title}", f"# written by tofmix {__version__}"]
    lines += [f"# {spec.name}: {spec.long_name} ({spec.units})" for spec in points.fields]
    lines += [
        "VERSION 0.7",
        f"FIELDS {' '.join(spec.name for spec in points.fields)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
        "",
    ]
    file.sink.write("\n".join(lines).encode("ascii"))
    for block in points:
        file.sink.write(block.tobytes())
        written()
    return count
