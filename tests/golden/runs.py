"""The golden runs by name: calls with a folder for results, changes by key path, and a nudge of the start."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import mujoco
import numpy as np
import pytest

import cosim
from cosim.cli.main import main
from tests.golden.figures import Figures, flat, of_recording, of_result

HERE: Final = Path(__file__).resolve().parent
PUBLISHED: Final[dict[str, Any]] = {"model.published": True}
SLIDING: Final[dict[str, Any]] = {
    "object.table.friction": 0.5, "phase.slide.ramp": "linear", "phase.slide.settle_s": 0.0,
}  # fmt: skip
"""The phase ends while the finger slides."""
CONTROLLED_SHORTLY: Final[dict[str, Any]] = {
    "phase.bang_bang.duration_s": 1.0, "phase.pi_tension.duration_s": 0.8, "phase.pi_length.duration_s": 0.6,
    "phase.relax.settle_s": 0.3, "phase.relax_again.settle_s": 0.3,
}  # fmt: skip
CONTROLLED: Final[dict[str, Any]] = {
    "phase.bang_bang.duration_s": 3.0, "phase.pi_tension.duration_s": 2.5, "phase.pi_length.duration_s": 2.0,
}  # fmt: skip
HELD_SHORTLY: Final[dict[str, Any]] = {"phase.shake.duration_s": 1.5, "phase.hold.duration_s": 0.2}
QUICK: Final[dict[str, Any]] = {
    f"phase.{name}.{key}": seconds
    for name, (ramp_s, settle_s) in {
        "hang": (0.2, 0.1), "inflate": (0.8, 0.2), "turn": (1.0, 0.3), "lift": (0.8, 0.2),
        "reach": (1.4, 0.2),
    }.items()
    for key, seconds in (("duration_s", ramp_s), ("settle_s", settle_s))
}  # fmt: skip
"""The reference scenario in a third of its time."""
FLAGSHIP_TICK: Final[dict[str, Any]] = {"clock.tick_s": 0.004}
CURLS_TICK: Final[dict[str, Any]] = {"clock.tick_s": 0.002}
"""Shorter than those of the scenarios, which have changed since the runs were recorded."""
CURLED_FAST: Final[dict[str, Any]] = {
    "phase.inflate.duration_s": 0.5, "phase.inflate.settle_s": 0.1, "phase.curl.duration_s": 1.0,
    "phase.curl.settle_s": 0.2, "phase.let_go.duration_s": 0.4, "phase.let_go.settle_s": 0.1,
}  # fmt: skip
CARRIED_FAST: Final[dict[str, Any]] = {
    f"arm.{arm}.phase.{phase}.duration_s": seconds
    for arm in ("left", "right")
    for phase, seconds in (("press", 0.3), ("lift", 0.4), ("carry", 0.4), ("hold", 0.1))
}
Changes = Mapping[str, Any]
UNCHANGED: Final[Changes] = MappingProxyType({})
Nudge = tuple[float, float, float]
STILL: Final[Nudge] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Scenario:
    """A golden run of a scenario that comes with cosim.

    Args:
        name: of the scenario.
        changes: values by key path.
        arm: the one of several whose start is nudged; empty: there are not several.
    """

    name: str
    changes: Changes = field(default_factory=dict)
    arm: str = ""

    def __call__(self, folder: Path, changes: Changes, nudge: Nudge) -> Figures:
        """Run it and return its figures.

        Args:
            folder: of the results.
            changes: further values by key path.
            nudge: of the flange's start [m].
        """
        overrides = {**self.changes, **changes}
        if any(nudge):
            start = f"arm.{self.arm}.start" if self.arm else "start"
            overrides[f"{start}.flange.position_m"] = np.add(self._start_m(), nudge).tolist()
        if self.arm:
            results = cosim.run_arms(self.name, overrides=overrides, out=folder, recording=True)
            figures = {f"{arm} {key}": v for arm, run in results.items() for key, v in of_result(run).items()}
        else:
            run = cosim.run(self.name, overrides=overrides, out=folder, recording=True, error=False)
            figures = of_result(run)
        return figures | of_recording(folder / "recording.rrd")

    def _start_m(self) -> list[float]:
        table = tomllib.loads((HERE.parents[1] / f"scenarios/{self.name}.toml").read_text(encoding="utf-8"))
        of_arm = next((arm for arm in table.get("arm", []) if arm["name"] == self.arm), table)
        position: list[float] = of_arm["start"]["flange"]["position_m"]
        return position


def attached(folder: Path, changes: Changes, nudge: Nudge) -> Figures:
    """Return what a soft robot on a foreign model does while joints and tensions change for 0.6 s."""
    spec = mujoco.MjSpec.from_string((HERE / "foreign.xml").read_text(encoding="utf-8"))
    spec.body("upper").pos += np.array(nudge)
    soft = cosim.attach(spec, "wrist", "square_core_cables", overrides={**LOSSES, **changes})
    model = spec.compile()
    data, figures = mujoco.MjData(model), {"run.tick_s": 0.002}
    soft.pressure_Pa = 5e3
    for step in range(1, 301):
        data.ctrl[:] = 0.002 * min(step, 150)
        soft.tension_N = 0.02 * min(step, 300 - step)  # cables slide in, and back
        soft.step(model, data)
        if step % 100 == 0:
            values = {
                "joint_rad": data.qpos, "rate_rad_s": data.qvel, "tip_position_m": soft.tip_position,
                "force_N": soft.wrench.force, "torque_Nm": soft.wrench.torque,
            }  # fmt: skip
            figures |= flat(f"step {step}", values)
    return figures


def identified(folder: Path, changes: Changes, nudge: Nudge) -> Figures:
    """Return the film's modulus that three lengths and three deflections give."""
    shutil.copytree(HERE / "bench", folder)
    bench = folder / "bench.toml"
    lines = "".join(f"{key} = {value}\n" for key, value in changes.items())
    bench.write_text(
        bench.read_text(encoding="utf-8").replace("[set]\n", f"[set]\n{lines}"), encoding="utf-8"
    )
    assert main(["identify", str(bench), "--force", "--out", str(folder)]) == 0
    robot = tomllib.loads((folder / "robot.toml").read_text(encoding="utf-8"))
    return {"film.young_modulus_Pa": float(robot["film"]["young_modulus_Pa"])}


