"""The paper's UR_Pneumatic example, from its own arrays: tips after inflation, rotation and cables.

First as published, an open chamber with the published code's 894 hinges, against the true equilibria of
that model with a correct constant-strain triangle; once with our plain film law (Green strain) and once
with strains measured along the edges, as the published triangles do. Then closed by caps and with a hinge
on every interior edge off the seams, to see what these two simplifications change. Weight 0.02 N per node,
30 kPa, cables of 20 N that lose a fifth per eyelet. Source: "cable pneumatic soft robots" and its code
Sim-FAST (Y. Zhu, CC-BY 4.0).
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, rotation_from_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState

REFERENCE = Path(__file__).resolve().parents[1] / "tests" / "reference" / "UR_Pneumatic.npz"
PAPER_INCREMENTS = (140, 140, 100)
STAGES = ("inflate", "rotate", "cable")
PRESSURE_Pa = 30e3
WEIGHT_PER_NODE_N = 0.02
TURN_RAD = -0.28 * np.pi
TENSION_N = 20.0
BASE = np.array([0.3, 0.0, 0.7])
MODELS: dict[str, tuple[bool, bool, FilmLaw]] = {
    # closed, all hinges, film law
    "published": (False, False, "plain"),
    "published_edge_strain": (False, False, "edge_strain"),
    "open_all_hinges": (False, True, "plain"),
    "closed_published_hinges": (True, False, "plain"),
    "closed_all_hinges": (True, True, "plain"),
}


def read(key: str) -> Any:
    """Return an array of the reference file."""
    with np.load(REFERENCE) as data:
        return data[key]


def outer_ring(unit: int = 0) -> IntArray:
    """Return the nodes of a unit's outer ring; the paper holds the first one while the cables pull."""
    return np.arange(18, 30) + 42 * unit


def paper_arm(*, closed: bool, all_hinges: bool, law: FilmLaw = "plain") -> SoftBody:
    """Return the arm from the file's arrays, drawn where the paper has it, relative to its base.

    Args:
        closed: whether caps close the end holes.
        all_hinges: a hinge on every interior edge off the seams instead of the published 894.
        law: of the film.
    """
    drawn, triangles = read("X_reference_m") - BASE, read("triangles_pressure_outward")
    hinges, stiffness, rest = (
        read("hinge_nodes_ijkl"),
        read("hinge_stiffness_Nm_per_rad"),
        read("hinge_stressfree_angle_rad"),
    )
    if all_hinges:
        seam = np.concatenate([outer_ring(unit) for unit in range(10)])
        hinges, stiffness, rest = interior_hinges(triangles, seam), stiffness[0], None
    young, poisson, thickness = (
        float(read(key)) for key in ("young_modulus_Pa", "poisson_ratio", "film_thickness_m")
    )
    return SoftBody.from_arrays(
        drawn,
        triangles,
        Film(young, poisson, thickness, law),
        hinge_nodes=hinges,
        hinge_stiffness=stiffness,
        hinge_rest_angle=rest,
        fold_barrier_rad=float(read("hinge_contact_theta1_rad")),
        # the drawn arm hangs: its base hole faces up, its tip hole down
        caps=(np.arange(6), np.arange(420, 426)[::-1]),
        closed=closed,
        cables=tuple(Cable(route, 0.8) for route in read("cable_routes_nodes_base_to_tip")),
        node_mass=WEIGHT_PER_NODE_N / 9.81,
        base=np.arange(6),
        tip=np.arange(420, 426)[::-1],
    )


@dataclass(frozen=True)
class Run:
    """What following the paper's three stages gave.

    Args:
        positions: (n, 3) [m] at the end of each stage.
        tips: (3,) [m] at the end of each stage.
        iterations: Newton iterations of each stage.
        residual_N: largest of all increments.
        seconds: wall time.
    """

    positions: list[Array]
    tips: list[Array]
    iterations: list[int]
    residual_N: float
    seconds: float


