"""The package keeps its shape: order of rooms, sole importers, sizes, no traces of a machine."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "cosim").rglob("*.py"))
PYTHON_FILES = SOURCES + sorted((ROOT / "tests").rglob("*.py")) + sorted((ROOT / "benchmarks").rglob("*.py"))
TEXT_SUFFIXES = {".py", ".toml", ".md", ".cff", ".urdf", ".yaml", ".yml", ".sh", ""}

MAX_FILE_LINES = 650
MAX_FUNCTION_LINES = 60  # of a body, without its docstring


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def functions_in(block: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield all functions of a block, those within others included."""
    for node in ast.iter_child_nodes(block):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node
        if isinstance(node, ast.stmt | ast.excepthandler):
            yield from functions_in(node)


def test_rooms_import_downwards_only() -> None:
    linted = subprocess.run(
        [Path(sys.executable).parent / "lint-imports", "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert linted.returncode == 0, linted.stdout


def test_every_room_has_its_place_in_the_order() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    order = next(entry for entry in contracts["contracts"] if entry["type"] == "layers")["layers"]
    rooms = {room.strip() for layer in order for room in re.split(r"[|:]", layer)}
    there = {path.name for path in (ROOT / "cosim").iterdir() if (path / "__init__.py").exists()}
    assert there | {"errors", "_version"} == rooms


def test_no_class_name_stands_twice() -> None:
    bodies = [parsed(path).body for path in SOURCES]
    names = Counter(node.name for body in bodies for node in body if isinstance(node, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []


def test_chains_of_imports_stay_short_and_open() -> None:
    graph = grimp.build_graph("cosim", cache_dir=None)
    below = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    depth: dict[str, int] = {}
    for module in TopologicalSorter(below).static_order():  # raises where imports run in a circle
        depth[module] = 1 + max((depth[imported] for imported in below[module]), default=0)
    assert max(depth.values()) <= 24


def test_the_document_draws_the_rooms_in_their_order() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    drawing = text.split("```text\n")[1].split("```")[0]
    lines = [re.split(r"\s{2,}", line)[0] for line in drawing.splitlines()]
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    assert lines == next(entry for entry in contracts["contracts"] if entry["type"] == "layers")["layers"]


def test_the_glossary_has_each_word_once_in_order() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+?) \|", text, re.MULTILINE)[2:]
    words = [word for row in rows for word in row.split(", ")]
    assert len(words) >= 30
    assert len(set(words)) == len(words)
    assert [row.lower() for row in rows] == sorted(row.lower() for row in rows)


def test_files_and_functions_stay_short() -> None:
    lines = {relative(path): len(path.read_text(encoding="utf-8").splitlines()) for path in PYTHON_FILES}
    assert [path for path, count in lines.items() if count > MAX_FILE_LINES] == []
    long = []
    for path in PYTHON_FILES:
        for node in functions_in(parsed(path)):
            documented = ast.get_docstring(node) is not None and len(node.body) > 1
            if (node.end_lineno or 0) - node.body[documented].lineno + 1 > MAX_FUNCTION_LINES:
                long.append(f"{relative(path)}: {node.name}")
    assert long == []


def test_public_names_say_what_they_are() -> None:
    bare = []
    for path in SOURCES:
        tree = parsed(path)
        definitions = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        if definitions and ast.get_docstring(tree) is None:
            bare.append(relative(path))
        public = [node for node in definitions if not node.name.startswith("_")]
        bare += [f"{relative(path)}: {node.name}" for node in public if not ast.get_docstring(node)]
    assert bare == []


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    pattern = re.compile(r"/(?:home|root|work|Users|tmp)/[A-Za-z0-9_.]")
    hidden = {".ci"}
    generated = {"runs", "dist", "__pycache__"}
    files = (
        path
        for path in ROOT.rglob("*")
        if path.suffix in TEXT_SUFFIXES
        and path.is_file()
        and not generated & set(path.relative_to(ROOT).parts)
        and not any(part.startswith(".") and part not in hidden for part in path.relative_to(ROOT).parts)
    )
    found = [relative(path) for path in files if pattern.search(path.read_text(encoding="utf-8"))]
    assert found == []
