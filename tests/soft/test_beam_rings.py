"""Rings of beams: derivatives, invariance, closed forms of rings and square frames, and their limits."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.errors import MeshError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.elements.element import Element, Instant
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.solve.state import SoftState
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors
from tests.soft.bodies import held, hexagon_arm, hung, random_rotation

SECTION = RectangularSection(2e-3, 3e-3, 2e9)
SLENDER = RectangularSection(2e-4, 3e-4, 2e9, 0.3)
RADIUS_M, SIDE_M = 0.05, 0.06
NO_SLOTS = np.zeros((0, 0), np.int64)


def circle(count: int) -> Array:
    angle = 2.0 * np.pi / count * np.arange(count)
    return np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), 0.0 * angle + 0.01], axis=1)


def square(beams_a_side: int) -> Array:
    """Return the nodes of a square frame, corner 0 first."""
    corners = (
        0.5 * SIDE_M * np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
    )
    along = np.arange(beams_a_side)[:, None] / beams_a_side
    sides = [a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.concatenate(sides)


def ring_of(drawn: Array, section: RectangularSection = SECTION) -> BeamRings:
    return BeamRings.from_shape(drawn, np.arange(len(drawn))[None], section)


def two_rings(count: int) -> tuple[Array, Evaluate]:
    """Return deformed positions of two rings of interleaved nodes, one of them turned, and the evaluation."""
    drawn = np.empty((2 * count, 3))
    drawn[::2], drawn[1::2] = circle(count), circle(count) @ random_rotation(3).T + 0.1
    rings = np.stack([np.arange(0, 2 * count, 2)[::-1], np.arange(1, 2 * count, 2)])
    beams = BeamRings.from_shape(drawn, rings, SECTION)
    x = 1.01 * drawn + 5e-4 * np.random.default_rng(5).normal(
        size=drawn.shape
    )  # stretched: away from buckling
    return x, assembled(beams.rings, beams.add, 2 * count)


def answers(drawn: Array, forces: Array, section: RectangularSection = SLENDER) -> Array:
    """Return the displacements (n, 3) [m] by small forces (n, 3) [N] that are in balance."""
    beams = ring_of(drawn, section)
    hessian = assembled(beams.rings, beams.add, len(drawn))(drawn)[2]
    return np.asarray(np.linalg.lstsq(hessian, forces.ravel(), rcond=1e-13)[0].reshape(-1, 3))


@pytest.mark.parametrize("count", [3, 4, 5, 8, 12])
def test_derivatives(count: int) -> None:
    x, evaluate = two_rings(count)
    assert max(derivative_errors(evaluate, x, 2e-6)) < RELATIVE


def test_derivatives_of_a_ring_that_is_bent_far() -> None:
    drawn = circle(16)
    beams = ring_of(drawn)
    x = drawn * [1.25, 0.7, 1.0]
    x[:, 2] += 2.0 * x[:, 0] * x[:, 1] / RADIUS_M
    assert max(derivative_errors(assembled(beams.rings, beams.add, 16), x, 2e-6)) < RELATIVE


def test_rigid_motion_and_balance() -> None:
    x, evaluate = two_rings(12)
    turn = random_rotation(2)
    energy, gradient, _ = evaluate(x)
    moved_energy, moved_gradient, _ = evaluate(x @ turn.T + (1.0, -2.0, 0.5))
    # moving by metres costs digits of strains of 1e-2
    assert moved_energy == pytest.approx(energy, rel=1e-11)
    assert moved_gradient == pytest.approx(gradient @ turn.T, abs=1e-10 * np.abs(gradient).max())
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-13 * size
    # the moments of the turns balance up to 1e-11 rad
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-11 * size * np.abs(x).max()


@pytest.mark.parametrize("drawn", [circle(3), circle(5), circle(12), square(1), square(2), square(8)])
def test_the_drawn_shape_is_stress_free_and_only_rigid_motions_are_free(drawn: Array) -> None:
    beams = ring_of(drawn)
    energy, gradient, hessian = assembled(beams.rings, beams.add, len(drawn))(drawn)
    stretch = SECTION.young_modulus_Pa * SECTION.area_m2
    assert energy < 1e-25 * stretch
    assert np.abs(gradient).max() < 1e-12 * stretch
    values = np.linalg.eigvalsh(hessian) * SIDE_M / stretch
    assert np.abs(values[:6]).max() < 1e-11
    assert values[6] > 1e-4


@pytest.mark.parametrize("drawn", [circle(5), square(1), square(4)])
def test_a_smaller_ring_is_stress_free_at_its_size_and_stretched_by_its_strain_where_drawn(
    drawn: Array,
) -> None:
    ratio = 0.98
    small = BeamRings.from_shape(drawn, np.arange(len(drawn))[None], SECTION, ratio)
    evaluate = assembled(small.rings, small.add, len(drawn))
    perimeter = float(np.linalg.norm(np.roll(drawn, -1, axis=0) - drawn, axis=1).sum())
    assert small.lengths.sum() == pytest.approx(ratio * perimeter, rel=1e-14)
    stretch, turn = SECTION.rigidities[0], random_rotation(4)
    energy, gradient, _ = evaluate(ratio * drawn @ turn.T + 0.1)
    assert energy < 1e-25 * stretch
    assert np.abs(gradient).max() < 1e-12 * stretch
    # E A / 2 times strain squared times length, of straight beams in tension
    energy, gradient, _ = evaluate(drawn)
    assert energy == pytest.approx(0.5 * stretch * (1.0 / ratio - 1.0) ** 2 * ratio * perimeter, rel=1e-10)
    turned_energy, turned_gradient, _ = evaluate(drawn @ turn.T)
    assert turned_energy == pytest.approx(energy, rel=1e-11)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-10 * np.abs(gradient).max())


def test_a_ring_pulled_at_two_points_widens_as_by_the_closed_form() -> None:
    # Timoshenko, Strength of Materials II: F R^3 / (E I) times pi/4 - 2/pi along, 2/pi - 1/2 across the load
    errors = []
    for count in (16, 32, 64):
        force = np.zeros((count, 3))
        force[[0, count // 2], 0] = 1.0, -1.0
        moved = answers(circle(count), force) * SLENDER.rigidities[1] / RADIUS_M**3
        along = moved[0, 0] - moved[count // 2, 0]
        across = moved[3 * count // 4, 1] - moved[count // 4, 1]
        # the slender ring is stretched by (R / r)^-2 of it, 1e-5
        errors.append([along / (np.pi / 4.0 - 2.0 / np.pi) - 1.0, across / (2.0 / np.pi - 0.5) - 1.0])
    error = np.abs(np.array(errors))
    assert error[1:].max() < 0.01
    assert np.log2(error[:-1] / error[1:]).min() > 1.9  # of second order in the drawn polygon's sides


def test_a_ring_warped_by_four_forces_bends_and_twists_as_by_its_series() -> None:
    # w = sum of W cos(n phi), n = 2, 6, 10...: each the least energy E I (w'' - R b)^2 + G J (b' R + w')^2
    # over the turns b of the section, so that 4 P = pi W n^2 (n^2 - 1)^2 E I G J / (R^3 (E I + n^2 G J))
    _, _, bending, torsion = SLENDER.rigidities
    orders = np.arange(2, 200, 4)
    terms = 8.0 / np.pi / (orders**2 - 1.0) ** 2 * (1.0 / (orders**2 * torsion) + 1.0 / bending)
    errors = []
    for count in (32, 64):
        force = np.zeros((count, 3))
        force[:: count // 4, 2] = 1.0, -1.0, 1.0, -1.0
        moved = answers(circle(count), force)
        errors.append((moved[0, 2] - moved[count // 4, 2]) / (terms.sum() * RADIUS_M**3) - 1.0)
    assert abs(errors[1]) < 0.005
    assert np.log2(errors[0] / errors[1]) > 1.8


@pytest.mark.parametrize("beams_a_side", [1, 2, 4, 16])
def test_a_square_frame_twists_by_its_closed_form_whatever_the_number_of_nodes(beams_a_side: int) -> None:
    # corners pushed up and down in turn: moments +-P a / 4 at the ends of each side, the same torque along it
    drawn = square(beams_a_side)
    force = np.zeros_like(drawn)
    force[::beams_a_side, 2] = 1.0, -1.0, 1.0, -1.0
    _, _, bending, torsion = SECTION.rigidities
    expected = SIDE_M**3 * (1.0 / (48.0 * bending) + 1.0 / (16.0 * torsion))
    assert answers(drawn, force, SECTION)[0, 2] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("beams_a_side", [2, 4, 16])
def test_sides_bend_between_built_in_corners_whatever_the_number_of_nodes(beams_a_side: int) -> None:
    drawn = square(beams_a_side)
    force, middle = np.zeros_like(drawn), slice(beams_a_side // 2, None, beams_a_side)
    force[middle, :2] = -2.0 * drawn[middle, :2] / SIDE_M
    moved = answers(drawn, force, SECTION)
    stretch, bending, _, _ = SECTION.rigidities
    # each side carries half a force of each neighbour along it
    expected = SIDE_M**3 / (192.0 * bending) + 0.25 * SIDE_M / stretch
    assert -2.0 / SIDE_M * (moved * drawn)[middle, :2].sum(axis=1) == pytest.approx(expected, rel=1e-7)


def test_peak_strain_is_that_of_the_largest_moment_and_the_force() -> None:
    drawn, load = square(2), 1e-3
    force = np.zeros_like(drawn)
    force[1::2, :2] = -2.0 * load * drawn[1::2, :2] / SIDE_M
    beams = ring_of(drawn)
    x = drawn + answers(drawn, force, SECTION)
    strain = beams.peak_strains(x, beams.first_memory(drawn))
    stretch, bending, _, _ = SECTION.rigidities
    moment = load * SIDE_M / 8.0  # in the middle and at the corners
    expected = 0.5 * SECTION.width_m * moment / bending + 0.5 * load / stretch
    assert strain == pytest.approx(np.full((1, 8), expected), rel=1e-4)  # exact to second order


def test_large_bends_need_no_finer_nodes() -> None:
    # the sides' middles pushed in by a sixth of a side: coarse and fine frames that pass through them
    energies = []
    for beams_a_side in (2, 8):
        drawn = square(beams_a_side)
        middle = np.arange(beams_a_side // 2, len(drawn), beams_a_side)
        beams, count = ring_of(drawn, SLENDER), len(drawn)
        evaluate = assembled(beams.rings, beams.add, count)
        x, free = drawn.copy(), np.ones((count, 3), dtype=bool)
        free[middle, :2], free[:, 2] = False, False
        for part in np.linspace(0.0, 1.0, 21)[1:]:
            x[middle, :2] = drawn[middle, :2] * (1.0 - part / 3.0)
            for _ in range(30):
                energy, gradient, hessian = evaluate(x)
                step = np.linalg.solve(hessian[free.ravel()][:, free.ravel()], -gradient[free])
                x[free] += min(1.0, 2e-3 / np.abs(step).max()) * step
                if np.abs(step).max() < 1e-9:
                    break
            assert np.abs(step).max() < 1e-9
        energies.append(energy)
    assert energies[0] == pytest.approx(energies[1], rel=0.02)


@pytest.mark.parametrize("beams_a_side", [2, 4])
def test_sides_of_a_square_buckle_under_euler_s_load(beams_a_side: int) -> None:
    # every other side outwards: corners turn freely, so that pi^2 E I / a^2 is exact
    tall = RectangularSection(2e-3, 20e-3, 2e9)  # buckles in its plane
    drawn = square(beams_a_side)
    count, euler = len(drawn), np.pi**2 * tall.rigidities[1] / SIDE_M**2
    evaluate, push = assembled(ring_of(drawn).rings, ring_of(drawn, tall).add, count), np.zeros_like(drawn)
    push[::beams_a_side, :2] = -np.sign(drawn[::beams_a_side, :2])
    lowest = []
    for load in (0.98 * euler, 1.02 * euler):
        shorter = drawn * (1.0 - load / tall.rigidities[0])
        _, gradient, hessian = evaluate(shorter)
        assert gradient == pytest.approx(load * push, abs=1e-3 * load)
        in_plane = hessian.reshape(count, 3, count, 3)[:, :2, :, :2].reshape(2 * count, 2 * count)
        # the dead load at the corners lets the compressed square turn: one mode below zero
        lowest.append(np.linalg.eigvalsh(in_plane)[1:4])
    assert np.abs(lowest[0][:2]).max() < 1e-6 * lowest[0][2]  # translations
    assert lowest[1][0] < -1e-3 * lowest[0][2]


def test_turns_in_balance_stay_so() -> None:
    for size in np.linspace(0.3, 1.0, 8):
        drawn = size * circle(12)
        beams, energies = ring_of(drawn), []
        memory = beams.first_memory(drawn)
        for _ in range(4):  # each time from those found before, which differ by rounding
            tracked = memory.copy()
            at = Instant(memory, tracked)
            energies.append(beams.add(drawn, NO_SLOTS, np.zeros_like(drawn), np.zeros((0, 3, 3)), at))
            memory = tracked
        assert max(energies) < 1e-20


def test_a_flat_ring_whose_beams_buckle_finds_its_way_out_of_the_plane() -> None:
    drawn = circle(3)
    beams = ring_of(drawn)
    energy, _, _ = assembled(beams.rings, beams.add, 3)(0.99 * drawn)
    straight = 0.5 * SECTION.rigidities[0] * 0.01**2 * beams.lengths.sum()
    assert energy < 0.6 * straight


def lifted(*elements: Element) -> float:
    """Return how far one hexagonal unit opens under gas [m]."""
    arm = held(hexagon_arm(1).with_elements(*elements))
    found = hung(arm, pressure_Pa=(1e4,), gravity=(0.0, 0.0, 0.0))
    return float(np.linalg.norm(arm.body.tip_position(found.state.positions) - arm.body.tip_position(HUNG)))


HUNG = SoftState.drawn(hexagon_arm(1), Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.7]))).positions


def test_between_bare_film_and_the_rigid_frame() -> None:
    body = hexagon_arm(1)
    rims, drawn = body.rings["unit_1.outer"][None], body.positions
    rigid = lifted(FrameRings.from_shape(drawn, rims, 1e8))
    stiff, usual, limp = (
        lifted(BeamRings.from_shape(drawn, rims, RectangularSection(2e-3, 2e-3, modulus)))
        for modulus in (1.2e14, 2e9, 1e3)  # rounding of stiffer ones is above the bound of the residual
    )
    bare = lifted()
    assert stiff == pytest.approx(rigid, rel=1e-4)
    assert limp == pytest.approx(bare, rel=1e-3)
    assert 1.1 * rigid < usual < 0.98 * bare


def test_copies_carry_it_along_with_what_it_remembers() -> None:
    single = hexagon_arm(1)
    beams = BeamRings.from_shape(single.positions, single.rings["unit_1.outer"][None], SECTION)
    framed = single.with_elements(beams)
    poses = around_axis(3, 0.1, 0.4)
    triple = copies(framed, poses)
    (joined,) = triple.of_kind(BeamRings)
    assert joined.rings.shape == (3, 12)
    x = single.positions + 1e-3 * np.random.default_rng(1).normal(size=single.positions.shape)
    moved = np.concatenate([pose.apply(x) for pose in poses])
    shapes = ((beams, x, single.nodes), (joined, moved, triple.nodes))
    alone, together = (assembled(b.rings, b.add, n)(y)[:2] for b, y, n in shapes)
    assert together[0] == pytest.approx(3.0 * alone[0], rel=1e-10)
    turned = np.concatenate([alone[1] @ pose.rotation.T for pose in poses])
    assert together[1] == pytest.approx(turned, abs=1e-9 * np.abs(alone[1]).max())
    kept = [
        hung(held(body), pressure_Pa=(2e3,)).state.memory[body.memory_slices[-1]] for body in (framed, framed)
    ]
    np.testing.assert_array_equal(*kept)
    assert np.abs(kept[0] - beams.first_memory(x)).max() > 1e-4


def test_where_the_search_for_the_turns_begins_does_not_matter() -> None:
    drawn = circle(8)
    beams, y = ring_of(drawn), drawn * [1.05, 1.02, 1.0]
    found = []
    for seed in range(3):
        start = beams.first_memory(drawn)
        start[:32] += 0.1 * seed * np.random.default_rng(seed).normal(size=32)
        tracked, gradient = start.copy(), np.zeros_like(y)
        at = Instant(start, tracked)
        beams.add(y, NO_SLOTS, gradient, np.zeros((0, 3, 3)), at)
        turns = tracked[:32]
        found.append((gradient, turns * np.sign(turns[::4].repeat(4))))
    for gradient, turns in found[1:]:
        assert turns == pytest.approx(found[0][1], abs=1e-9)
        assert gradient == pytest.approx(found[0][0], abs=1e-8 * np.abs(found[0][0]).max())


@pytest.mark.parametrize(
    ("positions", "rings", "message"),
    [
        (circle(6), [[0, 1]], r"shape \(1, 2\)"),
        (circle(6), [[0, 1, 6]], "node 6; there are nodes 0 to 5"),
        (circle(6) * [1.0, 0.0, 0.0], [range(6)], "ring of beams 0 lies on a line"),
        (circle(6), [[0, 1, 1, 2, 3, 4]], "ring of beams 0 has two neighbouring nodes in one place"),
    ],
)
def test_impossible_rings_are_refused(positions: Array, rings: list[list[int]], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        BeamRings.from_shape(positions, np.array([list(ring) for ring in rings]), SECTION)
