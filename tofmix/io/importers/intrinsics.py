"""Intrinsics of a camera as ROS has them: `sensor_msgs/CameraInfo` of bags, and calibration files in YAML.

`Calibration.pinhole` converts either to the pinhole of the imported images. The rules are those of ROS's
`image_geometry`: values of full resolution are shifted by the region of interest, then divided by the binning.
"""

import configparser
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tofmix.errors import BadInputError
from tofmix.io.importers.base import foreign
from tofmix.io.importers.conversion import depths_among
from tofmix.io.next_command import need
from tofmix.io.storage import read_text
from tofmix.optics.pinhole import DISTORTION_LENGTHS, Pinhole
from tofmix.toml_table import MOST_CHARACTERS

MODELS = ("plumb_bob", "rational_polynomial")
"""Distortion models of ROS that are OpenCV's pinhole with k1 k2 p1 p2 k3 and with k4 k5 k6 too."""

_MATRIX, _PROJECTION = 9, 12  # numbers of K (3 x 3) and P (3 x 4) in ROS's camera_info


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A calibrated camera, and the window of its sensor that images show."""

    what: str  # its source, for messages
    image: tuple[int, int] | None  # rows and columns at full resolution; None if unknown
    matrix: tuple[float, ...]  # K, 3 x 3 in rows: of images as the lens makes them
    distortion: tuple[float, ...] = ()  # D of these images
    model: str = ""  # name of the distortion model; empty if none is said
    projection: tuple[float, ...] = ()  # P, 3 x 4 in rows: of rectified images; empty if not known
    region: tuple[int, int, int, int] = (0, 0, 0, 0)
    """First row, first column, rows and columns of the region of interest at full resolution; no rows and columns for
    the whole image."""
    binning: tuple[int, int] = (1, 1)  # pixels that are joined, down and across

    @property
    def calibrated(self) -> bool:
        """Whether a focal length is known: an uncalibrated camera has zeros."""
        return min(self.matrix[0], self.matrix[4]) > 0 or self._rectified_focal() > 0

    def words(self) -> tuple[str, ...]:
        """Its parts in words, `what` apart."""
        fx, _, cx, _, fy, cy = self.matrix[:6]
        parts = (
            ("distortion", self.distortion),
            ("P", self.projection),
            ("region of interest", self.region),
            ("binning", self.binning),
            ("image", self.image or ()),
        )
        return (
            f"fx {fx:.10g} fy {fy:.10g} cx {cx:.10g} cy {cy:.10g}",
            *(f"{name} {' '.join(f'{number:.10g}' for number in numbers) or 'unknown'}" for name, numbers in parts),
            f"model {' '.join(self.model.split()) or 'unknown'}",
        )

    def _rectified_focal(self) -> float:
        return min(self.projection[0], self.projection[5]) if self.projection else 0.0

    def size(self) -> tuple[int, int] | None:
        """Rows and columns of the images: the region, or all, divided by the binning; None if not known."""
        rows, cols = self.region[2:] if self.region[2] and self.region[3] else (self.image or (0, 0))
        return (rows // self.binning[0], cols // self.binning[1]) if rows and cols else None

    def pinhole(self, shape: tuple[int, int], *, rectified: bool) -> Pinhole:
        """The pinhole of images.

        Parameters
        ----------
        shape : (int, int)
            Their rows and columns.
        rectified : bool
            Whether they are rectified: then by P and without distortion, or by K where there is no P; else by K and D.
            Images without K are taken as rectified.
        """
        size = self.size()
        if size is not None and size != tuple(shape):
            raise BadInputError(
                f"{self.what}: describes {size[0]} x {size[1]} pixels, the depths have {shape[0]} x {shape[1]}"
            )
        only_rectified = min(self.matrix[0], self.matrix[4]) <= 0  # drivers of rectified images may leave out K
        rectified = rectified or only_rectified
        by_projection = rectified and self._rectified_focal() > 0
        at = (0, 5, 2, 6) if by_projection else (0, 4, 2, 5)
        fx, fy, cx, cy = (float((self.projection if by_projection else self.matrix)[k]) for k in at)
        top, left, _, _ = self.region
        down, across = self.binning
        try:
            return Pinhole(
                fx=fx / across,
                fy=fy / down,
                cx=(cx - left) / across,
                cy=(cy - top) / down,
                distortion=() if rectified else self._coefficients(),
            )
        except ValueError as error:
            raise BadInputError(f"{self.what}: {error}") from error

    def _coefficients(self) -> tuple[float, ...]:
        """D for a pinhole; empty if all numbers are 0."""
        if not any(self.distortion):
            return ()
        if self.model and self.model not in MODELS:
            raise BadInputError(
                f"{self.what}: distortion model {' '.join(self.model.split())} is not a pinhole's;"
                f" {' and '.join(MODELS)} are read: rectify the images, or give the lens with --intrinsics"
                " FX,FY,CX,CY or --fov HxV"
            )
        longest = max(DISTORTION_LENGTHS)
        if any(self.distortion[longest:]):
            raise BadInputError(
                f"{self.what}: distortion of {len(self.distortion)} numbers: thin prisms and tilted sensors are not"
                " supported"
            )
        fits = [n for n in DISTORTION_LENGTHS if n >= len(self.distortion[:longest])]
        return (*self.distortion[:longest], *(0.0,) * (fits[0] - len(self.distortion[:longest])))


def differences(one: Calibration, other: Calibration) -> tuple[str, str]:
    """Parts of two calibrations that differ, in words of each."""
    pairs = [pair for pair in zip(one.words(), other.words(), strict=True) if pair[0] != pair[1]]
    return ", ".join(mine for mine, _ in pairs), ", ".join(theirs for _, theirs in pairs)


def from_camera_info(message: Any, what: str) -> Calibration:  # noqa: ANN401  a ROS message
    """Take a `sensor_msgs/CameraInfo` of ROS 1 or 2."""
    roi = message.roi
    return _calibration(
        what,
        image=(int(message.height), int(message.width)),
        matrix=_either(message, "k"),
        distortion=_either(message, "d"),
        model=str(message.distortion_model),
        projection=_either(message, "p"),
        region=(int(roi.y_offset), int(roi.x_offset), int(roi.height), int(roi.width)),
        binning=(int(message.binning_y), int(message.binning_x)),
    )


def _either(message: Any, key: str) -> Any:  # noqa: ANN401  a ROS message
    """A matrix by its name in ROS 2 (small) or ROS 1 (capital)."""
    return getattr(message, key, None) if hasattr(message, key) else getattr(message, key.upper(), ())


def _calibration(
    what: str,
    *,
    image: tuple[int, int] | None,
    matrix: object,
    distortion: object,
    model: str,
    projection: object,
    region: tuple[int, int, int, int] = (0, 0, 0, 0),
    binning: tuple[int, int] = (0, 0),
) -> Calibration:
    k, d, p = (_numbers(values, what) for values in (matrix, distortion, projection))
    if len(k) != _MATRIX or len(p) not in (0, _PROJECTION):
        raise BadInputError(f"{what}: a camera matrix of {len(k)} and a projection of {len(p)} numbers, not 9 and 12")
    if min(*region, *binning) < 0:
        raise BadInputError(f"{what}: its region of interest or its binning is negative")
    return Calibration(
        what=what,
        image=image if image and min(image) > 0 else None,
        matrix=k,
        distortion=d,
        model=model,
        projection=p,
        region=region,
        binning=(max(1, binning[0]), max(1, binning[1])),
    )


def _numbers(values: object, what: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(value) for value in np.asarray(values, dtype=np.float64).ravel())
    except (TypeError, ValueError):
        raise BadInputError(f"{what}: a camera matrix is not made of numbers") from None
    if not all(math.isfinite(number) for number in numbers):
        raise BadInputError(f"{what}: a camera matrix is not finite")
    return numbers


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file: of ROS's `camera_calibration`, a `CameraInfo` as text, or OpenCV's own YAML."""
    _refuse_arrays(path)
    text = read_text(path)
    if len(text) > MOST_CHARACTERS:
        raise BadInputError(f"{path}: {len(text):,} characters; a calibration has no more than {MOST_CHARACTERS:,}")
    with foreign(path):
        kind, unread = _of_other_syntax(text)
    if kind:
        _refuse_other_kinds(unread, path, kind)
        raise BadInputError(f"{path}: not a calibration: {kind}, without a camera matrix")
    with foreign(path):
        messages = _parse(text)
    read = [_calibration_of(found, path) for found in messages or [None]]
    return next((calibration for calibration in read if calibration.calibrated), read[0])


