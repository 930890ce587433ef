"""Negative pivots count the ways down; the search for lower states takes one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.measure.stability import PerturbationOptions, find_lower_state, negative_pivots
from cosim.base.frames import Array, Pose
from cosim.bench.known_answers import NO_CLAMP, UNLOADED, Specimen, Strip
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.element import Sums
from cosim.soft.elements.material import Film
from cosim.soft.linear.linear_solver import LowRank, negative_added
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.stability import assess_stability
from cosim.soft.solve.state import Equilibrium
from tests.derivatives import differences
from tests.soft.bodies import HANGING, PRESSURE_Pa, held, hexagon_arm, hung

STRIP = Strip(12)
EULER_N = math.pi**2 * STRIP.bending_stiffness / (4.0 * STRIP.length_m**2)


def pushed(load_N: float) -> Loads:
    """Return an axial push at the tip."""
    return replace(UNLOADED, nodal_force=STRIP.tip_force((-load_N, 0.0, 0.0)))


def straight(share: float) -> tuple[Specimen, Equilibrium]:
    """Return the straight equilibrium at a share of Euler's load."""
    specimen = STRIP.specimen()
    return specimen, specimen.solve(specimen.drawn(), pushed(share * EULER_N))


# the n-th buckling load of a clamped-free column is (2 n - 1)^2 times the first
@pytest.mark.parametrize(("share", "ways_down"), [(0.9, 0), (1.2, 1), (8.0, 1), (10.5, 2), (30.0, 3)])
def test_each_buckling_load_passed_adds_a_negative_pivot(share: float, ways_down: int) -> None:
    specimen, here = straight(share)
    assert negative_pivots(specimen.newton, here) == ways_down
    assert here.negative_pivots == ways_down, "it comes with the solution"


@pytest.mark.parametrize("seed", range(4))
def test_no_unstable_equilibrium_is_missed_on_an_uneven_way(seed: int) -> None:
    # factorisations are kept over solutions; steps from 0.1 % to 50 % of Euler's load, there and back
    strip = STRIP.specimen()
    kept = EquilibriumSolver(strip.newton, NO_CLAMP, replace(strip.equilibria.options, reuse_max=6))
    steps = np.random.default_rng(seed).choice([0.001, 0.01, 0.02, 0.1, 0.5], 60)
    shares = np.abs(np.cumsum(steps) % 3.0 - 1.5)
    here, state, seen = None, strip.drawn(), []
    for share in shares:
        here = kept.solve(state, Pose(), pushed(share * EULER_N))
        assert here.negative_pivots == negative_pivots(strip.newton, here), f"at {share} of Euler's load"
        state = here.state
        seen.append(here.negative_pivots)
    assert {0, 1} <= set(seen)


def test_small_steps_need_no_look_at_every_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    strip, looks = STRIP.specimen(), []
    kept = EquilibriumSolver(strip.newton, NO_CLAMP, replace(strip.equilibria.options, reuse_max=6))
    look = strip.newton.factorise
    monkeypatch.setattr(strip.newton, "factorise", lambda *given: looks.append(1) or look(*given))
    state = strip.drawn()
    for share in np.linspace(0.0, 0.9, 91):
        state = kept.solve(state, Pose(), pushed(share * EULER_N)).state
    # the factors of Newton's method say the rest; one look an increment before
    assert len(looks) < 30


@pytest.mark.parametrize("share", [1.2, 1.5, 3.0])
def test_eulers_load_is_found_as_a_branching_of_one_large_step(share: float) -> None:
    specimen = STRIP.specimen()
    leaving = replace(specimen.equilibria.options, switches_branches=True)
    equilibria = EquilibriumSolver(specimen.newton, NO_CLAMP, leaving)
    found = equilibria.follow(
        equilibria.solve(specimen.drawn(), Pose(), pushed(0.0)), Pose(), pushed(share * EULER_N)
    )
    (branching,) = found.branchings
    # bisected to 0.5 % from above; the mesh is 0.2 % too soft
    assert branching.load_factor * share == pytest.approx(1.0, abs=0.01)
    assert branching.ways == 1
    # nodes 26 and 27 are its tip; across, it bends the easy way
    assert branching.place in ("node 26", "node 27")
    assert branching.direction == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)
    assert found.negative_pivots == 0
    assert found.state.positions[STRIP.tip, 2].mean() > 0.3 * STRIP.length_m, "to the positive side"


