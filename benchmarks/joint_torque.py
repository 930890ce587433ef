"""Torques of joints in runs against inverse dynamics of their motion, and against the plan, at several ticks.

    python benchmarks/joint_torque.py [--arms ur5e panda] [--ticks-ms 4 2 1 0.5] [--motions rest move hurry]

A frozen soft robot hangs on the arm. In every tick, the torque that the run reports is compared with the
inverse dynamics (Pinocchio's RNEA) of the run's angles, speeds and change of speed, with the rotor inertia
of the scene and the wrench that acted on the flange; friction is that at the end of the tick. Dry friction of
a joint that hardly moves, turns round or comes to a halt in a tick may be anything up to its bound, to either
side: there only what is off by more than that counts. `hurry` asks for more than the servos can give.
Differences are relative to the joint's largest torque in that motion, or to `LEAST_NM` if that is more.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cosim
from cosim.base.frames import Array
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm

ARMS = ("ur5e", "ur3", "ur10", "panda", "xarm7")
TICKS_MS = (4.0, 2.0, 1.0, 0.5)
LEAST_NM = 2.5
"""2 % of it are 0.05 N m."""
CREEP_RAD_S = 2e-3
HALTS = 0.1  # of a tick's change of speed: a joint that is slower at its end has come to a halt
MOTIONS = {"rest": (0.1, 0.0), "move": (0.5, 0.15), "hurry": (0.08, 0.2)}
"""Duration [s] and way [m]."""
SCENARIO = """schema = 2
title = "joint torque"
robot = "{arm}"
soft_robot = "hexagon_arm"
fidelity = "rigid"
[clock]
tick_s = {tick_s}
[start]
flange = {{ position_m = {position}, direction = {direction} }}
pressure_Pa = 30e3
[[phase]]
name = "move"
duration_s = {duration_s}
flange_shift_m = [0.0, {way_m}, 0.0]
"""


@dataclass(frozen=True)
class Torques:
    """Torques of one run, n ticks.

    Args:
        limit: (joints,) [N m].
        reported: (n, joints) [N m], by the run.
        of_motion: (n, joints) [N m], by inverse dynamics of the run's motion.
        planned: (n, joints) [N m], by inverse dynamics of what the servos are asked for.
        unknown: (n, joints) [N m], by how much dry friction may be off.
    """

    limit: Array
    reported: Array
    of_motion: Array
    planned: Array
    unknown: Array

    @property
    def saturated(self) -> bool:
        """Whether a servo gave all it could."""
        return bool((np.abs(self.reported) >= 0.999 * self.limit).any())

    def apart(self, other: Array) -> float:
        """Return the largest difference of reported torques from others (n, joints)."""
        largest = np.maximum(np.abs(self.of_motion).max(axis=0), LEAST_NM)
        off = np.maximum(np.abs(self.reported - other) - self.unknown, 0.0)
        return float((off.max(axis=0) / largest).max())


def run(name: str, motion: str, tick_s: float, folder: Path) -> Torques:
    """Return the torques of a run.

    Args:
        name: of the arm.
        motion: in `MOTIONS`.
        tick_s: of the clock.
        folder: for the scenario's file.
    """
    file, (duration_s, way_m) = find_arm(name), MOTIONS[motion]
    arm = Arm(file)
    flange = arm.forward(arm.home)
    position, direction = flange.translation.tolist(), flange.rotation[:, 2].tolist()
    path = folder / "joint_torque.toml"
    path.write_text(
        SCENARIO.format(
            arm=name,
            tick_s=tick_s,
            position=position,
            direction=direction,
            duration_s=duration_s,
            way_m=way_m,
        )
    )
    result = cosim.run(path, error=False)
    q, v, aim = result.joint_position, result.joint_velocity, result.joint_target
    wrench = np.hstack([result.flange_force, result.flange_torque])
    of_motion, planned = np.empty((2, len(q) - 3, arm.joint_count))
    for row, k in enumerate(range(1, len(q) - 2)):
        load = arm.jacobian(q[k]).T @ wrench[k]
        of_motion[row] = arm.inverse_dynamics(q[k], v[k], (v[k + 1] - v[k]) / tick_s, file.armature) - load
        of_motion[row] += arm.friction(v[k + 1]) - arm.friction(v[k])
        speed = (aim[k + 2] - aim[k]) / (2.0 * tick_s)
        change = (aim[k + 2] - 2.0 * aim[k + 1] + aim[k]) / tick_s**2
        planned[row] = arm.inverse_dynamics(aim[k + 1], speed, change, file.armature) - load
    begin, end = v[1:-2], v[2:-1]
    halts = (begin * end < 0.0) | (np.abs(end) < np.maximum(CREEP_RAD_S, HALTS * np.abs(end - begin)))
    unknown = np.where(halts, 2.0 * arm.dry_friction(np.ones(arm.joint_count)), 0.0)
    return Torques(arm.effort_limit, result.joint_torque[2:-1], of_motion, planned, unknown)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="+", default=ARMS)
    parser.add_argument("--ticks-ms", nargs="+", type=float, default=TICKS_MS)
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    chosen = parser.parse_args()
    print("| arm | motion | tick [ms] | largest torque [N m] | saturated | off RNEA [%] | off the plan [%] |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen.arms:
            for motion in chosen.motions:
                for tick_ms in chosen.ticks_ms:
                    found = run(name, motion, 1e-3 * tick_ms, Path(folder))
                    off, plan = 100.0 * found.apart(found.of_motion), 100.0 * found.apart(found.planned)
                    full = "yes" if found.saturated else "no"
                    largest = np.abs(found.reported).max()
                    print(
                        f"| {name} | {motion} | {tick_ms:g} | {largest:.2f} | {full} | {off:.3f} |"
                        + (f" {plan:.2f} |" if not found.saturated else " |"),
                        flush=True,
                    )


if __name__ == "__main__":
    main()
