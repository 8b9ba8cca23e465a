"""Points as comma-separated text, a header line first."""

from collections.abc import Callable

from tofmix.io.storage import AtomicFile
from tofmix.points import POINT_FIELDS, LayerPoints

# Nine digits give every float32 back.
_LINE = ",".join("%.9g" if spec.dtype == "<f4" else "%d" for spec in POINT_FIELDS) + "\n"


def write(file: AtomicFile, points: LayerPoints, _: str, written: Callable[[], None]) -> int:
    """Write the points window by window; a value that is not known is ``nan``."""
    file.sink.write((",".join(spec.name for spec in POINT_FIELDS) + "\n").encode())
    count = 0
    for block in points:
        file.sink.write("".join(_LINE % row for row in block.tolist()).encode())
        written()
        count += len(block)
    return count