def test_the_lowest_frequency_is_that_of_a_clamped_beam() -> None:
    heavy = replace(Strip(24), density=2.0)
    specimen = heavy.specimen()
    state = specimen.drawn()
    found = assess_stability(specimen.newton, state, UNLOADED, np.eye(3))
    per_length = heavy.density * heavy.width_m
    exact = (
        1.8751040687**2
        / (2.0 * math.pi)
        * math.sqrt(heavy.bending_stiffness / per_length)
        / heavy.length_m**2
    )
    # the error of 24 panels, which falls with their square
    assert found.lowest_frequency_Hz == pytest.approx(exact, rel=5e-3)
    pressed = replace(UNLOADED, nodal_force=heavy.tip_force((-1.2 * EULER_N, 0.0, 0.0)))
    straight_one = specimen.solve(state, pressed).state
    found = assess_stability(specimen.newton, straight_one, pressed, np.eye(3))
    assert found.unstable is not None
    assert found.lowest_frequency_Hz is None


@pytest.mark.parametrize("share", [0.6, 0.9, 0.98])
def test_what_is_left_until_eulers_load_is_told_below_it(share: float) -> None:
    specimen, here = straight(share)
    found = assess_stability(specimen.newton, here.state, here.loads, np.eye(3))
    # a straight line: the nearer, the better; the mesh is 0.2 % too soft
    assert share * (1.0 + found.load_margin) == pytest.approx(1.0, abs=0.003 + 0.04 * (1.0 - share))
    assert not found.snaps, "the push bends it to no side"
    assert found.stability([]) == ("near a branching" if share > 0.95 else "stable")
    # it grows as 1 / (1 - share), within 1.5 %; corners move more than the end's middle
    force = 1e-6 * share * EULER_N
    softness = STRIP.length_m**3 / (3.0 * STRIP.bending_stiffness) / (1.0 - share)
    assert found.disturbed_tip_m == pytest.approx(force * softness, rel=0.1)


def test_of_open_ends_the_symmetric_part_of_the_tangent_counts() -> None:
    arm = held(hexagon_arm(2, closed=False))
    here = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    tested = NewtonSolver(arm.film, arm.newton.clamped, symmetric=True)
    found = assess_stability(tested, here.state, here.loads, HANGING.rotation)
    assert found.losses_held
    free, share = arm.newton.free, arm.film.losses_at(here.state.positions, here.loads)

    def gradient(x: Array) -> Array:
        arm.film.evaluate(x, here.loads, share, here.state.memory, hessian=False)
        return arm.film.gradient[free]

    tangent = differences(gradient, here.state.positions, 1e-6)[free.ravel()]
    asymmetry = np.abs(tangent - tangent.T).max()
    assert asymmetry > 1.0, "N/m: this would not be the whole tangent's"
    mass = np.repeat(arm.body.node_mass, 3)[free.ravel()]
    scaled = 0.5 * (tangent + tangent.T) / np.sqrt(np.outer(mass, mass))
    lowest = np.linalg.eigvalsh(scaled)[0]
    assert lowest > 0.0
    assert found.lowest_frequency_Hz == pytest.approx(math.sqrt(lowest) / (2.0 * math.pi), rel=1e-4)


HALF_m, RISE_m, WIDTH_m, ROOF = 0.05, 0.01, 0.02, Film(1e6, 0.0, 1e-3)
# two bars of length L, Green's strain e = (z^2 - rise^2) / (2 L^2): the push 2 E A z e / L is largest at
# z = rise / 3^(1/2)
SNAPS_N = (
    ROOF.young_modulus_Pa * ROOF.thickness_m * WIDTH_m * 2.0 / (3.0 * math.sqrt(3.0))
    * (RISE_m / math.hypot(HALF_m, RISE_m)) ** 3
)  # fmt: skip


def roof(share: float) -> tuple[Specimen, Equilibrium]:
    """Return a shallow roof of two strips under a share of the push on its ridge at which it snaps."""
    x = np.repeat([-HALF_m, 0.0, HALF_m], 2)
    positions = np.stack([x, np.tile([0.0, WIDTH_m], 3), np.where(x == 0.0, RISE_m, 0.0)], axis=1)
    body = SoftBody.from_arrays(positions, np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]]), ROOF)
    specimen = Specimen(body, x != 0.0, NewtonOptions(1e-9, step_max_m=1e-3, switches_branches=True))
    force = np.zeros((6, 3))
    force[2:4, 2] = -0.5 * share * SNAPS_N
    begin = specimen.solve(specimen.drawn(), UNLOADED)
    return specimen, specimen.equilibria.follow(begin, Pose(), replace(UNLOADED, nodal_force=force))


