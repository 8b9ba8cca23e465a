"""The library's messages, cut down to their reasons."""

from pathlib import Path

import h5py
import pytest

from tofmix.errors import BadInputError
from tofmix.io import hdf5
from tofmix.io.guard import guard


def test_a_reason_is_one_short_line() -> None:
    with (
        pytest.raises(BadInputError, match=r"^a\.h5: range: cannot be read: wrong checksum$"),
        guard.reading(Path("a.h5"), "range"),
    ):
        raise OSError("Can't synchronously read data\n (wrong checksum)")


def test_text_attributes_of_either_kind_are_read(tmp_path: Path) -> None:
    import numpy as np

    with h5py.File(tmp_path / "a.h5", "w") as root:
        root.attrs["variable"] = "text"
        root.attrs["fixed"] = np.bytes_(b"text")
        root.attrs["list"] = ["text"]
        root.attrs["number"] = 3
        for key in ("variable", "fixed", "list"):
            assert hdf5.text_attribute(root, key) == "text"
        assert hdf5.text_attribute(root, "number") is None
        assert hdf5.text_attribute(root, "none") is None
