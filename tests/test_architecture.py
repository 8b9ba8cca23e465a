"""Imports point one way: cli -> io, report -> estimation, simulation -> root modules -> optics, compiled."""

import ast
from collections.abc import Iterator
from pathlib import Path

from support.modules import MODULES, PACKAGE, nodes, tree

COMMON = {"optics", "compiled"}
"""Folders below the root modules, which all may import."""

MAY_IMPORT = {
    "api": {
        "api",
        "jobs",
        "io",
        "report",
        "reconciliation",
        "estimation",
        "simulation",
        "sensors",
        "unmixing",
        "suspicion",
    },
    "cli": {
        "cli",
        "jobs",
        "pipeline",
        "io",
        "report",
        "reconciliation",
        "estimation",
        "unmixing",
        "mapping",
        "surfaces",
        "simulation",
        "sensors",
    },
    "jobs": {
        "jobs",
        "pipeline",
        "io",
        "report",
        "reconciliation",
        "estimation",
        "mapping",
        "surfaces",
        "simulation",
        "sensors",
    },
    "pipeline": {"pipeline", "io", "estimation", "unmixing", "suspicion", "mapping", "simulation", "surfaces"},
    "io": {"io", "mapping", "simulation", "surfaces", "suspicion"},
    "report": {
        "report",
        "io",
        "surfaces",
        "reconciliation",
        "estimation",
        "unmixing",
        "simulation",
        "sensors",
        "suspicion",
    },
    "reconciliation": {"reconciliation", "simulation"},
    "estimation": {"estimation", "unmixing", "suspicion"},
    "suspicion": {"suspicion", "image"},
    "unmixing": {"unmixing", "image"},
    "image": {"image"},
    "mapping": {"mapping"},
    "surfaces": {"surfaces", "image"},
    "simulation": {"simulation", "sensors"},
    "sensors": {"sensors"},
    "optics": {"optics", "compiled"},
    "compiled": {"compiled"},
    "": set(),
}
BELOW_COMMON = {"arrays", "version"}
"""Root modules that the folders below them may import."""

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
    for node in nodes(module):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def _misplaced(module: Path) -> Iterator[str]:
    """Imports that the folder of a module may not have."""
    if module.parent == PACKAGE and module.name in ("__main__.py", "__init__.py"):
        return  # the command, and what `import tofmix` offers
    folder = _folder(module)
    for name in _imports(module):
        top, *rest = name.split(".")
        if folder not in ONLY_IN.get(top, {folder}):
            yield f"{module.relative_to(PACKAGE)}: {name} belongs to tofmix/{' or '.join(ONLY_IN[top])}"
        if top == "tofmix" and rest and not _may_import(folder, rest[0]):
            yield f"{module.relative_to(PACKAGE)}: tofmix/{folder} must not import {name}"


def _may_import(folder: str, name: str) -> bool:
    """Whether a module of a folder may import a folder, or a root module."""
    if folder in COMMON:
        return name in MAY_IMPORT[folder] | BELOW_COMMON
    return name in MAY_IMPORT[folder] | COMMON or not (PACKAGE / name).is_dir()


def test_imports_point_one_way() -> None:
    assert len(MODULES) > 100
    offenders = [text for module in MODULES for text in _misplaced(module)]
    assert not offenders, "\n".join(offenders)


ORDER = {
    "estimation": ("noise", "peaks", "mixture", "learnt", "blocks"),
    "io": ("guard", "recording", "layers", "importers", "exporters"),
    "report": ("summary", "descriptions", "pixels", "figures", "explorer", "page", "comparison", "gap"),
    "reconciliation": ("likelihood", "comparison", "parameters", "search", "verification"),
    "simulation": ("casting", "effects"),
}
"""Subfolders of a folder: each may import those before it. What two of them use stands in the folder above."""


def _subfolder(parts: tuple[str, ...]) -> str:
    return "/".join(parts[:2]) if len(parts) > 1 and (PACKAGE / "/".join(parts[:2])).is_dir() else ""


def test_folders_within_a_folder_import_one_way() -> None:
    edges = set()
    for module in MODULES:
        here = _subfolder(module.relative_to(PACKAGE).parts)
        for name in _imports(module):
            top, *rest = name.split(".")
            there = _subfolder(tuple(rest)) if top == "tofmix" else ""
            if here and there and here != there and here.split("/")[0] == there.split("/")[0]:
                edges.add((here, there))
    assert len(edges) > 10
    place = {f"{folder}/{part}": index for folder, parts in ORDER.items() for index, part in enumerate(parts)}
    assert {here for edge in edges for here in edge} <= place.keys(), "a subfolder has no place in ORDER"
    against = [f"{here} must not import {there}" for here, there in sorted(edges) if place[here] < place[there]]
    assert not against, "\n".join(against)


def test_every_module_has_a_docstring() -> None:
    offenders = [str(module.relative_to(PACKAGE)) for module in MODULES if not ast.get_docstring(tree(module))]
    assert not offenders, "\n".join(offenders)


def _is_number(value: ast.expr) -> bool:
    if isinstance(value, ast.Tuple):
        return bool(value.elts) and all(_is_number(element) for element in value.elts)
    if isinstance(value, ast.BinOp):
        return _is_number(value.left) and _is_number(value.right)
    if isinstance(value, ast.UnaryOp):
        return _is_number(value.operand)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def _unexplained_constants(module: Path) -> Iterator[str]:
    """Numbers at a module's top level with no comment, and no string below them or below their block of assignments."""
    lines, body = ["", *module.read_text().splitlines(), ""], tree(module).body
    for node in body:
        if not (isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _is_number(node.value)):
            continue
        end = node.end_lineno or node.lineno
        for later in body:
            if isinstance(later, ast.Assign | ast.AnnAssign) and later.lineno == end + 1:
                end = later.end_lineno or end
        has_comment = "#" in lines[node.lineno] or lines[node.lineno - 1].startswith("#")
        if not has_comment and not lines[end + 1].startswith('"""'):
            yield f"{module.relative_to(PACKAGE)}:{node.lineno}: {lines[node.lineno]}"


def test_every_numeric_constant_is_explained() -> None:
    offenders = [text for module in MODULES for text in _unexplained_constants(module)]
    assert not offenders, "\n".join(offenders)
