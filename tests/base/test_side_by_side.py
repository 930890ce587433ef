"""Processes compile kernels for one another; whatever one does not leave on disk is compiled by who asked."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cosim.base import kernels
from tests.base.forked_python import run_forked

SOURCES = Path(kernels.__file__).parent
MODULE = """
from cosim.base.kernels import kernel
@kernel
def first(x: float) -> float:
    return {factor} * x
@kernel
def second(x: float) -> float:
    return {factor} * x + 1.0
"""
MODULES = 3
RUN = """
import importlib, logging, os, subprocess, sys, time
from cosim.base import compilation
{before}
modules = tuple(importlib.import_module(f"cosim.part_{{k}}") for k in range({modules}))
told, started, begin = [], [], subprocess.Popen
subprocess.Popen = lambda *given, **more: started.append(begin(*given, **more)) or started[-1]
os.sched_getaffinity = lambda process: {{0, 1}}
logging.getLogger("cosim").addFilter(told.append)
compilation.compile_modules(modules)
kernels = [kernel for module in modules for kernel in (module.first, module.second)]
count = lambda stats: sum(sum(getattr(kernel.stats, stats).values()) for kernel in kernels)
values = [kernel(10.0) for kernel in kernels]
assert all(process.poll() is not None for process in started)
print(values, count("cache_hits"), count("cache_misses"), len(started), len(told), sep="|")
"""
IDLE = "compilation.compile_parts = lambda take, parts: None"
VALUES = "[0.0, 1.0, 10.0, 11.0, 20.0, 21.0]"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package of some modules with two kernels each."""
    folder = tmp_path / "cosim"
    shutil.copytree(SOURCES, folder / "base", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "__init__.py").touch()
    shutil.copy(SOURCES.parent / "errors.py", folder)
    for k in range(MODULES):
        (folder / f"part_{k}.py").write_text(MODULE.format(factor=float(k)), encoding="utf-8")
    return folder


def run(package: Path, before: str = "", **environment: str) -> tuple[str, int, int, int, int]:
    """Return what all kernels make of 10; how many were on disk, compiled; processes and announcements."""
    environment = {"NUMBA_NUM_THREADS": "2", **environment}
    done = run_forked(RUN.format(before=before, modules=MODULES), package.parent, **environment)
    assert done.returncode == 0, done.stderr
    values, *counts = done.stdout.split("|")
    hits, misses, started, told = map(int, counts)
    return values, hits, misses, started, told


def test_what_another_process_has_compiled_is_loaded(package: Path) -> None:
    assert run(package, IDLE) == (VALUES, 6, 0, 1, 1)


def test_all_is_compiled_once_and_nothing_is_started_when_all_is_there(package: Path) -> None:
    values, hits, misses, started, told = run(package)
    assert (values, hits + misses, started, told) == (VALUES, 6, 1, 1)
    assert run(package) == (VALUES, 6, 0, 0, 0)


def test_where_a_file_was_edited_all_are_compiled_anew(package: Path) -> None:
    run(package)
    (package / "part_0.py").write_text(MODULE.format(factor=30.5), encoding="utf-8")
    assert run(package, IDLE) == ("[305.0, 306.0, 10.0, 11.0, 20.0, 21.0]", 6, 0, 1, 1)


@pytest.mark.parametrize(
    "script", ["exit 1", "head -c 1 > taken; exit 1", "head -c 1 > taken; kill -9 $$", None]
)
def test_what_another_process_has_left_undone_is_compiled_here(package: Path, script: str | None) -> None:
    other = package.parent / "other.sh"
    if script is not None:
        other.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        other.chmod(0o755)
    found = run(package, f"sys.executable = {str(other)!r}")
    assert found == (VALUES, 0, 6, 0 if script is None else 1, 1)


def test_an_interruption_ends_the_others(package: Path) -> None:
    before = """
def interrupted(take, parts):
    raise KeyboardInterrupt
compilation.compile_parts = interrupted
whole = compilation.compile_modules
def compile_modules(*given):
    try:
        whole(*given)
    except KeyboardInterrupt:
        assert [process.poll() for process in started] == [-9]
compilation.compile_modules = compile_modules
"""
    assert run(package, before)[3] == 1


def test_one_thread_is_one_process(package: Path) -> None:
    assert run(package, NUMBA_NUM_THREADS="1") == (VALUES, 0, 6, 0, 1)
