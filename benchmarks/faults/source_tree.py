"""A copy of the source tree in which a fault is put and the tests run; links to files that never change."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import final

PACKAGE = "cosim"


@final
@dataclass(frozen=True)
class SourceTree:
    """A tree with caches of its own: of Python's byte code, of kernels, and of what cosim keeps for a user.

    Args:
        folder: holds the tree in `tree` and its user's caches in `cache`.
    """

    folder: Path

    @property
    def root(self) -> Path:
        """Of the sources."""
        return self.folder / "tree"

    @classmethod
    def of_repository(cls, repository: Path, folder: Path) -> SourceTree:
        """Return a copy of what git tracks in a repository."""
        tree = cls(folder)
        names = subprocess.run(
            ["git", "ls-files", "-z"], cwd=repository, check=True, capture_output=True
        ).stdout
        for name in names.decode().split("\0")[:-1]:
            (tree.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(repository / name, tree.root / name)
        (folder / "cache").mkdir()
        return tree

    def linked(self, folder: Path) -> SourceTree:
        """Return a tree of hard links to this one's files in a folder, which loses what it held."""
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.folder, folder, copy_function=os.link)
        return SourceTree(folder)

    def replace(self, path: str, source: bytes) -> None:
        """Give a file another text; forget the kernels that were compiled with the one before."""
        (self.root / path).unlink()
        (self.root / path).write_bytes(source)
        for user in self._users(path):
            for kept in (self.root / user).parent.glob(f"__pycache__/{Path(user).stem}.*"):
                kept.unlink()

    def _users(self, path: str) -> set[str]:
        """Return the file and all that import it, however indirectly."""
        imported = {
            str(file.relative_to(self.root)): _imported(ast.parse(file.read_bytes()))
            for file in (self.root / PACKAGE).rglob("*.py")
        }
        users, added = {path}, {path}
        while added:
            names = {name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in added}
            added = {file for file, used in imported.items() if not used.isdisjoint(names)} - users
            users |= added
        return users

    def environment(self) -> dict[str, str]:
        """Return the variables with which the tests run in the tree, and leave everything else alone."""
        caches = {"XDG_CACHE_HOME": str(self.folder / "cache")}
        return {**os.environ, **caches, "PYTHONPATH": str(self.root), "OMP_NUM_THREADS": "1"}


def _imported(module: ast.Module) -> set[str]:
    """Return the names of modules that a module imports, and of what it imports from them."""
    names: set[str] = set()
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names
