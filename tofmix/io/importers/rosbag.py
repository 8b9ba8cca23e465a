"""Depth images of ROS 1 bags, ROS 2 bags and MCAP files, by rosbags.

`16UC1` is in millimetres and `32FC1` in metres, along z (REP 118), unless a RealSense bag states its unit; rows may be
padded (`step`) and of either byte order. A frame's time is its header's stamp, or the bag's where the header has none.
Messages are read one by one.
"""

import math
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.importers.base import Frame, FrameSource, SourceRequest, check_frame, foreign, unused
from tofmix.io.importers.conversion import depths_among, stream_of
from tofmix.io.importers.intrinsics import Calibration, differences, from_camera_info
from tofmix.io.next_command import need
from tofmix.optics.pinhole import Pinhole
from tofmix.points import MM_A_METRE

SUFFIXES = (".bag", ".mcap", ".db3")

DEPTH_UNITS_MM = {"16UC1": 1.0, "16SC1": 1.0, "32FC1": 1000.0, "64FC1": 1000.0, "mono16": None}
"""mm of one unit, by encoding; None where it must be stated. mono16 is depth only by the name of its topic."""

_DTYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4", "8UC1": "u1", "mono8": "u1", "16SC1": "i2", "64FC1": "f8"}
_SURE = ("16UC1", "16SC1", "32FC1", "64FC1")
_IMAGE, _INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_COMPRESSED, _NUMBER = "sensor_msgs/msg/CompressedImage", "std_msgs/msg/Float32"
_UNIT_TOPIC = "/option/Depth_Units/value"
_DEPTH_TRANSPORT = "/compressedDepth"
_WAITING = 64
"""Frames that wait for an amplitude image of the same time stamp; older frames have none."""


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return (path / "metadata.yaml").is_file()


