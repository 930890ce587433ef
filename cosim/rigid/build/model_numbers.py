"""Whether all numbers of a compiled model are finite, and whose those are that are not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from cosim.base.frames import Array


def check_finite(model: mujoco.MjModel) -> None:
    """Check every number of a model, whatever arrays this version of MuJoCo has.

    Raises:
        ValueError: one is not finite; the message names what it belongs to and its attribute.
    """
    wrong = {name: values for name, values in _arrays(model) if not np.isfinite(values).all()}
    if not wrong:
        return
    # names of what MuJoCo works out from the others end in 0
    name = min(wrong, key=lambda name: (name.endswith("0"), name))
    values = wrong[name]
    row = int(np.argwhere(~np.isfinite(values))[0][0]) if values.ndim else 0
    shown = " ".join(f"{value:g}" for value in np.atleast_1d(values[row] if values.ndim else values).ravel())
    owner, attribute = _owner(model, name, row, len(np.atleast_1d(values)))
    raise ValueError(f"{owner}{attribute} is {shown[:80]}; every number must be finite")


def _arrays(part: Any, prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield names and values of all numbers of a model, or of one of its parts such as the options."""
    for name in dir(part):
        value = None if name.startswith("_") else getattr(part, name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            yield f"{prefix}{name}", np.asarray(value)
        elif type(value).__module__.startswith("mujoco") and not callable(value):
            yield from _arrays(value, f"{prefix}{name}.")


def _owner(model: mujoco.MjModel, name: str, row: int, rows: int) -> tuple[str, str]:
    """Return whose number it is, as the beginning of a sentence, and the attribute that holds it."""
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
