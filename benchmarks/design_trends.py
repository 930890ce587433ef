"""What a designer changes, and which way the answer goes: sign and size of some trends, mesh by mesh.

    python benchmarks/design_trends.py [--trends lift higher ..] [--meshes drawn default ..]

lift: mean tension with which the cables bring the tip of `ur5e_hexagon_arm` to its height, 0.59 m, in films
of 0.11 and 0.15 mm; statics of the plan alone. higher: the same to 0.62 m. grip: force of one gripper finger,
weightless, that curls around a fixed roll without friction, at 30 and 40 kPa, mean while its cables go from
1 to 2 N; its units may pass through one another. thicker: the same at 30 kPa, in films of
0.11 and 0.15 mm. touching, touching_thicker: as both, but units touch, as they do unless told otherwise.
Meshes: "drawn" is the paper's model on its mesh, "default" the robot as its file states it, "refined" and
"twice" the same on triangles cut once and twice. A way without an equilibrium is named below its row.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from cosim.base.kept_parts import KeptParts
from cosim.build.simulation import build
from cosim.build.soft_model import SoftModel
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError, SolverError
from cosim.plan.planning import make_plan, solved_phases
from cosim.stepping.carrier import HeldBase

Changes = Mapping[str, Any]
MESHES: dict[str, Changes] = {
    "drawn": {"model.published": True},
    "default": {"model.published": False},
    "refined": {"model.published": False, "soft_robot.stack.mesh": "drawn", "soft_robot.stack.refine": 1},
    "twice": {"model.published": False, "soft_robot.stack.mesh": "drawn", "soft_robot.stack.refine": 2},
}
AROUND_ROLL: Changes = {
    "robot": "ur5e",
    "contact": {"stiffness_N_m3": 1e8, "smoothing_m": 3e-4},   # soft pads, as in gripper_lifts_roll
    "start.flange": {"position_m": [0.45, 0.0, 0.6], "direction": [0.0, 0.0, -1.0]},
    "object": [
        {
            "name": "roll", "shape": "cylinder", "size_m": [0.035, 0.1],
            "position_m": [0.45, 0.075, 0.5], "quaternion": [0.5**0.5, 0.0, 0.5**0.5, 0.0],   # along x
        }
    ],
    "phase": [
        {"name": "inflate", "duration_s": 1.0, "ramp": "linear", "increments": 60},
        {"name": "close", "duration_s": 1.0, "ramp": "linear", "increments": 40, "cable_tension_N": [2, 2]},
    ],
}  # fmt: skip


def lift_tension(changes: Changes) -> float:
    """Return the mean tension of the cables at the end of `lift` [N]."""
    scenario = load_scenario("ur5e_hexagon_arm", changes)
    names = [phase.name for phase in scenario.phases]
    scenario = replace(scenario, phases=scenario.phases[: names.index("lift") + 1])
    model = SoftModel(scenario, KeptParts())
    plan = make_plan(scenario, HeldBase.plan, model.body, lambda: solved_phases(scenario, model.trial()))
    return float(np.mean(plan.phases[-1].end.cable_tension_N))


def grip_force(changes: Changes) -> float:
    """Return the mean force on the roll over the second half of the pull [N]."""
    simulation = build(load_scenario("gripper_finger_closing", {**AROUND_ROLL, **changes}))
    roll = simulation.stage.body_names.index("roll")
    forces = [np.linalg.norm(snapshot.body_contact_force[roll]) for snapshot in simulation.steps()]
    return float(np.mean(forces[-20:]))


@dataclass(frozen=True)
class Trend:
    """What is changed, and what is looked at.

    Args:
        answer: figure of a scenario with some changes.
        key: what is changed.
        values: from and to.
        besides: changes on either side.
    """

    answer: Callable[[Changes], float]
    key: str
    values: tuple[float, float]
    besides: Changes = field(default_factory=dict)


THROUGH, TOUCHING = ({"contact.self_contact": touches} for touches in (False, True))
AT_30_KPA = {"phase.inflate.pressure_Pa": 30e3}
FILMS, PRESSURES = (0.11e-3, 0.15e-3), (30e3, 40e3)
TRENDS = {
    "lift": Trend(lift_tension, "soft_robot.film.thickness_m", FILMS),
    "higher": Trend(
        lift_tension, "soft_robot.film.thickness_m", FILMS,
        {"phase.lift.tip_target": {"height_m": 0.62, "reach_with": "cables"}},
    ),
    "grip": Trend(grip_force, "phase.inflate.pressure_Pa", PRESSURES, THROUGH),
    "thicker": Trend(grip_force, "soft_robot.film.thickness_m", FILMS, AT_30_KPA | THROUGH),
    "touching": Trend(grip_force, "phase.inflate.pressure_Pa", PRESSURES, TOUCHING),
    "touching_thicker": Trend(grip_force, "soft_robot.film.thickness_m", FILMS, AT_30_KPA | TOUCHING),
}  # fmt: skip


def row(name: str, mesh: str) -> str:
    """Return the line of one trend on one mesh, and where a way was lost."""
    trend, found, lost, began = TRENDS[name], list[float](), "", time.process_time()
    for value in trend.values:
        try:
            found.append(trend.answer({**trend.besides, **MESHES[mesh], trend.key: value}))
        except (ScenarioError, SolverError) as error:
            found.append(np.nan)
            lost += f"\n  {trend.key} = {value:g}: {error}"
    low, high = found
    cells = (name, mesh, f"{low:.2f}", f"{high:.2f}", f"{100 * (high / low - 1):+.0f} %")
    return f"| {' | '.join(cells)} | {time.process_time() - began:.0f} |{lost}"


def main() -> None:
    """Print a row for every trend and mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trends", nargs="+", choices=TRENDS, default=list(TRENDS))
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES)[:-1])
    options = parser.parse_args()
    print("| trend | mesh | from [N] | to [N] | change | CPU s |\n|---|---|---|---|---|---|", flush=True)
    for name in options.trends:
        for mesh in options.meshes:
            print(row(name, mesh), flush=True)


if __name__ == "__main__":
    main()
