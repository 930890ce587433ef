"""Whoever does what a warning of a plan asks for is not warned again."""

from __future__ import annotations

import re
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import cosim
from cosim.base.frames import Pose
from cosim.build.arms import find_arm
from cosim.config.schema.phase import PhaseTable, TipPathTable
from cosim.kinematics.arm import Arm, Payload
from cosim.plan.commands import SoftCommand
from cosim.plan.joint_path import JointPath
from cosim.plan.plan import Holding, PhasePlan, Plan
from cosim.plan.required_motion import planned_arm
from tests.plan.test_arm_limits import heavy, scenario

SMOOTH: dict[str, Any] = {"name": "a", "duration_s": 0.08, "flange_shift_m": [0.2, 0.2, -0.1]}
LINEAR = {"name": "a", "duration_s": 0.05, "ramp": "linear", "flange_shift_m": [0.1, 0.0, 0.0]}
AFTER = {"name": "b", "duration_s": 0.5, "flange_shift_m": [0.0, 0.02, 0.0]}
BACK = {"name": "b", "duration_s": 0.5, "ramp": "linear", "flange_shift_m": [-0.1, 0.0, 0.0]}
SHAKE = {
    "name": "a", "duration_s": 1.0, "ramp": "linear",
    "flange_shake": {"axis": [1.0, 0.0, 0.0], "amplitude_m": 0.05, "frequency_Hz": 6.0},
}  # fmt: skip
ONCE: Any = {"axis": [1.0, 0.0, 0.0], "amplitude_m": 0.005, "frequency_Hz": 3.0}


def warned(path: Path, phases: list[dict[str, Any]]) -> dict[str, str]:
    """Return the warnings of a plan, by quantity."""
    arm = cosim.Simulation(path, overrides={"phase": phases}).stage.arm
    assert arm is not None
    lines = [line.removeprefix("planned: ") for line in arm.warnings()]
    return {line.split(maxsplit=1)[0]: line for line in lines}


