"""The assembled body: derivatives of all terms together, weight, inertia, rigid motions."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.geometry.surface import dihedral_angle
from tests.derivatives import RELATIVE, Evaluate, dense, derivative_errors, differences
from tests.soft.bodies import hexagon_arm, random_rotation, shapes

UNITS = 2
UP = np.array([0.0, 0.0, 1.0])
LOADS = Loads((30e3,), (6.0, 9.0), (1.0, -2.0, -9.81))


def inertia_bed(body: SoftBody) -> Inertia:
    random = np.random.default_rng(3)
    return Inertia(
        random.uniform(1.0, 5e3, body.nodes), body.positions + 1e-3 * random.normal(size=(body.nodes, 3))
    )


def evaluation(body: SoftBody, x: Array, loads: Loads, inertia: Inertia | None = None) -> Evaluate:
    """Return the body's evaluation with the segment tensions and angles of x."""
    system = FilmPotential(body)
    tension, angles = system.losses_at(x, loads), dihedral_angle(x, body.hinges.nodes)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(np.ascontiguousarray(y), loads, tension, angles, inertia=inertia)
        hessian = dense(system.pattern, system.blocks)
        for ring, part in system.open_cap_stiffness(np.ascontiguousarray(y)):
            dofs = (3 * ring[:, None] + np.arange(3)).ravel()
            hessian[np.ix_(dofs, dofs)] += part
        return energy, system.gradient.copy(), hessian

    return evaluate


@pytest.mark.parametrize("shape", ["random", "nearly flat", "inflated"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_derivatives_of_the_whole_body(shape: str, dynamic: bool) -> None:
    x, body = shapes(UNITS)[shape], hexagon_arm(UNITS)
    evaluate = evaluation(body, x, LOADS, inertia_bed(body) if dynamic else None)
    # hinges near 0 and 2 pi change over 1e-4 m; films of 1 kN/m leave the energy 1e-16 / 5e-7 of rounding
    assert max(derivative_errors(evaluate, x, 5e-7)) < RELATIVE


@pytest.mark.parametrize(("shape", "closed"), [("random", False), ("inflated", False), ("inflated", True)])
def test_every_row_of_the_hessian(shape: str, closed: bool) -> None:
    # norm-wise per degree of freedom, so that soft rows are not hidden behind stiff ones; of open chambers,
    # which have no potential, only the derivative of the force can be checked
    x, body = shapes(UNITS)[shape], hexagon_arm(UNITS, closed=closed)
    evaluate = evaluation(body, x, LOADS, inertia_bed(body) if closed else None)
    by_difference = differences(lambda y: evaluate(y)[1].ravel(), x, 5e-7).T
    hessian = evaluate(x)[2]
    rows = np.linalg.norm(hessian - by_difference, axis=1) / np.linalg.norm(hessian, axis=1)
    assert rows.max() < RELATIVE


def test_without_hessian_energy_and_gradient_are_the_same() -> None:
    x, body = shapes(UNITS)["inflated"], hexagon_arm(UNITS)
    system = FilmPotential(body)
    tension, angles = system.losses_at(x, LOADS), dihedral_angle(x, body.hinges.nodes)
    energy = system.evaluate(x, LOADS, tension, angles)
    gradient, blocks = system.gradient.copy(), system.blocks.copy()
    assert system.evaluate(x, LOADS, tension, angles, hessian=False) == pytest.approx(energy, rel=1e-13)
    assert system.gradient == pytest.approx(gradient, abs=1e-13 * np.abs(gradient).max())
    assert (system.blocks == blocks).all()


def test_inertia_is_an_elastic_bed() -> None:
    body = hexagon_arm(1)
    x, bed = shapes(1)["random"], inertia_bed(body)
    plain, with_bed = evaluation(body, x, Loads())(x), evaluation(body, x, Loads(), bed)(x)
    offset = x - bed.target
    energy = 0.5 * float((bed.coefficient * (offset**2).sum(axis=1)).sum())
    assert with_bed[0] - plain[0] == pytest.approx(energy, rel=1e-10)
    assert with_bed[1] - plain[1] == pytest.approx(bed.coefficient[:, None] * offset, abs=1e-11)
    assert with_bed[2] - plain[2] == pytest.approx(np.diag(np.repeat(bed.coefficient, 3)), abs=1e-9)


def test_weight_is_the_only_outer_load_of_a_closed_body() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    _, gradient, _ = evaluation(body, x, LOADS)(x)
    size = np.abs(gradient).sum()
    assert gradient.sum(axis=0) == pytest.approx(-body.mass_kg * np.array(LOADS.gravity), abs=1e-13 * size)
    weight = body.node_mass[:, None] * np.array(LOADS.gravity)
    moment = -np.cross(x, weight).sum(axis=0)
    assert np.cross(x, gradient).sum(axis=0) == pytest.approx(moment, abs=1e-14 * size)


def test_potential_of_weight_falls_with_height() -> None:
    body = hexagon_arm(1)
    x = body.positions
    low, high = (evaluation(body, x, Loads())(x + z * UP)[0] for z in (0.0, 0.5))
    assert high - low == pytest.approx(body.mass_kg * 9.81 * 0.5, rel=1e-9)


def test_the_whole_turns_with_its_gravity() -> None:
    x, body, turn = shapes(UNITS)["random"], hexagon_arm(UNITS), random_rotation(8)
    energy, gradient, hessian = evaluation(body, x, LOADS)(x)
    gx, gy, gz = turn @ np.array(LOADS.gravity)
    y = np.ascontiguousarray(x @ turn.T)
    found = evaluation(body, y, Loads((30e3,), (6.0, 9.0), (gx, gy, gz)))(y)
    assert found[0] == pytest.approx(energy, rel=1e-10)
    assert found[1] == pytest.approx(gradient @ turn.T, abs=1e-10 * np.abs(gradient).max())
    whole_turn = np.kron(np.eye(body.nodes), turn)
    assert found[2] == pytest.approx(whole_turn @ hessian @ whole_turn.T, abs=1e-10 * np.abs(hessian).max())


def test_translation_is_in_the_kernel_of_the_stiffness() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    _, _, hessian = evaluation(body, x, LOADS)(x)
    shift = np.tile([0.3, -0.5, 0.7], body.nodes)
    assert hessian @ shift == pytest.approx(0.0, abs=1e-12 * np.abs(hessian).max())


def test_loads_change_in_proportion_to_the_share() -> None:
    end = Loads((10e3,), (0.0, 1.0), (0.0, 0.0, -1.0))
    middle = LOADS.interpolated(end, 0.25)
    assert middle.pressure_Pa[0] == pytest.approx(25e3)
    assert middle.cable_tension_N == pytest.approx((4.5, 7.0))
    assert middle.gravity == pytest.approx((0.75, -1.5, -7.6075))
    assert LOADS.interpolated(end, 1.0) is end


def test_what_acts_is_made_once_for_the_same_objects() -> None:
    body = hexagon_arm(1)
    system, loads, share = FilmPotential(body), Loads(), np.zeros((0, 7))
    acting = system.acting(loads, share, None)
    assert system.acting(loads, share, None) is acting
    assert system.acting(Loads(), share, None) is not acting
