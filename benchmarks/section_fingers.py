"""Fingers on section models: the free bending curve against the film, and grasps against `lumped`.

    python benchmarks/section_fingers.py [--curve] [--until S] [--set KEY=VALUE ...] [SCENARIO ...]

The curve is that of one finger of `gripper_lifts_roll` without weight: its cables are pulled by up to 6 N at
several pressures; the film's units press on one another without friction, as in the samples. The angle is the
sum of all bends between rims.

Grasps start with gas (`--set start.pressure_Pa=5e3`) in both models. The table has at the end of every phase
the sum of contact forces on the lightest movable object and its place over the flange, and times real time by
CPU time, without recording, before and while it is touched.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import replace
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cosim.app.driver import build_simulation, prepared
from cosim.base.frames import Array, Pose
from cosim.build.soft_body import build_soft_body
from cosim.build.soft_model import section_model
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.errors import CosimError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.newton import ChainSolver
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.state import Clamp, SoftState
from cosim.stepping.parts import film_law

PRESSURES_Pa = (5e3, 10e3, 20e3, 30e3, 40e3)
TENSIONS_N = np.linspace(0.0, 6.0, 13)


def angle(section: SectionBody, frames: Array) -> float:
    """Return the sum [deg] of the bends of all sections."""
    bends = np.linalg.norm(section.frames.strains(frames)[:, 3:5], axis=1)
    return float(np.degrees(np.arcsin(bends)).sum())


def curve() -> None:
    """Print the angles of the free finger."""
    scenario = load_scenario("gripper_lifts_roll", {"fidelity": "section"})
    body = build_soft_body(replace(file_of(scenario, "a finger"), copies=None, palm=None), scenario.model)
    body = body.with_other(Cable, *(replace(each, directed=False, loss_N=0.0) for each in body.cables))
    law, clamp = film_law(scenario), Clamp.of_base(body)
    assert law is not None, "units of the finger touch"
    contact = SelfContact(body, replace(law, friction=0.0, throughout=True))
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    options = NewtonOptions(tolerance_N=1e-5, start_tolerance_N=1e-5, iterations_max=60)
    film = EquilibriumSolver(newton, clamp, options, contact, slides_max=2)
    chain = ChainSolver(SectionBody(body, section_model(scenario, print)))
    print("| gas [kPa] | tension [N] | film [deg] | section [deg] | off [%] | tip off [mm] |")
    flat = film.solve(SoftState.drawn(body, Pose()), Pose(), Loads((), (0.0, 0.0), (0.0, 0.0, 0.0)))
    for pressure in PRESSURES_Pa:
        here, frames = flat, chain.section.straight(pressure)
        for tension in TENSIONS_N.tolist():
            loads = Loads((pressure,), (tension, tension), (0.0, 0.0, 0.0))
            here = film.follow(here, Pose(), loads)
            there = chain.section.frames.fit(here.state.positions, Pose())
            found = chain.solve(frames, np.arange(len(frames)) > 0, loads, 1e-6, 200)
            frames, bent = found.frames, angle(chain.section, there)
            if found.outcome is not Outcome.CONVERGED:
                print(f"| {1e-3 * pressure:g} | {tension:g} | {bent:.1f} | {found.outcome.value} | | |")
                break
            ours, off = angle(chain.section, frames), 1e3 * np.linalg.norm(frames[-1, 0] - there[-1, 0])
            share = f"{100.0 * (ours / bent - 1.0):+.1f}" if bent > 1.0 else ""
            print(f"| {1e-3 * pressure:g} | {tension:g} | {bent:.1f} | {ours:.1f} | {share} | {off:.1f} |")


def grasp(name: str, given: dict[str, Any], fidelity: str, until_s: float) -> str:
    """Run a grasp and return its row."""
    scenario = load_scenario(name, {"fidelity": fidelity} | given)
    run = build_simulation(prepared(scenario, lambda _: None, recording=False, contact=True))
    held = min((each for each in scenario.objects if each.mass_kg), key=lambda each: each.mass_kg or 0.0)
    cells, spent, last = [], np.zeros((2, 2)), time.process_time()
    body, place, force, phase, end = -1, np.zeros(3), 0.0, 0, 0.0
    try:
        for batch in run.batches():
            if body < 0:
                body = run.stage.body_names.index(held.name)
            for row, index in enumerate(batch.phase.tolist()):
                if index != phase:
                    cells.append(f"{force:.2f} N, {np.round(1e3 * place, 1).tolist()}")
                phase, end = index, float(batch.time_s[row])
                force = float(np.linalg.norm(batch.body_contact_force[row, body]))
                place = batch.body_position[row, body] - batch.flange_position[row]
            now = time.process_time()
            spent[int(force > 0.0)] += (len(batch.phase) * scenario.clock.tick_s, now - last)
            last = now
            if end >= until_s:
                break
    except CosimError as error:
        cells.append(f"{type(error).__name__} at {end:.2f} s: {str(error)[:150]}")
    factors = ", ".join(f"{simulated / max(cpu, 1e-9):.2g}" for simulated, cpu in spent)
    cells.append(f"{force:.2f} N, {np.round(1e3 * place, 1).tolist()}")
    return f"| `{name}` | {fidelity} | {'; '.join(cells)} | {factors} |"


def main() -> None:
    """Print the curve of a finger, or the grasps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--curve", action="store_true")
    parser.add_argument("--until", type=float, default=np.inf, help="end of the runs [s]")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("scenarios", nargs="*")
    options = parser.parse_args()
    if options.curve:
        curve()
    given = {key: json.loads(value) for key, value in (each.split("=", 1) for each in options.set)}
    for name in options.scenarios:
        for fidelity in ("section", "lumped"):
            print(grasp(name, given, fidelity, options.until), flush=True)


if __name__ == "__main__":
    main()
