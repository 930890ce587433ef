"""Balls dropped on a soft robot: the film's impulse is their change of momentum, however light they are.

    python benchmarks/light_bodies.py [--masses 1e-4,1e-3] [--ticks 4e-3] [--schemes staggered] [--json PATH]
    python benchmarks/light_bodies.py --block [--ticks 2e-3,2.5e-4]

A ball of 30 mm falls by 35 mm on an arm that lies on its side, near its tip. Of each mass, tick and scheme:
what the film's impulse less m g t differs from the ball's change of momentum, over that; the impulse; the
strongest force; how high the ball comes after the first touch, and what its energy could lift it above its
start at most and at the end; how far the arm's tip moves; the largest contact ratio; processor time a tick.

`--block`: a block of 100 g falls by 50 mm on the end of two upright units. Of each tick and integrator: its
speed after the hit over that before, what the integrator takes, and the rest of the energy balance over all
energy that was put in and taken.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import cosim
from cosim.app.simulation import stepped_run
from cosim.base.names import PUT_IN
from cosim.errors import SolverError

RADIUS_M, DROP_M, GRAVITY = 0.015, 0.035, 9.81
FROM_TIP_M = 0.05
MASSES_KG = (1e-4, 1e-3, 1e-2, 0.1, 1.0)
TICKS_S = (1e-3, 2e-3, 4e-3, 8e-3)
SCENARIO = """
schema = 2
title = "a ball falls on an arm"
robot = "ur5e"
soft_robot = "hexagon_arm"
fidelity = "lumped"

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [1.0, 0.0, 0.0] }
pressure_Pa = 30e3

[[object]]
name = "ball"
shape = "sphere"
size_m = [0.015]
position_m = [0.41, 0.0, 0.9]

[[phase]]
name = "drop"
duration_s = 0.24
pressure_Pa = 30e3
"""

BLOCK = """
schema = 2
title = "a block falls on two upright units"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [] }
fidelity = "lumped"

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, 1.0] }
pressure_Pa = 30e3

[[object]]
name = "block"
shape = "box"
size_m = [0.04, 0.04, 0.04]
position_m = [0.4, 0.0, 0.9]
mass_kg = 0.1

