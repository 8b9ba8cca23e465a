"""Points as comma-separated text, a header line first."""

from collections.abc import Callable

from tofmix.io.atomic.storage import AtomicFile
from tofmix.points import PointSource


def write(file: AtomicFile, points: PointSource, _: str, written: Callable[[], None]) -> int:
    """Write the points block by block; a value that is not known is ``nan``."""
    file.sink.write((",".join(spec.name for spec in points.fields) + "\n").encode())
    # Nine digits give every float32 back.
    line = ",".join("%.9g" if spec.dtype == "<f4" else "%d" for spec in points.fields) + "\n"
    count = 0
    for block in points:
        file.sink.write("".join(line % row for row in block.tolist()).encode())
        written()
        count += len(block)
    return count