@pytest.mark.parametrize("share", [1.01, 1.3, 3.0])
def test_a_snap_is_named_with_its_load(share: float) -> None:
    _, found = roof(share)
    (snap,) = found.branchings
    assert snap.snap
    assert snap.load_factor * share == pytest.approx(1.0, abs=0.01)
    assert snap.place in ("node 2", "node 3")
    assert snap.direction == pytest.approx((0.0, 0.0, -1.0), abs=1e-9)
    assert found.state.positions[2:4, 2].max() < -RISE_m


@pytest.mark.parametrize("share", [0.5, 0.9, 0.97])
def test_what_is_left_until_a_snap_is_told_below_it(share: float) -> None:
    specimen, here = roof(share)
    assert here.branchings == ()
    found = assess_stability(specimen.newton, here.state, here.loads, np.eye(3))
    assert found.snaps
    assert share * (1.0 + found.load_margin) == pytest.approx(1.0, abs=0.003 + 0.12 * (1.0 - share))
    assert found.stability([]) == ("near a snap" if share > 0.95 else "stable")
    assert found.stability([(0.6, True)]) == ("near a snap" if share > 0.95 else "after a snap")


RING_R_m, RING_NODES = 0.05, 32
STIFFENER = RectangularSection(2e-4, 1e-3, 2e9, 0.3)
RING_N_m = STIFFENER.rigidities[1] / RING_R_m**3
AROUND = 2.0 * np.pi / RING_NODES * np.arange(RING_NODES)
INWARD = np.zeros((RING_NODES + 3, 3))
"""Of each node; the last three are those of a film, as a body needs one, held."""
INWARD[:RING_NODES, :2] = -np.stack([np.cos(AROUND), np.sin(AROUND)], axis=1)


def ring() -> Specimen:
    """Return a ring of beams, free to become an ellipse in its plane and not to move as a whole."""
    film = np.array([[0.0, 0.0, 0.1], [0.01, 0.0, 0.1], [0.0, 0.01, 0.1]])
    positions = np.concatenate([-RING_R_m * INWARD[:RING_NODES], film])
    plain = SoftBody.from_arrays(positions, np.array([RING_NODES + np.arange(3)]), ROOF)
    beams = BeamRings.from_shape(positions, np.arange(RING_NODES)[None], STIFFENER)
    held, quarter = np.zeros(positions.shape, np.bool_), RING_NODES // 4
    held[RING_NODES:], held[:, 2] = True, True
    held[[0, 2 * quarter], 1] = held[[quarter, 3 * quarter], 0] = True
    return Specimen(plain.with_elements(beams), held, NewtonOptions(1e-9, switches_branches=True))


def test_a_stiffeners_buckling_load_is_found_as_a_branching() -> None:
    # under radial forces that keep their direction: 4 E I / R^3 a length (Boresi, J. Appl. Mech. 22, 95)
    specimen, share = ring(), 1.03
    force = share * 4.0 * RING_N_m * (2.0 * np.pi * RING_R_m / RING_NODES) * INWARD
    begin = specimen.solve(specimen.drawn(), UNLOADED)
    found = specimen.equilibria.follow(begin, Pose(), replace(UNLOADED, nodal_force=force))
    first = found.branchings[0]
    assert first.load_factor * share == pytest.approx(1.0, abs=0.01)
    assert first.ways == 1
    assert not first.snap
    assert found.negative_pivots == 0