def _calibration_of(found: object, path: Path) -> Calibration:
    """The calibration that a document of YAML or JSON holds."""
    matrix = _first(found, "camera_matrix", "k", "K") if isinstance(found, Mapping) else None
    if matrix is None or (isinstance(matrix, Mapping) and "data" not in matrix):
        _refuse_other_kinds(found, path, "of Kalibr's or a camera maker's kind")
    if not isinstance(found, Mapping):
        raise BadInputError(f"{path}: not a calibration: no table of keys")
    if matrix is None:
        raise BadInputError(f"{path}: not a calibration: it has no camera_matrix (nor K)")
    size = _first(found, "image_height", "height"), _first(found, "image_width", "width")
    roi = found.get("roi")
    roi = roi if isinstance(roi, Mapping) else {}
    region = [_whole(roi.get(key), path) for key in ("y_offset", "x_offset", "height", "width")]
    rows, cols = (_whole(value, path) for value in size)
    return _calibration(
        str(path),
        image=(rows, cols),
        matrix=_flat(matrix),
        distortion=_flat(_first(found, "distortion_coefficients", "d", "D")),
        model=str(found.get("distortion_model") or ""),
        projection=_flat(_first(found, "projection_matrix", "p", "P")),
        region=(region[0], region[1], region[2], region[3]),
        binning=(_whole(found.get("binning_y"), path), _whole(found.get("binning_x"), path)),
    )


