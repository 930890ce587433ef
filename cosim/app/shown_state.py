"""Checks of what a saved run shows of itself, and one line for whatever is wrong with its file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from cosim.base.state_check import check_indices, check_state
from cosim.errors import InputError
from cosim.telemetry.snapshot import RunInfo, Snapshot


def sizes_of(stage: RunInfo) -> dict[str, int]:
    """Return the counts by which `check_state` judges what a simulation shows of itself."""
    return {
        "bodies": len(stage.body_names),
        "cables": len(stage.cables),
        "chambers": len(stage.chamber_names),
    }


def check_shown(snapshot: Snapshot, stage: RunInfo) -> None:
    """Check that a saved snapshot is one of a stage: what draws it takes that for granted.

    Raises:
        InputError: it is not.
    """
    check_state(snapshot, None, Snapshot, place="snapshot", sizes=sizes_of(stage), finite=False)
    check_indices(np.array([snapshot.phase]), len(stage.phase_names), "phases")
    check_indices(np.array([snapshot.tick]), stage.ticks + 1, "ticks")
    for nodes in (stage.soft_triangles, *stage.cables):
        check_indices(nodes, len(snapshot.node_position), "nodes")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn whatever a state that was made up raises into one line with the name of its file.

    Raises:
        InputError: in place of any other error.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # a state may be wrong in more ways than its kinds and sizes
        text = (str(error).splitlines() or [""])[0]
        raise InputError(f"{path}: does not fit this run ({type(error).__name__}: {text})") from error
