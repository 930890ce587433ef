"""Schemes of exchange side by side: against one body, on an arm without rotor inertia, and in a soft grasp.

    python benchmarks/strong_coupling.py [--json FILE] [--ticks N] [--integrator bdf2]
    python benchmarks/strong_coupling.py --wrench

strip: a strip of film hangs from a carriage on a slide that is pushed; the exact answer is one implicit body
with the carriage's mass on its first node. arm: a UR5e of weak servos and little rotor inertia, a soft arm of
heavy base, a step of 2 mrad in all joints. grasp: a light cube between two pads; its error is how far it
goes, its unrest how much that changes in the last fifth of the ticks. shaken: one of 50 g in a grasp that
swings 20 mm at 2 Hz; how far it moves in its grasp. "plain": the staggered exchange without algorithmic mass,
"staggered": with it. The soft side steps by implicit Euler unless told otherwise; the strip has an exact
answer with that only. Costs are processor time of one tick, ratios within this run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np

import cosim
from cosim.app.simulation import stepped_run
from cosim.base.frames import Array, Pose
from cosim.coupling.schemes.interface import Coupling, Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.errors import SolverError
from cosim.rigid.build.description import ServoGains
from cosim.soft.solve.state import Integrator

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.coupling.pads import GRASP, CoupledGrasp
from tests.coupling.slider import OneBody, Slider
from tests.coupling.test_staggered import rig

RATIOS = (0.5, 0.99, 1.01, 2.0, 10.0)
FILMS_PA = {"soft": 1e8, "stiff": 1e11}
ARM_KG = (0.5, 2.0, 4.0, 8.0)
CUBES_KG = (0.01, 0.05)
TICKS_S = (5e-4, 1e-3, 2e-3, 5e-3)
GRAVITY = 9.81
SHAKEN_KG, SHAKE_M, SHAKE_HZ = 0.05, 0.02, 2.0

SCHEMES: dict[str, Callable[[Interface], Coupling]] = {
    "plain": lambda interface: StaggeredCoupling(interface, np.inf),
    "staggered": StaggeredCoupling,
    "iterated": IteratedCoupling,
}
Case = tuple[Callable[[], LedgerEntry], Callable[[], float], float]
"""Takes a tick; tells how far the answer is from the right one [m]; from where on it has diverged [m]."""


def measure(case: Case, ticks: int) -> dict[str, Any]:
    """Return how a case fares over some ticks."""
    tick, error_m, lost_m = case
    entries, errors, spent, ended = [], [0.0], 0.0, "held"
    for _ in range(ticks):
        began = time.thread_time()
        try:
            entries.append(tick())
        except SolverError as failure:
            ended = type(failure).__name__
            break
        spent += time.thread_time() - began
        errors.append(error_m())
        if errors[-1] > lost_m:
            ended = "diverged"
            break
    trials = [entry.trials for entry in entries]
    return {
        "ended": ended,
        "ticks": len(entries),
        "trials_mean": float(np.mean(trials)),
        "trials_max": max(trials),
        "error_m": max(errors),
        "unrest_m": float(np.ptp(errors[-max(2, len(entries) // 5) :])),
        "power_error": max(entry.power_error for entry in entries),
        "momentum_error": max(entry.momentum_error for entry in entries),
        "ratio": max(max(entry.stability_ratio, entry.contact_ratio) for entry in entries),
        "ms_per_tick": 1e3 * spent / len(entries),
    }


def strip(ratio: float, film_Pa: float, scheme: str) -> Case:
    """Return carriage and strip; the error is that of the carriage's height."""
    slider = Slider(ratio, film_Pa)
    one, coupling = OneBody(slider, film_Pa), SCHEMES[scheme](slider.interface)

    def error_m() -> float:
        one.tick()
        return abs(slider.height_m - one.height_m)

    return lambda: slider.tick(coupling), error_m, 0.5


def arm(carried_kg: float, scheme: str, integrator: Integrator) -> Case:
    """Return a weak arm with a heavy load; the error is the flange's way beyond what it was asked for."""
    gains = ServoGains(np.full(6, 200.0), np.full(6, 5.0))
    here = rig(carried_kg, integrator=integrator, armature=0.01, gains=gains)
    here.coupling = SCHEMES[scheme](here.coupling.interface)
    start = here.scene.flange_pose.translation

    def error_m() -> float:
        return float(np.abs(here.scene.flange_pose.translation - start).max())

    return lambda: here.ticks(1, 0.002)[0], error_m, 0.05


def grasp(mass_kg: float, tick_s: float, scheme: str, integrator: Integrator) -> Case:
    """Return a cube between pads; the error is how far it goes from where it began."""
    here = CoupledGrasp(mass_kg, tick_s, SCHEMES[scheme], integrator)

    def error_m() -> float:
        return float(np.abs(here.grasp.cube_position - GRASP).max())

    return here.tick, error_m, 0.03


def shaken(tick_s: float, scheme: str, integrator: Integrator, seconds: float) -> dict[str, Any]:
    """Return how far a cube moves in a grasp that swings, after a swing to come to rest in it."""
    here = CoupledGrasp(SHAKEN_KG, tick_s, SCHEMES[scheme], integrator)
    way, trials = [], []
    for k in range(round(seconds / tick_s)):
        turned = max(0.0, k * tick_s - 0.2) * SHAKE_HZ * 2.0 * np.pi
        shift = 0.5 * SHAKE_M * np.array([0.0, 0.0, 1.0 - np.cos(turned)])
        here.holder.flange_pose = Pose(np.eye(3), GRASP + shift)
        trials.append(here.tick().trials)
        way.append(here.grasp.cube_position - here.holder.flange_pose.translation)
    last = np.array(way[-round(1.0 / SHAKE_HZ / tick_s) :])
    return {"moves_m": float(np.ptp(last, axis=0).max()), "trials_mean": float(np.mean(trials))}