class OuterPressure:
    """Pressure on the ring that stays normal to it: its potential is that times the polygon's area."""

    def __init__(self, pressure_N_m: float) -> None:
        self._pressure = pressure_N_m

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add gradient and Hessian."""
        here = np.arange(RING_NODES)
        after = (here + 1) % RING_NODES
        (x, y), half = positions[:RING_NODES, :2].T, 0.5 * self._pressure
        sums.gradient[:RING_NODES, 0] += half * (y[after] - np.roll(y, 1))
        sums.gradient[:RING_NODES, 1] += half * (np.roll(x, 1) - x[after])
        if hessian:
            turn = half * np.array(
                [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
            )  # d2 by this and next
            for slot in sums.slots(np.stack([here, after], axis=1))[:, 1].tolist():  # of next and this
                block = turn.T if slot >= 0 else turn
                sums.blocks[slot if slot >= 0 else -1 - slot] += block
        return float(half * (x * y[after] - x[after] * y).sum())


@pytest.mark.parametrize(("share", "ways_down"), [(0.99, 0), (1.01, 1)])
def test_a_stiffener_buckles_under_pressure_that_stays_normal_to_it(share: float, ways_down: int) -> None:
    # 3 E I / R^3 a length (Timoshenko and Gere, Theory of Elastic Stability, 7.4)
    specimen = ring()
    loads = replace(UNLOADED, extra=OuterPressure(share * 3.0 * RING_N_m))
    assert specimen.solve(specimen.drawn(), loads).negative_pivots == ways_down


def stayed(stiffness_N_m: float) -> Specimen:
    """Return the strip with a long vertical cable of half that stiffness at either node of its tip."""
    plain, count = STRIP.body(), STRIP.nodes
    anchors = plain.positions[STRIP.tip] + (0.0, 0.0, 1.0)
    ends = zip(STRIP.tip, (count, count + 1), strict=True)
    body = SoftBody.from_arrays(
        np.concatenate([plain.positions, anchors]),
        plain.triangles,
        STRIP.film,
        hinge_nodes=plain.hinges.nodes,
        hinge_stiffness=plain.hinges.stiffness,
        cables=tuple(Cable(np.array(pair), stiffness_N_m=0.5 * stiffness_N_m) for pair in ends),
    )
    clamped = np.concatenate([STRIP.clamped(), [True, True]])
    return Specimen(body, clamped, NewtonOptions(1e-9))


@pytest.mark.parametrize(("share", "ways_down"), [(0.8, 1), (1.25, 0)])
def test_dense_terms_count_as_well(share: float, ways_down: int) -> None:
    # beyond Euler's load P a spring k at the tip keeps the column straight if k (tan u - u) < -P kappa, with
    # kappa = sqrt(P / E I) and u = kappa L (Timoshenko and Gere, Theory of Elastic Stability, 2.1)
    push = 1.2 * EULER_N
    kappa = math.sqrt(push / STRIP.bending_stiffness)
    u = kappa * STRIP.length_m
    specimen = stayed(share * push * kappa / (u - math.tan(u)))
    force = np.concatenate([pushed(push).nodal_force, np.zeros((2, 3))])
    # just taut: stiff, but hardly pulling
    loads = replace(UNLOADED, nodal_force=force, cable_tension_N=(0.0, 0.0), cable_length_m=(1.0 - 1e-5,) * 2)
    here = specimen.solve(specimen.drawn(), replace(loads, cable_length_m=()))
    assert negative_pivots(specimen.newton, here) == 1
    assert negative_pivots(specimen.newton, replace(here, loads=loads)) == ways_down
    taken_as_it_is = EquilibriumSolver(specimen.newton, NO_CLAMP, NewtonOptions(1e-3, 1e-3))
    again = taken_as_it_is.solve(here.state, Pose(), loads)
    assert again.negative_pivots == ways_down


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_negative_eigenvalues_by_dense_terms(sign: float) -> None:
    random = np.random.default_rng(11)
    turn = np.linalg.qr(random.normal(size=(12, 12)))[0]
    sparse = turn @ np.diag([-2.0, -1.0, -0.5, *np.linspace(1.0, 9.0, 9)]) @ turn.T
    changes = set()
    for scale in np.geomspace(0.01, 100.0, 9):
        coefficients = sign * scale * np.array([1.0, -0.3, 0.0, 2.0])
        terms = LowRank(random.normal(size=(4, 4, 3)), coefficients)
        found = negative_added(
            terms, lambda f: np.linalg.solve(sparse, f.reshape(-1, 12).T).T.reshape(f.shape)
        )
        wanted = int((np.linalg.eigvalsh(sparse + terms.matrix()) < 0.0).sum()) - 3
        assert found == wanted
        changes.add(wanted)
    assert len(changes) > 1


def test_a_pushed_strip_is_found_to_buckle() -> None:
    specimen, here = straight(1.5)
    found = find_lower_state(specimen.equilibria, here, PerturbationOptions(1e-3, 2))
    assert found.potential_J < here.potential_J
    assert negative_pivots(specimen.newton, found) == 0
    assert abs(found.state.positions[STRIP.tip, 2].mean()) > 0.3 * STRIP.length_m


def test_a_minimum_is_kept() -> None:
    specimen, here = straight(0.5)
    found = find_lower_state(specimen.equilibria, here, PerturbationOptions(1e-3, 2))
    # perturbed and solved again, the same state comes back: nothing lower than rounding allows
    assert found.potential_J == pytest.approx(here.potential_J, rel=1e-9)
    assert found.state.positions == pytest.approx(np.array(here.state.positions), abs=1e-6)
