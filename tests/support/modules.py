"""The modules of the package, each parsed once for all tests that look at its code."""

import ast
from functools import cache
from pathlib import Path

import tofmix

PACKAGE = Path(tofmix.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))


@cache
def tree(module: Path) -> ast.Module:
    """The code of a module."""
    return ast.parse(module.read_text())


@cache
def nodes(module: Path) -> tuple[ast.AST, ...]:
    """All nodes of a module's code."""
    return tuple(ast.walk(tree(module)))
