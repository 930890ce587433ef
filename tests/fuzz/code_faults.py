"""Small faults that a source file could have, each a replacement of one piece of its text.

Where they can be is read from the syntax tree. Left out is what changes no behaviour that a test could see:
docstrings, annotations, decorators, the texts of messages and what is raised with them.
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, final

_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
_EXTREMES = {
    "min": "max", "minimum": "maximum", "fmin": "fmax", "argmin": "argmax",
    "max": "min", "maximum": "minimum", "fmax": "fmin", "argmax": "argmin",
}  # fmt: skip
_ORDERLESS = {*_EXTREMES, "hypot", "array_equal", "allclose"}
_TOLD = {"tell", "warn", "log", "print"}


@final
@dataclass(frozen=True)
class Fault:
    """One fault of one file.

    Args:
        path: of the file, from the root of the tree.
        line: where it begins.
        owner: dotted name of the function or class it is in, or the name that a statement outside assigns.
        kind: of fault.
        begin: first byte of the piece that is replaced.
        end: byte after it.
        text: that replaces it.
    """

    path: str
    line: int
    owner: str
    kind: str
    begin: int
    end: int
    text: str

    def applied(self, source: bytes) -> bytes:
        """Return the source with the fault."""
        return source[: self.begin] + self.text.encode() + source[self.end :]

    def difference(self, source: bytes) -> list[str]:
        """Return the lines that differ, those without the fault first."""
        before, after = (text.decode().splitlines() for text in (source, self.applied(source)))
        lines = list(difflib.unified_diff(before, after, n=0, lineterm=""))
        return [line for line in lines[2:] if not line.startswith("@@")]


def faults(path: str, source: bytes) -> list[Fault]:
    """Return every fault that a file could have, in the order of its text.

    Args:
        path: of the file, from the root of the tree.
        source: of the file.
    """
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for owner, node, kind, text in _in_block(ast.parse(source).body, ""):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        found.append(Fault(path, node.lineno, owner, kind, begin, end, text))
    return sorted(found, key=lambda fault: (fault.begin, fault.kind, fault.text))


_Found = Iterator[tuple[str, ast.expr | ast.stmt, str, str]]


def _in_block(block: list[ast.stmt], owner: str) -> _Found:
    """Yield owner, replaced node, kind and text of the faults in a block of statements."""
    for statement in block:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            yield from _in_definition(statement, f"{owner}.{statement.name}" if owner else statement.name)
        elif _is_seen(statement):
            yield from _in_statement(statement, owner or _assigned(statement))


def _in_definition(definition: ast.FunctionDef | ast.ClassDef, owner: str) -> _Found:
    if isinstance(definition, ast.FunctionDef):
        for default in (*definition.args.defaults, *definition.args.kw_defaults):
            if default is not None:
                yield from _in_expression(default, owner)
        if not any(_gives_a_value(node) for node in ast.walk(definition)):
            for statement in definition.body:
                if not _is_text(statement) and not isinstance(statement, ast.Return | ast.Pass):
                    yield owner, statement, "return early", "return"
    yield from _in_block(definition.body, owner)


def _in_statement(statement: ast.stmt, owner: str) -> _Found:
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        yield owner, statement, "removed statement", "pass"
    if isinstance(statement, ast.AugAssign) and type(statement.op) in _OPERATORS:
        changed = ast.AugAssign(statement.target, _other(statement.op), statement.value)
        yield owner, statement, "operator", ast.unparse(changed)
    for name, value in ast.iter_fields(statement):
        if name == "annotation" or (isinstance(statement, ast.Assert) and name == "msg"):
            continue
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, ast.expr):
                yield from _in_expression(part, owner)
            elif isinstance(part, ast.stmt):
                yield from _in_block([part], owner)
            elif isinstance(part, ast.ExceptHandler | ast.withitem | ast.match_case):
                yield from _in_parts(part, owner)


def _in_parts(node: ast.AST, owner: str) -> _Found:
    for part in ast.iter_child_nodes(node):
        if isinstance(part, ast.expr):
            yield from _in_expression(part, owner)
        elif isinstance(part, ast.stmt):
            yield from _in_block([part], owner)
        else:
            yield from _in_parts(part, owner)


def _in_expression(node: ast.expr, owner: str, place: str = "") -> _Found:
    """Yield the faults of an expression; `place` says whether it is an index or the end of a range."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Call) and _name(node.func) in _TOLD):
        return
    for kind, changed in _changes(node, place):
        yield owner, node, kind, changed if isinstance(changed, str) else f"({ast.unparse(changed)})"
    if isinstance(node, ast.Subscript):
        yield from _in_expression(node.value, owner)
        yield from _in_expression(node.slice, owner, "index")
        return
    if isinstance(node, ast.Call) and _name(node.func) == "range":
        place = "range"
    elif not isinstance(node, ast.Slice | ast.Tuple | ast.UnaryOp):
        place = ""
    for part in ast.iter_child_nodes(node):
        if isinstance(part, ast.expr):
            yield from _in_expression(part, owner, place)
        elif isinstance(part, ast.keyword | ast.comprehension):
            yield from _in_parts(part, owner)


