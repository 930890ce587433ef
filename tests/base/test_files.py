"""Files: what is read is gathered by every block around it; one that cannot be rewritten stays as it was."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cosim.base.files import files_read, read_file
from cosim.base.whole_files import rewrite


def test_blocks_around_one_that_reads_get_its_files_as_well(tmp_path: Path) -> None:
    path = tmp_path / "read.txt"
    path.write_bytes(b"text")
    with files_read() as outer:
        with files_read() as inner:
            read_file(path, 10)
        assert set(inner) == {str(path)}
    assert outer == inner


@pytest.mark.parametrize("fails_at", [1, 2])
def test_a_file_that_cannot_be_rewritten_is_what_it_was(
    fails_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, written = tmp_path / "file.txt", []
    path.write_bytes(b"before")

    def full(_descriptor: int) -> None:
        written.append(None)
        if len(written) == fails_at:  # of the copy kept meanwhile, or of the file
            raise OSError("no space left")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="no space left"):
        rewrite(path, b"after, and longer")
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