def slopes(folder: Path, changes: Changes, nudge: Nudge) -> Figures:
    """Return derivatives of tip, volume and flange force of an inflated, pulled core of fabric."""
    inputs = ["pressure_Pa", "cable_tension_N.corner_0", "soft_robot.film.poisson_ratio"]
    overrides = {"model.published": False, "phase": PULL, "soft_robot.film": FABRIC, **changes}
    jacobian = cosim.sensitivity(
        "bending_angle", inputs, ["tip_position_m", "volume_m3"], overrides=overrides
    )
    figures: Figures = {}
    for name, column in zip(inputs, jacobian.matrix.T, strict=True):
        figures |= flat(f"tip by {name}", column[:3]) | flat(f"volume by {name}", column[3:])
    return figures


LOSSES: Final = {
    "solver.damping_per_s": 2.0,
    "solver.air_drag_per_s": 0.5,
    "soft_robot.film.loss_factor": 0.02,
    "soft_robot.stiffener.kind": "stiff",
    "soft_robot.cable": [
        {"name": f"corner_{k}", "corner": k, "units": [1, 3], "capstan_factor": 0.9, "losses": "directed"}
        for k in range(2)
    ],
}
PULL: Final = [
    {"name": "inflate", "duration_s": 1.0, "increments": 2, "pressure_Pa": 8e3},
    {"name": "pull", "duration_s": 1.0, "increments": 2, "cable_tension_N": [1.0, 0.5]},
]
FABRIC: Final = {
    "law": "tension_field", "poisson_ratio": 0.2, "thickness_m": 1.1e-4, "density_kg_m3": 0.0,
    "fabric": {
        "modulus_warp_Pa": 0.5e9, "modulus_weft_Pa": 0.4e9, "shear_modulus_Pa": 0.15e9,
        "warp_direction": [1.0, 0.0, 0.0],
        "straight_modulus_warp_Pa": 1.25e9, "straight_modulus_weft_Pa": 1.2e9,
        "straight_strain_warp": 0.01, "straight_strain_weft": 0.01,
    },
}  # fmt: skip
WHOLE: Final[Mapping[str, Callable[[Path, Changes, Nudge], Figures]]] = {
    "roll_whole": Scenario("gripper_lifts_roll"),
    "two_arms_whole": Scenario("two_arms_hold_box", arm="left"),
    "bending_control_whole": Scenario("bending_angle_control", CONTROLLED),
    "curls_whole": Scenario("hexagon_arm_curls", CURLS_TICK),
    "flagship_whole": Scenario("ur5e_hexagon_arm", FLAGSHIP_TICK),
    "spool_whole": Scenario("gripper_lifts_spool", PUBLISHED),
}
"""What the others show in less time: run every week."""
SHORT: Final[Mapping[str, Callable[[Path, Changes, Nudge], Figures]]] = {
    "roll": Scenario("gripper_lifts_roll", HELD_SHORTLY),
    "two_arms": Scenario("two_arms_hold_box", CARRIED_FAST, arm="left"),
    "bending_control": Scenario("bending_angle_control", CONTROLLED_SHORTLY),
    "curls": Scenario("hexagon_arm_curls", CURLS_TICK | CURLED_FAST),
    "flagship": Scenario("ur5e_hexagon_arm", FLAGSHIP_TICK | QUICK),
    "sealed": Scenario("sealed_arm"),
    "spool": Scenario("gripper_lifts_spool", PUBLISHED | HELD_SHORTLY),
    "pumped": Scenario("pumped_arm"),
    "tip_path": Scenario("tip_path"),
    "deploys": Scenario("hexagon_arm_deploys"),
    "table_edge": Scenario("gripper_on_table_edge", PUBLISHED | SLIDING),
    "attached": attached,
    "figure_9": Scenario("paper_figure_9", {"soft_robot.film.law": "edge_strain"}),
    "flagship_published": Scenario("ur5e_hexagon_arm", FLAGSHIP_TICK | PUBLISHED),
    "flagship_section": Scenario("ur5e_hexagon_arm", FLAGSHIP_TICK | {"fidelity": "section"}),
    "identified": identified,
    "pattern": Scenario("pouch_finger_bends"),
    "slopes": slopes,
}  # longest first
RUNS: Final = {**WHOLE, **SHORT}


def figures_of(name: str, folder: Path, changes: Changes = UNCHANGED, nudge: Nudge = STILL) -> Figures:
    """Return the figures of a golden run.

    Args:
        name: of the run.
        folder: empty; for its results in `run`, and for caches.
        changes: further values by key path.
        nudge: of the start [m].
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        return RUNS[name](folder / "run", changes, nudge)