def _changes(node: ast.expr, place: str) -> Iterator[tuple[str, ast.expr | str]]:
    """Yield kind and replacement of the faults of one node."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            yield from _other_numbers(value, place)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            if not _is_word(left) and not _is_word(right):
                yield "operator", ast.BinOp(left, _other(op), right)
        case ast.BinOp(left=left, op=ast.MatMult() as op, right=right):
            yield "swapped arguments", ast.BinOp(right, op, left)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", operand
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not", operand
        case ast.Compare(left=left, ops=[op, *more], comparators=others) if type(op) in _OPERATORS:
            yield "comparison", ast.Compare(left, [_other(op), *more], others)
        case ast.BoolOp(op=op, values=values):
            yield "and, or", ast.BoolOp(_other(op), values)
        case ast.Call(func=function, args=arguments, keywords=keywords):
            if _name(function) in _EXTREMES:
                yield "min, max", ast.Call(_renamed(function), arguments, keywords)
            if _name(function) not in _ORDERLESS:
                yield from _swaps(node)


def _other_numbers(value: float, place: str) -> Iterator[tuple[str, str]]:
    if place and isinstance(value, int):
        yield "off by one", str(value - 1 if place == "range" and value > 0 else value + 1)
    elif value == 0:
        yield "constant", str(value + 1)
    else:
        yield "constant", repr(2 * value)
        yield "constant", repr(0 * value)


def _swaps(call: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    for k, pair in enumerate(pairwise(call.args)):
        starred = any(isinstance(argument, ast.Starred) for argument in pair)
        if not starred and ast.dump(pair[0]) != ast.dump(pair[1]):
            swapped = [*call.args[:k], pair[1], pair[0], *call.args[k + 2 :]]
            yield "swapped arguments", ast.Call(call.func, swapped, call.keywords)


def _other(operator: ast.AST) -> Any:
    return _OPERATORS[type(operator)]()


def _name(function: ast.expr) -> str:
    if isinstance(function, ast.Name):
        return function.id
    return function.attr if isinstance(function, ast.Attribute) else ""


def _renamed(function: ast.expr) -> ast.expr:
    other = _EXTREMES[_name(function)]
    if isinstance(function, ast.Attribute):
        return ast.Attribute(function.value, other, function.ctx)
    return ast.Name(other, ast.Load())


def _is_word(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_text(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _is_seen(statement: ast.stmt) -> bool:
    """Whether a statement does something that a test could see."""
    if isinstance(statement, ast.Raise | ast.Import | ast.ImportFrom) or _is_text(statement):
        return False
    return not (isinstance(statement, ast.If) and _name(statement.test) == "TYPE_CHECKING")


def _gives_a_value(node: ast.AST) -> bool:
    return isinstance(node, ast.Return | ast.Lambda) and getattr(node, "value", node) is not None


def _assigned(statement: ast.stmt) -> str:
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    names = [
        node.id for target in targets if target for node in ast.walk(target) if isinstance(node, ast.Name)
    ]
    return names[0] if names else ""
