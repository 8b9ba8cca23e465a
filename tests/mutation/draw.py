"""Draw mutants of the package: small changes of its code, each of which parses.

A line is drawn first, all lines with a possible change alike, then one of the line's changes. The first N of a longer
draw are the draw of N with the same seed.

Changed are operators, comparisons, `and`, `or` and `not`, numbers and truth values, and statements within functions
(assignments, calls, `return`, `raise`, `break` and `continue` become `pass`, or `return None`). Left alone are text,
docstrings, annotations, type aliases, the arguments of `raise`, `__all__`, `if TYPE_CHECKING`,
`if __name__ == "__main__"`, and the options of `dataclass` and `zip(strict=)`: no test can or should notice these. The
first assignment of a name stays too: any test that runs the next lines would notice.
"""

import ast
import difflib
import random
import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path

_OPERATORS: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
    ast.BitXor: ("^", "|"),
    ast.LShift: ("<<", ">>"),
    ast.RShift: (">>", "<<"),
}
_COMPARISONS: dict[type[ast.cmpop], tuple[str, tuple[str, ...]]] = {
    ast.Lt: ("<(?!=)", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: (r"\bis\b", ("is not",)),
    ast.IsNot: (r"is\s+not", ("is",)),
    ast.In: (r"\bin\b", ("not in",)),
    ast.NotIn: (r"not\s+in", ("in",)),
}
_UNNOTICED_CALLS = ("dataclass",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One change: `old` at the bytes `start` to `end` of `file` becomes `new`. `line` is its first line."""

    number: int
    kind: str
    file: str
    line: int
    end_line: int
    start: int
    end: int
    old: str
    new: str

    def applied(self, source: bytes) -> bytes:
        """Return the file's bytes with the change.

        Raises ValueError: If the file is no longer the one that the mutant was drawn from.
        """
        if source[self.start : self.end] != self.old.encode():
            raise ValueError(f"{self.file}: not the source of mutant {self.number}; draw again")
        return source[: self.start] + self.new.encode() + source[self.end :]

    def diff(self, source: bytes) -> str:
        """Return the change as a unified diff without context."""
        before, after = source.decode().splitlines(), self.applied(source).decode().splitlines()
        lines = difflib.unified_diff(before, after, self.file, self.file, lineterm="", n=0)
        return "\n".join(line for line in lines if line not in {"+", "+ "})


def draw(top: Path, *, seed: int, count: int) -> list[Mutant]:
    """Draw `count` mutants of the package in the folder `top`, at most one a line."""
    sources = {path.relative_to(top).as_posix(): path.read_bytes() for path in sorted((top / "tofmix").rglob("*.py"))}
    by_line: dict[tuple[str, int], list[Mutant]] = defaultdict(list)
    for file, source in sources.items():
        for mutant in mutants_of(source, file):
            by_line[file, mutant.line].append(mutant)
    chance = random.Random(seed)  # noqa: S311  no secret
    lines = sorted(by_line)
    chance.shuffle(lines)
    drawn: list[Mutant] = []
    for line in lines:
        if len(drawn) == count:
            break
        choices = by_line[line]
        chance.shuffle(choices)
        changed = next((mutant for mutant in choices if _is_a_change(mutant, sources[mutant.file])), None)
        if changed is not None:
            drawn.append(replace(changed, number=len(drawn)))
    return drawn


def mutants_of(source: bytes, file: str) -> list[Mutant]:
    """List every mutant of a module; a few of them may not parse (`_is_a_change`)."""
    tree = ast.parse(source)
    starts = [0, *accumulate(len(line) for line in source.splitlines(keepends=True))]
    found = []
    for kind, node, (start_line, start), (end_line, end), new in _Walk(source, starts).changes(tree):
        first, last = starts[start_line - 1] + start, starts[end_line - 1] + end
        old = source[first:last].decode()
        found.append(
            Mutant(
                number=-1,
                kind=kind,
                file=file,
                line=start_line,
                end_line=max(end_line, node.end_lineno or 0),
                start=first,
                end=last,
                old=old,
                # Lines keep their numbers: a statement of several lines is followed by as many empty ones.
                new=new + "\n" * old.count("\n"),
            )
        )
    return found


def _is_a_change(mutant: Mutant, source: bytes) -> bool:
    try:
        after = ast.parse(mutant.applied(source))
    except SyntaxError:
        return False
    return ast.dump(after) != ast.dump(ast.parse(source))


_Place = tuple[int, int]
_Change = tuple[str, ast.expr | ast.stmt, _Place, _Place, str]


class _Walk:
    """Goes through a module, and yields what can be changed: kind, node, first and last place, and the new text."""

    def __init__(self, source: bytes, starts: list[int]) -> None:
        self._source = source
        self._starts = starts

    def changes(self, node: ast.AST, bound: dict[str, int] | None = None) -> Iterator[_Change]:
        """Yield the changes of a node and of all below; `bound` says where the function first binds a name."""
        if isinstance(node, ast.stmt) and bound is not None:
            yield from self._statement(node, bound)
        if isinstance(node, ast.expr):
            yield from self._expression(node)
        if isinstance(node, ast.AugAssign):
            yield from self._operator(node, node.target, node.op, node.value, "=")
        inside = _first_bindings(node) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else bound
        for child in _changeable_children(node):
            yield from self.changes(child, inside)

    def _statement(self, node: ast.stmt, bound: dict[str, int]) -> Iterator[_Change]:
        start, end = (node.lineno, node.col_offset), (node.end_lineno or node.lineno, node.end_col_offset or 0)
        match node:
            case ast.Assign(targets=[target]) | ast.AnnAssign(target=target) if _first_bound(target, bound):
                return  # without it the name is unknown, as any test that comes by notices
            case ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Break() | ast.Continue() | ast.Delete():
                yield "statement", node, start, end, "pass"
            case ast.AnnAssign(value=ast.expr()) | ast.Expr(value=ast.Call() | ast.Yield() | ast.YieldFrom()):
                yield "statement", node, start, end, "pass"
            case ast.Return(value=ast.expr()):
                yield "statement", node, start, end, "return None"

    def _expression(self, node: ast.expr) -> Iterator[_Change]:
        match node:
            case ast.BinOp(left=left, op=operator, right=right):
                if not _is_text(left) and not _is_text(right):
                    yield from self._operator(node, left, operator, right, "")
            case ast.Compare():
                yield from self._comparison(node)
            case ast.BoolOp(op=logic, values=values):
                old, new = ("and", "or") if isinstance(logic, ast.And) else ("or", "and")
                for before, after in pairwise(values):
                    yield from self._between("logic", node, before, after, rf"\b{old}\b", new)
            case ast.UnaryOp(op=ast.Not()):
                start = (node.lineno, node.col_offset)
                yield "logic", node, start, (node.lineno, node.col_offset + len("not")), ""
            case ast.Constant(value=bool() | int() | float() as value):
                start, end = (node.lineno, node.col_offset), (node.end_lineno or node.lineno, node.end_col_offset or 0)
                for text in _other_numbers(value):
                    yield "constant", node, start, end, text

    def _comparison(self, node: ast.Compare) -> Iterator[_Change]:
        for (before, after), comparison in zip(pairwise([node.left, *node.comparators]), node.ops, strict=True):
            old, replacements = _COMPARISONS[type(comparison)]
            for new in replacements:
                yield from self._between("comparison", node, before, after, old, new)

    def _operator(
        self, node: ast.expr | ast.stmt, left: ast.expr, operator: ast.operator, right: ast.expr, suffix: str
    ) -> Iterator[_Change]:
        if type(operator) in _OPERATORS:
            old, new = _OPERATORS[type(operator)]
            yield from self._between("operator", node, left, right, re.escape(old + suffix), new + suffix)

    def _between(
        self, kind: str, node: ast.expr | ast.stmt, left: ast.expr, right: ast.expr, pattern: str, new: str
    ) -> Iterator[_Change]:
        """The operator stands between its operands, among brackets and perhaps a comment."""
        first = self._starts[(left.end_lineno or 1) - 1] + (left.end_col_offset or 0)
        last = self._starts[right.lineno - 1] + right.col_offset
        gap = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment.group()), self._source[first:last])
        found = list(re.finditer(pattern.encode(), gap))
        if len(found) == 1:
            start, end = self._place(first + found[0].start()), self._place(first + found[0].end())
            yield kind, node, start, end, new

    def _place(self, position: int) -> _Place:
        line = bisect_right(self._starts, position)
        return line, position - self._starts[line - 1]


def _first_bindings(function: ast.AST) -> dict[str, int]:
    """The line at which a function first binds each name; its arguments at 0."""
    first: dict[str, int] = {}
    for node in ast.walk(function):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            first[node.id] = min(node.lineno, first.get(node.id, node.lineno))
        elif isinstance(node, ast.arg):
            first[node.arg] = 0
    return first


def _first_bound(target: ast.expr, bound: dict[str, int]) -> bool:
    """Whether an assignment binds names alone, all of them for the first time."""
    names = target.elts if isinstance(target, ast.Tuple) else [target]
    return all(isinstance(name, ast.Name) and bound.get(name.id) == name.lineno for name in names)


def _changeable_children(node: ast.AST) -> Iterator[ast.AST]:  # noqa: C901  one case a kind of node
    """The parts of a node that run, without annotations and what no test should notice."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            yield from (*node.decorator_list, *node.args.defaults, *filter(None, node.args.kw_defaults), *node.body)
        case ast.AnnAssign(annotation=annotation, value=value):
            if value is not None and not ast.unparse(annotation).endswith("TypeAlias"):
                yield value
        case ast.Assign(targets=[ast.Name(id="__all__")]):
            return
        case ast.If(test=ast.Name(id="TYPE_CHECKING") | ast.Attribute(attr="TYPE_CHECKING")):
            yield from node.orelse
        case ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):
            return
        case ast.Raise() | ast.JoinedStr():
            return
        case ast.Call(func=ast.Name(id=name)) if name in _UNNOTICED_CALLS:
            return
        case ast.Call():
            yield from (node.func, *node.args, *(word for word in node.keywords if word.arg != "strict"))
        case ast.Subscript(value=ast.Name(id="Literal" | "Annotated")):
            return
        case _:
            yield from ast.iter_child_nodes(node)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _other_numbers(value: float) -> tuple[str, ...]:
    if isinstance(value, bool):
        return (str(not value),)
    if isinstance(value, int):
        return (str(value + 1), str(value - 1) if value > 0 else "2")
    return ("1.0",) if value == 0.0 else (repr(2.0 * value), repr(0.5 * value))