[[phase]]
name = "drop"
duration_s = 0.3
pressure_Pa = 30e3
"""
BLOCK_TICKS_S = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)


def bounced(scenario: Path, tick_s: float, integrator: str) -> tuple[float, dict[str, float]]:
    """Return the restitution of the block, and the energy balance of its drop [J]."""
    top = float(cosim.Simulation(scenario).snapshot.node_position[:, 2].max())
    changes = {
        "object.block.position_m": [0.4, 0.0, top + 0.02 + 0.05],
        "clock.tick_s": tick_s,
        "solver.integrator": integrator,
    }
    run = cosim.run(scenario, overrides=changes, error=False)
    height = run.body_position[:, run.stage.body_names.index("block"), 2]
    speeds = np.diff(height) / tick_s
    hit = int(np.argmin(speeds))
    return float(speeds[hit:].max() / -speeds[hit]), run.summary["phases"][-1]["energy"]


def print_blocks(scenario: Path, ticks_s: Sequence[float]) -> None:
    """Print what comes of the drops of the block."""
    scenario.write_text(BLOCK, encoding="utf-8")
    print("| integrator | tick [ms] | restitution | numerical loss [mJ] | rest of the balance [%] |")
    print("|---|---:|---:|---:|---:|")
    for integrator, tick_s in product(("bdf2", "implicit_euler"), ticks_s):
        restitution, energy = bounced(scenario, tick_s, integrator)
        turned = sum(abs(energy[name]) for name in PUT_IN)
        rest = 100.0 * abs(energy["rest_J"]) / turned
        row = f"| {integrator} | {1e3 * tick_s:g} | {restitution:.3f} | {1e3 * energy['numerical_J']:.1f} "
        print(f"{row}| {rest:.2f} |", flush=True)


def place_above(scenario: Path) -> list[float]:
    """Return from where a ball falls on the film by its drop (3,) [m]."""
    film = cosim.Simulation(scenario).snapshot.node_position
    x, y = float(film[:, 0].max()) - FROM_TIP_M, 0.0
    below = film[np.hypot(film[:, 0] - x, film[:, 1] - y) < RADIUS_M]
    return [x, y, float(below[:, 2].max()) + RADIUS_M + DROP_M]


def dropped(scenario: Path, place: list[float], mass_kg: float, tick_s: float, scheme: str) -> dict[str, Any]:
    """Return what comes of one drop."""
    changes = {
        "object.ball.position_m": place,
        "object.ball.mass_kg": mass_kg,
        "clock.tick_s": tick_s,
        "coupling.scheme": scheme,
    }
    simulation = cosim.Simulation(scenario, overrides=changes)
    carrier: Any = stepped_run(simulation).carrier
    scene, ball = carrier._scene, simulation.stage.body_names.index("ball")
    began, seen, speeds = time.process_time(), [simulation.snapshot], [np.zeros(3)]
    while simulation.ticks_left:
        try:
            seen.append(simulation.step())
        except SolverError as failure:
            return {"ended": str(failure)}
        speeds.append(scene.bodies.spins[ball, 3:].copy())
    spent = time.process_time() - began
    force = np.array([each.body_contact_force[ball] for each in seen[1:]])
    position, velocity = np.array([each.body_position[ball] for each in seen]), np.array(speeds)
    impulse = tick_s * force.sum(axis=0)
    weight = mass_kg * GRAVITY * tick_s * len(force)
    gained = mass_kg * velocity[-1]
    height = position[:, 2] - position[0, 2] + (velocity**2).sum(axis=1) / (2.0 * GRAVITY)
    first = int(np.flatnonzero(force.any(axis=1))[0])
    lowest = first + int(np.argmin(position[first : first + round(0.05 / tick_s), 2]))
    tips = np.array([each.tip_position for each in seen])
    return {
        "ended": "held",
        "impulse_error": float(
            np.linalg.norm(impulse - [0.0, 0.0, weight] - gained) / np.linalg.norm(impulse)
        ),
        "impulse_N_s": float(np.linalg.norm(impulse)),
        "momentum_N_s": mass_kg * float(np.sqrt(2.0 * GRAVITY * DROP_M)),
        "force_N": float(np.linalg.norm(force, axis=1).max()),
        "rebound_m": float(position[lowest:, 2].max() - position[lowest, 2]),
        "highest_energy_m": float(height.max()),
        "last_energy_m": float(height[-1]),
        "tip_m": float(np.ptp(tips, axis=0).max()),
        "contact_ratio": max(each.ledger.contact_ratio for each in seen[1:]),
        "ms_per_tick": 1e3 * spent / len(force),
    }


def row(figures: dict[str, Any]) -> str:
    """Return a line of the table."""
    case = f"| {1e3 * figures['mass_kg']:g} | {1e3 * figures['tick_s']:g} | {figures['scheme']} |"
    if figures["ended"] != "held":
        return f"{case} {figures['ended']} |"
    return (
        f"{case} {figures['contact_ratio']:.3g} | {figures['impulse_error']:.1e} | "
        f"{1e3 * figures['impulse_N_s']:.3g} | {figures['force_N']:.3g} | {1e3 * figures['rebound_m']:.1f} | "
        f"{1e3 * figures['highest_energy_m']:.2f}, {1e3 * figures['last_energy_m']:.1f} | "
        f"{1e3 * figures['tip_m']:.2f} | {figures['ms_per_tick']:.1f} |"
    )


def numbers(text: str) -> list[float]:
    """Return numbers that commas part."""
    return [float(number) for number in text.split(",")]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--masses", type=numbers, default=MASSES_KG)
    parser.add_argument("--ticks", type=numbers)
    parser.add_argument("--block", action="store_true", help="drop a block on upright units instead")
    parser.add_argument("--schemes", type=lambda text: text.split(","), default=("staggered", "iterated"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.block:
        with TemporaryDirectory() as folder:
            print_blocks(Path(folder) / "block.toml", options.ticks or BLOCK_TICKS_S)
        return
    found = []
    print("| mass [g] | tick [ms] | scheme | ratio | impulse error | impulse [mN s] | force [N] |", end="")
    print(" rebound [mm] | energy, most, last [mm] | tip [mm] | ms a tick |")
    print("|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    with TemporaryDirectory() as folder:
        scenario = Path(folder) / "ball.toml"
        scenario.write_text(SCENARIO, encoding="utf-8")
        place = place_above(scenario)
        for scheme, mass_kg, tick_s in product(options.schemes, options.masses, options.ticks or TICKS_S):
            case = {"mass_kg": mass_kg, "tick_s": tick_s, "scheme": scheme}
            found.append(case | dropped(scenario, place, mass_kg, tick_s, scheme))
            print(row(found[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
