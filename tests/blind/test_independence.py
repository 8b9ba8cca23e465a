"""The bench shares no code with the package that it judges."""

import ast
from pathlib import Path

import pytest

MODULES = sorted(p for p in Path(__file__).parent.glob("*.py") if not p.name.startswith("test_"))


@pytest.mark.parametrize("module", MODULES, ids=lambda p: p.name)
def test_never_imports_the_package(module: Path) -> None:
    names = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names.add(str(node.module).split(".")[0])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            assert called not in ("__import__", "import_module")
    assert "tofmix" not in names


def test_the_simulator_is_there() -> None:
    assert {"camera.py", "effects.py", "geometry.py", "strangers.py"} <= {m.name for m in MODULES}
