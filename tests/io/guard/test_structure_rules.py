"""What a header may claim: each rule refuses, by name, before a byte of data is read."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.io.guard.structure_rules import LIMITS, RefusedError, check_structure
from tofmix.io.recording.recording_file import open_recording

Change = Callable[[h5py.File], object]


def _dataset(shape: tuple[int, ...], **settings: object) -> Change:
    return lambda root: root.create_dataset("x", shape, **({"dtype": "u2"} | settings))


def _external(root: h5py.File) -> None:
    root["sensor/x"] = h5py.ExternalLink("other.h5", "/x")


def _numbers(root: h5py.File) -> None:
    root.attrs["x"] = np.zeros(50)


def _virtual(root: h5py.File) -> None:
    layout = h5py.VirtualLayout((4,), "u2")
    layout[:] = h5py.VirtualSource("other.h5", "range", (4,))
    root.create_virtual_dataset("group/x", layout)


def _texts(root: h5py.File) -> None:
    root["sensor"].attrs.create("x", "a" * 5000)


def _many(root: h5py.File) -> None:
    for number in range(30):
        root[f"link{number}"] = h5py.SoftLink("/range")


def _attributes(root: h5py.File) -> None:
    for number in range(30):
        root["range"].attrs[f"a{number}"] = number


def _unknown_filter(root: h5py.File) -> None:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((4,))
    plist.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, (1,))
    h5py.h5d.create(root.id, b"x", h5py.h5t.NATIVE_UINT16, h5py.h5s.create_simple((4,)), plist)


def _filtered(*filters: tuple[int, tuple[int, ...]]) -> Change:
    def change(root: h5py.File) -> None:
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((4,))
        for code, values in filters:
            plist.set_filter(code, h5py.h5z.FLAG_OPTIONAL, values)
        h5py.h5d.create(root.id, b"x", h5py.h5t.NATIVE_UINT16, h5py.h5s.create_simple((4,)), plist)

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_filtered((1, (1,)), (1, (1,))), "x: compressed by gzip and then by another filter"),
        (_filtered((1, (1,)), (32000, ())), "x: compressed by gzip and then by another filter"),
        (_dataset((9_000_000,), chunks=(9_000_000,), compression="lzf"), "x: one lzf chunk is over 16.78"),
        (_external, "sensor/x: a link to another file"),
        (_virtual, "group/x: its data lie in another file"),
        (_dataset((4,), external=[("/etc/passwd", 0, 8)]), "x: its data lie in another file"),
        (_unknown_filter, "x: filter 32001 is not one of gzip"),
        (_dataset((1,) * 9), "x: 9 dimensions; at most 8"),
        (_dataset((1 << 30, 1 << 30), chunks=(1, 4)), r"x: shape .* takes 2.306e\+06 TB; at most 17.59 TB"),
        (_dataset((10_000_000, 4, 4), chunks=(1000, 4, 4)), r"declares 320 MB, the file holds .* bytes; refused"),
        (
            _dataset((10, 144, 176), chunks=(30_000, 144, 176), maxshape=(None, 144, 176)),
            "x: one chunk .* takes 1.521 GB; at most 268.4 MB",
        ),
        (_dataset((1 << 25,), chunks=(1,), dtype="u1"), "x: 33554432 chunks of 1 bytes"),
        (_dataset((1,), dtype="S2000000"), "x: one value takes 2 MB"),
    ],
)
def test_excessive_header_values_are_refused_at_any_depth(tmp_path: Path, change: Change, reason: str) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with open_recording(path):
        pass
    with h5py.File(path, "r+") as root:
        change(root)
    with pytest.raises(BadInputError, match=reason) as caught, open_recording(path):
        pass
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("change", "bound", "reason"),
    [
        (_many, "objects", "more than 20 objects"),
        (_attributes, "attributes", "range: 30 attributes; at most 20"),
        (_texts, "attribute_bytes", "sensor: attribute x takes 5000 bytes"),
        (_numbers, "attribute_bytes", "the file: attribute x takes 400 bytes"),
        (lambda root: root.attrs.create("x", ["a" * 30] * 5), "attribute_bytes", "attribute x takes 150 bytes"),
    ],
)
def test_counts_and_attributes_are_bounded(tmp_path: Path, change: Change, bound: str, reason: str) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        change(root)
    with h5py.File(path) as root:
        check_structure(root, path.stat().st_size)
        limits = replace(LIMITS, **{bound: 130 if "bytes" in bound else 20})
        with pytest.raises(RefusedError, match=reason):
            check_structure(root, path.stat().st_size, limits)


def test_no_data_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_recording(tmp_path / "r.h5", boards(), chunks=(7, 3, 4), compression="gzip")

    def fail(*_: object) -> None:
        pytest.fail("data were read")

    monkeypatch.setattr(h5py.Dataset, "__getitem__", fail)
    with h5py.File(path) as root:
        check_structure(root, path.stat().st_size)


def test_chunks_outside_of_the_file_are_refused(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", boards(200, 16, 20), chunks=(7, 3, 4), compression="gzip")
    with h5py.File(path) as root, pytest.raises(RefusedError, match="range: its index of chunks is damaged"):
        check_structure(root, 5000)


def test_extra_objects_of_foreign_files_are_accepted(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        root["texts"] = ["a", "b"]
        root["empty"] = h5py.Empty("f4")
        root["type"] = np.dtype("f4")
        root["loop"] = h5py.SoftLink("/loop")
        root["nowhere"] = h5py.SoftLink("/none")
        root["again"] = root["sensor"]
        root["sensor/up"] = root
        root.attrs["empty"] = h5py.Empty("f4")
        root.create_dataset("growing", (0, 3), maxshape=(None, 3), dtype="f4")
        root.create_dataset("record", (2,), dtype=[("a", "f4"), ("b", h5py.ref_dtype)])
    with open_recording(path) as recording:
        assert recording.shape == (30, 4, 6)
