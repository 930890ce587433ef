"""What the derivatives by 20 parameters cost at a static equilibrium, in Newton iterations.

    python benchmarks/sensitivity_cost.py [--refine 0 1 2]

Three square units at 8 kPa, pulled by two cables, on the mesh as it is drawn and with every triangle divided
into four, once and twice. Parameters are of film, hinges, frames, cables, geometry, masses and loads.
CPU times are the least of several calls. An iteration is that of the static solve: its CPU time over its
iterations, some of which reuse a factorisation; and one with a new tangent: assembled, factorised, solved.
The bodies of changed values are built once, and are the same at all equilibria of a robot. Then: the tip's
derivatives by all pressures and tensions of the default arm, as `cosim.sensitivity` returns them.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import cosim
from cosim.app.simulation import stepped_run
from cosim.bench.equilibria import Slopes, outputs_of
from cosim.bench.parameters import StaticModel, parameters_of
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.soft.solve.sensitivity import factorise_at
from cosim.stepping.quasistatic import QuasistaticSimulation

BEGIN: dict[str, Any] = {
    "model.published": False,
    "contact.self_contact": False,
    "soft_robot.stack.mesh": "drawn",
    "soft_robot.stack.neck": {"fused_radius_m": 0.005},
    "soft_robot.film.density_kg_m3": 1400.0,
    "soft_robot.stiffener.density_kg_m3": 1270.0,
    "soft_robot.mass.node_mass_kg": 1e-3,
    "gravity_m_s2": [0.0, 0.0, 4.0],
    "phase": [
        {"name": "inflate", "duration_s": 1.0, "increments": 2, "pressure_Pa": 8e3},
        {"name": "pull", "duration_s": 1.0, "increments": 2, "cable_tension_N": [1.0, 0.5]},
    ],
}
KEYS = (
    "film.young_modulus_Pa", "film.thickness_m", "film.poisson_ratio", "film.density_kg_m3",
    "hinge.stiffness_factor", "stiffener.width_m", "stiffener.height_m", "stiffener.young_modulus_Pa",
    "stiffener.density_kg_m3", "mass.node_mass_kg", "stack.corner_radius_m", "stack.hole_radius_m",
    "stack.unit_height_m", "stack.mid_ring_fraction", "stack.neck.fused_radius_m",
    "cable.corner_0.capstan_factor", "cable.corner_1.capstan_factor",
)  # fmt: skip
NAMES = [*(f"soft_robot.{key}" for key in KEYS), "pressure_Pa", "cable_tension_N"]


def least_ms(call: Callable[[], object], repeats: int) -> float:
    """Return the least CPU time [ms] of some calls."""
    found = []
    for _ in range(repeats):
        began = time.process_time()
        call()
        found.append(time.process_time() - began)
    return 1e3 * min(found)


def costs(refine: int) -> str:
    """Return a row of the table."""
    simulation = cosim.Simulation("bending_angle", overrides=BEGIN | {"soft_robot.stack.refine": refine})
    began, spent = time.process_time(), 0
    run = stepped_run(simulation)
    assert isinstance(run, QuasistaticSimulation)
    assert isinstance(run.soft, SoftArm)
    while simulation.ticks_left:
        simulation.step()
        spent += run.equilibrium.iterations
    solved_ms = 1e3 * (time.process_time() - began) / spent
    here, solver, clamp = run.equilibrium, run.soft.equilibrium_solver.solver, run.soft.clamp
    model = StaticModel.of(simulation.scenario, solver.system)
    wanted, rows = parameters_of(NAMES, model), outputs_of(["tip_position_m"], model)
    load = np.where(solver.free, 1.0, 0.0)

    def iteration() -> None:
        factorise_at(solver, here)
        solver.linear.solve(load)

    new_ms = least_ms(iteration, 30)
    slopes = Slopes(wanted, rows, model)
    own_ms = least_ms(lambda: slopes.at(solver, clamp, here), 12)
    built_ms = least_ms(lambda: Slopes(wanted, rows, model), 2)
    return (
        f"| {refine} | {run.soft.body.nodes} | {len(wanted)} | {solved_ms:.2f} | {new_ms:.2f} | "
        f"{own_ms:.2f} | {own_ms / solved_ms:.1f} | {own_ms / new_ms:.1f} | {built_ms:.0f} |"
    )


def tip_of_the_default_arm() -> str:
    """Return what the tip's derivatives by pressures and tensions cost."""
    hold = {"name": "hold", "duration_s": 1.0, "increments": 3, "pressure_Pa": 30e3}
    hold["cable_tension_N"] = [1.0, 0.5]
    simulation = cosim.Simulation("ur5e_hexagon_arm", overrides={"mode": "quasistatic", "phase": [hold]})
    simulation.step(ticks=simulation.ticks_left)
    loads = ["pressure_Pa", "cable_tension_N"]
    found = cosim.sensitivity(simulation, loads, ["tip_position_m"])
    spent = least_ms(lambda: cosim.sensitivity(simulation, loads, ["tip_position_m"]), 5)
    return f"tip of the default arm by {', '.join(found.parameters)}: {spent:.1f} ms"


def main() -> None:
    """Print a row for each mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--refine", type=int, nargs="*", default=[0, 1, 2])
    options = parser.parse_args()
    heads = (
        "refined", "nodes", "parameters", "iteration of the solve [ms]", "with a new tangent [ms]",
        "all derivatives [ms]", "in iterations", "in those with a new tangent", "bodies built [ms]",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for refine in options.refine:
        print(costs(refine), flush=True)
    print(tip_of_the_default_arm())


if __name__ == "__main__":
    main()
