"""Turns MuJoCo's warnings into errors."""

from __future__ import annotations

import mujoco
import numpy as np

from cosim.errors import InstabilityError


def silence_warning_file() -> None:
    """Keep MuJoCo from writing its warnings to a file in the working directory."""
    mujoco.set_mju_user_warning(_ignore)


def raise_if_unstable(data: mujoco.MjData) -> None:
    """Raise when MuJoCo has warned since the data was made.

    Raises:
        InstabilityError: the state is no longer finite, or a mass matrix is singular.
    """
    counts = data.warning.number
    if not counts.any():
        return
    kind = int(np.flatnonzero(counts)[0])
    raise InstabilityError(
        f"the rigid scene became unstable at {data.time:.4f} s: "
        f"{mujoco.mju_warningText(kind, data.warning.lastinfo[kind])} Use a shorter tick_s, or check masses "
        "and loads."
    )


def _ignore(_message: str) -> None:
    """Take a warning; `raise_if_unstable` reports it from the counts."""