MOVE = {"name": "move", "duration_s": 0.2, "settle_s": 0.15, "flange_shift_m": [0.1, 0.0, 0.0]}


def wrench_errors(tick_s: float, scheme: str) -> tuple[float, float, float]:
    """Return how far forces are from the soft side's own impulse, over the largest that the move adds.

    That which was sent; that which moves the arm, algorithmic mass included; that of the tick before.
    MuJoCo's speeds belong to the middle of ticks: a load changes the momentum of the middle before.
    """
    changes = {"clock.tick_s": tick_s, "coupling.scheme": scheme, "phase": [MOVE], "start.pressure_Pa": 30e3}
    simulation = cosim.Simulation("ur5e_hexagon_arm", overrides=changes)
    carrier: Any = stepped_run(simulation).carrier
    scene, coupling, seen = carrier._scene, carrier._coupling, [simulation.snapshot]
    mass_kg, resists = simulation.stage.soft_mass_kg, []
    while simulation.ticks_left:
        seen.append(simulation.step())
        carried = coupling.carried() if isinstance(coupling, StaggeredCoupling) else None
        load = np.zeros(6)
        if carried is not None and len(carried.inertia):
            load = carried.inertia @ (carried.weights @ carried.past - scene.joint_acceleration)
        resists.append(np.linalg.solve(scene.flange.jacobian().T, load)[:3])
    wrench, center = (
        np.array(each) for each in zip(*((s.ledger.wrench.force, s.soft_center) for s in seen), strict=True)
    )
    own = -mass_kg * (np.diff(center, n=2, axis=0) / tick_s**2 + [0.0, 0.0, GRAVITY])
    acts = wrench[1:-1] if scheme == "staggered" else wrench[2:]
    size = np.linalg.norm(wrench - wrench[0], axis=1).max()
    sent, felt, late = wrench[1:-1] - own, acts + resists[1:] - own, np.diff(wrench, axis=0)

    def most(difference: Array) -> float:
        return float(np.linalg.norm(difference, axis=1).max() / size)

    return most(sent), most(felt), most(late)


def cases(integrator: Integrator) -> list[tuple[dict[str, Any], Callable[[], Case]]]:
    """Return what each case is, and how it is made."""
    found: list[tuple[dict[str, Any], Callable[[], Case]]] = []
    for scheme in SCHEMES:
        for name, film in FILMS_PA.items() if integrator == "implicit_euler" else ():
            for ratio in RATIOS:
                what = {"case": f"strip, {name} film, {ratio:g}", "scheme": scheme}
                found.append((what, partial(strip, ratio, film, scheme)))
        for carried in ARM_KG:
            what = {"case": f"arm, {carried:g} kg on the base ring", "scheme": scheme}
            found.append((what, partial(arm, carried, scheme, integrator)))
        for cube, tick in product(CUBES_KG, TICKS_S):
            what = {"case": f"grasp of {1e3 * cube:g} g, {1e3 * tick:g} ms", "scheme": scheme}
            found.append((what, partial(grasp, cube, tick, scheme, integrator)))
    return sorted(found, key=lambda entry: str(entry[0]["case"]))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--ticks", type=int, default=100)
    parser.add_argument("--integrator", choices=get_args(Integrator), default="implicit_euler")
    parser.add_argument("--wrench", action="store_true", help="what the arm feels in a fast move")
    options = parser.parse_args()
    if options.wrench:
        for kind, length_s in product(("staggered", "iterated"), (4e-3, 2e-3, 1e-3)):
            sent, felt, late = wrench_errors(length_s, kind)
            print(f"{kind}, {1e3 * length_s:g} ms: sent {sent:.1%}, felt {felt:.1%}, a tick late {late:.1%}")
        return
    figures = []
    print("| case | scheme | ratio | trials | error, unrest [m] | power error | momentum | ms a tick | |")
    print("|---|---|---:|---:|---:|---:|---:|---:|---|")
    for what, make in cases(options.integrator):
        found = what | measure(make(), options.ticks)
        figures.append(found)
        print(
            f"| {found['case']} | {found['scheme']} | {found['ratio']:.2f} | {found['trials_mean']:.1f} / "
            f"{found['trials_max']} | {found['error_m']:.1e}, {found['unrest_m']:.1e} | "
            f"{found['power_error']:.1e} | {found['momentum_error']:.1e} | {found['ms_per_tick']:.2f} | "
            f"{found['ended']} |",
            flush=True,
        )
    for scheme in ("staggered", "iterated"):
        for tick_s in (1e-3, 2e-3):
            found = {"case": "shaken", "scheme": scheme, "tick_s": tick_s} | shaken(
                tick_s, scheme, options.integrator, 1.2
            )
            figures.append(found)
            print(
                f"shaken at {1e3 * tick_s:g} ms, {scheme}: moves {1e3 * found['moves_m']:.3f} mm, "
                f"{found['trials_mean']:.1f} trials a tick",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
