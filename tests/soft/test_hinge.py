"""Rotational springs: derivatives in every range of the angle, rigid motions, the fold barrier's law."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.elements import hinge
from cosim.soft.elements.element import Remembered
from cosim.soft.elements.hinge import CLOSED_FRACTION, HingeRows, Hinges, add_hinges
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry import surface
from cosim.soft.geometry.surface import dihedral_angle
from tests.compiled import compiled
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors
from tests.soft.bodies import hexagon_arm, random_rotation, shapes

fold_law, full_angle = compiled(hinge.fold_law), compiled(surface.full_angle)
UNITS = 2
K = 2.0e-3
THETA1 = 0.1 * np.pi
REST = 2.5
TURN = 2.0 * np.pi


def folded(angle: float) -> Array:
    """Return nodes i, j, k, l (4, 3) [m] of two unequal triangles folded to an angle, askew in space."""
    i = np.array([0.003, -0.008, 0.0])
    across = 0.006 * np.array([0.0, -np.cos(angle), -np.sin(angle)])
    points = np.array([i, [0.0, 0.0, 0.0], [0.01, 0.0, 0.0], np.array([0.008, 0.0, 0.0]) + across])
    return points @ random_rotation(5).T + (0.1, 0.2, -0.3)


def evaluation(hinges: Hinges, reference: Array, nodes: int) -> Evaluate:
    angles = np.zeros(len(hinges.nodes))

    def add(x, slots, force, blocks):  # type: ignore[no-untyped-def]
        return add_hinges(x, hinges.arrays, Remembered(reference, angles), slots, force, blocks)

    return assembled(hinges.nodes, add, nodes)


def spring(
    reference: float, *, rest: float = REST, theta1: float = THETA1, order: Array | None = None
) -> Evaluate:
    nodes = (np.arange(4) if order is None else order)[None]
    hinges = Hinges(nodes, np.array([K]), np.array([rest]), theta1)
    return evaluation(hinges, np.array([reference]), 4)


def test_the_fixture_has_the_angle_it_says() -> None:
    hinge = np.array([[0, 1, 2, 3]])
    for angle in (0.05, 1.0, np.pi, 4.0, 6.2):
        # l starts folded onto i at angle 0 and lies opposite at pi
        assert dihedral_angle(folded(angle), hinge)[0] == pytest.approx(angle, abs=1e-12)


# angle, theta1, reference: the linear range, both barriers, no barrier, and unwrapped past 2 pi and below 0
RANGES = {
    "linear": (2.0, THETA1, 2.0),
    "flat": (np.pi, THETA1, np.pi),
    "linear, other side": (4.5, THETA1, 4.5),
    "lower barrier": (0.1, THETA1, 0.1),
    "lower barrier, nearly closed": (0.02, THETA1, 0.02),
    "upper barrier": (TURN - 0.1, THETA1, TURN - 0.1),
    "upper barrier, nearly closed": (TURN - 0.02, THETA1, TURN - 0.02),
    "no barrier": (0.1, 0.0, 0.1),
    "unwrapped past 2 pi": (0.05, 0.0, TURN - 0.05),
    "unwrapped below 0": (TURN - 0.05, 0.0, 0.05),
}


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("seed", range(4))
def test_derivatives_of_one_spring(name: str, seed: int) -> None:
    angle, theta1, reference = RANGES[name]
    order = np.random.default_rng(seed).permutation(4)
    x = np.empty((4, 3))
    x[order] = folded(angle)
    # a thousandth of the heights (6 and 8 mm), and of how far the barrier is from infinite
    step = 6e-6 * min(1.0, angle, TURN - angle)
    assert max(derivative_errors(spring(reference, theta1=theta1, order=order), x, step)) < RELATIVE


@pytest.mark.parametrize("shape", ["random", "nearly flat", "inflated"])
def test_derivatives_of_every_hinge_of_a_chamber(shape: str) -> None:
    x, hinges = shapes(UNITS)[shape], hexagon_arm(UNITS).hinges
    angles = dihedral_angle(x, hinges.nodes)
    barriers = 0
    for e, nodes in enumerate(hinges.nodes):
        order = np.argsort(np.argsort(nodes))  # keeps which node of the four has the lowest number
        barrier = hinges.fold_barrier_rad
        alone = Hinges(order[None], hinges.stiffness[e : e + 1], hinges.rest_angle[e : e + 1], barrier)
        gap = min(angles[e], TURN - angles[e])
        barriers += gap < barrier
        evaluate = evaluation(alone, angles[e : e + 1], 4)
        y = x[np.sort(nodes)]
        assert max(derivative_errors(evaluate, y, 2e-6 * min(1.0, gap))) < RELATIVE, e
    assert barriers > 0 or shape != "nearly flat"  # the drawn shape starts inside the barrier


@pytest.mark.parametrize(("angle", "reference", "unwrapped"), [
    (0.05, TURN - 0.05, TURN + 0.05),
    (TURN - 0.05, 0.05, -0.05),
    (1.0, TURN + 0.5, TURN + 1.0),
    (3.0, 3.5, 3.0),
])  # fmt: skip
def test_angles_are_unwrapped_against_the_last_state(
    angle: float, reference: float, unwrapped: float
) -> None:
    angles, force = np.zeros(1), np.zeros((4, 3))
    springs = HingeRows(np.array([[0, 1, 2, 3]]), np.array([K]), np.array([REST]), 0.0)
    energy = add_hinges(
        folded(angle), springs, Remembered(np.array([reference]), angles), np.zeros((0, 0), np.int64), force,
        np.zeros((0, 3, 3)),
    )  # fmt: skip
    assert angles[0] == pytest.approx(unwrapped, abs=1e-12)
    assert energy == pytest.approx(0.5 * K * (unwrapped - REST) ** 2, rel=1e-12)


def moment(angle: float, rest: float = REST) -> float:
    """Return the moment that the law gives: the force that l feels across its triangle, times its height."""
    _, gradient, _ = spring(angle, rest=rest)(folded(angle))
    # dtheta/dx_l has length 1 / height, and points against growing angle seen from the other triangle
    change = folded(angle + 1e-6)[3] - folded(angle - 1e-6)[3]
    return float(gradient[3] @ change) / 2e-6


@pytest.mark.parametrize("angle", [0.5, 1.7, 2.5, 3.5, 5.9])
def test_moment_in_the_linear_range(angle: float) -> None:
    assert moment(angle) == pytest.approx(K * (angle - REST), rel=1e-8, abs=1e-12)  # differences of 1e-6 rad
    _, gradient, _ = spring(angle)(folded(angle))
    assert np.linalg.norm(gradient[0]) == pytest.approx(abs(K * (angle - REST)) / 0.008, abs=1e-14)
    assert np.linalg.norm(gradient[3]) == pytest.approx(abs(K * (angle - REST)) / 0.006, abs=1e-14)


def law(angle: float, rest: float = REST) -> tuple[float, float, float]:
    """Return (energy, moment, tangent) by the formula of Liu and Paulino."""
    if THETA1 < angle < TURN - THETA1:
        return 0.5 * K * (angle - rest) ** 2, K * (angle - rest), K
    if angle > np.pi:
        energy, moment, tangent = law(TURN - angle, TURN - rest)
        return energy, -moment, tangent
    a = 0.5 * np.pi * (THETA1 - angle) / THETA1
    c = 2.0 * THETA1 / np.pi
    energy = 0.5 * (THETA1 - rest) ** 2 + (THETA1 - rest) * (angle - THETA1) - c * c * np.log(np.cos(a))
    return K * energy, K * (THETA1 - rest) - K * c * np.tan(a), K / np.cos(a) ** 2


@pytest.mark.parametrize("angle", [0.003, 0.1, 0.3, TURN - 0.3, TURN - 0.1, TURN - 0.003])
def test_the_barrier_follows_its_formula(angle: float) -> None:
    energy, _, _ = spring(angle)(folded(angle))
    assert energy == pytest.approx(law(angle)[0], rel=1e-9)
    assert moment(angle) == pytest.approx(law(angle)[1], rel=1e-4)  # differences of 1e-6 rad at 3e-3 rad


@pytest.mark.parametrize("edge", [THETA1, TURN - THETA1])
def test_the_barrier_joins_the_linear_range_smoothly(edge: float) -> None:
    tiny = 1e-9
    before, after = (spring(edge + s * tiny)(folded(edge + s * tiny)) for s in (-1.0, 1.0))
    # energy and moment differ by slope times 2e-9, the tangent by (2e-9)^2: it is flat there
    assert before[0] == pytest.approx(after[0], rel=1e-8)
    assert before[1] == pytest.approx(after[1], rel=1e-7, abs=1e-8)
    assert before[2] == pytest.approx(after[2], rel=1e-6, abs=1e-5 * np.abs(after[2]).max())


CLOSED = CLOSED_FRACTION * THETA1


@pytest.mark.parametrize("edge", [CLOSED, TURN - CLOSED])
def test_a_closed_fold_goes_on_along_the_tangent(edge: float) -> None:
    inwards = -1.0 if edge < 1.0 else 1.0
    energy, moment, tangent = fold_law(edge, REST, K, THETA1)
    assert (energy, moment, tangent) == pytest.approx(law(edge), rel=1e-9)
    for past in (1e-9, 0.5 * CLOSED, CLOSED, 2.0 * CLOSED, 0.05):  # to the angle 0, and beyond it
        change = inwards * past
        found = fold_law(edge + change, REST, K, THETA1)
        assert found[0] == pytest.approx(energy + moment * change + 0.5 * tangent * change**2, rel=1e-10)
        assert found[1:] == pytest.approx((moment + tangent * change, tangent), rel=1e-10)


@pytest.mark.parametrize("overshoot", [1e-5, 3e-3, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_a_fold_that_has_closed_too_far(overshoot: float, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(4)
    x = np.empty((4, 3))
    for angle in (-overshoot, TURN + overshoot):
        x[order] = folded(angle)
        reference = np.clip(angle, 0.01, TURN - 0.01)
        evaluate = spring(reference, order=order)
        assert evaluate(x)[0] == pytest.approx(fold_law(angle, REST, K, THETA1)[0], rel=1e-9)
        assert max(derivative_errors(evaluate, x, 2e-8)) < RELATIVE


def test_closing_a_fold_takes_the_work_that_it_stores() -> None:
    # from half the barrier's range through x_c and 0 to 0.3 degrees beyond it
    open_part = np.geomspace(0.5 * THETA1, CLOSED, 4001)
    path = np.concatenate([open_part, np.linspace(CLOSED, -0.005, 400)[1:]])
    moments = np.array([fold_law(a, REST, K, THETA1)[1] for a in path])
    work = float(np.sum(0.5 * (moments[1:] + moments[:-1]) * np.diff(path)))
    stored = fold_law(path[-1], REST, K, THETA1)[0] - fold_law(path[0], REST, K, THETA1)[0]
    # trapezoids on 4000 pieces of ratio 1.0015: 0.0015^2 / 12 of the work up to x_c, none beyond it
    assert work == pytest.approx(stored, rel=1e-6)


def test_springs_are_in_balance_and_turn_with_the_body() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    reference = dihedral_angle(x, body.hinges.nodes)
    evaluate, turn = evaluation(body.hinges, reference, body.nodes), random_rotation(6)
    energy, gradient, _ = evaluate(x)
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-13 * size
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-13 * size * np.abs(x).max()
    turned_energy, turned_gradient, _ = evaluate(x @ turn.T + (0.5, 0.0, -1.0))
    assert turned_energy == pytest.approx(energy, rel=1e-10)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-9 * np.abs(gradient).max())


def test_without_slots_the_gradient_is_the_same() -> None:
    # 114 hinges: a whole group of lanes and part of another; shapes on the linear range and in the barrier
    body = hexagon_arm(1)
    hinges, slots = body.hinges, FilmPotential(body).pattern.slots(body.hinges.nodes)
    assert len(hinges.nodes) > 64
    for name, x in shapes(1).items():
        reference = dihedral_angle(x, hinges.nodes)
        found = []
        for table in (slots, np.zeros((0, 0), np.int64)):
            force, angles = np.zeros((body.nodes, 3)), np.zeros(len(hinges.nodes))
            springs, turned = hinges.arrays._replace(fold_barrier=3.0), Remembered(reference, angles)
            energy = add_hinges(x, springs, turned, table, force, np.zeros((slots.max() + 1, 3, 3)))
            found.append((energy, force, angles))
        (energy, force, angles), other = found
        assert other[0] == pytest.approx(energy, rel=1e-12), name
        assert other[1] == pytest.approx(force, rel=1e-11, abs=1e-12 * np.abs(force).max()), name
        assert other[2] == pytest.approx(angles, abs=1e-14), name


def test_the_angle_in_the_plane_is_exact_to_rounding() -> None:
    edges = np.pi / 8.0 * np.arange(16.0)  # where the reduction changes
    turns = np.concatenate([edges, edges + 1e-13, np.random.default_rng(3).uniform(0.0, TURN, 2000)])
    for turn in turns:
        sine, cosine = 3e-9 * np.sin(turn), 3e-9 * np.cos(turn)
        assert full_angle(sine, cosine) == pytest.approx(np.arctan2(sine, cosine) % TURN, abs=2e-15)
    assert np.isnan(full_angle(0.0, 0.0))
