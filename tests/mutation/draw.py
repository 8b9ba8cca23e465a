"""Draw mutants of the package: small changes of its code.

A line is drawn first, all lines with a possible change alike, then one of the line's changes. The first N of a longer
draw are the draw of N with the same seed.

Changed are operators, comparisons, `and`, `or` and `not`, numbers and truth values, and statements within functions
(assignments, calls, `return`, `raise`, `break` and `continue` become `pass`, or `return None`). Left alone are text,
docstrings, annotations, type aliases, the arguments of `raise`, `__all__`, `if TYPE_CHECKING`,
`if __name__ == "__main__"`, and the options of `dataclass` and `zip(strict=)`: no test can or should notice these. The
first assignment of a name stays too: any test that runs the next lines would notice.
"""

import ast
import random
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """The lines `line` to `end_line` of `file`, a statement, become `new`."""

    number: int
    kind: str
    file: str
    at: int
    """The line that changes."""
    line: int
    end_line: int
    old: str
    new: str

    def applied(self, source: str) -> str:
        """Return the file with the change.

        Raises ValueError: If the file is no longer the one that the mutant was drawn from.
        """
        lines = source.splitlines(keepends=True)
        if "".join(lines[self.line - 1 : self.end_line]) != self.old:
            raise ValueError(f"{self.file}: not the source of mutant {self.number}; draw again")
        return "".join([*lines[: self.line - 1], self.new, *lines[self.end_line :]])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Change:
    kind: str
    line: int
    statement: ast.stmt
    """The statement that has it."""
    make: Callable[[], ast.stmt]
    """Changes the tree; returns what stands in place of the statement."""


def draw(top: Path, *, seed: int, count: int) -> list[Mutant]:
    """Draw `count` mutants of the package in the folder `top`, at most one a line."""
    sources = {path.relative_to(top).as_posix(): path.read_text() for path in (top / "tofmix").rglob("*.py")}
    by_line: dict[tuple[str, int], list[int]] = defaultdict(list)
    for file, source in sources.items():
        for place, change in enumerate(_changes(ast.parse(source))):
            by_line[file, change.line].append(place)
    chance = random.Random(seed)  # noqa: S311  no secret
    lines = sorted(by_line)
    chance.shuffle(lines)
    drawn = [(file, chance.choice(by_line[file, line])) for file, line in lines[:count]]
    return [_mutant(sources[file], file, place, number) for number, (file, place) in enumerate(drawn)]


def mutants_of(source: str, file: str) -> list[Mutant]:
    """List every mutant of a module."""
    return [_mutant(source, file, place, place) for place, _ in enumerate(_changes(ast.parse(source)))]


def _mutant(source: str, file: str, place: int, number: int) -> Mutant:
    change = list(_changes(ast.parse(source)))[place]
    old = change.statement
    first = min([old.lineno, *(part.lineno for part in getattr(old, "decorator_list", []))])
    last = old.end_lineno or first
    new = "".join(f"{' ' * old.col_offset}{line}\n" for line in ast.unparse(change.make()).splitlines())
    before = "".join(source.splitlines(keepends=True)[first - 1 : last])
    return Mutant(
        number=number, kind=change.kind, file=file, at=change.line, line=first, end_line=last, old=before, new=new
    )


def _changes(
    node: ast.AST, statement: ast.stmt | None = None, bound: dict[str, int] | None = None
) -> Iterator[_Change]:
    """Yield the changes of a node and of all below; `bound` says where the function first binds a name."""
    if isinstance(node, ast.stmt):
        statement = node
        if bound is not None:
            yield from _of_statement(node, bound)
    if statement is not None:
        for kind, part, name, value in _of_node(node):
            yield _Change(
                kind=kind,
                line=getattr(node, "lineno", statement.lineno),
                statement=statement,
                make=partial(_put, part, name, value, statement),
            )
    inside = _first_bindings(node) if isinstance(node, ast.FunctionDef) else bound
    for child in _changeable_children(node):
        yield from _changes(child, statement, inside)


def _put(part: ast.AST, name: str, value: object, whole: ast.stmt) -> ast.stmt:
    setattr(part, name, value)
    return whole


def _of_statement(node: ast.stmt, bound: dict[str, int]) -> Iterator[_Change]:
    match node:
        case ast.Assign(targets=[target]) | ast.AnnAssign(target=target) if _first_bound(target, bound):
            return  # without it the name is unknown, as any test that comes by notices
        case ast.Return(value=ast.expr()):
            new: ast.stmt = ast.Return(value=ast.Constant(value=None))
        case ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Break() | ast.Continue() | ast.Delete():
            new = ast.Pass()
        case ast.AnnAssign(value=ast.expr()) | ast.Expr(value=ast.Call() | ast.Yield() | ast.YieldFrom()):
            new = ast.Pass()
        case _:
            return
    yield _Change(kind="statement", line=node.lineno, statement=node, make=lambda: new)


def _of_node(node: ast.AST) -> Iterator[tuple[str, ast.AST, str, object]]:  # noqa: C901  one case a kind of node
    """Yield the kind of each change, the node, and the new value of one of its fields."""
    match node:
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
            if not _is_text(left) and not _is_text(right):
                yield "operator", node, "op", _OPERATORS[type(operator)]()
        case ast.AugAssign(op=operator) if type(operator) in _OPERATORS:
            yield "operator", node, "op", _OPERATORS[type(operator)]()
        case ast.Compare(ops=ops):
            for place, old in enumerate(ops):
                for new in _COMPARISONS[type(old)]:
                    yield "comparison", node, "ops", [*ops[:place], new(), *ops[place + 1 :]]
        case ast.BoolOp(op=logic):
            yield "logic", node, "op", ast.Or() if isinstance(logic, ast.And) else ast.And()
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "logic", node, "operand", ast.UnaryOp(op=ast.Not(), operand=operand)
        case ast.Constant(value=bool() | int() | float() as value):
            for other in _other_numbers(value):
                yield "constant", node, "value", other
        case _:
            return


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
        case ast.Call(func=ast.Name(id=name)) if name == "dataclass":
            return
        case ast.Call():
            yield from (node.func, *node.args, *(word for word in node.keywords if word.arg != "strict"))
        case ast.Subscript(value=ast.Name(id="Literal" | "Annotated")):
            return
        case _:
            yield from ast.iter_child_nodes(node)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _other_numbers(value: float) -> tuple[float, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int):
        return value + 1, value - 1 if value > 0 else 2
    return (1.0,) if value == 0.0 else (2.0 * value, 0.5 * value)
