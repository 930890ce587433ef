"""The UR5e with the reference scenario's soft robot, or a short one, at the ends of what may be asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from benchmarks.atlas.extremes import Verdict, judged
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.telemetry.tick_batch import Snapshot

SCENARIO = "ur5e_hexagon_arm"
ARM_MASS_KG = 17.7  # the UR5e's moving links
TICKS_MAX = 400
RUNAWAY_M = 10.0
SHORT_NODES = 90  # of two units
# flange positions and directions; at those marked singular the arm's Jacobian loses rank
POSES: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "ordinary": ((0.3, 0.0, 0.7), (0.0, 0.0, -1.0)),
    "nearly straight": ((0.80, 0.0, 0.35), (1.0, 0.0, -0.2)),
    "straight (singular)": ((0.891935, 0.159943, 0.321674), (0.124149, 0.267499, -0.955527)),
    "at the shoulder (singular)": ((0.009614, 0.169391, 0.546152), (0.096527, 0.362358, -0.927027)),
    "wrist in line (singular)": ((0.372, 0.2329, 0.4097), (0.0, 1.0, 0.0)),
    "upright": ((-0.0196, 0.2285, 1.0799), (-0.2955, 0.9553, 0.0059)),
    "too near the base": ((0.16, 0.0, 0.4), (0.0, 0.0, -1.0)),
    "out of reach": ((1.5, 0.0, 0.7), (0.0, 0.0, -1.0)),
}


@dataclass(frozen=True)
class ArmExtreme:
    """One run on the arm; the defaults are the reference scenario's turn, hurried.

    Args:
        mass_ratio: of the soft robot to the arm's links; None: as it is.
        short: two units instead of ten, no cables.
        pose: at the start, of POSES.
        step_m: the flange's reference jumps by so much (0: it turns by half a radian in 0.3 s).
        object_kg: mass of a ball in the tip's way, without gravity; None for no ball.
        published: the paper's lumped model; False: the robot as its file has it.
    """

    tick_s: float = 0.002
    pressure_Pa: float = 30e3
    mass_ratio: float | None = None
    short: bool = False
    pose: str = "ordinary"
    step_m: float = 0.0
    object_kg: float | None = None
    integrator: str = "implicit_euler"
    published: bool = True


def overrides(extreme: ArmExtreme) -> dict[str, Any]:
    """Return the changes to the reference scenario."""
    phase: dict[str, Any] = {"name": "move", "duration_s": 0.3, "settle_s": 0.1}
    if extreme.step_m:
        phase |= {"ramp": "step", "flange_shift_m": [0.6 * extreme.step_m, 0.8 * extreme.step_m, 0.0]}
    else:
        phase |= {"flange_turn": {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.5}}
    position, direction = POSES[extreme.pose]
    changes: dict[str, Any] = {
        "model.published": extreme.published,
        "clock.tick_s": extreme.tick_s,
        "solver.integrator": extreme.integrator,
        "start.pressure_Pa": extreme.pressure_Pa,
        "start.flange.position_m": position,
        "start.flange.direction": direction,
        "phase": [phase],
    }
    if extreme.short:
        robot: dict[str, Any] = {"file": "hexagon_arm", "stack": {"units": 2}, "cable": []}
        if extreme.mass_ratio is not None:
            robot["mass"] = {"node_mass_kg": extreme.mass_ratio * ARM_MASS_KG / SHORT_NODES}
        changes |= {"soft_robot": robot, "start.cable_tension_N": []}
    if extreme.object_kg is not None:
        ball = {"name": "ball", "shape": "sphere", "size_m": [0.04], "mass_kg": extreme.object_kg,
                "position_m": [0.42, 0.0, 0.56]}  # fmt: skip
        changes |= {"object": [ball], "gravity_m_s2": [0.0, 0.0, 0.0]}
    return changes


def _check(snapshot: Snapshot) -> None:
    numbers = [snapshot.node_position.ravel(), snapshot.joint_position, snapshot.wrench.force,
               snapshot.wrench.torque, snapshot.body_position.ravel(), snapshot.tip_position]  # fmt: skip
    if not np.isfinite(np.concatenate(numbers)).all():
        raise ArithmeticError("a number that is not finite left the loop")
    far = float(np.linalg.norm(snapshot.tip_position - snapshot.world_from_flange.translation))
    if far > RUNAWAY_M:
        raise ArithmeticError(f"the tip ran away: {far:.3g} m from the flange")


def probe_arm(extreme: ArmExtreme) -> Verdict:
    """Run the scenario, for at most 400 ticks, and say how it ended."""
    kept: list[Snapshot] = []

    def run() -> float:
        iterations = ticks = 0
        for snapshot in islice(build(load_scenario(SCENARIO, overrides(extreme))).steps(), TICKS_MAX):
            _check(snapshot)
            kept[:] = [snapshot]
            ticks += 1
            iterations += snapshot.newton_iterations if ticks > 1 else 0
        return iterations / max(ticks - 1, 1)

    return judged(run, lambda: not kept or bool(np.isfinite(kept[0].node_position).all()))
