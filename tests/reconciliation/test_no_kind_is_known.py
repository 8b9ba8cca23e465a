"""Reconciliation and the report know declarations of effects, and no kind: their sources are read."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.modules import MODULES, PACKAGE, tree

from tofmix.simulation.effects import EFFECTS

FOLDERS = ("reconciliation", "report")
READ = [module for module in MODULES if module.relative_to(PACKAGE).parts[0] in FOLDERS]
TEMPLATES = sorted(path for end in ("html", "js") for path in (PACKAGE / "report").rglob(f"*.{end}"))
OWN_MODULES = {kind.__module__ for kind in EFFECTS.values()}
OWN_CLASSES = {kind.__name__ for kind in EFFECTS.values()}


def _docstrings(code: ast.Module) -> set[int]:
    """Strings that stand alone, which explain and do nothing."""
    return {id(node.value) for node in ast.walk(code) if isinstance(node, ast.Expr)}


def _kinds_in(text: str) -> Iterator[str]:
    """Kinds that a text is, or has as words; kinds of one word are also words of plain sentences."""
    words = text.replace('"', " ").replace("'", " ").replace("`", " ").replace(":", " ").split()
    yield from (kind for kind in EFFECTS if text == kind or ("_" in kind and kind in words))


def known_kinds(code: ast.Module) -> list[str]:
    """Modules, classes and names of registered kinds that a module uses."""
    out, silent = [], _docstrings(code)
    for node in ast.walk(code):
        if isinstance(node, ast.Import):
            out += [alias.name for alias in node.names if alias.name in OWN_MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            out += sorted(({node.module} | names) & OWN_MODULES)
            out += [alias.name for alias in node.names if alias.name in OWN_CLASSES]
        elif isinstance(node, ast.Attribute) and node.attr in OWN_CLASSES:
            out.append(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in silent:
            out += _kinds_in(node.value)
    return out


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from tofmix.simulation.effects.motion import Motion", ["tofmix.simulation.effects.motion", "Motion"]),
        ("from tofmix.simulation.effects import motion", ["tofmix.simulation.effects.motion"]),
        ("import tofmix.simulation.effects.motion", ["tofmix.simulation.effects.motion"]),
        ("effects.Motion(velocity_mm_s=1.0)", ["Motion"]),
        ("e.kind == 'motion'", ["motion"]),
        ("f'give the map of a fixed_pattern: {n}'", ["fixed_pattern"]),
        ("'''A motion, or a fixed_pattern.'''", []),
        ("'the motion of a surface'", []),
    ],
)
def test_use_of_a_kind_is_found_in_code_and_not_in_docstrings(source: str, found: list[str]) -> None:
    code = ast.parse(source if source.startswith(("from", "import", "'''")) else f"x = {source}")
    assert known_kinds(code) == found


def test_no_module_of_reconciliation_or_report_knows_a_kind() -> None:
    assert len(READ) > 60
    offenders = [
        f"{module.relative_to(PACKAGE)}: {name}" for module in READ for name in dict.fromkeys(known_kinds(tree(module)))
    ]
    assert not offenders, "\n".join(offenders)


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.name)
def test_no_template_knows_a_kind(path: Path) -> None:
    assert not [kind for kind in EFFECTS if "_" in kind and kind in path.read_text()]
