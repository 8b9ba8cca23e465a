"""docs/reference/python.md is the public names with their docstrings."""

from pathlib import Path

from python_page import COMMAND, reference

import tofmix

PAGE = Path(__file__).parents[2] / "docs/reference/python.md"


def test_page_is_what_the_command_prints() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference(), f"run: {COMMAND}"


def test_every_public_name_has_a_heading() -> None:
    headings = {
        line.lstrip("# ").removeprefix("tofmix.") for line in reference().splitlines() if line.startswith("###")
    }
    assert set(tofmix.__all__) - {"__version__"} <= headings


def test_parameters_are_items_with_their_types_and_texts() -> None:
    assert '- `units`, {"mm", "cm", "m"}: Unit of `ranges`.' in reference()
    assert "numpy.ndarray" not in reference()
