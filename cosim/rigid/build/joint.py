"""How an object hangs on another one, or on the world: by a hinge or a slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosim.errors import InputError


@dataclass(frozen=True)
class Joint:
    """One degree of freedom between an object and its parent; 0 where the scene is drawn.

    Moment = -stiffness q - damping dq/dt - friction sign(dq/dt). The spring is stepped implicitly: MuJoCo
    takes springs explicitly and damping implicitly, so stiffness times tick rides along as damping.

    Args:
        kind: turns about the axis, or shifts along it.
        axis: (3,) world, where the scene is drawn.
        anchor_m: (3,) [m], world, a point on the axis of a hinge.
        parent: name of the object that it hangs on; None for the world.
        limits: smallest and largest q [rad] or [m]; None for free motion.
        damping: [N m s] or [N s/m].
        stiffness: [N m] or [N/m].
        friction: dry, [N m] or [N].

    Raises:
        InputError: an axis without direction, or a value outside its bounds.
    """

    kind: Literal["hinge", "slide"]
    axis: tuple[float, float, float]
    anchor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parent: str | None = None
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    stiffness: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.axis)) and np.linalg.norm(self.axis) > 1e-9):
            raise InputError(f"axis is {self.axis}; it must not be zero")
        for name in ("damping", "stiffness", "friction"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} is {value}; it must be finite and not negative")
        if self.limits is not None and not self.limits[0] <= 0.0 <= self.limits[1]:
            raise InputError(f"limits are {self.limits}; they must hold 0, where the scene is drawn")
