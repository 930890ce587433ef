"""What `RigidScene.save_state` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

from cosim.base.frames import Array, IntArray


@final
@dataclass(frozen=True)
class RigidState:
    """Everything that a step depends on or leaves behind.

    Args:
        integration: MuJoCo's own state vector, inputs and warm start included.
        armature: (dofs,) [kg m^2] or [kg], the algorithmic mass of free bodies included.
        acceleration: (dofs,) of the last finished step.
        servo_torque: (dofs,) [N m] or [N], of the last finished step.
        flange_load: (6,) reading of the flange sensor.
        loaded: bodies that contact loads at present.
        carrying: bodies on joints that carry extra inertia.
        carried: their inertia (b, 6, 6).
        on_arm: (joints, joints) [kg m^2], that the arm's joints carry.
    """

    integration: Array
    armature: Array
    acceleration: Array
    servo_torque: Array
    flange_load: Array
    loaded: Annotated[IntArray, ("k",)]
    carrying: Annotated[IntArray, ("b",)]
    carried: Annotated[Array, ("b", 6, 6)]
    on_arm: Array
