"""Grasps of the three-finger gripper: masses x shapes x initial positions, lifted, shaken and held.

    python benchmarks/grasps.py [--json FILE] [--markdown FILE] [--seeds N] [--masses G ..] [--shapes NAME ..]
                              [--published] [--fidelity NAME] [--set KEY=VALUE ..]
    python benchmarks/grasps.py --drawn N [--json FILE] [--seed N] [--shapes NAME ..] [--compared NAME ..]
    python benchmarks/grasps.py --ticks S .. [--integrators NAME ..] [--until close]
                              [--nudges MM ..] [--seeds N] [--masses G ..] [--shapes NAME ..]
                              [--set KEY=VALUE ..]

Each case is one of the scenarios gripper_lifts_roll, _plant, _spool with another mass and another place:
object and stand are shifted by up to 5 mm along x and y, the object is turned about the vertical, by seed.
The lift is 0.2 m, the shake 2 Hz and 20 mm for 2.5 s, the hold 10 s. Slip is how far the object's origin
moves in the flange's frame: "lift", from the end of the closing to the end of the lift, in which the object
settles between the fingers; "shake", the furthest from there; "hold", over the whole hold; creep is what
moves in the last 8 s of the hold per minute. Held: lifted by at least 0.19 m, and in the end within 30 mm of
where it was at the end of the lift. Cases in FILE are not run again, so an interrupted benchmark goes on.

`--drawn`: N grasps with drawn mass (0.1 to 2 kg), friction (0.1 to 0.8) and pressure (28 to 40 kPa), shape
by shape, on section fingers and on `lumped` ones: how many end alike, and how far the slips of those are
apart that both hold. They end after 0.5 s of shaking. Held: lifted by 0.19 m and within 30 mm of where the
object was at the end of the closing; slip is from there to the end. How many grasps end by an error,
as where a section model leaves its range, is counted apart.

`--ticks`: the same with several ticks and integrators, up to the end of a phase ("shake" unless told
otherwise), of 100 g unless masses are given and of seed 0 alone unless seeds are: where the closing ends in
the flange's frame, and slips. `--nudges`: object and stand are moved by so much along x before, which says
what of these figures rests on chance. `--set` changes the scenarios, here and in the first form.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from cosim.app.preparation import build_simulation
from cosim.base.frames import Array, Pose
from cosim.config.loading import load_scenario
from cosim.config.toml.reading import parse_assignment
from cosim.errors import SolverError

MASSES_G = (20, 50, 100, 200, 300)
SHAPES = ("roll", "plant", "spool")
SHIFT_M = 5e-3
HELD_M, LIFT_M = 0.03, 0.19
COMPARED = ("section", "lumped")
SHAKEN_S = 0.5  # of drawn grasps
SETTLED_S = 2.0  # of the hold, before creep is measured


def place(shape: str, seed: int) -> dict[str, Any]:
    """Return overrides that put object and stand of a scenario elsewhere; seed 0 leaves them."""
    scenario = load_scenario(f"gripper_lifts_{shape}")
    rng = np.random.default_rng(seed)
    shift = np.array([*rng.uniform(-SHIFT_M, SHIFT_M, size=2), 0.0]) * (seed > 0)
    half = 0.5 * rng.uniform(-np.pi, np.pi) * (seed > 0)
    stands = {entry.name: np.array(entry.position_m) for entry in scenario.objects}
    return {
        f"object.{shape}.position_m": (stands[shape] + shift).tolist(),
        f"object.{shape}.quaternion": [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))],
        "object.stand.position_m": (stands["stand"] + shift).tolist(),
    }


def grasp(shape: str, mass_g: int, seed: int, changes: dict[str, Any]) -> dict[str, Any]:
    """Return how one case ended, and what it moved, in a scenario with changes."""
    overrides = place(shape, seed) | {f"object.{shape}.mass_kg": 1e-3 * mass_g} | changes
    simulation = build_simulation(load_scenario(f"gripper_lifts_{shape}", overrides))
    stage = simulation.stage
    body, began = stage.body_names.index(shape), time.thread_time()
    paths: dict[str, list[Array]] = {name: [] for name in stage.phase_names}
    heights, force, error = [], 0.0, None
    try:
        for snapshot in simulation.steps():
            world = Pose(np.eye(3), snapshot.body_position[body])
            paths[stage.phase_names[snapshot.phase]].append(
                (snapshot.world_from_flange.inverse() @ world).translation
            )
            heights.append(snapshot.body_position[body][2])
            force = max(force, snapshot.contact_force_N)
    except SolverError as stopped:
        error = f"{stopped}"
    found = {"shape": shape, "mass_g": mass_g, "seed": seed, "error": error, "contact_force_N": force}
    return found | figures(paths, heights, stage.tick_s) | {"cpu_s": time.thread_time() - began}


def traced(shape: str, changes: dict[str, Any], until: str) -> dict[str, Array]:
    """Return the path (n, 3) [m] of the object's origin in the flange's frame, phase by phase up to one."""
    simulation = build_simulation(load_scenario(f"gripper_lifts_{shape}", changes))
    stage = simulation.stage
    body, last = stage.body_names.index(shape), stage.phase_names.index(until)
    paths: dict[str, list[Array]] = {name: [] for name in stage.phase_names[: last + 1]}
    for snapshot in simulation.steps():
        if snapshot.phase > last:
            break
        world = Pose(np.eye(3), snapshot.body_position[body])
        paths[stage.phase_names[snapshot.phase]].append(
            (snapshot.world_from_flange.inverse() @ world).translation
        )
    return {name: np.array(path) for name, path in paths.items()}


def compare(options: argparse.Namespace) -> None:
    """Print what ticks and integrators differ in."""
    print(
        "| shape | mass [g] | seed | integrator | tick [ms] | nudge [mm] | x, y, z after closing [mm] ",
        end="",
    )
    print("| slip: lift [mm] | shake [mm] | CPU [s] |\n|---|---:|---:|---|---:|---:|---|---:|---:|---:|")
    seeds, masses = options.only or range(options.seeds or 1), options.masses or (100,)
    for shape, mass, seed, integrator, tick_s, nudge in product(
        options.shapes, masses, seeds, options.integrators, options.ticks, options.nudges
    ):
        began, places = time.thread_time(), place(shape, seed)
        for name in (shape, "stand"):
            places[f"object.{name}.position_m"][0] += 1e-3 * nudge
        changes = places | {
            f"object.{shape}.mass_kg": 1e-3 * mass,
            "clock.tick_s": tick_s,
            "solver.integrator": integrator,
        }
        changes |= dict(map(parse_assignment, options.changes))
        paths = traced(shape, changes, options.until)
        begin = paths["close"][-1]
        cells = [shape, mass, seed, integrator, f"{1e3 * tick_s:g}", f"{nudge:g}"]
        cells.append(", ".join(f"{1e3 * value:.2f}" for value in begin))
        lifted = paths["lift"][-1] if "lift" in paths else begin
        cells.append(f"{1e3 * np.linalg.norm(lifted - begin):.2f}" if "lift" in paths else "")
        shaken = np.linalg.norm(paths["shake"] - lifted, axis=1).max() if "shake" in paths else np.nan
        cells += [f"{1e3 * shaken:.2f}" if "shake" in paths else "", f"{time.thread_time() - began:.0f}"]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def drawn(shape: str, number: int, seed: int) -> dict[str, Any]:
    """Return overrides of a drawn grasp."""
    rng = np.random.default_rng((seed, number))
    mass, friction = 0.1 * 20.0 ** rng.uniform(), 0.1 * 8.0 ** rng.uniform()
    return place(shape, number) | {
        f"object.{shape}.mass_kg": float(mass),
        f"object.{shape}.friction": float(friction),
        "phase.inflate.pressure_Pa": float(rng.uniform(28e3, 40e3)),
        "start.pressure_Pa": 5e3,
    }


def ending(shape: str, changes: dict[str, Any]) -> dict[str, Any]:
    """Return how a drawn grasp ends."""
    simulation = build_simulation(load_scenario(f"gripper_lifts_{shape}", changes))
    stage, seen, error, began = simulation.stage, [], None, time.process_time()
    body, last = stage.body_names.index(shape), stage.phase_names.index("shake")
    shaken, ticks = 0, round(SHAKEN_S / stage.tick_s)
    try:
        for batch in simulation.batches():
            seen.append(batch)
            shaken += int(np.count_nonzero(batch.phase == last))
            if shaken >= ticks:
                break
    except SolverError as stopped:
        error = f"{stopped}"
    phase, at, force, origin, axes = (
        np.concatenate([getattr(batch, name) for batch in seen])
        for name in ("phase", "body_position", "body_contact_force", "flange_position", "flange_rotation")
    )
    seen_from_flange = np.einsum("kr,krs->ks", at[:, body] - origin, axes)
    until = min(len(phase), int(np.searchsorted(phase, last)) + ticks) - 1
    closed = int(np.searchsorted(phase, stage.phase_names.index("close"), side="right")) - 1
    lifted = float(at[until, body, 2] - at[0, body, 2])
    slip = float(np.linalg.norm(seen_from_flange[until] - seen_from_flange[closed]))
    held = error is None and lifted > LIFT_M and slip < HELD_M
    pressed = float(np.linalg.norm(force[closed, body]))
    figures = {"held": held, "lifted_m": lifted, "slip_mm": 1e3 * slip, "force_N": pressed, "error": error}
    return figures | {"cpu_s": time.process_time() - began}


def compare_drawn(options: argparse.Namespace) -> None:
    """Run what is missing of drawn grasps, and print in what the fidelities differ."""
    cases: list[dict[str, Any]] = []
    if options.json and options.json.is_file():
        cases = json.loads(options.json.read_text())
    done = {(case["fidelity"], case["number"]) for case in cases}
    for number, fidelity in product(range(options.drawn), options.compared):
        shape = options.shapes[number % len(options.shapes)]
        if (fidelity, number) in done:
            continue
        changes = drawn(shape, number, options.seed) | {"fidelity": fidelity}
        cases.append({"fidelity": fidelity, "number": number, "shape": shape} | ending(shape, changes))
        print(json.dumps(cases[-1]), flush=True)
        if options.json:
            options.json.write_text(json.dumps(cases, indent=2) + "\n")
    one, other = ({case["number"]: case for case in cases if case["fidelity"] == name} for name in COMPARED)
    both = sorted(one.keys() & other.keys())
    alike = [k for k in both if one[k]["held"] == other[k]["held"]]
    held = [k for k in alike if one[k]["held"]]
    off = np.array([abs(one[k]["slip_mm"] - other[k]["slip_mm"]) for k in held])
    share = off / np.array([max(other[k]["slip_mm"], 1e-9) for k in held])
    lost = sum(not other[k]["held"] for k in both)
    failed = sum(one[k]["error"] is not None for k in both)
    print(f"{len(both)} grasps; {COMPARED[1]} loses {lost}; {len(alike)} end alike, {len(held)} of them held")
    print(f"{failed} ended by an error")
    if held:
        print(f"slips are {np.median(off):.2f} mm apart in the median, {100.0 * np.median(share):.0f} %")


def figures(paths: dict[str, list[Array]], heights: list[float], tick_s: float) -> dict[str, Any]:
    """Return lifted, held, slips and creep of a path in the flange's frame, phase by phase."""
    if not paths["hold"]:
        return {"held": False, "lifted_m": heights[-1] - heights[0]}
    begin, lifted = paths["close"][-1], paths["lift"][-1]
    hold = np.array(paths["hold"])
    tail = hold[round(SETTLED_S / tick_s) :]
    seconds = tick_s * max(1, len(tail) - 1)
    return {
        "lifted_m": heights[-1] - heights[0],
        "held": bool(heights[-1] - heights[0] > LIFT_M and np.linalg.norm(hold[-1] - lifted) < HELD_M),
        "slip_lift_mm": 1e3 * float(np.linalg.norm(lifted - begin)),
        "slip_shake_mm": 1e3 * float(np.linalg.norm(np.array(paths["shake"]) - lifted, axis=1).max()),
        "slip_hold_mm": 1e3 * float(np.linalg.norm(hold[-1] - hold[0])),
        "creep_mm_min": 6e4 * float(np.linalg.norm(tail[-1] - tail[0])) / seconds if len(tail) else None,
    }


