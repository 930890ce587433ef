"""Solved phases of plans, kept on disk: targets of the tip take a second to solve, and no time to read."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from cosim.base.identity import code_identity, content_name
from cosim.base.kept_parts import is_nameless
from cosim.base.numba_insides import processor
from cosim.base.state_archive import read_archive, write_archive
from cosim.base.whole_files import keep, kept
from cosim.plan.paths.phase_drafts import SolvedPhases

_MOST: Final = 100  # files, of some hundred kilobytes each


def solved_on_disk(folder: Path | None, name: str, solve: Callable[[], SolvedPhases]) -> SolvedPhases:
    """Return the solved phases of a name, from disk or newly solved.

    They are those of the same program on the same kind of processor; paths of the tip are solved anew.

    Args:
        folder: in which files are kept; None: nowhere.
        name: of all that the phases depend on.
        solve: solves them.
    """
    if folder is None or is_nameless(name):
        return solve()
    path = folder / f"plan_{content_name(name, code_identity(), processor())}.kept"
    found = kept(path, _unpacked)
    if found is None:
        found = solve()
        stream = io.BytesIO()
        with suppress(TypeError):  # a path of the tip is no plain data
            write_archive(stream, {}, found)
            keep(path, stream.getvalue())
            _remove_oldest(folder)
    return found


def _unpacked(data: bytes) -> SolvedPhases:
    found = read_archive(io.BytesIO(data))
    if not isinstance(found, SolvedPhases):
        raise TypeError(f"a {type(found).__name__} is no plan")
    return found


def _remove_oldest(folder: Path) -> None:
    """Delete the plans that were solved longest ago, if there are many."""
    with suppress(OSError):  # another process may do the same
        files = sorted(folder.glob("plan_*.kept"), key=lambda path: path.stat().st_mtime)
        for path in files[:-_MOST]:
            path.unlink()