_XML_MATRIX = re.compile(r"<(\w+)[^<>]*>(?:(?!</\1>).)*?<data>([^<>]*)</data>\s*</\1>", re.DOTALL)
_INI = re.compile(r"(?:\s*[#;][^\n]*\n|\s*\n)*\s*\[[^\]\n]*\]\s*\n\s*(?:[#;][^\n]*\n\s*)*[\w. ]+=")
_ONLY_NUMBERS = re.compile(r"[\s\d.,;eE+\-\[\]()]+")


def _of_other_syntax(text: str) -> tuple[str, object]:
    """What a text of another syntax than YAML and JSON holds, and the syntax in words; no words if it is none."""
    plain = text.lstrip("\ufeff \t\r\n")
    if plain.startswith("<"):
        return "in XML", {name: {"k": _split(numbers)} for name, numbers in _XML_MATRIX.findall(plain)}
    if _INI.match(text):
        ini = configparser.ConfigParser(strict=False, interpolation=None)
        ini.read_string(text)
        return "in INI", {name: {key: _plain(value) for key, value in ini[name].items()} for name in ini.sections()}
    numbers = _split(plain) if _ONLY_NUMBERS.fullmatch(plain) else []
    return ("a matrix as text", {"k": numbers}) if len(numbers) == _MATRIX else ("", None)


def _split(text: str) -> list[Any]:
    return [_plain(word) for word in re.split(r"[\s,;\[\]()]+", text) if word]


def _plain(text: str) -> Any:  # noqa: ANN401  what a text says
    """A number; else the text itself."""
    for of_type in (int, float):
        try:
            return of_type(text)
        except ValueError:
            continue
    return text


def _refuse_arrays(path: Path) -> None:
    """Refuse arrays of NumPy, with the numbers of a camera matrix among them."""
    if path.suffix.lower() not in (".npy", ".npz"):
        return
    with foreign(path):
        found = np.load(path, allow_pickle=False, mmap_mode="r")
        arrays = {name: found[name] for name in found.files} if hasattr(found, "files") else {"array": found}
    small = {name: {"k": np.asarray(array).tolist()} for name, array in arrays.items() if array.shape == (3, 3)}
    _refuse_other_kinds(small, path, "in NumPy's format")
    raise BadInputError(f"{path}: not a calibration: an array that is no camera matrix")


def _parse(text: str) -> list[Any]:
    """The documents of JSON, or of plain YAML without OpenCV's additions: its first line and its matrices' tag."""
    if text.lstrip().startswith(("{", "[")):
        try:
            return [json.loads(text)]  # may be indented with tabs, as YAML may not
        except ValueError:
            pass
    yaml = need("yaml", extra="ros", what="a calibration in YAML")
    first, _, rest = text.partition("\n")
    plain = (rest if first.startswith("%YAML:") else text).replace("!!opencv-matrix", "")
    # `ros2 topic echo` ends each message in ---: the first one that is calibrated counts.
    return [found for found in yaml.safe_load_all(plain) if found is not None]


_LENS_KEYS = (("fx", "fy", "cx", "cy"), ("fx", "fy", "ppx", "ppy"))
"""Names of focal lengths and centre in calibrations of other kinds."""

_LENS_MATRICES = "intrinsic_matrix", "intrinsicmatrix", "intrinsics", "intrinsic", "camera_matrix", "cameramatrix", "k"
"""Names of a 3 x 3 matrix there: Open3D writes its columns, DepthAI its rows."""

_OWN_NAMES = "Purpose", "rostopic", "name"
"""What a camera's table says of the camera there: an Azure Kinect's, Kalibr's, others'."""

_SIZES = (("width", "height"), ("sensorwidth", "sensorheight"))
"""Names of the image's size there."""


