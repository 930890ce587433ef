"""One policy for all that is kept on disk: where it lies, how much, and how it is listed and deleted."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from cosim.base import caches
from cosim.cli.main import main


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder that the variable names."""
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "kept"))
    return tmp_path / "kept"


def test_all_kinds_are_in_one_folder_and_the_command_lists_and_deletes_them(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in caches.KINDS:
        caches.store(kind, "one", bytes(1_000_000))
        assert caches.load(kind, "one", len) == 1_000_000
    assert sorted(path.name for path in folder.iterdir()) == sorted(caches.KINDS)
    assert main(["cache"]) == 0
    listed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert listed == [[kind, "1", "files", "1.0", "MB", str(folder / kind)] for kind in caches.KINDS]
    assert main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out.count(" 0 files") == len(caches.KINDS)
    assert all(caches.load(kind, "one", len) is None for kind in caches.KINDS)


def test_what_was_not_used_for_longest_is_deleted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caches, "MOST_BYTES", 2500)
    for k, name in enumerate("ab"):
        caches.store(caches.PLANS, name, bytes(1000))
        os.utime(folder / caches.PLANS / name, (time.time() - 1e6 * (3 - k),) * 2)
    caches.load(caches.PLANS, "a", len)
    caches.store(caches.PLANS, "c", bytes(1000))
    assert sorted(path.name for path in (folder / caches.PLANS).iterdir()) == ["a", "c"]


def test_a_damaged_file_is_deleted_with_a_warning(folder: Path) -> None:
    caches.store(caches.PLANS, "a", b"sound")
    path = folder / caches.PLANS / "a"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.warns(RuntimeWarning, match="a: is damaged; its content is computed again"):
        assert caches.load(caches.PLANS, "a", bytes) is None
    assert not path.exists()


def test_a_file_of_another_version_is_deleted_without_a_warning(folder: Path) -> None:
    def cannot(_data: bytes) -> bytes:
        raise LookupError("a class that this version does not have")

    caches.store(caches.PLANS, "a", b"sound")
    assert caches.load(caches.PLANS, "a", cannot) is None
    assert not (folder / caches.PLANS / "a").exists()


def test_without_a_folder_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    for name in (caches.VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "file"))
    caches.store(caches.PLANS, "a", b"sound")
    assert caches.load(caches.PLANS, "a", bytes) is None
    assert main(["cache"]) == 0
