"""Which functions of cosim each test runs, and how long it takes; so, which tests may notice a fault.

As a plugin of pytest (`-p benchmarks.faults.records`) it writes these records, `--write-records FOLDER`, or
runs some of the tests only, `--choice FILE`. Kernels and numbers leave no trace of their own when they are
used: for them the records of the functions that name them count, through other kernels where need be.
"""

from __future__ import annotations

import ast
import json
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, final

import pytest

from benchmarks.faults.code_faults import Fault

PACKAGE = "cosim"
_LEVELS = 8  # of kernels that call kernels
_LONGER, _BESIDES_S = 10.0, 300.0  # of CPU time a test may take: kernels may have to be compiled


@final
@dataclass(frozen=True)
class TestRecords:
    """What was noted about each test.

    Args:
        functions: of each test, as "path:dotted name".
        cpu_s: that each test took.
        failed: tests that did.
        root: of the tree.
    """

    __test__ = False

    functions: dict[str, list[str]]
    cpu_s: dict[str, float]
    failed: list[str]
    root: Path

    @classmethod
    def read(cls, folder: Path, root: Path) -> TestRecords:
        """Return the records in the files of a folder, one of each process that ran tests."""
        records = cls({}, {}, [], root)
        for path in sorted(folder.glob("*.json")):
            part = json.loads(path.read_text(encoding="utf-8"))
            records.functions.update(part["functions"])
            records.cpu_s.update(part["cpu_s"])
            records.failed.extend(part["failed"])
        return records

    def order(self, fault: Fault) -> list[str]:
        """Return the tests that run what a fault is in: of files of its name, then cheap files first."""
        wanted = self._traces(fault)
        found = [test for test, functions in self.functions.items() if not wanted.isdisjoint(functions)]
        costs: dict[str, float] = {}
        for test in found:
            costs[file_of(test)] = costs.get(file_of(test), 0.0) + self.cpu_s[test]
        named = f"/test_{Path(fault.path).stem}.py"
        return sorted(
            found, key=lambda test: (not file_of(test).endswith(named), costs[file_of(test)], file_of(test))
        )

    def _traces(self, fault: Fault) -> set[str]:
        """Return the functions whose running tells that the fault's place was in use."""
        noted = {name for names in self.functions.values() for name in names}
        here = f"{fault.path}:{fault.owner}"
        if here in noted:
            return {here}
        names, seen, found = {fault.owner.rpartition(".")[2]}, {here}, set()
        for _ in range(_LEVELS):
            users = {user for user, used in self._names_used.items() if not used.isdisjoint(names)} - seen
            found |= users & noted
            names = {user.rpartition(":")[2].rpartition(".")[2] for user in users - noted}
            seen |= users
        return found

    @cached_property
    def _names_used(self) -> dict[str, set[str]]:
        """Names that each function of the package, or statement outside, uses."""
        used: dict[str, set[str]] = {}
        for path in sorted((self.root / PACKAGE).rglob("*.py")):
            for owner, node in _owners(ast.parse(path.read_bytes()), ""):
                names = used.setdefault(f"{path.relative_to(self.root)}:{owner}", set())
                names |= {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
                names |= {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}
        return used


def _owners(node: ast.AST, within: str) -> Iterator[tuple[str, ast.AST]]:
    for part in ast.iter_child_nodes(node):
        if isinstance(part, ast.FunctionDef | ast.ClassDef):
            name = f"{within}.{part.name}" if within else part.name
            yield name, part
            yield from _owners(part, name)
        elif isinstance(part, ast.Assign | ast.AnnAssign) and not within:
            targets = part.targets if isinstance(part, ast.Assign) else [part.target]
            yield from ((target.id, part) for target in targets if isinstance(target, ast.Name))


def file_of(test: str) -> str:
    """Return the file of a test."""
    return test.partition("::")[0]


@final
@dataclass(eq=False)
class Recorder:
    """Notes what each test runs.

    Args:
        path: of the file with the records.
        root: of the tree.
    """

    path: Path
    root: Path
    functions: dict[str, list[str]] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note that a test failed."""
        if report.failed:
            self.failed.append(report.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Note what one test runs, with its fixtures."""
        seen: set[CodeType] = set()

        def note(frame: FrameType, _event: str, _argument: Any) -> None:
            seen.add(frame.f_code)

        began = time.process_time()
        sys.settrace(note)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self.cpu_s[item.nodeid] = time.process_time() - began
            folder = f"{self.root / PACKAGE}/"
            own = [code for code in seen if code.co_filename.startswith(folder)]
            names = {f"{code.co_filename[len(str(self.root)) + 1 :]}:{_dotted(code)}" for code in own}
            self.functions[item.nodeid] = sorted(names)

    def pytest_sessionfinish(self) -> None:
        """Write the records, unless other processes ran the tests."""
        if self.functions:
            noted = {"functions": self.functions, "cpu_s": self.cpu_s, "failed": self.failed}
            self.path.write_text(json.dumps(noted), encoding="utf-8")


def _dotted(code: CodeType) -> str:
    return code.co_qualname.split(".<locals>")[0].split(".<lambda>")[0]


@final
@dataclass(frozen=True, eq=False)
class Choice:
    """Runs some of the tests, and none of them for ever.

    Args:
        only: tests to run, in this order; None for all.
        without: tests not to run.
        cpu_s: that each takes.
    """

    only: list[str] | None
    without: list[str]
    cpu_s: dict[str, float]

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose the tests."""
        items[:] = [item for item in items if item.nodeid not in set(self.without)]
        if self.only is not None:
            place = {test: k for k, test in enumerate(self.only)}
            items[:] = [item for item in items if item.nodeid in place]
            items.sort(key=lambda item: place[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """End the process where a test computes for far too long, be it within a kernel."""
        signal.setitimer(signal.ITIMER_PROF, _LONGER * self.cpu_s.get(item.nodeid, 0.0) + _BESIDES_S)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plugin."""
    parser.addoption("--write-records", type=Path)
    parser.addoption("--choice", type=Path)


def pytest_configure(config: pytest.Config) -> None:
    """Do what the options say."""
    if folder := config.getoption("--write-records"):
        process = getattr(config, "workerinput", {"workerid": "main"})["workerid"]
        config.pluginmanager.register(Recorder(folder / f"{process}.json", config.rootpath))
    if path := config.getoption("--choice"):
        config.pluginmanager.register(Choice(**json.loads(path.read_text(encoding="utf-8"))))