def follow_stages(body: SoftBody, increments: tuple[int, int, int] = PAPER_INCREMENTS) -> Run:
    """Inflate with growing weight, turn the base by 0.28 pi about y, pull both cables.

    Args:
        body: from `paper_arm`.
        increments: of the three stages.
    """
    began = time.perf_counter()
    system, clamp = SoftSystem(body), Clamp.of_base(body)
    start = Pose(np.eye(3), BASE)
    nothing = Loads((), (0.0, 0.0), (0.0, 0.0, 0.0))
    full = Loads((PRESSURE_Pa,), (0.0, 0.0))
    pulled = replace(full, cable_tension_N=(TENSION_N, TENSION_N))
    turned = Pose(rotation_from_vector(np.array([0.0, TURN_RAD, 0.0])), BASE)
    ends = ((start, full), (turned, full), (turned, pulled))
    here = _solver(system, clamp).solve(SoftState.drawn(body, start), start, nothing)
    run = Run([], [], [], 0.0, 0.0)
    worst = 0.0
    for (pose, loads), count, stage in zip(ends, increments, STAGES, strict=True):
        if stage == "cable":
            clamp = clamp.extended(outer_ring(), here.state.positions, here.world_from_flange)
        here, spent, residual = _stage(_solver(system, clamp), here, pose, loads, count)
        worst = max(worst, residual)
        run.positions.append(here.state.positions)
        run.tips.append(body.tip_position(here.state.positions))
        run.iterations.append(spent)
    return replace(run, residual_N=worst, seconds=time.perf_counter() - began)


def _solver(system: SoftSystem, clamp: Clamp) -> EquilibriumSolver:
    newton = NewtonSolver(system, clamp.mask(system.body.nodes))
    return EquilibriumSolver(newton, clamp, NewtonOptions(iterations_max=100))


def _stage(
    solver: EquilibriumSolver, begin: Equilibrium, pose: Pose, loads: Loads, count: int
) -> tuple[Equilibrium, int, float]:
    here, spent, worst = begin, 0, 0.0
    for k in range(1, count + 1):
        share = k / count
        flange = begin.world_from_flange.interpolated(pose, share)
        here = solver.follow(here, flange, begin.loads.interpolated(loads, share))
        spent += here.iterations
        worst = max(worst, here.residual_N)
    return here, spent, worst


def reference_tips() -> list[Array]:
    """Return the tips (3,) [m] of the true equilibria with a correct triangle."""
    tip = np.arange(420, 426)
    return [read(f"X_end_{stage}_true_equilibrium_correctCST_m")[tip].mean(axis=0) for stage in STAGES]


def figures(increments: tuple[int, int, int] = PAPER_INCREMENTS) -> dict[str, Any]:
    """Return tips, distances, iterations and times of both models [mm, s]."""
    reference = reference_tips()
    result: dict[str, Any] = {"increments": dict(zip(STAGES, increments, strict=True))}
    result["reference_tip_mm"] = {
        stage: (1e3 * tip).round(3).tolist() for stage, tip in zip(STAGES, reference, strict=True)
    }
    for name, (closed, all_hinges, law) in MODELS.items():
        body = paper_arm(closed=closed, all_hinges=all_hinges, law=law)
        run = follow_stages(body, increments)
        result[name] = {
            "hinges": len(body.hinges.nodes),
            "tip_mm": {s: (1e3 * tip).round(3).tolist() for s, tip in zip(STAGES, run.tips, strict=True)},
            "distance_to_reference_mm": {
                s: round(1e3 * float(np.linalg.norm(tip - ref)), 3)
                for s, tip, ref in zip(STAGES, run.tips, reference, strict=True)
            },
            "newton_iterations": sum(run.iterations),
            "newton_iterations_by_stage": dict(zip(STAGES, run.iterations, strict=True)),
            "max_residual_N": run.residual_N,
            "seconds": round(run.seconds, 3),
        }
    return result


def main() -> None:
    """Print the figures, as a table or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    found = figures()
    if arguments.json:
        print(json.dumps(found, indent=2))
        return
    print(f"{'model':24} {'stage':8} {'tip x y z [mm]':>26} {'off [mm]':>9}")
    for stage, tip in found["reference_tip_mm"].items():
        print(f"{'reference':24} {stage:8} {tip[0]:8.2f} {tip[1]:8.2f} {tip[2]:8.2f}")
    for name in MODELS:
        model = found[name]
        for stage, tip in model["tip_mm"].items():
            off = model["distance_to_reference_mm"][stage]
            print(f"{name:24} {stage:8} {tip[0]:8.2f} {tip[1]:8.2f} {tip[2]:8.2f} {off:9.3f}")
        print(
            f"{'':24} {model['hinges']} hinges, {model['newton_iterations']} Newton iterations, "
            f"residual below {model['max_residual_N']:.1e} N, {model['seconds']:.2f} s"
        )


if __name__ == "__main__":
    main()
