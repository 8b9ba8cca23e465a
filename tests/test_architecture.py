"""What the package as a whole keeps: imports point one way, no code from input, closed streams."""

import ast
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.commandline import succeed
from support.files import boards, write_recording
from support.modules import MODULES, PACKAGE, nodes, tree

from tofmix.errors import ExitCode

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
    "report": ("summary", "pixels", "figures"),
    "reconciliation": ("likelihood", "comparison", "parameters", "search", "verification", "one"),
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


def test_modules_have_docstrings_and_constants_a_word() -> None:
    offenders = [str(module.relative_to(PACKAGE)) for module in MODULES if not ast.get_docstring(tree(module))]
    assert not offenders, "\n".join(offenders)
    offenders = [text for module in MODULES for text in _unexplained_constants(module)]
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


def test_modules_that_start_programs_or_import_by_name_are_known() -> None:
    starting = {_name(module) for module in MODULES if _imported(module) & {"subprocess", "multiprocessing"}}
    assert starting == STARTS_PROGRAMS
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


TOFMIX = f"{shlex.quote(sys.executable)} -m tofmix"


def _run(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of the shell, where TOFMIX is the program."""
    command = ["sh", "-c", line.replace("TOFMIX", TOFMIX)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.slow
def test_outputs_are_whole_and_codes_the_same_with_closed_streams(tmp_path: Path) -> None:
    succeed("estimate", write_recording(tmp_path / "a.h5", boards(40)), "-o", tmp_path / "open.h5")
    whole = (tmp_path / "open.h5").read_bytes()
    for closed in ("2>&-", ">&-", "<&-", ">&- 2>&- <&-"):
        done = _run(f"TOFMIX estimate a.h5 -o closed.h5 --overwrite {closed}", tmp_path)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False), closed
        assert (tmp_path / "closed.h5").read_bytes() == whole, closed
        (tmp_path / "closed.h5").unlink()
    assert _run("TOFMIX report open.h5 >&-", tmp_path).returncode == 0
    assert _run("TOFMIX report none.h5 2>&-", tmp_path).returncode == ExitCode.BAD_INPUT


def test_a_closed_stdin_names_no_recording(tmp_path: Path) -> None:
    done = _run("TOFMIX estimate - <&-", tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "stdin names no recording" in done.stderr
