"""How well MuJoCo and Pinocchio agree on an arm, and that its tool is where the maker says.

Largest differences over random states within the joint limits; the mass matrix, gravity torque and
bias torque relative to their largest component, armature left out on both sides.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene


def differences(name: str, states: int, seed: int = 0) -> dict[str, Any]:
    """Return the largest differences between the two models of an arm."""
    file = find_arm(name)
    arm, rng = Arm(file), np.random.default_rng(seed)
    scene = RigidScene(SceneDescription(file, armature=0.0, floor_height_m=None))
    rows = []
    for _ in range(states):
        q, v = rng.uniform(*arm.drawn_from), rng.normal(size=arm.joint_count)
        pose, mass, gravity = arm.forward(q), arm.mass_matrix(q), arm.gravity_torque(q)
        scene.set_joint_state(q)
        gravity_error = relative(scene.bias_torque, gravity)
        scene.set_joint_state(q, v)
        bias = arm.inverse_dynamics(q, v, np.zeros_like(q)) - arm.joint_damping * v
        rows.append(
            (
                float(np.linalg.norm(scene.flange_pose.translation - pose.translation)),
                float(np.max(np.abs(scene.flange_pose.rotation - pose.rotation))),
                float(np.max(np.abs(scene.flange.jacobian() - arm.jacobian(q)))),
                relative(scene.mass_matrix, mass),
                gravity_error,
                relative(scene.bias_torque, bias),
            )
        )
    names = (
        "flange_position_m",
        "flange_rotation",
        "jacobian",
        "mass_matrix_relative",
        "gravity_torque_relative",
        "bias_torque_relative",
    )
    worst = dict(zip(names, np.max(rows, axis=0).tolist(), strict=True))
    tool = arm.forward(np.zeros(arm.joint_count)).translation.round(12).tolist()
    return {"arm": name, "states": states, **worst, "tool_at_zero_m": tool}


def relative(value: Any, reference: Any) -> float:
    """Return the largest difference over the largest component of the reference."""
    return float(np.max(np.abs(value - reference)) / np.max(np.abs(reference)))


def main() -> None:
    """Print the figures, as lines or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=1000)
    parser.add_argument("--json", action="store_true", help="print one JSON list")
    arguments = parser.parse_args()
    figures = [differences(name, arguments.states) for name in list_arms()]
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for entry in figures:
        print(entry["arm"])
        for name, value in entry.items():
            print(f"  {name}: {value}")


if __name__ == "__main__":
    main()
