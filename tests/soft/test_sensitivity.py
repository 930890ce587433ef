"""Derivatives of the tip against solutions at neighbouring loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector, vector_from_rotation
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.elements.cable import Cable
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.state import Equilibrium, SoftState
from tests.derivatives import relative_error
from tests.soft.bodies import FILM, HANGING, Held, PRESSURE_Pa, held, hexagon_arm, hung, no_load, shapes

UNITS = 4
TIGHT = NewtonOptions(tolerance_N=2e-10, start_tolerance_N=2e-10)
GRAVITY = np.array([0.0, 0.0, -9.81])
TENSION = np.array([1.0, 2.0])
TILTED = Pose(rotation_from_vector(np.array([0.0, -0.7, 0.2])) @ HANGING.rotation, np.array([0.3, 0.0, 0.7]))


def between(behind: TipFrame, ahead: TipFrame) -> Array:
    """Return the motion (6,) from one tip frame to another."""
    turn = vector_from_rotation(ahead.rotation @ behind.rotation.T)
    return np.concatenate([ahead.position - behind.position, turn])


def solved(arm: Held, here: Equilibrium, tension: Array, gravity: Array) -> TipFrame:
    gx, gy, gz = gravity.tolist()
    loads = Loads((PRESSURE_Pa,), tuple(tension.tolist()), (gx, gy, gz))
    return TipFrame.of(arm.body, arm.equilibrium.follow(here, TILTED, loads).state.positions)


@pytest.mark.parametrize("case", ["closed", "open"])
def test_sensitivities_against_neighbouring_equilibria(case: str) -> None:
    arm = held(hexagon_arm(UNITS, closed=case == "closed"), TIGHT)
    here = arm.equilibrium.follow(
        hung(arm, pressure_Pa=(PRESSURE_Pa,)),
        TILTED,
        no_load(arm.body, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=tuple(TENSION.tolist())),
    )
    # a solver that has seen nothing of the way here
    sensitivity = Sensitivity(held(arm.body).newton, here)
    to_gravity, to_tension = sensitivity.to_gravity(), sensitivity.to_tension()
    assert to_gravity.shape == (6, 3)
    assert to_tension.shape == (6, 2)
    step = 1e-3  # of m/s^2 and N; the tip moves by micrometres, curvature shows in the 8th digit
    for k in range(3):
        nudge = step * np.eye(3)[k]
        ends = [solved(arm, here, TENSION, GRAVITY + sign * nudge) for sign in (-1.0, 1.0)]
        assert relative_error(to_gravity[:, k], between(*ends) / (2.0 * step)) < 1e-5
    for k in range(2):
        nudge = step * np.eye(2)[k]
        ends = [solved(arm, here, TENSION + sign * nudge, GRAVITY) for sign in (-1.0, 1.0)]
        assert relative_error(to_tension[:, k], between(*ends) / (2.0 * step)) < 1e-5


@pytest.mark.parametrize("shape", ["random", "inflated"])
def test_motion_of_the_tip_frame(shape: str) -> None:
    body, x = hexagon_arm(2), shapes(2)[shape]
    frame, random, step = TipFrame.of(body, x), np.random.default_rng(5), 1e-6
    for _ in range(5):
        move = random.normal(size=x.shape)
        ends = [TipFrame.of(body, x + sign * step * move) for sign in (-1.0, 1.0)]
        found = frame.motion(body, x, move)
        # the angle of a turn of 1e-4 rad comes out of a quaternion with 1e-12 of it
        assert relative_error(found, between(*ends) / (2.0 * step)) < 1e-6


def test_tip_frame_of_a_rigid_motion() -> None:
    body, x = hexagon_arm(2), shapes(2)["random"]
    frame = TipFrame.of(body, x)
    assert frame.rotation.T @ frame.rotation == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    spin, shift = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, -0.3])
    moved = frame.motion(body, x, shift + np.cross(spin, x - frame.position))
    assert moved == pytest.approx(np.concatenate([shift, spin]), abs=1e-13)


def test_the_tip_looks_away_from_the_body() -> None:
    body = hexagon_arm(3)
    frame = TipFrame.of(body, body.positions)
    assert frame.direction == pytest.approx([0.0, 0.0, 1.0])
    assert frame.position == pytest.approx([0.0, 0.0, 0.006])
    toward_first = body.positions[body.tip[0]] - frame.position
    assert frame.rotation[:, 0] == pytest.approx(toward_first / np.linalg.norm(toward_first))


def test_the_solver_knows_that_its_factorisation_is_another_one() -> None:
    arm = held(hexagon_arm(2))
    here = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    solver, reuse = held(arm.body).newton, NewtonOptions(reuse_max=30)
    Sensitivity(solver, here)
    more = no_load(arm.body, pressure_Pa=(1.001 * PRESSURE_Pa,))
    frame = here.world_from_flange.rotation
    again = solver.solve(here.state.positions, here.state.memory, more, reuse, frame=frame)
    assert again.converged
    assert again.factorisations == 0  # the tangent of the sensitivity serves
    soft = no_load(arm.body, pressure_Pa=(-1e6,))  # collapsing: no stable tangent
    with pytest.raises(ConvergenceError):
        Sensitivity(solver, replace(here, loads=soft))
    once_more = solver.solve(here.state.positions, here.state.memory, more, reuse, frame=frame)
    assert once_more.converged
    assert once_more.factorisations > 0  # and a failed one is not used


def test_no_cables_no_columns() -> None:
    arm = held(hexagon_arm(2, cables=()))
    assert Sensitivity(arm.newton, hung(arm)).to_tension().shape == (6, 0)


def column(load_share: float) -> tuple[Held, Equilibrium]:
    """Return a strip of springs that stands up and carries a share of Euler's load pi^2 E I / 4 L^2."""
    rows, length, width, stiffness = 40, 0.1, 0.01, 1e-4
    step = length / rows
    x = np.array([[side * width / 2, 0.0, step * k] for k in range(-1, rows + 1) for side in (-1, 1)])
    cells = 2 * np.arange(rows + 1)[:, None]
    triangles = np.concatenate([cells + np.array(corners) for corners in ((0, 2, 1), (1, 2, 3))])
    hinges = interior_hinges(triangles)
    across = hinges[:, 1] // 2 == hinges[:, 2] // 2
    springs = np.where(across, stiffness / step, 1e4 * stiffness / step)
    springs[across & (hinges[:, 1] // 2 == 1)] *= 2.0
    mass = np.zeros(len(x))
    mass[-2:] = 0.5 * load_share * np.pi**2 * stiffness / (4.0 * length**2) / 9.81
    body = SoftBody.from_arrays(
        x, triangles, FILM, hinge_nodes=hinges, hinge_stiffness=springs, node_mass=mass, base=np.arange(4),
        tip=np.array([-4, -3, -1, -2]) + len(x), cables=(Cable(np.array([0, len(x) - 1])),),
    )  # fmt: skip
    arm = held(body)
    return arm, arm.equilibrium.solve(SoftState.drawn(body, Pose()), Pose(), Loads((), (0.0,)))


@pytest.mark.parametrize(("share", "stable"), [(0.98, True), (1.02, False)])
def test_a_column_beyond_eulers_load_has_no_sensitivity(share: float, stable: bool) -> None:
    arm, upright = column(share)
    assert np.abs(upright.state.positions[:, 1]).max() < 1e-9
    if stable:
        assert Sensitivity(arm.newton, upright).to_gravity()[1, 1] > 0.0
        return
    with pytest.raises(ConvergenceError, match="not stable"):
        Sensitivity(arm.newton, upright)