def _refuse_other_kinds(found: object, path: Path, kind: str) -> None:
    """Refuse a calibration of another kind, in words, with the numbers to give instead.

    Kalibr's camera chains and JSON of camera makers have the focal lengths under names of their own. Where one file
    describes several cameras, those of depth are named; without such a name, all are.
    """
    with foreign(path):
        lenses = {name: lens for name, table in _tables(found) if (lens := _lens_of(table)) is not None}
    if not lenses:
        return
    chosen = depths_among(lenses) or list(lenses)
    named = []
    for name in chosen:
        lens = lenses[name]
        about = ", ".join(part for part in (name if len(chosen) > 1 else "", lens.image) if part)
        numbers = ",".join(f"{n:.10g}" for n in lens.numbers)
        named.append(f"--intrinsics {numbers}{f' ({about})' if about else ''}")
    raise BadInputError(
        f"{path}: a calibration {kind}, which is not read; give its numbers, without"
        f" distortion: {' or '.join(' '.join(text.split()) for text in named)}"
    )


def _tables(found: object, name: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """A table and those in it, outermost first, each with the names that lead to it, and what it calls itself."""
    if isinstance(found, Mapping):
        own = [text for key in _OWN_NAMES if isinstance(text := found.get(key), str)]
        yield ".".join(filter(None, (name, *own))), found
    parts: Iterable[tuple[object, object]] = ()
    if isinstance(found, Mapping):
        parts = found.items()
    elif isinstance(found, list):
        parts = enumerate(found)
    for key, value in parts:
        yield from _tables(value, f"{name}.{key}".lstrip("."))


class _Lens(NamedTuple):
    """Fx, fy, cx and cy, pixels, and the image that they are of in words, empty if it is not known."""

    numbers: tuple[float, ...]
    image: str


def _lens_of(table: Mapping[str, Any]) -> _Lens | None:
    """The lens of a table of Kalibr's or a maker's kind; None if it has none."""
    lower = {str(key).lower(): value for key, value in table.items()}
    sizes = [(lower.get(width), lower.get(height)) for width, height in _SIZES]
    size = next(((w, h) for w, h in sizes if type(w) is int and type(h) is int and min(w, h) > 0), None)
    values: list[list[Any]] = [[lower.get(key) for key in keys] for keys in _LENS_KEYS]
    values += [_of_matrix(lower.get(key)) for key in _LENS_MATRICES]
    if isinstance(lower.get("intrinsics"), list):
        values.append(lower["intrinsics"][-len(_LENS_KEYS[0]) :])  # models of wide lenses put numbers before
    if size is not None:
        values.append(_of_azure(lower.get("intrinsics"), size))
    for numbers in values:
        plain = len(numbers) == len(_LENS_KEYS[0]) and all(type(number) in (int, float) for number in numbers)
        if plain and all(math.isfinite(number) for number in numbers) and min(numbers[:2]) > 0:
            image = "" if size is None else f"of images of {size[1]} x {size[0]} pixels"
            return _Lens(tuple(float(number) for number in numbers), image)
    return None


def _of_matrix(value: object) -> list[Any]:
    """Fx, fy, cx and cy of a 3 x 3 matrix in rows or in columns; empty if it is none."""
    m = list(_flat(value)) if isinstance(value, (list, Mapping)) else []
    if len(m) != _MATRIX or m[8] != 1:
        return []
    return [m[0], m[4], m[2], m[5]] if m[6] == m[7] == 0 else [m[0], m[4], m[6], m[7]]


def _of_azure(value: object, size: tuple[int, int]) -> list[Any]:
    """Fx, fy, cx and cy of the whole sensor, by an Azure Kinect: cx, cy, fx and fy in parts of the sensor's size."""
    numbers = value.get("ModelParameters") if isinstance(value, Mapping) else None
    first = numbers[:4] if isinstance(numbers, list) else []
    if len(first) < len(_LENS_KEYS[0]) or not all(type(number) is float for number in first):
        return []
    cx, cy, fx, fy = first
    return [fx * size[0], fy * size[1], cx * size[0] - 0.5, cy * size[1] - 0.5]


def _first(found: Mapping[str, Any], *keys: str) -> Any:  # noqa: ANN401  what YAML holds
    return next((found[key] for key in keys if found.get(key) is not None), None)


def _flat(value: Any) -> Any:  # noqa: ANN401  what YAML holds
    """Numbers of a matrix: a table with `data`, or a list, perhaps of rows."""
    if isinstance(value, Mapping):
        value = value.get("data")
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [number for row in value for number in (row if isinstance(row, list) else [row])]
    return () if value is None else value


def _whole(value: Any, path: Path) -> int:  # noqa: ANN401  what YAML holds
    if value is None:
        return 0
    if isinstance(value, bool) or not isinstance(value, int):
        raise BadInputError(f"{path}: {' '.join(str(value).split())[:40]!r} is not a whole number of pixels")
    return value
