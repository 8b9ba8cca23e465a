"""What a source's streams are, by their names, and its numbers as those of a recording: radial ranges in mm.

Topics, files, datasets and channels are of depth, or of something else. Status codes beside the ranges mark which
samples are valid.
"""

import math
import re
from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.importers.base import SourceRequest
from tofmix.io.samples import no_sample

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


_NAMES = set_of("status confidence quality valid validity flag flags error errors")


def is_status_name(name: str) -> bool:
    """Whether a column, dataset or array holds codes or grades of samples, by a word of its name."""
    words = re.split(r"[^a-z0-9]+", name.lower())
    return any(word.rstrip("0123456789") in _NAMES for word in words)


def codes_of(name: str, request: SourceRequest) -> tuple[int, ...] | None:
    """Codes of valid samples in a column, dataset or array of a name or path; None where nothing tells them.

    `valid_status` of the request is used first, then the camera's codes for whatever is called ``status``.
    """
    last = name.rpartition("/")[2].lower()
    if request.valid_status is not None:
        wanted, codes = request.valid_status
        return codes if wanted.strip("/").lower() in (name.strip("/").lower(), last) else None
    of_camera = "status" in re.split(r"[^a-z0-9]+", last)
    return request.status_codes if of_camera and request.status_codes else None


_WHOLE_MM = ("u1", "u2")
"""Types whose whole mm a recording holds as they are."""


class Converted(NamedTuple):
    """Ranges in mm of the shape of the depths, and the number of values that were dropped, by reason."""

    range_mm: NDArray[np.uint16] | NDArray[np.float32]
    dropped: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conversion:
    """How the depths of a source become ranges.

    `tofmix.io.samples.no_sample` says which values are no samples.
    """

    dtype: np.dtype[Any]  # type of the depths
    unit_mm: float = 1.0  # mm of one unit, above 0
    offset_mm: float = 0.0  # added after the unit, mm
    invalid: tuple[float, ...] = ()  # further invalid values, in the source's numbers
    valid_span: tuple[float, float] = (-math.inf, math.inf)  # least and largest valid value, in the source's numbers
    status_valid: tuple[int, ...] = ()  # status codes of valid samples
    ray_over_depth: FloatArray | None = None
    """(row, col) float64, optional: Range over depth, where depths are along z."""
    unit_known: bool = True  # whether the unit was given; if not, real numbers are checked
    keep_values: bool = False  # whether zeros and fill values are ranges

    @property
    def is_doubtful(self) -> bool:
        """Whether the unit is a guess: whole numbers are rarely metres, real ones may be."""
        return not self.unit_known and self.dtype.kind == "f"

    @property
    def stored_dtype(self) -> str:
        """``u2`` where ranges are whole mm in 16 bits as they come, with 0 for no sample; else ``f4`` with NaN."""
        whole = self.dtype.newbyteorder("=").str[1:] in _WHOLE_MM and not self.keep_values
        as_they_are = self.unit_mm == 1.0 and not self.offset_mm and self.ray_over_depth is None
        return "u2" if whole and as_they_are else "f4"

    def __call__(self, depth: NDArray[Any], status: NDArray[Any] | None = None) -> Converted:
        """Convert a frame, (row, col) or (target, row, col), with status codes of the same shape.

        The ranges are of `stored_dtype`; in `f4` they are rounded once, from float64.
        """
        bad, dropped = no_sample(
            depth,
            unit_mm=self.unit_mm,
            offset_mm=self.offset_mm,
            invalid=self.invalid,
            valid_span=self.valid_span,
            keep_values=self.keep_values,
        )
        if status is not None:
            unfit = ~bad & ~np.isin(status, self.status_valid)
            if count := int(np.count_nonzero(unfit)):
                dropped["status"] = count
                bad |= unfit
        if self.stored_dtype == "u2":
            return Converted(np.where(bad, 0, depth).astype(np.uint16), dropped)
        with np.errstate(over="ignore", invalid="ignore"):
            along: Any = 1.0 if self.ray_over_depth is None else self.ray_over_depth
            rounded = (depth.astype(np.float64) * (self.unit_mm * along) + self.offset_mm * along).astype(np.float32)
        rounded[bad | ~np.isfinite(rounded)] = np.nan
        return Converted(rounded, dropped)