def markdown(cases: list[dict[str, Any]]) -> str:
    """Return the table of success, slip and creep: a row for each shape and mass."""
    lines = [
        "| shape | mass [g] | held | slip: lift [mm] | shake [mm] | hold [mm] | creep [mm/min] |",
        "|---|---|---|---|---|---|---|",
    ]
    for shape in SHAPES:
        for mass in MASSES_G:
            rows = [case for case in cases if (case["shape"], case["mass_g"]) == (shape, mass)]
            held = [case for case in rows if case["held"]]
            cells = [shape, str(mass), f"{len(held)} of {len(rows)}"]
            for key in ("slip_lift_mm", "slip_shake_mm", "slip_hold_mm", "creep_mm_min"):
                values = [case[key] for case in held]
                cells.append(f"{np.median(values):.2f} ({max(values):.2f})" if values else "")
            if rows:
                lines.append("| " + " | ".join(cells) + " |")
    total = sum(case["held"] for case in cases)
    return "\n".join([*lines, "", f"{total} of {len(cases)} held; median and, in brackets, largest of them."])


def main() -> None:
    """Run what is missing, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--seeds", type=int, help="5 unless given")
    parser.add_argument("--masses", type=int, nargs="+", metavar="G")
    parser.add_argument("--shapes", nargs="+", default=SHAPES, choices=SHAPES)
    parser.add_argument("--fidelity", default="lumped", choices=("section", "lumped", "refined"))
    parser.add_argument("--published", action="store_true", help="fingers of the paper's lumped model")
    parser.add_argument("--drawn", type=int, metavar="N", help="compare so many drawn grasps")
    parser.add_argument("--seed", type=int, default=1, help="of drawn ones")
    parser.add_argument("--compared", nargs="+", default=COMPARED, choices=COMPARED, help="only these")
    parser.add_argument("--ticks", type=float, nargs="+", metavar="S")
    parser.add_argument("--integrators", nargs="+", default=("bdf2",), choices=("bdf2", "implicit_euler"))
    parser.add_argument("--nudges", type=float, nargs="+", default=(0.0,), metavar="MM")
    parser.add_argument("--only", type=int, nargs="+", metavar="SEED", help="these seeds, with --ticks")
    parser.add_argument("--set", dest="changes", nargs="+", default=(), metavar="KEY=VALUE")
    parser.add_argument("--until", default="shake", choices=("close", "lift", "shake"))
    options = parser.parse_args()
    if options.ticks or options.drawn:
        (compare if options.ticks else compare_drawn)(options)
        return
    cases: list[dict[str, Any]] = []
    changes: dict[str, Any] = {"model.published": options.published, "fidelity": options.fidelity}
    changes |= dict(map(parse_assignment, options.changes))
    if options.json and options.json.is_file():
        cases = json.loads(options.json.read_text())
    done = {(case["shape"], case["mass_g"], case["seed"]) for case in cases}
    # the seed in the outer loop: a benchmark that is cut short still covers every mass and shape
    for seed, mass, shape in product(range(options.seeds or 5), options.masses or MASSES_G, options.shapes):
        case = (shape, mass, seed)
        if case in done:
            continue
        cases.append(grasp(*case, changes))
        print(json.dumps(cases[-1]), flush=True)
        if options.json:
            options.json.write_text(json.dumps(cases, indent=2) + "\n")
    print(markdown(cases))
    if options.markdown:
        options.markdown.write_text(markdown(cases) + "\n")


if __name__ == "__main__":
    main()
