"""Breaks expressions, one at a time, and shows what finds it: python -m tests.mutants [--count N] [--seed S].

Each mutant is one changed sign, operator, comparison, condition or number in a copy of cosim; rooms take
turns, the place within a room is drawn. Tests that import the file go first, then those of the room, the
golden runs and all others, each until the first failure or for 15 minutes. A line is printed for each
mutant. Some change nothing that a user could see: a bound of a search that is never met, the speed, the width
of a picture.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
ROOMS: Final = sorted(path.parent.name for path in (ROOT / "cosim").glob("*/__init__.py"))
LEFT_OUT: Final = (".git", ".venv", "build", "runs")
LONGEST_S: Final = 900
_FEW: Final = 8  # files of tests, which are run in one process
_OPERATORS: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
_COMPARISONS: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_NOT_RUN: Final = (ast.Raise, ast.JoinedStr, ast.Assert)
"""What only words a message, or is checked by mypy as well."""


@dataclass(frozen=True)
class Mutant:
    """One changed expression.

    Args:
        file: that it is in, below the folder of cosim.
        line: of the expression.
        before: its text.
        after: text in its place.
        source: of the whole file, changed.
    """

    file: Path
    line: int
    before: str
    after: str
    source: str

    def __str__(self) -> str:
        before, after = (" ".join(text.split()) for text in (self.before, self.after))
        return f"{self.file.as_posix()}:{self.line} {before} -> {after}"


def drawn(count: int, seed: int) -> Iterator[Mutant]:
    """Yield so many mutants, of one room after another."""
    generator = random.Random(seed)
    for number in range(count):
        room = ROOMS[number % len(ROOMS)]
        files = sorted((ROOT / "cosim" / room).rglob("*.py"))
        places = [(file, place) for file in files for place in places_in(file.read_text(encoding="utf-8"))]
        file, place = generator.choice(places)
        source = file.read_text(encoding="utf-8")
        before = ast.get_source_segment(source, place)
        assert before is not None
        after = f"({ast.unparse(changed(place))})"
        start, end = _offset(source, place.lineno, place.col_offset), len(before)
        broken = source[:start] + after + source[start + end :]
        ast.parse(broken)
        yield Mutant(file.relative_to(ROOT / "cosim"), place.lineno, before, after, broken)


def places_in(source: str) -> list[ast.expr]:
    """Return the expressions of a file that can be changed and are run."""
    return list(_places(ast.parse(source)))


def _places(node: ast.AST) -> Iterator[ast.expr]:
    if isinstance(node, _NOT_RUN):
        return
    if isinstance(node, ast.expr) and changed(node) is not node:
        yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _places(child)


def changed(node: ast.expr) -> ast.expr:
    """Return an expression with its outermost operator, comparison, condition or number changed."""
    other = copy(node)
    match other:
        case ast.BinOp(op=operator) if type(operator) in _OPERATORS:
            other.op = _OPERATORS[type(operator)]()
        case ast.Compare(ops=[comparison]):
            other.ops = [_COMPARISONS[type(comparison)]()]
        case ast.BoolOp(op=ast.And()):
            other.op = ast.Or()
        case ast.BoolOp(op=ast.Or()):
            other.op = ast.And()
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            return other.operand
        case ast.IfExp():
            other.body, other.orelse = other.orelse, other.body
        case ast.Constant(value=bool(value)):
            other.value = not value
        case ast.Constant(value=int(value)):
            other.value = value + 1
        case ast.Constant(value=float(value)):
            other.value = 1.5 * value + (value == 0.0)
        case _:
            return node
    return other


def _offset(source: str, line: int, column: int) -> int:
    """Return where a place of the syntax tree, whose column counts bytes, begins in the text."""
    lines = source.splitlines(keepends=True)
    head = lines[line - 1].encode()[:column].decode()
    return sum(map(len, lines[: line - 1])) + len(head)


def finder(mutant: Mutant, folder: Path, *, near: bool = False) -> str:
    """Return the first test that fails with a mutant; empty if none does.

    Args:
        mutant: what is broken.
        folder: empty; for the copy of cosim.
        near: leave out the tests of other rooms.
    """
    for path in ROOT.iterdir():
        if path.is_dir() and path.name not in LEFT_OUT:
            shutil.copytree(path, folder / path.name)
        elif path.is_file():
            shutil.copy(path, folder)
    (folder / "cosim" / mutant.file).write_text(mutant.source, encoding="utf-8")
    importing, room = _importing(mutant.file), f"tests/{mutant.file.parts[0]}"
    others = sorted(f"tests/{path.parent.name}" for path in (ROOT / "tests").glob("*/test_*.py"))
    left = sorted({*others} - {room, "tests/golden"})
    stages = [importing, [room] if room in others else [], ["tests/golden"], [] if near else left]
    for stage in filter(None, stages):
        failed = _first_failure(stage, folder)
        if failed:
            return failed
    return ""


def _importing(file: Path) -> list[str]:
    """Return the tests that import a file of cosim, or are named after it."""
    module = ".".join(("cosim", *file.with_suffix("").parts))
    tests = sorted((ROOT / "tests").glob("*/test_*.py"))
    named = re.compile(
        rf"{re.escape(module)}\b|from {re.escape(module.rpartition('.')[0])} import .*\b{file.stem}\b"
    )
    chosen = [path for path in tests if named.search(path.read_text("utf-8")) or file.stem in path.stem]
    return [path.relative_to(ROOT).as_posix() for path in chosen]


def _first_failure(paths: list[str], folder: Path) -> str:
    """Return the first test of some folders that fails in a copy of the project; empty if none does."""
    few = len(paths) < _FEW and all(path.endswith(".py") for path in paths)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-n",
        "0" if few else "auto",
        "--dist",
        "worksteal",
    ]
    command += ["--no-header", "--tb=no", *paths]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(folder)}
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {LONGEST_S} s"
    if done.returncode in (0, 5):  # passed, or no tests there
        return ""
    said = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return said[0][:160] if said else f"pytest ends by {done.returncode}"


def main() -> int:
    """Try mutants, print a line for each, and return how many nothing finds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="leave out those before")
    parser.add_argument("--near", action="store_true", help="leave out the tests of other rooms")
    parser.add_argument("--list", action="store_true", help="show the mutants only")
    options = parser.parse_args()
    missed = 0
    for number, mutant in enumerate(drawn(options.count, options.seed)):
        if number < options.first:
            continue
        if options.list:
            print(f"{number} {mutant}")
            continue
        with tempfile.TemporaryDirectory() as made:
            found = finder(mutant, Path(made), near=options.near)
        missed += not found
        print(f"{number} {mutant} | {found or 'NOT FOUND'}", flush=True)
    return missed


if __name__ == "__main__":
    sys.exit(main())
