"""Turns MuJoCo's warnings into errors, and keeps it from what would outlast a scene."""

from __future__ import annotations

from typing import Never

import mujoco
import numpy as np

from cosim.errors import InstabilityError


def set_up_engine() -> None:
    """Keep MuJoCo from writing warnings to a file in the working directory, and from keeping meshes.

    It would take a mesh that it has read before for the one of a file that was rewritten within a second.
    """
    mujoco.set_mju_user_warning(_ignore)
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)


def raise_instability(data: mujoco.MjData) -> Never:
    """Raise what MuJoCo has warned of since the data was made.

    Raises:
        InstabilityError: the state is no longer finite, or a mass matrix is singular.
    """
    kind = int(np.flatnonzero(data.warning.number)[0])
    moving = data.time > 0.0  # statics take no steps
    advice = "Use a shorter tick_s, or check" if moving else "Check"
    raise InstabilityError(
        f"the rigid scene became unstable{f' at {data.time:.4f} s' if moving else ''}: "
        f"{mujoco.mju_warningText(kind, data.warning.lastinfo[kind])} {advice} masses and loads."
    )


def _ignore(_message: str) -> None:
    """Take a warning; `raise_instability` reports it from the counts."""
