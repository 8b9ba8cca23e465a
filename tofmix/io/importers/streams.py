"""Streams by their names: topics, files, datasets and channels of depth, and those of something else."""

import re
from collections.abc import Container, Iterable
from typing import Literal

Stream = Literal["depth", "other", "unknown"]


def set_of(words: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(words.split())


_DEPTH = set_of("depth depths range ranges distance distances dist z tof")
_LIGHT = set_of(
    "ir infra infrared nir amplitude amplitudes amp intensity intensities color colour rgb bgr grey gray mono"
    " reflectivity reflectance ambient signal active brightness"
)
"""Images of another kind; before a word of depth they say what it was made of, as in ``ir_depth``."""

_PROPERTY = set_of("confidence confidences conf disparity status quality mask noise sigma variance temperature valid")
"""Properties of samples; beside a word of depth they are properties of it, as in ``depth_confidence``, ``sigma_z``."""

_OTHER = _LIGHT | _PROPERTY
_ADJECTIVES = set_of("valid active")
"""Words that say nothing beside one of depth: ``depth_valid`` may be the depths that are valid."""

_OF_A_SCENE = set_of("grey gray mono ambient signal active noise temperature quality valid")
"""Words that in the name of a file may describe what was recorded rather than how."""

_BESIDE = set_of(
    "image images img imgs frame frames map maps data raw stack stream video seq sequence left right cam camera sensor"
    " ome"
)
"""Words beside which the name of a file still says no more than its stream."""

_NOT_A_STREAM = re.compile(
    r"(?<![A-Za-z])(?:to[_\- ]+[A-Za-z]+|noise[_\- ]+(?:filtered|reduced|removed|free|corrected))", re.IGNORECASE
)
"""``depth_to_color`` is of depths that are seen from another camera; ``noise_filtered`` is of no noise."""


def _words(part: str) -> list[str]:
    """Words of a part of a name, lower case."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", part)
    return [word for word in re.split(r"[^a-z]+", _NOT_A_STREAM.sub("", spaced).lower()) if word]


def _stream_of_words(words: list[str]) -> Stream:
    known = [word for word in words if word in _DEPTH or word in _OTHER]
    if any(word in _DEPTH for word in known):
        known = [word for word in known if word not in _ADJECTIVES]
    if not known:
        return "unknown"
    return "depth" if known[-1] in _DEPTH and not any(word in _PROPERTY for word in known) else "other"


def stream_of(name: str) -> Stream:
    """Tell a stream by the words of its name.

    The last part of a path that says something decides: ``/rgb_camera/depth/image_raw`` is one of depths,
    ``/depth/confidence/image`` is none. Within a part the last word decides, and a property of samples always.
    """
    told = (_stream_of_words(_words(part)) for part in reversed(name.split("/")))
    return next((stream for stream in told if stream != "unknown"), "unknown")


def stream_of_file(name: str) -> Stream:
    """Tell the stream of a file or folder by its name, without its suffix.

    Names of files describe much else: ``grey_wall`` and ``noise`` are of no stream. One is of another stream where all
    its words say so, apart from numbers and words such as ``image``.
    """
    words = _words(name)
    stream = _stream_of_words(words)
    if stream == "other" and not all(word in _BESIDE or word in _OTHER - _OF_A_SCENE for word in words):
        return "unknown"
    return stream


def depths_among(names: Iterable[str], bytewise: Container[str] = ()) -> list[str]:
    """Names that may be of depths: those that say so, else those that say nothing.

    Parameters
    ----------
    names : iterable of str
        Names of streams side by side. Of two that say depth, one without a word of another stream comes before
        ``rgb_camera/depth`` and ``depth_valid``.
    bytewise : container of str
        Those whose values have 8 bits. Among streams that say nothing they are no depths beside wider ones: masks,
        confidences and grey images have 8 bits, and ranges in mm need more.
    """
    told = {name: stream_of(name) for name in names}
    sure = [name for name, stream in told.items() if stream == "depth"]
    plain = [name for name in sure if not any(word in _OTHER for word in _words(name))]
    silent = [name for name, stream in told.items() if stream == "unknown"]
    return plain or sure or [name for name in silent if name not in bytewise] or silent
