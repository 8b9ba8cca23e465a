"""ROS bags of depth images, written by rosbags."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

KINDS = ("ros1", "sqlite3", "mcap")
DEPTH, AMPLITUDE, INFO = "/camera/depth/image_raw", "/camera/ir/image_raw", "/camera/depth/camera_info"
ENCODINGS = {"u2": "16UC1", "f4": "32FC1", "u1": "mono8"}


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: Any, kind: str) -> None:  # noqa: ANN401  either writer
        self._ros1 = kind == "ros1"
        self._store = get_typestore(Stores.ROS1_NOETIC if self._ros1 else Stores.ROS2_HUMBLE)
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def _header(self, stamp_ns: int) -> Any:  # noqa: ANN401  a ROS message
        types = self._store.types
        time = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        sequence = {"seq": 0} if self._ros1 else {}
        return types["std_msgs/msg/Header"](**sequence, stamp=time, frame_id="camera")

    def _write(self, topic: str, kind: str, message: Any, bag_ns: int) -> None:  # noqa: ANN401  a ROS message
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        serialize = self._store.serialize_ros1 if self._ros1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], bag_ns, serialize(message, kind))

    def image(
        self,
        topic: str,
        pixels: NDArray[Any],
        *,
        stamp_ns: int,
        bag_ns: int | None = None,
        padding: int = 0,
        big_endian: bool = False,
        encoding: str | None = None,
        lost_bytes: int = 0,
    ) -> None:
        """Write one image; rows may be padded with rubbish, the data may be too short."""
        rows, cols = pixels.shape
        raw = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<"))
        lines = np.full((rows, cols * raw.itemsize + padding), 0xA5, dtype=np.uint8)
        lines[:, : cols * raw.itemsize] = raw.view(np.uint8).reshape(rows, -1)
        data = lines.ravel()[: lines.size - lost_bytes]
        message = self._store.types["sensor_msgs/msg/Image"](
            header=self._header(stamp_ns),
            height=rows,
            width=cols,
            encoding=encoding or ENCODINGS[raw.dtype.str[1:]],
            is_bigendian=int(big_endian),
            step=lines.shape[1],
            data=data,
        )
        self._write(topic, "sensor_msgs/msg/Image", message, stamp_ns if bag_ns is None else bag_ns)

    def info(
        self,
        topic: str,
        size: tuple[int, int],
        intrinsics: Sequence[float],
        *,
        distortion: Sequence[float] = (0.0,) * 5,
        model: str = "plumb_bob",
        projection: Sequence[float] = (0.0,) * 4,
        region: tuple[int, int, int, int] = (0, 0, 0, 0),
        binning: tuple[int, int] = (0, 0),
        stamp_ns: int = 1,
        bag_ns: int | None = None,
    ) -> None:
        """Write one camera_info with fx, fy, cx, cy, and those of rectified images.

        `region` is its first row and column, its rows and columns; `binning` down and across.
        """
        fx, fy, cx, cy = intrinsics
        types = self._store.types
        roi = types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=region[1], y_offset=region[0], height=region[2], width=region[3], do_rectify=False
        )
        names = dict(zip("dkrp", "DKRP" if self._ros1 else "dkrp", strict=True))
        matrices = {
            names["d"]: np.array(distortion or (0.0,) * 5, dtype=np.float64),
            names["k"]: np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], dtype=np.float64),
            names["r"]: np.eye(3).ravel(),
            names["p"]: np.array([projection[0], 0, projection[2], 0, 0, projection[1], projection[3], 0] + [0.0] * 4),
        }
        message = types["sensor_msgs/msg/CameraInfo"](
            header=self._header(stamp_ns),
            height=size[0],
            width=size[1],
            distortion_model=model,
            binning_x=binning[1],
            binning_y=binning[0],
            roi=roi,
            **matrices,
        )
        self._write(topic, "sensor_msgs/msg/CameraInfo", message, stamp_ns if bag_ns is None else bag_ns)

    def number(self, topic: str, value: float, *, bag_ns: int = 1) -> None:
        """Write one std_msgs/Float32."""
        message = self._store.types["std_msgs/msg/Float32"](data=value)
        self._write(topic, "std_msgs/msg/Float32", message, bag_ns)

    def compressed(self, topic: str, *, stamp_ns: int) -> None:
        """Write one compressed image, without sensible data."""
        message = self._store.types["sensor_msgs/msg/CompressedImage"](
            header=self._header(stamp_ns), format="16UC1; compressedDepth png", data=np.zeros(30, dtype=np.uint8)
        )
        self._write(topic, "sensor_msgs/msg/CompressedImage", message, stamp_ns)


@contextmanager
def new_bag(folder: Path, kind: str) -> Iterator[tuple[Bag, Path]]:
    """Write a bag; yields it and its path."""
    path = folder / ("bag.bag" if kind == "ros1" else f"bag_{kind}")
    if kind == "ros1":
        with Writer1(path) as writer:
            yield Bag(writer, kind), path
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        with Writer2(path, version=9, storage_plugin=plugin) as writer:
            yield Bag(writer, kind), path
