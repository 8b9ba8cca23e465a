"""The bench shares no code with the package that it judges."""

import ast
from pathlib import Path

MODULES = sorted(p for p in Path(__file__).parent.glob("*.py") if not p.name.startswith("test_"))


def _imported(module: Path) -> set[str]:
    """The packages that a module imports by statements; "dynamic" for those that it names at run time."""
    names = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(str(node.module).split(".")[0] if node.level == 0 else "relative")
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            if called in ("__import__", "import_module"):
                names.add("dynamic")
    return names


def test_no_module_of_the_bench_imports_the_package() -> None:
    assert {"camera.py", "effects.py", "geometry.py", "strangers.py"} <= {m.name for m in MODULES}
    forbidden = {"tofmix", "relative", "dynamic"}
    offenders = {module.name: found for module in MODULES if (found := _imported(module) & forbidden)}
    assert offenders == {}
