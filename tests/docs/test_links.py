"""The Markdown pages: links lead somewhere, commands are ones that click takes, and the first pages are short."""

import re
import shlex
from functools import cache
from pathlib import Path

import click
import pytest

from tofmix.cli.main import main

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


def test_every_link_leads_to_a_file_and_a_heading_that_exist() -> None:
    assert sum(len(links(page)) for page in PAGES) > 100
    dead = [f"{page.relative_to(ROOT)}: {link}" for page in PAGES for link in links(page) if leads_nowhere(page, link)]
    assert not dead, "\n".join(dead)


def test_index_lists_every_page_of_docs() -> None:
    index = ROOT / "docs/index.md"
    listed = {(index.parent / link).resolve() for link in links(index)}
    missing = [n for p, n in zip(PAGES, NAMES, strict=True) if n.startswith("docs/") and p not in {*listed, index}]
    assert not missing, "\n".join(missing)


def test_readme_and_tutorials_are_short() -> None:
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in (ROOT / "README.md", *TUTORIALS)}
    assert words.pop(ROOT / "README.md") < MOST_WORDS_OF_README
    assert max(words.values()) < MOST_WORDS_OF_A_TUTORIAL


def test_every_script_that_a_page_runs_exists() -> None:
    named = {(name, s) for p, name in zip(PAGES, NAMES, strict=True) for s in SCRIPT.findall(p.read_text("utf-8"))}
    assert len(named) > 10
    missing = [f"{name}: {script}" for name, script in named if not (ROOT / script).is_file()]
    assert not missing, "\n".join(missing)


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


def test_a_wrong_option_or_command_has_a_fault() -> None:
    assert fault_of(["tofmix", "estimate", "x.h5", "--sigmas", "tied"]) != ""
    assert fault_of(["tofmix", "estimates", "x.h5"]) != ""
    assert fault_of(["tofmix", "estimate", "x.h5", "--sigma", "tied"]) == ""


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
