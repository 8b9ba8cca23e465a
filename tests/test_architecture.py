"""Imports point one way: cli -> io, report -> estimation, simulation -> the root modules."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import tofmix

PACKAGE = Path(tofmix.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

MAY_IMPORT = {
    "api": {"api", "io", "report", "reconciliation", "estimation", "simulation", "sensors"},
    "cli": {"cli", "pipeline", "io", "report", "reconciliation", "estimation", "mapping", "simulation", "sensors"},
    "pipeline": {"pipeline", "io", "estimation", "mapping", "simulation"},
    "io": {"io", "mapping", "simulation"},
    "report": {"report", "reconciliation", "estimation", "simulation", "sensors"},
    "reconciliation": {"reconciliation", "simulation"},
    "estimation": {"estimation"},
    "mapping": {"mapping"},
    "simulation": {"simulation", "sensors"},
    "sensors": {"sensors"},
    "": set(),
}
ONLY_IN = {
    "h5py": {"io"},
    "sqlite3": {"io"},
    "distributed": {"pipeline"},
    "click": {"cli"},
    "tqdm": {"cli"},
    "matplotlib": {"report", "api"},
    "jinja2": {"report"},
    "xarray": {"api"},
    "plyfile": {"io"},
}


def _folder(module: Path) -> str:
    inside = module.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else ""


def _imports(module: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(module: Path) -> None:
    if module == PACKAGE / "__main__.py" or module == PACKAGE / "__init__.py":
        return  # the command, and what `import tofmix` offers
    folder = _folder(module)
    for name in _imports(module):
        top, *rest = name.split(".")
        assert folder in ONLY_IN.get(top, {folder}), f"{name} belongs to tofmix/{ONLY_IN.get(top)}"
        if top == "tofmix" and rest and (PACKAGE / rest[0]).is_dir():
            assert rest[0] in MAY_IMPORT[folder], f"tofmix/{folder} must not import {name}"


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_every_module_says_what_it_is_for(module: Path) -> None:
    assert ast.get_docstring(ast.parse(module.read_text()))
