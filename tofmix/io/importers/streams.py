"""Streams by their names: topics, files, datasets and channels of depth, and those of something else."""

import re
from collections.abc import Container, Iterable
from typing import Literal

Stream = Literal["depth", "other", "unknown"]

_DEPTH = frozenset({"depth", "depths", "range", "ranges", "distance", "distances", "dist", "z", "tof"})
_OTHER = frozenset({
    "ir", "infra", "infrared", "nir", "amplitude", "amplitudes", "amp", "intensity", "confidence", "conf", "color",
    "colour", "rgb", "bgr", "grey", "gray", "mono", "disparity", "reflectivity", "reflectance", "ambient", "signal",
    "status", "quality", "valid", "mask", "noise", "sigma", "variance", "temperature", "active", "brightness",
})  # fmt: skip


def stream_of(name: str) -> Stream:
    """Tell a stream by the words of its name.

    A word of another stream decides: ``depth/confidence`` is none of depths. ``depth_to_color`` is one of depths that
    are seen from another camera.
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = [
        word for word in re.split(r"[^a-z]+", re.sub(r"(?<![A-Za-z])to[_\- ]+[A-Za-z]+", "", spaced).lower()) if word
    ]
    if any(word in _OTHER for word in words):
        return "other"
    return "depth" if any(word in _DEPTH for word in words) else "unknown"


def depths_among(names: Iterable[str], bytewise: Container[str] = ()) -> list[str]:
    """Names that may be of depths: those that say so, else those that say nothing.

    Parameters
    ----------
    names : iterable of str
        Names of streams side by side.
    bytewise : container of str
        Those whose values have 8 bits. Among streams that say nothing they are no depths beside wider ones: masks,
        confidences and grey images have 8 bits, and ranges in mm need more.
    """
    told = {name: stream_of(name) for name in names}
    sure = [name for name, stream in told.items() if stream == "depth"]
    silent = [name for name, stream in told.items() if stream == "unknown"]
    return sure or [name for name in silent if name not in bytewise] or silent
