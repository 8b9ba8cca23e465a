"""The Markdown pages: links, commands, blocks of Python, guarantees and shell loops."""

import os
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import click
import numpy as np
import pytest
from support.commandline import succeed
from support.files import boards, write_recording

from tofmix.cli.main import main
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

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "sample_data").glob("*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
MOST_WORDS_OF_README, MOST_WORDS_OF_A_TUTORIAL = 900, 800

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
SCRIPT = re.compile(r"\bpython ((?:tests|docs|sample_data)/[\w/]+\.py)")


@cache
def anchors(page: Path) -> frozenset[str]:
    """Anchors of the headings outside fences, as forges make them."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", re.sub(r"[`*]", "", h).lower()) for h in headings)
    return frozenset(text.strip().replace(" ", "-") for text in plain)


def links(page: Path) -> list[str]:
    """Links of a page that stay in the repository."""
    return [link for link in LINK.findall(page.read_text(encoding="utf-8")) if not re.match(r"[a-z]+:", link)]


def leads_nowhere(page: Path, link: str) -> bool:
    name, _, anchor = link.partition("#")
    target = page.parent / name if name else page
    return not target.exists() or bool(anchor and target.suffix == ".md" and anchor not in anchors(target.resolve()))


def test_pages_are_listed_and_short_and_their_links_lead_somewhere() -> None:
    assert sum(len(links(page)) for page in PAGES) > 100
    dead = [f"{page.relative_to(ROOT)}: {link}" for page in PAGES for link in links(page) if leads_nowhere(page, link)]
    assert not dead, "\n".join(dead)
    index = ROOT / "docs/index.md"
    listed = {(index.parent / link).resolve() for link in links(index)}
    missing = [n for p, n in zip(PAGES, NAMES, strict=True) if n.startswith("docs/") and p not in {*listed, index}]
    assert not missing, "\n".join(missing)
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in (ROOT / "README.md", *TUTORIALS)}
    assert words.pop(ROOT / "README.md") < MOST_WORDS_OF_README
    assert max(words.values()) < MOST_WORDS_OF_A_TUTORIAL


def test_scripts_of_pages_exist_and_a_wrong_command_has_a_fault() -> None:
    named = {(name, s) for p, name in zip(PAGES, NAMES, strict=True) for s in SCRIPT.findall(p.read_text("utf-8"))}
    assert len(named) > 10
    missing = [f"{name}: {script}" for name, script in named if not (ROOT / script).is_file()]
    assert not missing, "\n".join(missing)
    assert fault_of(["tofmix", "estimate", "x.h5", "--sigmas", "tied"]) != ""
    assert fault_of(["tofmix", "estimates", "x.h5"]) != ""
    assert fault_of(["tofmix", "estimate", "x.h5", "--sigma", "tied"]) == ""


def commands(page: Path) -> list[list[str]]:
    """Words of each line of a shell fence that begins with `tofmix`, up to a comment, a pipe or a redirection."""
    shell = (text for language, text in FENCE.findall(page.read_text(encoding="utf-8")) if language in ("sh", "bash"))
    lines = [line for text in shell for line in text.replace("\\\n", " ").splitlines()]
    found = [shlex.split(line, comments=True) for line in lines if line.startswith("tofmix ")]
    ends = [next((k for k, w in enumerate(words) if w in ("|", ">", "&&", "2>")), len(words)) for words in found]
    return [words[:end] for words, end in zip(found, ends, strict=True)]


def fault_of(words: list[str]) -> str:
    """What click has against a command line; empty if nothing."""
    if len(words) < 2 or words[1].startswith(("-", "[")):
        return ""
    command = main.commands.get(words[1])
    if command is None:
        return f"no command {words[1]}"
    if "[OPTIONS]" in words:
        return ""
    try:  # a path need not exist: values are not converted
        command.make_parser(click.Context(command)).parse_args(words[2:])
    except click.UsageError as error:
        return error.format_message()
    return ""


@pytest.mark.parametrize("kind", ["README.md", "docs/tutorials", "docs/how-to", "docs/reference", "docs/explanation"])
def test_every_command_of_a_shell_fence_is_one_that_click_takes(kind: str) -> None:
    pages = [(p, n) for p, n in zip(PAGES, NAMES, strict=True) if n.startswith(kind)]
    faults = [
        f"{name}: {' '.join(words)}: {fault}"
        for page, name in pages
        for words in commands(page)
        if (fault := fault_of(words))
    ]
    assert not faults, "\n".join(faults)


DOCS = Path(__file__).parents[2] / "docs"
PAGES_PYTHON = ("tutorials/python.md", "how-to/python.md", "how-to/scene.md", "reference/formats.md")
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
@pytest.mark.parametrize("name", PAGES_PYTHON)
def test_every_block_runs_without_a_warning(request: pytest.FixtureRequest, name: str) -> None:
    folder: Path = request.getfixturevalue("clone" if name.startswith("tutorials/") else "folder")
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
    for name in PAGES_PYTHON:
        fences = re.findall(r"^```(.*)$", (DOCS / name).read_text(encoding="utf-8"), re.MULTILINE)
        assert set(fences[::2]) <= {"python", "toml", "sh"}, name  # other tests run shell commands
        assert set(fences[1::2]) == {""}, name


def test_model_and_statuses_of_the_pages_are_those_of_the_code() -> None:
    page = (DOCS / "reference/formats.md").read_text(encoding="utf-8")
    text, *_ = re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert parse_model(text, source="docs/reference/formats.md").surfaces[0].name == "white board"
    page = (DOCS / "reference/formats.md").read_text(encoding="utf-8")
    for status, meaning in STATUS_MEANINGS.items():
        assert f"| {int(status)} | {status_name(status)} | {meaning}" in page.replace("`", "")


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


PAGE = (ROOT / "docs/explanation/reliability.md").read_text()


def test_every_named_test_exists() -> None:
    named = 0
    for line in PAGE.splitlines():
        module: Path | None = None
        for path, function in re.findall(r"`(tests/[\w/]+\.py)?(?:::(\w+))?`", line):
            if not path and not function:
                continue
            module = ROOT / path if path else module
            assert module is not None, line
            text = module.read_text()
            if function:
                assert f"def {function}(" in text, f"{module}: no {function}"
            named += 1
    assert named > 30


def test_every_guarantee_names_its_test() -> None:
    offenders = []
    for section in ("Reading", "Writing", "Signals", "Code and network"):
        text = PAGE.split(f"### {section}\n", 1)[1].split("\n#", 1)[0]
        rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| guarantee")]
        assert rows, section
        offenders += [row for row in rows if "`tests/" not in row and "the same" not in row]
    assert not offenders, "\n".join(offenders)


PAGE_CLUSTER_PAGE = (Path(__file__).parents[2] / "docs/how-to/cluster.md").read_text()


def script(name: str) -> str:
    found = re.search(rf"<!-- ci:{name} -->\n```sh\n(.*?)^```$", PAGE_CLUSTER_PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


@pytest.mark.slow
@pytest.mark.compiled("it estimates whole images in other processes")
def test_merged_tasks_of_the_array_give_the_bytes_of_one_run(tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "recording.h5", boards(200, 12, 16))
    (tmp_path / "task.sh").write_text(script("array"))
    (tmp_path / "tofmix").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tofmix "$@"\n')
    (tmp_path / "tofmix").chmod(0o755)
    # Task 2 is started twice, as after a failure of its node.
    loop = (
        "set -e; export SLURM_ARRAY_TASK_COUNT=2\n"
        f"for task in 2 1 2; do SLURM_ARRAY_TASK_ID=$task bash task.sh; done\n{script('merge')}\n"
    )
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    tasks = subprocess.run(
        ["/bin/bash", "-c", loop], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert tasks.returncode == 0, tasks.stderr
    whole = tmp_path / "whole.layers.h5"
    succeed("estimate", recording, "--window", 50, "-o", whole)
    assert (tmp_path / "recording.layers.h5").read_bytes() == whole.read_bytes()
