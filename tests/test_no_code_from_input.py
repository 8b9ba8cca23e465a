"""Nothing in the package runs code that comes from a file, opens a connection by itself, or holds a secret."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.modules import MODULES, PACKAGE, nodes

RUNS_CODE = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "shelve", "marshal", "joblib", "code", "runpy"}
CONNECTS = {"socket", "ssl", "http", "urllib", "urllib3", "requests", "ftplib", "smtplib", "telnetlib", "aiohttp"}
BUILTINS = {"eval", "exec", "compile", "__import__"}
STARTS_PROGRAMS = {"io/guard/guard.py", "io/importers/matlab.py", "pipeline/first_run.py"}
"""Modules that start a process: each starts the interpreter with a file of the package, never what a file names."""

KEEPS_CODE = {"compiled/kept.py"}
"""Modules that read compiled code: from folders of the installation and of the user alone, never from a given file."""

CALLS_C = {"io/guard/hdf5_memory.py"}
"""Modules that call C themselves: one function of the HDF5 library that h5py has loaded."""

IMPORTS_BY_NAME = {"__init__.py", "io/next_command.py"}
"""Optional libraries, backends and the public names of the package, by names that stand in our own code."""


def _name(module: Path) -> str:
    return str(module.relative_to(PACKAGE))


def _imported(module: Path) -> set[str]:
    found: set[str] = set()
    for node in nodes(module):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def _calls(module: Path) -> dict[str, list[ast.Call]]:
    found: dict[str, list[ast.Call]] = {}
    for node in nodes(module):
        if isinstance(node, ast.Call):
            found.setdefault(ast.unparse(node.func), []).append(node)
    return found


def _code_runners(module: Path) -> Iterator[str]:
    """What in a module could run code that a file holds, or open a connection."""
    tops = {name.split(".")[0] for name in _imported(module)}
    yield from sorted(tops & (RUNS_CODE | CONNECTS) - ({"pickle"} if _name(module) in KEEPS_CODE else set()))
    if _name(module) not in CALLS_C:
        yield from sorted(tops & {"ctypes", "cffi"})
    calls = _calls(module)
    yield from sorted(calls.keys() & (BUILTINS | {"yaml.load"}))
    yield from (name for name in calls if name.startswith(("os.system", "os.popen", "os.exec", "os.spawn")))
    for name, found in calls.items():
        for node in found:
            options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            if options.get("allow_pickle", "False") != "False" or options.get("shell", "False") != "False":
                yield f"{ast.unparse(node)} in line {node.lineno}"
            if name in ("np.load", "numpy.load", "npy_format.read_array") and "allow_pickle" not in options:
                yield f"{name} without allow_pickle=False in line {node.lineno}"


def test_no_module_runs_code_of_a_file_or_connects() -> None:
    assert len(MODULES) > 100
    offenders = [f"{_name(module)}: {text}" for module in MODULES for text in _code_runners(module)]
    assert not offenders, "\n".join(offenders)


def test_modules_that_start_programs_are_known() -> None:
    starting = {_name(module) for module in MODULES if _imported(module) & {"subprocess", "multiprocessing"}}
    assert starting == STARTS_PROGRAMS


def test_modules_that_import_by_name_are_known() -> None:
    importing = {
        _name(module)
        for module in MODULES
        for name, nodes in _calls(module).items()
        if name.endswith("import_module") and not all(isinstance(node.args[0], ast.Constant) for node in nodes)
    }
    assert importing == IMPORTS_BY_NAME


@pytest.mark.parametrize("name", sorted(STARTS_PROGRAMS))
def test_a_started_program_is_a_file_of_the_package(name: str) -> None:
    text = (PACKAGE / name).read_text()
    assert re.search(r'\(?\[?sys\.executable, "-P", str\(Path\(__file__\)\.with_name\("\w+\.py"\)\)', text)


@pytest.mark.parametrize("name", sorted(CALLS_C))
def test_the_called_c_library_is_that_of_h5py(name: str) -> None:
    calls = _calls(PACKAGE / name)
    loads = [node for function, nodes in calls.items() if function.startswith("ctypes.") for node in nodes]
    assert [ast.unparse(node) for node in loads] == ["ctypes.PyDLL(h5py.h5.__file__)"]


def test_the_package_holds_no_secret() -> None:
    words = re.compile(r"(?i)(password|passwd|api_?key|secret_?key|access_?token|BEGIN [A-Z ]*PRIVATE KEY)\s*[=:]")
    for path in PACKAGE.rglob("*"):
        if path.is_file() and path.suffix in (".py", ".toml", ".html", ".js", ".css"):
            assert not words.search(path.read_text()), path


def test_pages_load_nothing_from_elsewhere() -> None:
    for path in PACKAGE.rglob("*"):
        if path.suffix in (".html", ".js", ".css"):
            text = path.read_text()
            assert not re.search(r"""(src|href)\s*=\s*["']https?:|@import|fetch\(|XMLHttpRequest|WebSocket""", text), (
                path
            )
