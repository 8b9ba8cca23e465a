"""Models from a file or built in."""

import io
import re
from pathlib import Path

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.io.model_file import load_model, load_model_text
from tofmix.simulation.effects.fixed_pattern import FixedPattern


def test_built_in_models_load() -> None:
    model = load_model("three-boards")
    assert (model.sensor.rows, model.sensor.cols, model.recording.frames) == (144, 176, 100)


def test_a_file_wins_over_a_built_in_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("corridor").write_text("mine")
    assert load_model_text("corridor") == "mine"


def test_an_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(BadInputError, match="three-boards, corridor"):
        load_model("four-boards")


def test_broken_toml_names_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text('[sensor]\nprofile = "sr3000"\nrows = = 3\n')
    with pytest.raises(BadInputError, match=r"m\.toml.*line 3"):
        load_model(str(path))


SMALL = """
[sensor]
profile = "sr3000"
rows = 3
cols = 4
[[effect]]
kind = "fixed_pattern"
map = "maps/pattern.npy"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "maps").mkdir()
    (tmp_path / "m.toml").write_text(SMALL)
    return tmp_path


def test_map_is_read_from_the_folder_of_the_model(folder: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.save(folder / "maps" / "pattern.npy", values)
    (effect,) = load_model(str(folder / "m.toml")).effects
    assert isinstance(effect, FixedPattern)
    assert effect.map is not None
    assert effect.map.path == "maps/pattern.npy"
    np.testing.assert_array_equal(effect.map.values, values)


@pytest.mark.parametrize(
    ("path", "values", "reason"),
    [
        ("maps/pattern.npy", None, "No such file or directory"),
        ("../pattern.npy", None, "expected a path within the model's folder"),
        ("/etc/passwd", None, "expected a path within the model's folder"),
        ("", None, "expected a path within the model's folder"),
        ("m.toml", None, "not an .npy file of numbers"),
        ("maps", None, "Is a directory"),
        ("maps/pattern.npy", np.zeros((4, 3), np.float32), "shape (4, 3) differs from the image (3, 4)"),
        ("maps/pattern.npy", np.zeros((3, 4), np.int32), "expected float32, got int32"),
        ("maps/pattern.npy", np.full((3, 4), np.nan, np.float32), "a value is not finite"),
        ("maps/pattern.npy", np.array([[{}]], dtype=object), "not an .npy file of numbers"),
    ],
)
def test_an_unfit_map_is_refused_in_one_line(folder: Path, path: str, values: object, reason: str) -> None:
    if values is not None:
        np.save(folder / "maps" / "pattern.npy", np.asarray(values))
    (folder / "m.toml").write_text(SMALL.replace("maps/pattern.npy", path))
    with pytest.raises(BadInputError, match=r"m\.toml: \[\[effect\]\] 1: map: .*" + re.escape(reason)) as caught:
        load_model(str(folder / "m.toml"))
    assert "\n" not in str(caught.value)


def test_map_that_declares_terabytes_is_refused_without_memory(folder: Path) -> None:
    header = io.BytesIO()
    claim = {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20)}
    np.lib.format.write_array_header_1_0(header, claim)
    (folder / "maps" / "pattern.npy").write_bytes(header.getvalue())
    with pytest.raises(BadInputError, match="map: "):
        load_model(str(folder / "m.toml"))
