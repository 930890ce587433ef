"""Machine code is kept under a hash of all the source that went into it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cosim.base import kernels
from cosim.base.kept import kernel_cache
from cosim.soft.elements import cable

SOURCES = Path(kernels.__file__).parent
KERNEL = """
from cosim.base.kernels import REAL, kernel
from cosim.factor import times
@kernel((REAL,))
def scaled(x):
    return times(x)
"""
HELPER = """
from cosim.base.kernels import device_function
from cosim.constants import FACTOR
@device_function
def times(x):
    return {factor} * FACTOR * x
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package of a kernel, a helper that is inlined from another file, and a number of a third."""
    folder = tmp_path / "cosim"
    shutil.copytree(SOURCES, folder / "base", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "__init__.py").touch()
    shutil.copy(SOURCES.parent / "errors.py", folder)
    (folder / "constants.py").write_text("FACTOR = 1.0\n", encoding="utf-8")
    (folder / "factor.py").write_text(HELPER.format(factor=2.0), encoding="utf-8")
    (folder / "scaled.py").write_text(KERNEL, encoding="utf-8")
    return folder


def run(package: Path) -> tuple[float, int]:
    """Return what the kernel makes of 1 in a new process, and how often it had to be compiled."""
    code = (
        "from cosim.scaled import scaled; y = scaled(1.0);print(y, sum(scaled.stats.cache_misses.values()))"
    )
    environment = os.environ | {"PYTHONPATH": str(package.parent)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=package.parent, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    value, misses = done.stdout.split()
    return float(value), int(misses)


def test_what_is_inlined_from_another_file_is_compiled_anew_when_that_changes(package: Path) -> None:
    assert run(package) == (2.0, 1)
    assert run(package) == (2.0, 0)
    (package / "factor.py").write_text(HELPER.format(factor=3.0), encoding="utf-8")
    assert run(package) == (3.0, 1)
    (package / "constants.py").write_text("FACTOR = 10.0\n", encoding="utf-8")
    assert run(package) == (30.0, 1)
    (package / "factor.py").write_text(HELPER.format(factor=2.0), encoding="utf-8")
    (package / "constants.py").write_text("FACTOR = 1.0\n", encoding="utf-8")
    assert run(package) == (2.0, 0)  # kept beside the others


def test_imports_of_every_form_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "_PACKAGE", tmp_path)
    for name in ("a", "b", "c", "d", "e"):
        (tmp_path / f"{name}.py").touch()
    main = tmp_path / "main.py"
    main.write_text(
        "from cosim.a import x\nfrom cosim import b, no\nfrom cosim import (\n    c,\n    d as other,\n)\n"
        "import numpy\ndef f():\n    import cosim.e\n",
        encoding="utf-8",
    )
    assert {path.stem for path in kernels._imports(main)} == {"a", "b", "c", "d", "e"}


def test_old_machine_code_is_deleted_and_that_of_other_kernels_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "_OLD_S", 60.0)
    kernel = next(value for value in vars(cable).values() if hasattr(value, "fixed_signature"))
    kept = kernel._cache
    base = kept._impl.filename_base
    own = kept._cache_file._index_name
    monkeypatch.setattr(kept, "_cache_path", str(tmp_path))
    for name in (own, f"{base}.1.nbc", f"{base}-0123456789ab.nbi", f"{base}-ba9876543210.nbi", "other.1.nbc"):
        (tmp_path / name).touch()
        age_s = 0.0 if name.startswith(f"{base}-ba") else 100.0
        os.utime(tmp_path / name, (time.time() - age_s,) * 2)
    kernel_cache.remove_old([kernel])
    left = {own, f"{base}-ba9876543210.nbi", "other.1.nbc"}
    assert {path.name for path in tmp_path.iterdir()} == left
