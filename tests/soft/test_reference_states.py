"""The edge-strain law against the equilibria of the paper's model, whose triangles measure strain with bars.

Reference: the paper's meshes, hinges, loads and open ends, solved by another code with a correct
constant-strain triangle (see the reference folder's README).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions

FOLDER = Path(__file__).resolve().parents[1] / "reference"
STAGES = [("Three_Unit_Compare", "inflate")]
STAGES += [("UR_Pneumatic", stage) for stage in ("inflate", "rotate", "cable")]


def example(name: str, law: FilmLaw) -> tuple[dict[str, Any], SoftBody]:
    with np.load(FOLDER / f"{name}.npz") as stored:
        data = {key: stored[key] for key in stored.files}
    film = Film(
        float(data["young_modulus_Pa"]), float(data["poisson_ratio"]), float(data["film_thickness_m"]), law
    )
    base, tip = data["base_ring_nodes"][0], data["tip_ring_nodes"][0]
    up = 1 if data["X_reference_m"][tip, 2].mean() > data["X_reference_m"][base, 2].mean() else -1
    body = SoftBody.from_arrays(
        data["X_reference_m"],
        data["triangles_pressure_outward"],
        film,
        hinge_nodes=data["hinge_nodes_ijkl"],
        hinge_stiffness=data["hinge_stiffness_Nm_per_rad"],
        hinge_rest_angle=data["hinge_stressfree_angle_rad"],
        fold_barrier_rad=float(data["hinge_contact_theta1_rad"]),
        caps=(base[::-up], tip[::up]),
        closed=False,
        base=base,
        tip=tip,
    )
    return data, body


def cable_pull(data: dict[str, Any], x: Array) -> Array:
    """Return the force (n, 3) [N] of the cables on the nodes."""
    force = np.zeros_like(x)
    for route, tension in zip(
        data["cable_routes_nodes_base_to_tip"], data["cable_segment_tension_final_N"], strict=True
    ):
        way = np.diff(x[route], axis=0)
        pull = (tension / np.linalg.norm(way, axis=1))[:, None] * way
        np.add.at(force, route[:-1], pull)
        np.add.at(force, route[1:], -pull)
    return force


def residual(name: str, stage: str, law: FilmLaw) -> float:
    """Return the largest out-of-balance force [N] on what is free at the reference's equilibrium."""
    data, body = example(name, law)
    x = np.ascontiguousarray(data[f"X_end_{stage}_true_equilibrium_correctCST_m"])
    system = FilmPotential(body)
    loads = Loads((float(data["target_pressure_Pa"]),), (), (0.0, 0.0, 0.0))
    system.evaluate(x, loads, np.zeros(0), dihedral_angle(x, body.hinges.nodes))
    force = system.gradient - data[f"dead_load_{stage}_N"]
    if stage == "cable":
        force = force - cable_pull(data, x)
    return float(np.abs(force[~data[f"fixed_dof_{stage}"]]).max())


@pytest.mark.parametrize(("name", "stage"), STAGES)
def test_reference_equilibria_are_equilibria(name: str, stage: str) -> None:
    # The reference's own bound is about 1e-6 N; film forces are about 100 N.
    assert residual(name, stage, "edge_strain") < 5e-6
    assert residual(name, stage, "plain") > 0.1  # so the check can tell the laws apart


@pytest.mark.parametrize(("law", "share"), [("edge_strain", 1e-6), ("plain", 0.005)])
def test_three_units_inflate_to_the_reference(law: FilmLaw, share: float) -> None:
    data, body = example("Three_Unit_Compare", law)
    solver = NewtonSolver(FilmPotential(body), data["fixed_dof_inflate"])
    x, angles = body.positions, dihedral_angle(body.positions, body.hinges.nodes)
    for step in np.linspace(0.0, 1.0, 41)[1:]:
        loads = Loads((step * float(data["target_pressure_Pa"]),), (), (0.0, 0.0, 0.0))
        result = solver.solve(x, angles, loads, NewtonOptions())
        assert result.converged
        x, angles = result.positions, result.memory
    wanted = data["X_end_inflate_true_equilibrium_correctCST_m"]
    extension = float((wanted - body.positions)[body.tip, 2].mean())
    assert extension == pytest.approx(0.0305, abs=1e-4)
    assert np.linalg.norm(x - wanted, axis=1).max() < share * extension
