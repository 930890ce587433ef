"""Sets up MuJoCo, raises its warnings as errors, and checks that all numbers of a compiled model
are finite.
"""

from collections.abc import Iterator
from typing import Any, Never

import mujoco
import numpy as np

from cosim.base.frames import Array
from cosim.errors import InstabilityError


def set_up_engine() -> None:
    """Turn off MuJoCo's log file in the working directory, and its mesh cache.

    The cache would use an outdated mesh for a file that was rewritten within a second.
    """
    mujoco.set_mju_user_warning(_ignore)
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)


def raise_instability(data: mujoco.MjData) -> Never:
    """Raise MuJoCo's first warning as an error.

    Raises:
        InstabilityError: the state is not finite, or a mass matrix is singular.
    """
    kind = int(np.flatnonzero(data.warning.number)[0])
    moving = data.time > 0.0  # statics take no steps
    advice = "Use a shorter tick_s, or check" if moving else "Check"
    raise InstabilityError(
        f"the rigid scene became unstable{f' at {data.time:.4f} s' if moving else ''}: "
        f"{mujoco.mju_warningText(kind, data.warning.lastinfo[kind])} {advice} masses and loads."
    )


def _ignore(_message: str) -> None:
    """Ignore a warning; `raise_instability` reads the counts of warnings."""


def check_finite(model: mujoco.MjModel) -> None:
    """Check that every number of a model is finite, in all arrays that this version of MuJoCo has.

    Raises:
        ValueError: one is not; the message names its element and attribute.
    """
    wrong = {name: values for name, values in _arrays(model) if not np.isfinite(values).all()}
    if not wrong:
        return
    # names of arrays that MuJoCo derives from others end in 0
    name = min(wrong, key=lambda name: (name.endswith("0"), name))
    values = wrong[name]
    row = int(np.argwhere(~np.isfinite(values))[0][0]) if values.ndim else 0
    shown = " ".join(f"{value:g}" for value in np.atleast_1d(values[row] if values.ndim else values).ravel())
    owner, attribute = _owner(model, name, row, len(np.atleast_1d(values)))
    raise ValueError(f"{owner}{attribute} is {shown[:80]}; every number must be finite")


def _arrays(part: Any, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield names and values of all arrays of a model, or of one of its parts such as the options."""
    for name in dir(part):
        value = None if name.startswith("_") else getattr(part, name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            yield f"{prefix}{name}", np.asarray(value)
        elif type(value).__module__.startswith("mujoco") and not callable(value):
            yield from _arrays(value, f"{prefix}{name}.")


def _owner(model: mujoco.MjModel, name: str, row: int, rows: int) -> tuple[str, str]:
    """Return the element of a number, as the beginning of a message, and its attribute."""
    kind, _, attribute = name.partition("_")
    if kind in ("dof", "qpos0", "qpos"):
        joints = model.jnt_dofadr if kind == "dof" else model.jnt_qposadr
        kind, row, rows = "jnt", int(np.searchsorted(joints, row, side="right")) - 1, model.njnt
    find = getattr(model, kind, None)
    if find is None:
        return "", name
    if rows != getattr(model, f"n{kind}", rows):  # such as the points of all meshes, one after the other
        first = getattr(model, f"{name}adr", getattr(model, f"{kind}_adr", None))
        if first is None:
            return "", name
        row = int(np.searchsorted(first, row, side="right")) - 1
    return f"{kind.replace('jnt', 'joint')} {find(row).name or row!r}: ", attribute or name
