"""The symmetric pouch of `tests/cases/saddle`: where statics and runs in time bring it, and what holds it.

In time it is held until it is at rest. From there it is looked at in statics: its energy, the least sideways
force on its tip after which it does not come back, and the state near it on the mesh refined once. Last, to
where the place of the longest tick moves with other values of the film and of the solver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from benchmarks.run_error import film_of, stepped
from cosim.bars.finer_mesh import ITERATIONS_MAX, FinerMesh
from cosim.bars.resting import at_rest
from cosim.base.kept_parts import KeptParts
from cosim.build.soft_model import SoftModel
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import ConvergenceError
from cosim.soft.solve.state import Equilibrium

CASE = Path(__file__).parents[2] / "tests" / "cases" / "saddle" / "pouch_on_ur5e.toml"
INCREMENTS, TICKS_S, HELD_S = (10, 20, 100, 1000), (0.001, 0.002, 0.004), 20.0
BRANCHES_Pa, ASIDE_mm = 7860.0, 85.0
FORCES_mN = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
BACK_mm = 1.0
VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "tolerance of statics 1e-9 instead of 1e-6 N": {"solver__residual_tolerance_N": 1e-9},
    "contact with itself off": {"contact__self_contact": False},
    "hinges by the shell's rule": {"soft_robot__hinge__rule": "shell"},
    "hinges half as stiff": {"soft_robot__hinge__stiffness_factor": 0.5},
    "hinges a tenth as stiff": {"soft_robot__hinge__stiffness_factor": 0.1},
    "wrinkles of a panel twice as wide": {"soft_robot__film__wrinkle_panel_m": 0.08},
}


def scenario(**changes: Any) -> Scenario:
    """Return the case without its arm; keys have __ in place of dots."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario(CASE, {"robot": "none"} | keys)


def aside_mm(side: FilmRobot, here: Equilibrium) -> float:
    """Return how far the tip is aside."""
    return 1e3 * float(side.body.tip_position(here.state.positions)[1])


def static_rows(increments: Sequence[int]) -> Iterator[tuple[str, bool]]:
    """Yield a row of the table of statics, and whether it is as it should be."""
    for count in increments:
        summary = cosim.run(
            scenario(mode="quasistatic", phase__inflate__increments=count), error=False
        ).summary
        (found,) = (row for row in summary["branchings"] if row["extent"] > 0.2 and not row["snap"])
        at_Pa, y_mm = found["pressure_Pa"][0], 1e3 * summary["phases"][-1]["tip_position_m"][1]
        sides = [1e3 * found[key][1] for key in ("tip_m", "other_tip_m")]
        good = abs(at_Pa / BRANCHES_Pa - 1.0) < 0.01 and abs(abs(y_mm) - ASIDE_mm) < 1.0
        yield f"| {count} | {1e-3 * at_Pa:.3f} | {y_mm:.1f} | {sides[0]:.1f}, {sides[1]:.1f} |", good


def bears_mN(side: FilmRobot, rest: Equilibrium, way: float) -> tuple[float, float]:
    """Return the least force on the tip to a side [mN] that moves it for good, and where it is then [mm]."""
    shape = np.zeros_like(rest.state.positions)
    shape[side.body.tip, 1] = way / len(side.body.tip)
    for force_mN in FORCES_mN:
        try:
            side.commit(rest)
            pushed = side.follow(
                rest, rest.world_from_flange, replace(rest.loads, nodal_force=1e-3 * force_mN * shape)
            )
            side.commit(pushed)
            back = side.follow(pushed, rest.world_from_flange, rest.loads)
        except ConvergenceError:
            return force_mN, np.nan
        if abs(aside_mm(side, back) - aside_mm(side, rest)) > BACK_mm:
            return force_mN, aside_mm(side, back)
    return np.inf, aside_mm(side, rest)


def at_rest_in(run: Scenario) -> tuple[FilmRobot, Equilibrium, float]:
    """Return the pouch at rest at a run's end, and how far its tip is aside in the run [mm]."""
    side, kept = stepped(run)
    state = film_of(kept.ends[-1])
    in_run_mm = 1e3 * float(side.body.tip_position(state.soft.positions)[1])
    return side, at_rest(side, state), in_run_mm


def resting_row(name: str, run: Scenario) -> tuple[str, Equilibrium]:
    """Return a row of the table of places where the pouch stays, and the place."""
    side, rest, in_run_mm = at_rest_in(run)
    y_mm, pivots = aside_mm(side, rest), rest.negative_pivots
    left = [bears_mN(side, rest, way) for way in (np.sign(y_mm), -np.sign(y_mm))]
    most = f"not up to {FORCES_mN[-1]:g} mN"
    pushed = " | ".join(most if np.isinf(force) else f"{force:g} mN, then {at:.1f}" for force, at in left)
    mesh = FinerMesh(side.body, SoftModel(run, KeptParts()).refined(1))
    try:
        finer = mesh.at_rest(mesh.clamp(side.clamp), rest)
        refined = f"{aside_mm(mesh.side, finer):.1f} ({finer.potential_J:.4f} J)"
    except ConvergenceError:
        refined = "none found"
    here = f"{in_run_mm:.1f} | {y_mm:.1f} | {rest.potential_J:.4f} | {pivots}"
    return f"| {name} | {here} | {pushed} | {refined} |", rest


def varied_rows(rest: Equilibrium) -> Iterator[str]:
    """Yield where the pouch comes to rest from a place, with other values of film and solver."""
    for name, changes in VARIANTS.items():
        low = scenario(mode="quasistatic", phase__inflate__pressure_Pa=4e3, **changes)  # below its branching
        side, *_ = at_rest_in(low)
        shape = side.state_at_rest(rest.state.positions, rest.world_from_flange)
        found = side.find_rest(shape, rest.world_from_flange, rest.loads, ITERATIONS_MAX)
        yield f"| {name} | {aside_mm(side, found):.1f} |"


def saddle_table(increments: Sequence[int] = INCREMENTS, ticks_s: Sequence[float] = TICKS_S) -> int:
    """Print the tables; return how many rows of statics are not as they should be."""
    wrong = 0
    print("| increments | branches at, kPa | tip aside, mm | sides just beyond, mm |\n|---|---:|---:|---|")
    for row, good in static_rows(increments):
        wrong += not good
        print(row, flush=True)
    print(
        "\n| where | tip aside in the run, mm | in statics from there, mm | V, J | negative pivots "
        "| leaves outwards at | leaves inwards at | refined once, mm |\n|---|---:|---:|---:|---:|---|---|---|"
    )
    row, rest = resting_row("statics, 20 increments", scenario(mode="quasistatic"))
    print(row, flush=True)
    for tick_s in ticks_s:
        keys = {"clock__tick_s": tick_s, "solver__integrator": "implicit_euler"}
        run = scenario(**keys, phase__inflate__settle_s=HELD_S)
        row, rest = resting_row(f"in time, {1e3 * tick_s:g} ms", run)
        print(row, flush=True)
    print("\n| the last of these places, with | tip aside, mm |\n|---|---:|")
    for row in varied_rows(rest):
        print(row, flush=True)
    return wrong
