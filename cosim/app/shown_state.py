"""Checks of the snapshot in a saved state, and one line of error for a file with a wrong state."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np

from cosim.base.column import check_arrays
from cosim.base.frames import Array
from cosim.base.state_checks import check_indices, check_state
from cosim.errors import InputError
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch


def sizes_of(stage: RunInfo) -> dict[str, int]:
    """Return the sizes of a run's arrays, for `check_state`."""
    return {
        "bodies": len(stage.body_names),
        "cables": len(stage.cables),
        "joints": len(stage.joint_names),
        "chambers": len(stage.chamber_names),
        "readings": sum(len(sensor.values) for sensor in stage.sensors),
    }


def check_shown(snapshot: Snapshot, stage: RunInfo) -> None:
    """Check that a saved snapshot fits a run, as programs that draw it assume.

    Raises:
        InputError: it does not.
    """
    sizes, table = sizes_of(stage), snapshot.table
    check_state(table, None, TickBatch, place="snapshot", sizes=sizes, finite=False)
    check_arrays(table.arrays, TickBatch, 1, sizes, "snapshot")
    check_state(table.film._shapes, None, Annotated[Array, (1, "k", 3)], place="snapshot.film", finite=False)
    if table.film._reader is not None or len(table.devices) != 1:
        raise InputError("snapshot.film has unread shapes, or those of several ticks")
    check_indices(np.array([snapshot.phase]), len(stage.phase_names), "phases")
    check_indices(np.array([snapshot.tick]), stage.ticks + 1, "ticks")
    for nodes in (stage.soft_triangles, *stage.cables):
        check_indices(nodes, len(snapshot.node_position), "nodes")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn any error of a wrong state into one line with the name of its file.

    Raises:
        InputError: instead of any other error.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # values may be wrong though types and sizes are right
        text = (str(error).splitlines() or [""])[0]
        raise InputError(f"{path}: does not fit this run ({type(error).__name__}: {text})") from error