@contextmanager
def open_bag(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a bag."""
    need("rosbags.highlevel", extra="ros", what="a ROS bag")
    with _Bag(path) as bag:
        topic, unused_topics = _depth_topic(bag, request.topic)
        first, _ = bag.first(topic)
        depth = _decoded(first, f"{path}: {topic}", tuple(DEPTH_UNITS_MM))
        if request.amplitude is not None:
            bag.check(request.amplitude, _IMAGE)
        pinhole, notes = _intrinsics(bag, topic, request, (depth.shape[0], depth.shape[1]))
        stated_mm = _stated_unit_mm(bag, topic) if depth.dtype.kind in "iu" else None
        unit_mm = DEPTH_UNITS_MM[first.encoding] if stated_mm is None else stated_mm
        unknown = "" if unit_mm else f"{topic}: {first.encoding} without a message {_UNIT_TOPIC}: the unit is not known"
        unused_topics = [name for name in unused_topics if name != request.amplitude]
        yield FrameSource(
            kind=f"{first.encoding} images of {topic}",
            shape=(bag.count(topic), depth.shape[0], depth.shape[1]),
            dtype=depth.dtype,
            frames=_frames(bag, topic, request.amplitude, depth),
            unit_mm=unit_mm,
            unit_unknown=unknown,
            depth_axis="z",
            has_amplitude=request.amplitude is not None,
            has_time=True,
            pinhole=pinhole,
            rectified=_is_rectified(topic),
            lens_unknown="; ".join(notes) if pinhole is None else "",
            notes=(*notes, *([unused(path, "topic", unused_topics)] if unused_topics else [])),
        )


class _Bag:
    """An open bag, with every error of the library in our words."""

    def __init__(self, path: Path) -> None:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        with foreign(path):
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))

    def __enter__(self) -> Self:
        with foreign(self.path):
            self._reader.open()
        for c in self._reader.connections:  # a ROS 2 bag's come from a text file, and the library takes any type
            if not (isinstance(c.topic, str) and isinstance(c.msgtype, str) and isinstance(c.msgcount, int)):
                self._reader.close()
                raise BadInputError(f"{self.path}: its list of topics is damaged")
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def topics(self, kind: str) -> list[str]:
        """Topics with messages of a type."""
        return sorted({c.topic for c in self._reader.connections if c.msgtype == kind and c.msgcount > 0})

    def count(self, topic: str) -> int:
        """Messages of a topic, by the bag's own index."""
        return sum(c.msgcount for c in self._reader.connections if c.topic == topic)

    def check(self, topic: str, kind: str) -> None:
        """Refuse a topic that is not there or of another type."""
        if topic not in self.topics(kind):
            there = ", ".join(self.topics(kind)) or "none"
            compressed = _compressed(self) if kind == _IMAGE else ""
            raise BadInputError(f"{self.path}: no topic {topic} of {kind}; it has: {there}{compressed}")

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Topic, the bag's time in ns, and message, in the bag's order."""
        with foreign(self.path):
            chosen = [c for c in self._reader.connections if c.topic in topics]
            raw = self._reader.messages(connections=chosen)
        while True:
            with foreign(self.path):
                item = next(raw, None)
                if item is None:
                    return
                connection, stamp, data = item
                message = self._reader.deserialize(data, connection.msgtype)
            yield connection.topic, stamp, message

    def first(self, topic: str) -> tuple[Any, int]:
        """The first message of a topic and the bag's time of it."""
        for _, stamp, message in islice(self.messages(topic), 1):
            return message, stamp
        raise BadInputError(f"{self.path}: {topic}: no message")


def _depth_topic(bag: _Bag, wanted: str | None) -> tuple[str, list[str]]:
    """The topic of the depths, and those beside it that are not used and may be taken for it."""
    if wanted is not None:
        bag.check(wanted, _IMAGE)
        return wanted, []
    encodings = {topic: " ".join(str(bag.first(topic)[0].encoding).split()) for topic in bag.topics(_IMAGE)}
    fitting = [
        topic
        for topic, encoding in encodings.items()
        if encoding in _SURE or (encoding in DEPTH_UNITS_MM and stream_of(topic) == "depth")
    ]
    depths = depths_among(fitting)
    if len(depths) == 1:
        beside = [t for t, e in encodings.items() if t in fitting or (e in _DTYPES and stream_of(t) == "other")]
        return depths[0], [topic for topic in beside if topic != depths[0]]
    readable = ", ".join(f"{topic} ({e})" for topic, e in encodings.items() if e in DEPTH_UNITS_MM)
    others = ", ".join(f"{topic} ({e})" for topic, e in encodings.items() if e not in DEPTH_UNITS_MM)
    reason = "several topics of depth images" if depths else f"no topic of depth images ({' or '.join(_SURE)})"
    choice = f"; choose with --topic from its images: {readable}" if readable else ""
    also = f"; not readable as depths: {others}" if others else ""
    raise BadInputError(f"{bag.path}: {reason}{choice}{also}{_compressed(bag)}")


def _compressed(bag: _Bag) -> str:
    """Remedy for depths that are compressed; empty where there are none."""
    names = [name for name in bag.topics(_COMPRESSED) if stream_of(name) == "depth" or name.endswith(_DEPTH_TRANSPORT)]
    if not names:
        return ""
    base, _, transport = names[0].rpartition("/")
    if bag.path.suffix == ".bag":
        command = f"rosrun image_transport republish {transport} in:={base} raw out:={base}_raw"
    else:
        command = (
            f"ros2 run image_transport republish {transport} raw --ros-args -r in/{transport}:={names[0]}"
            f" -r out:={base}_raw"
        )
    return (
        f"; {names[0]} holds compressed images, which are not read: start {command}, play the bag, and record"
        f" {base}_raw"
    )


def _stated_unit_mm(bag: _Bag, topic: str) -> float | None:
    """Mm of one count by the message of a RealSense bag that belongs to the topic's sensor; None without one."""
    near = [
        name
        for name in bag.topics(_NUMBER)
        if name.endswith(_UNIT_TOPIC) and topic.startswith(name.removesuffix(_UNIT_TOPIC) + "/")
    ]
    if not near:
        return None
    # The shortest text of a float32 is the number that was meant: 0.00025, not 0.000250000012.
    values = [float(str(np.float32(message.data))) for _, _, message in bag.messages(near[0])]
    if len(set(values)) > 1:
        text = ", ".join(f"{value:g}" for value in dict.fromkeys(values))
        raise BadInputError(f"{bag.path}: {near[0]}: the unit changes ({text} m); cut the bag where it does")
    unit_mm = values[0] * MM_A_METRE
    if not (math.isfinite(unit_mm) and unit_mm > 0):
        raise BadInputError(f"{bag.path}: {near[0]}: {values[0]:g} m is no unit of a count")
    return round(unit_mm, 12)


def _decoded(message: Any, what: str, encodings: tuple[str, ...]) -> NDArray[Any]:  # noqa: ANN401  a ROS message
    """Pixels (row, col) of an image message."""
    encoding, rows, cols, step = str(message.encoding), int(message.height), int(message.width), int(message.step)
    if encoding not in encodings:
        raise BadInputError(f"{what}: encoding {encoding!r}, expected {' or '.join(encodings)}")
    dtype = np.dtype((">" if message.is_bigendian else "<") + _DTYPES[encoding])
    data = np.asarray(message.data, dtype=np.uint8)
    if min(rows, cols) < 1 or step < cols * dtype.itemsize or data.size < rows * step:
        raise BadInputError(
            f"{what}: {data.size} bytes do not make an image of {rows} x {cols} pixels {encoding} in steps of {step}"
        )
    lines = data[: rows * step].reshape(rows, step)[:, : cols * dtype.itemsize]
    return np.ascontiguousarray(lines).view(dtype).astype(dtype.newbyteorder("="))


def _stamp(message: Any, bag_ns: int) -> int:  # noqa: ANN401  a ROS message
    stamp = message.header.stamp
    stamp_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return stamp_ns or bag_ns


def _frames(bag: _Bag, topic: str, amplitude: str | None, first: NDArray[Any]) -> Iterator[Frame]:
    shape, dtype = (first.shape[0], first.shape[1]), first.dtype
    waiting: list[tuple[int, NDArray[Any]]] = []
    amplitudes: dict[int, NDArray[Any]] = {}
    origin: int | None = None
    topics = (topic,) if amplitude is None else (topic, amplitude)
    for number, (name, bag_ns, message) in enumerate(bag.messages(*topics)):
        what = f"{bag.path}: {name}: message {number}"
        stamp = _stamp(message, bag_ns)
        if name == topic:
            depth = _decoded(message, what, tuple(DEPTH_UNITS_MM))
            waiting.append((stamp, check_frame(depth, shape, dtype, what)))
            origin = stamp if origin is None else origin
        else:
            amplitudes[stamp] = _decoded(message, what, tuple(_DTYPES))
            if amplitudes[stamp].shape != shape:
                raise BadInputError(f"{what}: {amplitudes[stamp].shape} pixels, the depths have {shape}")
        while waiting and (amplitude is None or waiting[0][0] in amplitudes or len(waiting) > _WAITING):
            yield _joined(*waiting.pop(0), amplitudes, origin)
        while len(amplitudes) > 2 * _WAITING:
            del amplitudes[next(iter(amplitudes))]
    for stamp, depth in waiting:
        yield _joined(stamp, depth, amplitudes, origin)


def _joined(stamp: int, depth: NDArray[Any], amplitudes: dict[int, NDArray[Any]], origin: int | None) -> Frame:
    ns = 1.0e-9  # s in a nanosecond
    time_s = (stamp - (origin or 0)) * ns
    return Frame(depth=depth, amplitude=amplitudes.pop(stamp, None), time_s=time_s)


def _is_rectified(topic: str) -> bool:
    """Whether images are rectified: ROS names their topics so, such as ``image_rect_raw``."""
    return "rect" in topic.rpartition("/")[2].split("_")


def _info_topics(topic: str) -> list[str]:
    """Names that drivers give the camera_info of a topic: beside it, or RealSense's ``Depth_0/info/camera_info``."""
    folder = topic.rpartition("/")[0]
    above = folder.rpartition("/")[0]
    return [f"{folder}/camera_info", f"{above}/info/camera_info", f"{folder}/info/camera_info", f"{topic}/camera_info"]


def _intrinsics(
    bag: _Bag, topic: str, request: SourceRequest, shape: tuple[int, int]
) -> tuple[Pinhole | None, tuple[str, ...]]:
    """Intrinsics from the camera_info of the depth topic, and warnings about them."""
    notes: list[str] = []
    there = bag.topics(_INFO)
    for name in _lens_topics(bag, topic, request):
        what = f"{bag.path}: {name}"
        found, blank = _calibrations(bag, name)
        if not found:
            notes.append(f"{what}: not calibrated (a focal length is not above 0); not used")
            continue
        if len(found) > 1 and not request.lens_given:
            found = [_only_lens(bag, topic, found, what)]
        if blank:
            notes.append(f"{what}: {blank} of its messages are not calibrated (zeros); the others are used")
        return found[0].calibration.pinhole(shape, rectified=_is_rectified(topic)), tuple(notes)
    if there and not (notes or request.lens_given):
        notes.append(f"{bag.path}: no camera_info beside {topic}; --camera-info takes one of: {', '.join(there)}")
    return None, tuple(notes)


def _lens_topics(bag: _Bag, topic: str, request: SourceRequest) -> list[str]:
    """Topics of camera_info that may describe the depths, the nearest first."""
    if request.camera_info is not None:
        bag.check(request.camera_info, _INFO)
        return [request.camera_info]
    there = bag.topics(_INFO)
    return [] if request.lens_given else [name for name in dict.fromkeys(_info_topics(topic)) if name in there]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lens:
    """A calibration from its first message on."""

    calibration: Calibration  # the camera
    # stamp, bag_ns: Time stamp of the message and the bag's time of it, ns.
    stamp: int
    bag_ns: int
    frame: int = 0  # number of the first frame that it describes


def _calibrations(bag: _Bag, name: str) -> tuple[list[_Lens], int]:
    """Calibrations of a topic, each where it begins, and the number of messages that are not calibrated."""
    what = f"{bag.path}: {name}"
    found: list[_Lens] = []
    blank = 0
    for _, bag_ns, message in bag.messages(name):
        with foreign(what):
            calibration = from_camera_info(message, what)
        if not calibration.calibrated:
            blank += 1
        elif not found or calibration != found[-1].calibration:
            found.append(_Lens(calibration=calibration, stamp=_stamp(message, bag_ns), bag_ns=bag_ns))
    return found, blank


def _only_lens(bag: _Bag, topic: str, found: list[_Lens], what: str) -> _Lens:
    """The one lens that describes all frames."""
    frames = [(_stamp(message, bag_ns), bag_ns) for _, bag_ns, message in bag.messages(topic)]
    used: list[_Lens] = []
    lenses = [found[0], *(_begin(lens, frames) for lens in found[1:])]
    for lens, following in zip(lenses, [*(later.frame for later in lenses[1:]), len(frames)], strict=True):
        if lens.frame < following and not (used and used[-1].calibration == lens.calibration):
            used.append(lens)
    if len(used) == 1:
        return used[0]
    one, other = used[:2]
    before, after = differences(one.calibration, other.calibration)
    raise BadInputError(
        f"{what}: the lens changes: {before} up to frame {other.frame - 1}, {after} from frame"
        f" {other.frame} on; cut the bag there ({_cut(bag.path, other.bag_ns)}) and import each part, or give"
        " --intrinsics FX,FY,CX,CY if one lens holds for all"
    )


def _begin(lens: _Lens, frames: list[tuple[int, int]]) -> _Lens:
    """The lens with its first frame: that of the same time stamp, else the first one after it in the bag."""
    same = [number for number, (stamp, _) in enumerate(frames) if stamp == lens.stamp]
    frame = same[0] if same else sum(bag_ns < lens.bag_ns for _, bag_ns in frames)
    bag_ns = min([lens.bag_ns, *(ns for _, ns in frames[frame : frame + 1])])
    return replace(lens, frame=frame, bag_ns=bag_ns)


def _cut(path: Path, bag_ns: int) -> str:
    """Command that cuts a bag in two."""
    name = shlex.quote(str(path))
    if path.suffix == ".bag":
        return f"rosbag filter {name} first.bag 't.to_nsec() < {bag_ns}', and second.bag with >="
    return (
        f"ros2 bag convert -i {name} -o cut.yaml, with cut.yaml: {{output_bags: [{{uri: first, all: true,"
        f" end_time_ns: {bag_ns - 1}}}, {{uri: second, all: true, start_time_ns: {bag_ns}}}]}}"
    )
