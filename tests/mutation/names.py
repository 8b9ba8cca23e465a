"""Which definitions of the package name each other: the way from a line that coverage cannot see to lines that it can.

Coverage sees the bodies of plain functions. It sees neither the lines of compiled kernels nor, for a single test, what
runs at import: constants, class bodies, decorators, default values. For a change there, the tests to run are found
upwards, from the changed definition to whatever names it: kernels, constants and classes are passed through, until
plain functions are met; tests that run a line of these are chosen. Names are resolved through imports; a module whose
attribute is taken (`density.density`) counts as the attribute.
"""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

COMPILING = ("jit", "borrowing")
"""Decorators of tofmix.compiled.jit: their functions' lines are unseen."""

Name = tuple[str, str]
"""A module, and what it defines at its top level; "" stands for the module as a whole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Definition:
    """A top-level statement of a module that defines a name."""

    module: str
    file: str
    name: str
    kind: str
    """"kernel", "function", "class", "value" or "import"."""
    lines: range
    body: frozenset[int] = field(repr=False)
    """Lines of plain functions within it: those that coverage sees run."""
    uses: frozenset[Name] = field(repr=False)


class Names:
    """The definitions of a package, and the ways between them."""

    def __init__(self, top: Path, package: str = "tofmix") -> None:
        self._modules = {_module(path.relative_to(top)): path for path in sorted((top / package).rglob("*.py"))}
        self._by_name: dict[Name, list[Definition]] = defaultdict(list)
        self._by_file: dict[str, list[Definition]] = defaultdict(list)
        self._users: dict[Name, set[Name]] = defaultdict(set)
        for module, path in self._modules.items():
            for definition in self._definitions(module, path, path.relative_to(top).as_posix()):
                self._by_name[module, definition.name].append(definition)
                self._by_file[definition.file].append(definition)
                for used in definition.uses:
                    self._users[used].add((module, definition.name))

    def at(self, file: str, line: int) -> list[Definition]:
        """Return the definitions whose statement a line belongs to."""
        return [found for found in self._by_file[file] if line in found.lines]

    def all_above(self, names: Iterable[Name]) -> set[Name]:
        """Return everything that may depend on `names`, through whatever stands between."""
        found, new = set[Name](), list(names)
        while new:
            name = new.pop()
            if name not in found:
                found.add(name)
                new += self._users[name]
        return found

    def seen_above(self, names: Iterable[Name], *, unseen: bool) -> set[Name]:
        """Return `names` and, if these are unseen, the definitions up to, and with, the first plain functions.

        What is seen is passed too where a value is made with it at import, for its lines then run in no test.
        """
        found: dict[Name, bool] = {}
        new = [(name, unseen) for name in names]
        while new:
            name, passes = new.pop()
            if name in found and (found[name] or not passes):
                continue
            found[name] = passes
            for user in self._users[name]:
                kinds = self._kinds(user)
                if passes:
                    new.append((user, kinds != {"function"}))
                elif kinds <= {"import", "value"}:
                    new.append((user, "value" in kinds))
        return set(found)

    def _kinds(self, name: Name) -> set[str]:
        return {definition.kind for definition in self._by_name[name]}

    def definitions(self, names: Iterable[Name]) -> list[Definition]:
        """Return what `names` stand for."""
        return [found for name in sorted(names) for found in self._by_name[name]]

    def imported_by(self, source: str, module: str = "") -> set[Name]:
        """Return what the text of a module, or of a test, imports of the package."""
        return set(self._imports(ast.parse(source), module).values())

    def _definitions(self, module: str, path: Path, file: str) -> Iterator[Definition]:
        tree = ast.parse(path.read_bytes())
        imports = self._imports(tree, module)
        own = {name for node in tree.body for name in _bound(node)}
        for node in tree.body:
            names = _bound(node)
            uses = frozenset(self._uses(node, module, imports, own)) - {(module, name) for name in names}
            first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])
            kind = _kind(node)
            body = frozenset() if kind == "kernel" else frozenset(_body_lines(node))
            for name in names or [f"line {node.lineno}"]:
                yield Definition(
                    module=module,
                    file=file,
                    name=name,
                    kind=kind,
                    lines=range(first, (node.end_lineno or first) + 1),
                    body=body,
                    uses=uses,
                )

    def _uses(self, node: ast.stmt, module: str, imports: dict[str, Name], own: set[str]) -> Iterator[Name]:
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute):
                whole = self._attribute(part, imports)
                if whole is not None:
                    yield whole
            elif isinstance(part, ast.Name):
                if part.id in imports:
                    yield imports[part.id]
                elif part.id in own:
                    yield module, part.id
            elif isinstance(part, ast.ImportFrom | ast.Import):
                yield from self._imports(part, module).values()

    def _attribute(self, node: ast.Attribute, imports: dict[str, Name]) -> Name | None:
        """What `module.name` or `package.module.name` stands for."""
        parts = [node.attr]
        value = node.value
        while isinstance(value, ast.Attribute):
            parts.append(value.attr)
            value = value.value
        if not isinstance(value, ast.Name) or value.id not in imports:
            return None
        module, name = imports[value.id]
        if name:
            return None
        for part in reversed(parts):
            if f"{module}.{part}" not in self._modules:
                return module, part
            module = f"{module}.{part}"
        return module, ""

    def _imports(self, tree: ast.AST, module: str) -> dict[str, Name]:
        """The names that imports anywhere in `tree` bind, and what of the package they stand for."""
        found: dict[str, Name] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                origin = self._origin(node, module)
                for alias in node.names:
                    inner = f"{origin}.{alias.name}"
                    if inner in self._modules:
                        found[alias.asname or alias.name] = (inner, "")
                    elif origin in self._modules:
                        found[alias.asname or alias.name] = (origin, alias.name)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    top = alias.name if alias.asname else alias.name.split(".")[0]
                    if top in self._modules:
                        found[alias.asname or top] = (top, "")
        return found

    def _origin(self, node: ast.ImportFrom, module: str) -> str:
        if not node.level:
            return node.module or ""
        is_package = self._modules.get(module, Path()).name == "__init__.py"
        parts = module.split(".")
        parts = parts[: len(parts) - node.level + is_package]
        return ".".join([*parts, *([node.module] if node.module else [])])


def _module(path: Path) -> str:
    parts = list(path.with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _bound(node: ast.stmt) -> list[str]:
    """The names that a top-level statement defines, or adds to (`TABLE[key] = value`)."""
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return [name]
        case ast.Import(names=names) | ast.ImportFrom(names=names):
            return [alias.asname or alias.name.split(".")[0] for alias in names]
        case ast.If() | ast.Try() | ast.With() | ast.For():
            return [name for part in ast.iter_child_nodes(node) if isinstance(part, ast.stmt) for name in _bound(part)]
        case ast.Assign() | ast.AnnAssign() | ast.AugAssign():
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            return [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
        case _:
            return []


def _kind(node: ast.stmt) -> str:
    match node:
        case ast.FunctionDef(decorator_list=decorators):
            names = {getattr(part, "id", getattr(part, "attr", "")) for part in decorators}
            return "kernel" if names & set(COMPILING) else "function"
        case ast.AsyncFunctionDef():
            return "function"
        case ast.ClassDef():
            return "class"
        case ast.Import() | ast.ImportFrom():
            return "import"
        case _:
            return "value"


def _body_lines(node: ast.AST) -> Iterator[int]:
    """Lines of the bodies of all functions within a node."""
    for part in ast.walk(node):
        if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from range(part.body[0].lineno, (part.end_lineno or part.lineno) + 1)


def statement_lines(source: bytes, line: int) -> tuple[range, bool]:
    """Return the lines of the innermost statement at `line`, and whether it runs when a function does.

    Of a statement with a body these are the lines before the body.
    """
    found, runs = range(line, line + 1), False
    node: ast.AST = ast.parse(source)
    while True:
        inner = next((part for part in _statements(node) if line in _extent(part)), None)
        if inner is None:
            return found, runs
        body = getattr(inner, "body", None)
        if isinstance(body, list) and body and line < body[0].lineno:
            header = range(_extent(inner).start, max(body[0].lineno, line + 1))
            return header, runs
        found = _extent(inner)
        runs = runs or isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef)
        node = inner


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    for part in ast.iter_child_nodes(node):
        if isinstance(part, ast.stmt):
            yield part
        elif isinstance(part, ast.ExceptHandler | ast.match_case):
            yield from _statements(part)


def _extent(node: ast.stmt) -> range:
    first = min([node.lineno, *(part.lineno for part in getattr(node, "decorator_list", []))])
    return range(first, (node.end_lineno or first) + 1)
