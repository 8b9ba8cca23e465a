"""Sources opened and read whole."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.io.importers import open_source
from tofmix.io.importers.base import Frame, FrameSource, SourceRequest


def read_source(path: Path, **request: Any) -> tuple[FrameSource, list[Frame]]:  # noqa: ANN401  of Request
    """The source and all its frames."""
    with open_source(path, SourceRequest(**request)) as source:
        return source, list(source.frames)


def depths(path: Path, **request: Any) -> NDArray[Any]:  # noqa: ANN401  of Request
    """All depths (frame, row, col), checked against what the source announces."""
    source, frames = read_source(path, **request)
    stacked = np.stack([frame.depth for frame in frames])
    assert stacked.shape == source.shape
    assert stacked.dtype == source.dtype.newbyteorder("=")
    assert source.has_amplitude == (request.get("amplitude") is not None)
    return stacked
