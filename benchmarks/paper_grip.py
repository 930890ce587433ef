"""Why the gripper does, or does not, hold 200 g at the paper's 30 kPa and 3 N: one thing changed at a time.

    python benchmarks/paper_grip.py [--mass 200] [--seed 0] [VARIANT ...]

The roll of `gripper_lifts_roll`, closed with 3 N a cable at 30 kPa, lifted by 0.2 m and held for 2 s (10 to
20 CPU seconds a row). "code's loss": 0.35 N at every eyelet but the first, as in Three_Finger_Gripper.m,
whatever the tension: 0.35 N more is pulled at the base, since the first eyelet takes its share here.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import cosim
from benchmarks.grasps import place
from cosim.config.loading import load_scenario
from cosim.errors import SolverError

PAPER_kPa, PAPER_N, LOSS_N = 30.0, 3.0, 0.35
NAMES: Final = ("corner_0", "corner_1")


def _cables(**values: Any) -> dict[str, Any]:
    return {f"soft_robot.cable.{name}.{key}": value for name in NAMES for key, value in values.items()}


def _pull(tension_N: float) -> dict[str, Any]:
    return {"phase.close.cable_tension_N": [tension_N] * 6}


_CODE: Final = {
    **_cables(capstan_factor=1.0, eyelet_loss_N=LOSS_N, losses="directed"),
    **_pull(PAPER_N + LOSS_N),
}
VARIANTS: Final[dict[str, Mapping[str, Any]]] = {
    "default": {},
    "no loss": _cables(capstan_factor=1.0),
    "factor 0.892, the code's sum": _cables(capstan_factor=0.892),
    "factor 0.842, directed": _cables(losses="directed"),
    "code's loss": _CODE,
    "friction 1.0 instead of 0.8": {"contact.film_friction": 1.0},
    "friction 1.6": {"contact.film_friction": 1.6},
    "no frames": {"soft_robot.stiffener": {"kind": "none"}},
    "no contact of units": {"contact.self_contact": False},
    "plain film, no frames (published)": {"model.published": True},
    "published, no loss": {"model.published": True, **_cables(capstan_factor=1.0)},
    "40 kPa": {"phase.inflate.pressure_Pa": 40e3},
    "6 N": _pull(2.0 * PAPER_N),
}


def grip(changes: Mapping[str, Any], mass_g: float, seed: int) -> str:
    """Return how far a roll was lifted, and how strongly it was pressed, as cells of a table."""
    scenario = load_scenario("gripper_lifts_roll", {
        "phase.inflate.pressure_Pa": 1e3 * PAPER_kPa, **_pull(PAPER_N), "object.roll.mass_kg": 1e-3 * mass_g,
        "phase.hold.duration_s": 2.0, "phase.lower.flange_shift_m": [0.0, 0.0, -0.142], **place("roll", seed),
        **changes,
    })  # fmt: skip
    phases = tuple(phase for phase in scenario.phases if phase.name != "shake")
    try:
        result = cosim.run(replace(scenario, phases=phases), error=False)
    except SolverError as error:
        return f"no solution: {error} | |"
    height = result.body_position[:, result.stage.body_names.index("roll"), 2]
    ends = [int(np.flatnonzero(result.phase == k)[-1]) for k in range(len(phases))]
    names = [phase.name for phase in phases]
    closed, held = ends[names.index("close")], ends[-1]
    pressed = float(result.contact_force_N[closed])
    lifted = 1e3 * (height[held] - height[ends[names.index("lower")]])
    return f"{pressed:.1f} | {1e3 * (height[closed] - height[0]):.1f} | {lifted:.0f}"


def main() -> None:
    """Run the variants, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help=f"of {', '.join(VARIANTS)}")
    parser.add_argument("--mass", type=float, default=200.0, help="of the roll [g]")
    parser.add_argument("--seed", type=int, default=0, help="of the roll's place; 0: the scenario's")
    options = parser.parse_args()
    print("| | pressed when closed [N] | raised by closing [mm] | lifted, of 200 [mm] |\n|---|---|---|---|")
    for name in options.variants or VARIANTS:
        print(f"| {name} | {grip(VARIANTS[name], options.mass, options.seed)} |", flush=True)


if __name__ == "__main__":
    main()
