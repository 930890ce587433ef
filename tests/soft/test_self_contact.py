"""Contact of a body with itself: who can meet whom, cushions, a curled arm, sliding, a state that returns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import copies
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.film_lists import FilmLists
from cosim.soft.contact.overlap_check import OverlapCheck
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import triangle_area
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.soft.bodies import HANGING, PRESSURE_Pa, held, hexagon_arm, icosphere, no_load
from tests.soft.contacts import half_space
from tests.soft.interpenetration import deepest_m

UP = np.array([0.0, 0.0, 1.0])
LAW = ContactLaw()


def test_a_stack_has_a_unit_per_chamber_and_two_faces_per_unit() -> None:
    body = hexagon_arm(4)
    faces = FilmFaces.of(body)
    assert faces.units == 4
    relation, unit = faces.relation, faces.unit_of_face
    assert relation.shape == (8, 8)
    assert (relation == relation.T).all()
    step = np.abs(unit[:, None] - unit[None, :])
    assert (relation[step == 0] == Relation.NONE).all()
    # far sides of two units never meet through those between them: one such pair for each two units
    apart = step > 1
    far = relation[apart] == Relation.NONE
    assert far.sum() == 2 * 3
    assert (relation[apart][~far] == Relation.APART).all()
    heights = np.array([body.positions[body.triangles[faces.face == f], 2].mean() for f in range(8)])
    upward = heights > np.array([body.positions[body.triangles[faces.unit == u], 2].mean() for u in unit])
    below = unit[:, None] < unit[None, :]
    assert (np.where(below, ~upward[:, None] & upward, upward[:, None] & ~upward)[apart] == far).all()
    # of the four pairs of faces of two neighbours one meets in the valley, seen from both sides
    assert (relation[step == 1] == Relation.VALLEY).sum() == 2 * 3
    points = FilmPoints.of(faces, body.positions)
    film = triangle_area(body.positions, body.triangles).sum()
    assert points.area.sum() == pytest.approx(film, rel=1e-12)


def test_one_unit_alone_cannot_meet_itself() -> None:
    x, triangles = icosphere(1, 0.05)
    body = SoftBody.from_arrays(x, triangles, Film(1e9, 0.3, 1e-4), node_mass=1e-3)
    films = SelfContact(body, FilmContactLaw(LAW))
    assert not films.faces.can_meet
    assert films.static_pairs(x) is None


def test_a_law_that_reaches_beyond_the_lists_of_near_films_finds_an_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    body, make, count = hexagon_arm(3), FilmLists.make, 0

    def counted(self: FilmLists, x: Array, room_m: float, moves: bool) -> None:
        nonlocal count
        count += 1
        assert count < 5, "the lists are made again and again"
        make(self, x, room_m, moves)

    monkeypatch.setattr(FilmLists, "make", counted)
    assert SelfContact(body, FilmContactLaw(replace(LAW, smoothing_m=0.03))).presses_at_rest(body.positions)
    assert not SelfContact(body, FilmContactLaw(LAW)).presses_at_rest(body.positions)


def test_a_negative_friction_coefficient_is_refused() -> None:
    with pytest.raises(InputError, match=r"friction coefficient is -0\.1"):
        FilmContactLaw(LAW, -0.1)


def squeezed(body: SoftBody, gaps: list[float], turned: bool) -> list[tuple[Equilibrium, float]]:
    """Return equilibria of an inflated body, and the force [N] on its lower end.

    Args:
        body: one cushion, or two of which the second is upside down.
        gaps: heights of the plane, or half the distance of the two ends, one after the other [m].
        turned: whether the body is two cushions.
    """
    system, clamp = FilmPotential(body), Clamp.of_base(body)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    films = SelfContact(body, FilmContactLaw(LAW)) if turned else None
    surface, state, found = ContactSurface.of(body, system.pattern), SoftState.drawn(body, Pose()), []
    upper = clamp.offsets[:, 2] > 0.01
    stiff = replace(LAW, stiffness_N_m3=2.0 * LAW.stiffness_N_m3, smoothing_m=0.5 * LAW.smoothing_m)
    before = gaps[0]
    for height in gaps:
        offsets, start = clamp.offsets.copy(), state.positions.copy()
        offsets[upper, 2] = 2.0 * height
        # the second cushion goes along with its end
        start[body.nodes // 2 if turned else body.nodes :, 2] += 2.0 * (height - before)
        before = height
        plane = None if turned else half_space(surface, -UP, -height, stiff)
        solver = EquilibriumSolver(
            newton, replace(clamp, offsets=offsets), NewtonOptions(tolerance_N=1e-7), films
        )
        inside = (PRESSURE_Pa,) * len(body.gas_chambers)
        loads = Loads(inside, gravity=(0.0, 0.0, 0.0), contact=plane)
        here = solver.solve(state, Pose(), loads, start)
        state = here.state
        found.append((here, float(system.gradient[clamp.nodes[~upper], 2].sum())))
    return found


def test_two_cushions_pressed_together_answer_like_one_on_a_plane() -> None:
    """By symmetry a plane lies between them; film on film shares the depth, so that law is twice as stiff."""
    one = hexagon_arm(1, cables=())
    free = squeezed(one, [1.0], turned=False)[0][0].state.positions[:, 2].max()
    gaps = [free * share for share in (0.97, 0.93, 0.88)]
    alone = squeezed(one, [1.0, *gaps], turned=False)[1:]
    both = copies(one, [Pose(), Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))])
    pair = squeezed(both, [1.0, *gaps], turned=True)[1:]
    for (single, force), (double, felt) in zip(alone, pair, strict=True):
        assert force > 1.0
        assert felt == pytest.approx(force, rel=1e-2)
        touching = double.state.touching
        assert touching is not None
        assert touching.normal_force_N == pytest.approx(felt, rel=0.03)  # its normals lean a little
        np.testing.assert_allclose(double.state.positions[: one.nodes], single.state.positions, atol=2e-4)


def curled(films: bool, tension_N: float) -> tuple[SoftBody, Equilibrium]:
    """Return three units whose cables pull, at equilibrium."""
    body = hexagon_arm(3)
    arm = held(body)
    law = SelfContact(body, FilmContactLaw(LAW)) if films else None
    solver = EquilibriumSolver(arm.newton, arm.clamp, NewtonOptions(), law)
    here = solver.solve(SoftState.drawn(body, HANGING), HANGING, no_load(body))
    for share in (0.25, 0.5, 1.0):
        here = solver.follow(here, HANGING, no_load(body, pressure_Pa=(share * PRESSURE_Pa,)))
    for share in np.linspace(0.1, 1.0, 10):
        tension = (share * tension_N,) * 2
        here = solver.follow(
            here, HANGING, no_load(body, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=tension)
        )
    return body, here


def test_units_of_a_curled_arm_press_on_one_another_instead_of_passing_through() -> None:
    body, through = curled(films=False, tension_N=20.0)
    depth = deepest_m(body, through.state.positions)
    assert depth > 3e-3
    body, pressed = curled(films=True, tension_N=20.0)
    touching = pressed.state.touching
    assert touching is not None
    assert touching.normal_force_N > 10.0
    left = deepest_m(body, pressed.state.positions)
    # the search sees what winding numbers see, and nothing else
    assert left == pytest.approx(touching.depth_m, rel=1e-2)
    assert left < 0.35 * depth
    assert pressed.residual_N < 1e-6
    assert pressed.loads.self_contact is not None
    arm = held(body)  # which looks for no contact: what pressed before does not press on
    free = EquilibriumSolver(arm.newton, arm.clamp, NewtonOptions()).follow(pressed, HANGING, pressed.loads)
    assert free.loads.self_contact is None
    assert deepest_m(body, free.state.positions) == pytest.approx(depth, rel=1e-6)


def test_where_nothing_touches_the_equilibrium_is_the_same() -> None:
    states = [curled(films, tension_N=1.0)[1].state for films in (True, False)]
    assert states[0].touching is None
    np.testing.assert_allclose(states[0].positions, states[1].positions, rtol=0.0, atol=1e-12)


def test_pairs_that_are_near_but_do_not_press_leave_the_tangent_narrow() -> None:
    body = hexagon_arm(3)  # drawn flat, unit on unit
    system, x = FilmPotential(body), body.positions
    pairs = SelfContact(body, FilmContactLaw(LAW)).static_pairs(x)
    assert pairs is not None
    assert pairs.memory(x) is None
    loads = no_load(body, self_contact=pairs)
    system.evaluate(x, loads, system.losses_at(x, loads), system.memory.copy())
    assert system.tangent.pattern is system.pattern


def brick(edge_m: float, mass_kg: float) -> SoftBody:
    """Return a stiff film box, half as high as wide, its faces braced by their diagonals."""
    corners = 0.5 * edge_m * (np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0) * (1.0, 1.0, 0.5)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
             [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return SoftBody.from_arrays(corners, np.array(faces), Film(1e9, 0.3, 1e-4), node_mass=mass_kg / 8)


def stacked(lower: SoftBody, upper: SoftBody, shift: tuple[float, float, float], **changes: Any) -> SoftBody:
    """Return two bricks as one body, the second moved."""
    count = lower.nodes
    return SoftBody.from_arrays(
        np.concatenate([lower.positions, upper.positions + np.array(shift)]),
        np.concatenate([lower.triangles, upper.triangles + count]),
        Film(1e9, 0.3, 1e-4),
        node_mass=np.concatenate([lower.node_mass, upper.node_mass]),
        **changes,
    )


@pytest.mark.parametrize("depth", [-1e-3, 5e-5, 3e-4, 2e-3])
def test_an_overlap_of_films_is_found_with_its_depth(depth: float) -> None:
    wide, narrow = 0.08, 0.04
    body = stacked(brick(wide, 0.4), brick(narrow, 0.05), (3e-3, 2e-3, 0.25 * (wide + narrow) - depth))
    found = OverlapCheck(body).overlap(body.positions)
    if depth < 1e-4:
        assert found is None
        return
    assert found is not None
    assert found.depth_m == pytest.approx(depth, rel=1e-9)
    assert found.place.startswith("node ")


def test_one_unit_alone_does_not_overlap() -> None:
    x, triangles = icosphere(1, 0.05)
    body = SoftBody.from_arrays(x, triangles, Film(1e9, 0.3, 1e-4), node_mass=1e-3)
    assert OverlapCheck(body).overlap(x) is None


def test_a_point_presses_with_half_the_laws_stiffness_times_depth_and_its_area() -> None:
    depth, wide, narrow = 3e-4, 0.08, 0.04
    body = stacked(brick(wide, 0.4), brick(narrow, 0.05), (3e-3, 2e-3, 0.25 * (wide + narrow) - depth))
    films = SelfContact(body, FilmContactLaw(LAW))
    pairs = films.static_pairs(body.positions)
    assert pairs is not None
    found = pairs.memory(body.positions)
    assert found is not None
    np.testing.assert_allclose(found.distance, -depth, rtol=1e-9)
    pressing = np.isin(pairs.key, found.key)
    corners = body.positions[body.triangles]
    level = np.ptp(corners[:, :, 2], axis=1) < 1e-9
    points = FilmPoints.of(films.faces, body.positions)
    flat = np.isin(points.home[found.key // films.faces.units, 0], films.faces.face[level])
    assert not flat.all()  # points of the walls, at the lower edges, press besides
    above = pairs.rows.nodes[pressing, 0] > 7
    # all of the small face; of the large one the midpoint of its diagonal and both centroids
    areas = narrow**2, (2.0 / 15.0 + 9.0 / 20.0) * wide**2
    for side, area in zip((above, ~above), areas, strict=True):
        force = 0.5 * LAW.stiffness_N_m3 * depth * area
        assert found.normal_force[side & flat].sum() == pytest.approx(force, rel=1e-9)


def test_films_that_can_meet_within_a_step_are_found_before_it() -> None:
    step_s, speed = 2e-3, 5.0
    gap = speed * step_s
    large, small = brick(0.08, 0.4), brick(0.04, 0.05)
    body = stacked(large, small, (3e-3, 2e-3, 0.03 + gap))
    films = SelfContact(body, FilmContactLaw(LAW))
    state = SoftState.drawn(body, Pose())
    assert films.step_pairs(state, step_s) is None
    falling = np.where(np.arange(body.nodes) < large.nodes, 0.0, -speed)[:, None] * [0.0, 0.0, 1.0]
    met = films.step_pairs(replace(state, velocities=falling), step_s)
    assert met is not None
    # upwards as well, since a film turns round where it meets another; together they meet nothing
    assert films.step_pairs(replace(state, velocities=-falling), step_s) is not None
    together = np.tile([0.0, 0.0, -speed], (body.nodes, 1))
    assert films.step_pairs(replace(state, velocities=together), step_s) is None


def test_pairs_that_pressed_before_a_step_rub_in_it() -> None:
    body = stacked(brick(0.08, 0.4), brick(0.04, 0.05), (3e-3, 2e-3, 0.03 - 3e-4))
    x, step_s, films = body.positions, 2e-3, SelfContact(body, FilmContactLaw(LAW, 0.5))
    pairs = films.static_pairs(x)
    assert pairs is not None
    pressing = pairs.memory(x)
    assert pressing is not None
    assert pressing.count > 0
    found = films.step_pairs(replace(SoftState.drawn(body, Pose()), touching=pressing), step_s)
    assert found is not None
    assert np.isin(pressing.key, found.key).all()
    assert found.rows.friction.sum() == pytest.approx(0.5 * pressing.normal_force.sum())


def slide(tangent: float, friction: float, ticks: int, tick_s: float = 2e-3) -> Array:
    """Return where a small brick on a large one is (ticks,) [m]; the slope is tilted within 200 ticks."""
    large, small = brick(0.08, 0.4), brick(0.04, 0.05)
    body = stacked(large, small, (3e-3, 2e-3, 0.03), base=np.arange(8))
    system, clamp = FilmPotential(body), Clamp.of_base(body)
    films = SelfContact(body, FilmContactLaw(LAW, friction))
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    stepper = Stepper(newton, clamp, StepOptions(tolerance_N=1e-9), films)
    state, place = SoftState.drawn(body, Pose()), []
    for tick in range(ticks):
        angle = np.arctan(tangent * min(1.0, tick / 200))
        gravity = (9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
        state, _ = stepper.step(state, Pose(), Loads(gravity=gravity), tick_s)
        place.append(state.positions[8:, 0].mean())
    return np.array(place)


def test_a_brick_on_a_brick_slips_at_its_friction_angle_within_one_percent() -> None:
    still = slide(0.99 * 0.3, 0.3, 400)
    assert abs(still[-1] - still[-101]) < 1e-3 / 60.0 * 0.2  # less than 1 mm/min
    sliding = slide(1.01 * 0.3, 0.3, 400)
    # the mean speed of two stretches of 50 ticks, 100 ticks apart
    gained = ((sliding[-1] - sliding[-51]) - (sliding[-101] - sliding[-151])) / (50 * 2e-3)
    acceleration = 9.81 * 0.01 * 0.3 / np.hypot(1.0, 1.01 * 0.3)
    assert gained == pytest.approx(acceleration * 100 * 2e-3, rel=0.1)


def test_two_cushions_that_collide_keep_their_momentum() -> None:
    one = hexagon_arm(1, cables=(), base=np.zeros(0, np.int64))
    body = copies(one, [Pose(), Pose(np.diag([1.0, -1.0, -1.0]), np.array([4e-3, 0.0, 0.035]))])
    system, clamp = FilmPotential(body), Clamp.of_base(body)
    films = SelfContact(body, FilmContactLaw(LAW, 0.5))
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    stepper = Stepper(newton, clamp, StepOptions(tolerance_N=1e-9), films)
    state = SoftState.drawn(body, Pose())
    speed = np.where(np.arange(body.nodes) < one.nodes, 0.5, -0.5)
    state = replace(state, velocities=speed[:, None] * [0.2, 0.0, 1.0])
    loads, most = Loads((5e3, 5e3), gravity=(0.0, 0.0, 0.0)), 0.0
    start = body.node_mass @ state.velocities
    for _ in range(60):
        state, _ = stepper.step(state, Pose(), loads, 1e-3)
        most = max(most, 0.0 if state.touching is None else state.touching.normal_force_N)
    assert most > 5.0
    given = body.node_mass[: one.nodes].sum() * 0.5
    np.testing.assert_allclose(body.node_mass @ state.velocities, start, atol=1e-8 * given)
    lower = body.node_mass[: one.nodes] @ state.velocities[: one.nodes]
    assert lower[2] < 0.2 * given  # it has been stopped
