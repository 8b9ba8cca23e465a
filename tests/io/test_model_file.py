"""Models from a file or built in."""

from pathlib import Path

import pytest

from tofmix.errors import BadInputError
from tofmix.io.model_file import load_model, load_model_text


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