def followed(line: str, phases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return phases that do what a warning asks for, and no more."""
    changed = deepcopy(phases)
    by_name = {phase["name"]: phase for phase in changed}
    remedy = line.partition("; ")[2]
    for name, times in re.findall(r"give phase '(\w+)' at least ([\d.]+) times its duration_s", remedy):
        by_name[name]["duration_s"] *= float(times)
        if "divide frequency_Hz of its flange_shake by as much" in remedy:
            by_name[name]["flange_shake"]["frequency_Hz"] /= float(times)
    for name in re.findall(r"give phase '(\w+)' ramp = \"smooth\"", remedy):
        by_name[name]["ramp"] = "smooth"
    for name, least_s in re.findall(
        r"'(\w+)' ramp = \"smooth\" and a duration_s of at least ([\d.]+)", remedy
    ):
        by_name[name]["duration_s"] = float(least_s)
    for name in re.findall(
        r"put the shift of phase '(\w+)' into a separate phase, with ramp = \"smooth\"", remedy
    ):
        shift = by_name[name].pop("flange_shift_m")
        changed.insert(
            0, {"name": "shift", "duration_s": by_name[name]["duration_s"], "flange_shift_m": shift}
        )
    assert changed != phases, f"nothing to follow in: {line}"
    return changed


@pytest.mark.parametrize(
    ("phases", "quantities"),
    [
        ([SMOOTH], {"velocity", "acceleration", "torque"}),
        ([SMOOTH | {"ramp": "step"}], {"velocity"}),
        ([SMOOTH | {"ramp": "step", "duration_s": 5.0}], {"velocity"}),
        ([LINEAR], {"velocity", "acceleration"}),
        ([LINEAR, AFTER], {"velocity", "acceleration"}),
        ([AFTER, LINEAR | {"settle_s": 0.1}], {"velocity", "acceleration"}),
        ([LINEAR, BACK], {"velocity", "acceleration"}),
        ([SHAKE], {"velocity", "acceleration", "torque"}),
        ([LINEAR | {"duration_s": 1.0, "flange_shake": ONCE}], {"acceleration"}),
    ],
    ids=["smooth", "step", "long step", "linear", "linear, then smooth", "linear, then still", "two linear",
         "shake", "shake and shift"],
)  # fmt: skip
def test_a_remedy_that_is_followed_helps(
    tmp_path: Path, phases: list[dict[str, Any]], quantities: set[str]
) -> None:
    path = scenario(tmp_path)
    told = warned(path, phases)
    assert set(told) == quantities
    for quantity, line in told.items():
        assert quantity not in warned(path, followed(line, phases)), line


def test_a_longer_phase_takes_no_longer_than_it_must(tmp_path: Path) -> None:
    """Speed falls as 1 / T, acceleration as 1 / T^2, torque to that of the arm's weight: by hand."""
    path = scenario(tmp_path)
    for quantity, line in warned(path, [SMOOTH]).items():
        times = float(re.findall(r"at least ([\d.]+) times", line)[0])
        shorter = 0.95 * (times - 0.1) / 1.02  # without the rounding and the margin, and a little less
        assert quantity in warned(path, [SMOOTH | {"duration_s": SMOOTH["duration_s"] * shorter}]), line


def warned_on_a_tip_path(speed_m_s: float, ramp_s: float) -> dict[str, str]:
    """Return the warnings of a phase with a tip path, by quantity, for joints that turn evenly along it."""
    points = ((0.4, 0.0, 0.4), (0.4, 0.2, 0.4))
    table = TipPathTable(points_m=points, speed_m_s=speed_m_s, ramp_s=ramp_s)
    course = table.course()
    phase = PhaseTable("follow", course.duration_s, ramp="linear", tip_path=table)
    idle, nothing = SoftCommand((), (), (), ()), Holding(np.zeros(0, np.int64), np.zeros((0, 3), dtype=bool))
    s = np.linspace(0.0, 1.0, 200)
    arm = Arm(find_arm("ur5e"))
    passed = np.linalg.norm(course.at(s * course.duration_s).position - points[0], axis=1)
    path = JointPath(arm.home, CubicSpline(s, arm.home + np.outer(passed, [5.0, 5.0, 0.0, 0.0, 0.0, 0.0])))
    planned = PhasePlan(phase, path, idle, idle, (), nothing, None, Pose())
    plan = Plan(Pose(), arm.home, idle, (0.0, 0.0, -9.81), (planned,))
    scene: Any = SimpleNamespace(tick_s=2e-3, armature=np.zeros(6))
    told = planned_arm(arm, scene, plan, Payload(1.0, np.zeros(3), np.eye(3)), None, dynamic=True).warnings()
    return {line.split()[1]: line for line in told}


def test_a_tip_path_is_slowed_down_as_its_warning_says() -> None:
    told = warned_on_a_tip_path(1.0, 0.1)
    assert set(told) == {"velocity", "acceleration", "torque"}
    for quantity, line in told.items():
        found = re.search(r"divide speed_m_s of the tip_path of phase 'follow' by ([\d.]+), and mul", line)
        assert found is not None, line
        assert quantity not in warned_on_a_tip_path(1.0 / float(found[1]), 0.1 * float(found[1])), line


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_weight_beyond_a_torque_is_not_helped_by_time(tmp_path: Path, mode: str) -> None:
    path = heavy(tmp_path)
    arm = cosim.Simulation(path, overrides={"mode": mode}).stage.arm
    assert arm is not None
    (line,) = arm.warnings()
    assert "; weight alone exceeds the bound: bring the flange closer in, or make the load lighter" in line
    closer = {"mode": mode, "phase.move.flange_shift_m": [0.2, 0.0, 0.0]}
    lighter = {"mode": mode, "soft_robot.mass.node_mass_kg": 0.07}
    for overrides in (closer, lighter):
        helped = cosim.Simulation(path, overrides=overrides).stage.arm
        assert helped is not None
        assert not helped.warnings()
