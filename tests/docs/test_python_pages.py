"""The Python pages and docs/reference/formats.md do what they say: their blocks run, in order, as one program each."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.commandline import succeed
from support.files import boards, write_recording

from tofmix.flags import STATUS_MEANINGS, status_name
from tofmix.io.schema import (
    LAW_FIELDS,
    LAYERS_FIELDS,
    RANGE_TRUE_FRAMES,
    RECORDING_FIELDS,
    SURFACES_FIELDS,
    TRUTH_FIELDS,
    Field,
)
from tofmix.simulation.model_toml import parse_model

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("tutorials/python.md", "how-to/python.md", "how-to/scene.md", "reference/formats.md")
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def program(page: str) -> str:
    """The page's blocks, each on the lines where it stands in the page, so that a traceback names them."""
    lines = [""] * (page.count("\n") + 1)
    for block in BLOCK.finditer(page):
        first = page.count("\n", 0, block.start(1))
        for offset, line in enumerate(block[1].splitlines()):
            lines[first + offset] = line
    return "\n".join(lines)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the pages name."""
    folder = tmp_path_factory.mktemp("docs")
    write_recording(folder / "recording.h5", boards(100))
    succeed("estimate", folder / "recording.h5")
    succeed("simulate", "three-boards", "--frames", 20, "-o", folder / "boards.h5")
    succeed("estimate", folder / "boards.h5")
    succeed("surfaces", folder / "boards.layers.h5")
    return folder


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a clone of the repository has, and nothing else: a reader runs the tutorial there."""
    folder = tmp_path_factory.mktemp("clone")
    (folder / "sample_data").symlink_to(DOCS.parent / "sample_data")
    return folder


@pytest.mark.slow
@pytest.mark.compiled("it estimates 25,344 pixels")
@pytest.mark.parametrize("name", PAGES)
def test_every_block_runs_without_a_warning(folder: Path, clone: Path, name: str) -> None:
    if name.startswith("tutorials/"):
        folder = clone
    code = program((DOCS / name).read_text(encoding="utf-8"))
    assert "import" in code
    (folder / "page.py").write_text(code, encoding="utf-8")
    command = [sys.executable, "-W", "error", "page.py"]
    environment = os.environ | {
        "PYTHONPATH": str(DOCS.parent)
    }  # the package that this process tests, not an installed one
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0, f"docs/{name} (line numbers are the page's):\n{ran.stderr}"
    said = [line for line in ran.stderr.splitlines() if not line.startswith("tofmix: compiling the kernels")]
    assert said == []  # but for what a first run says
    if name == "reference/formats.md":
        succeed("estimate", folder / "mine.h5", "--overwrite")


def test_every_fenced_block_is_run_or_parsed() -> None:
    for name in PAGES:
        fences = re.findall(r"^```(.*)$", (DOCS / name).read_text(encoding="utf-8"), re.MULTILINE)
        assert set(fences[::2]) <= {"python", "toml"}, name
        assert set(fences[1::2]) == {""}, name


def test_the_model_of_the_page_is_read() -> None:
    page = (DOCS / "reference/formats.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert parse_model(text, source="docs/reference/formats.md").surfaces[0].name == "white board"


FIELDS = (*RECORDING_FIELDS, *TRUTH_FIELDS, RANGE_TRUE_FRAMES, *LAYERS_FIELDS, *LAW_FIELDS, *SURFACES_FIELDS)


@pytest.mark.parametrize("spec", FIELDS, ids=lambda spec: spec.name)
def test_each_dataset_of_a_file_has_a_row_with_its_dimensions_type_and_unit(spec: Field) -> None:
    page = (DOCS / "reference/formats.md").read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"]
    rows = [row[1:4] for row in cells if len(row) > 3 and f"`{spec.name}`" in row[0].split(", ")]
    expected = [", ".join(spec.dims), spec.units]
    assert any(
        [dims, units] == expected and np.dtype(spec.dtype).name in kind.split(" or ") for dims, kind, units in rows
    ), rows


def test_the_table_of_statuses_is_that_of_the_code() -> None:
    page = (DOCS / "reference/formats.md").read_text(encoding="utf-8")
    for status, meaning in STATUS_MEANINGS.items():
        assert f"| {int(status)} | {status_name(status)} | {meaning}" in page.replace("`", "")
