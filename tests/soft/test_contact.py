"""Contact of a film: exact derivatives, the law's figures, Coulomb's angle, the squeezed tube."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import GLUED, ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import triangle_area
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import hexagon_arm, icosphere, shapes
from tests.soft.contacts import half_space

LAW = ContactLaw(stiffness_N_m3=3e8, smoothing_m=2e-3, stick_m=1e-3)
UP = np.array([0.0, 0.0, 1.0])


def evaluate(planes: ContactPlanes, system: FilmPotential, x: Array) -> tuple[float, Array, Array]:
    force, blocks = np.zeros_like(x), np.zeros((system.pattern.blocks, 3, 3))
    energy = planes.add(x, Sums(force, blocks), hessian=True)
    return energy, force, dense(system.pattern, blocks)


@pytest.mark.parametrize("share", [0.02, 0.5, 3.0])
def test_derivatives_are_exact_within_the_transition_and_beyond(share: float) -> None:
    body = hexagon_arm(1)
    system = FilmPotential(body)
    surface = ContactSurface.of(body, system.pattern)
    x = shapes(1)["random"]
    rng = np.random.default_rng(0)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    points = surface.points(x)
    height = np.quantile(points @ normal, 0.7)
    anchor = points + share * LAW.stick_m * rng.normal(size=points.shape)
    planes = half_space(surface, normal, height, LAW, rng.uniform(0.0, 2.0, len(surface)), anchor)
    depth = height + 0.5 * LAW.smoothing_m - points @ normal
    for low, high in ((-1.0, 0.0), (0.0, LAW.smoothing_m), (LAW.smoothing_m, 1.0)):
        assert ((low < depth) & (depth < high)).sum() > 3  # every branch is met
    errors = derivative_errors(lambda y: evaluate(planes, system, y), x, 1e-7)
    # the third derivative jumps at the ends of the transitions, which differences may straddle
    assert max(errors) < 20.0 * RELATIVE


def test_glued_points_are_held_by_springs_in_every_direction() -> None:
    """Derivatives are exact; stiffnesses that others read are those of the tangent."""
    body = hexagon_arm(1)
    system = FilmPotential(body)
    surface = ContactSurface.of(body, system.pattern)
    x = shapes(1)["random"]
    anchor = surface.points(x) + 1e-4 * np.random.default_rng(0).normal(size=(len(surface), 3))
    planes = half_space(surface, UP, 0.0, LAW, GLUED, anchor)
    assert max(derivative_errors(lambda y: evaluate(planes, system, y), x, 1e-7)) < RELATIVE
    stretch = surface.points(x) - anchor
    assert evaluate(planes, system, x)[0] == pytest.approx(0.5 * planes.stiffness @ (stretch**2).sum(axis=1))
    np.testing.assert_array_equal(planes.at(x).tangent, planes.stiffness[:, None, None] * np.eye(3))


def test_contact_points_stand_for_the_whole_area_and_its_moments() -> None:
    body = hexagon_arm(2)
    surface = ContactSurface.of(body, FilmPotential(body).pattern)
    x = body.positions
    area = triangle_area(x, body.triangles)
    points = surface.points(x)
    assert surface.area.sum() == pytest.approx(area.sum(), rel=1e-12)
    corners = x[body.triangles]
    # the rule integrates quadratics: sum over triangles of A/12 (sum_i x_i^2 + (sum_i x_i)^2)
    exact = (area[:, None] / 12.0 * ((corners**2).sum(axis=1) + corners.sum(axis=1) ** 2)).sum(axis=0)
    np.testing.assert_allclose(surface.area @ points**2, exact, rtol=1e-12)


def test_deep_in_contact_pressure_is_stiffness_times_depth_and_nothing_pulls() -> None:
    body = hexagon_arm(1)
    surface = ContactSurface.of(body, FilmPotential(body).pattern)
    planes = half_space(surface, UP, 0.0, LAW)
    flat = np.array(body.positions)
    for z, pressure in ((-3e-3, 3e8 * 3e-3), (-1e-3, 3e8 * 1e-3), (1e-3, 0.0), (2e-3, 0.0)):
        flat[:, 2] = z
        found = planes.at(flat)
        np.testing.assert_allclose(found.normal_force, pressure * surface.area, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found.force, found.normal_force[:, None] * UP, atol=1e-12)


def test_values_of_the_law_are_checked() -> None:
    for name in ("stiffness_N_m3", "smoothing_m", "stick_m"):
        with pytest.raises(InputError, match=name):
            ContactLaw(**{name: 0.0})


def block() -> SoftBody:
    """Return a stiff film cube of 40 mm edge, 50 g, free in space, its faces braced by their diagonals."""
    corners = 0.02 * (np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
             [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return SoftBody.from_arrays(corners, np.array(faces), Film(1e9, 0.3, 1e-4), node_mass=0.05 / 8)


def slide(tangent: float, friction: float, ticks: int, tick_s: float = 2e-3) -> Array:
    """Return the velocity along the slope (ticks,) [m/s] of the block; the slope is tilted within 200 ticks.

    Args:
        tangent: of the angle of the slope.
        friction: coefficient.
        ticks: steps.
        tick_s: step [s].
    """
    body = block()
    system = FilmPotential(body)
    surface = ContactSurface.of(body, system.pattern)
    clamp = Clamp.of_base(body)
    stepper = Stepper(NewtonSolver(system, clamp.mask(body.nodes)), clamp, StepOptions(tolerance_N=1e-9))
    law = ContactLaw()
    state = SoftState.drawn(body, Pose(np.eye(3), np.array([0.0, 0.0, 0.02])))
    anchor, normal_force, speed = surface.points(state.positions), np.zeros(len(surface)), []
    for tick in range(ticks):
        # gently: a load put on at once swings to twice its value
        angle = np.arctan(tangent * min(1.0, tick / 200))
        planes = half_space(surface, UP, 0.0, law, friction * normal_force, anchor)
        loads = Loads(gravity=(9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)), contact=planes)
        state, _ = stepper.step(state, Pose(), loads, tick_s)
        found = planes.at(state.positions)
        normal_force = found.normal_force
        # dragged along the plane: at most `stick` behind the points
        stretch = (found.point - anchor) * (1.0, 1.0, 0.0)
        length = np.linalg.norm(stretch, axis=1)[:, None]
        anchor = found.point - np.minimum(1.0, law.stick_m / np.maximum(length, 1e-300)) * stretch
        speed.append(body.node_mass @ state.velocities[:, 0] / body.mass_kg)
    return np.array(speed)


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_a_block_slips_at_its_friction_angle_within_one_percent(friction: float) -> None:
    held = slide(0.99 * friction, friction, 500)
    # it rocks on its stick springs, but creeps by less than 1 mm/min
    assert abs(held[-250:].mean()) < 1e-3 / 60.0
    slipping = slide(1.01 * friction, friction, 400)
    # 1 % above: a = g cos(angle) 0.01 mu
    acceleration = 9.81 * 0.01 * friction / np.hypot(1.0, 1.01 * friction)
    gained = slipping[-1] - slipping[-101]
    assert gained == pytest.approx(acceleration * 100 * 2e-3, rel=0.05)


def tube(around: int, along: int, radius: float, length: float) -> tuple[Array, IntArray]:
    """Return nodes and outward triangles of a tube along x, its seam nowhere."""
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = np.stack([np.zeros(around), radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    x = np.concatenate([ring + np.array([length * k / along, 0.0, 0.0]) for k in range(along + 1)])
    triangles = []
    for k in range(along):
        for i in range(around):
            a, b = around * k + i, around * k + (i + 1) % around
            c, d = b + around, a + around
            triangles += [[a, b, c], [a, c, d]]
    return x, np.array(triangles)


def test_a_squeezed_tube_pushes_back_with_its_pressure_times_its_flat_part() -> None:
    """F / L = p (W - pi h / 2), W the width of the empty tube laid flat, h the gap."""
    radius, length, pressure, gap = 0.03, 0.01, 10e3, 0.03
    around, along = 120, 2
    x, triangles = tube(around, along, radius, length)
    ends = (np.arange(around)[::-1].copy(), around * along + np.arange(around))
    body = SoftBody.from_arrays(x, triangles, Film(1e9, 0.0, 1e-4), caps=ends, node_mass=1e-4)
    assert triangles.shape == (2 * around * along, 3)
    system = FilmPotential(body)
    surface = ContactSurface.of(body, system.pattern)
    held = np.zeros((body.nodes, 3), dtype=bool)
    held[:, 0] = True  # plane strain
    state = SoftState.drawn(body, Pose())
    law = ContactLaw()
    clamp = Clamp(np.arange(body.nodes), x, held)
    stepper = Stepper(
        NewtonSolver(system, clamp.mask(body.nodes)), clamp, StepOptions(tolerance_N=1e-5, damping_per_s=20.0)
    )
    for tick in range(400):
        height = radius + (0.5 * gap - radius) * min(1.0, tick / 200)
        planes = [half_space(surface, side * UP, -height, law) for side in (1.0, -1.0)]
        contact = _joined(planes[0], planes[1])
        loads = Loads((pressure,), gravity=(0.0, 0.0, 0.0), contact=contact)
        state, _ = stepper.step(state, Pose(), loads, 2e-3)
    found = contact.at(state.positions)
    below = contact.normal[:, 2] > 0.0
    forces = found.normal_force[below].sum(), found.normal_force[~below].sum()
    assert forces[0] == pytest.approx(forces[1], rel=1e-3)
    width = np.pi * radius
    expected = pressure * (width - 0.5 * np.pi * gap) * length
    assert forces[0] == pytest.approx(expected, rel=0.02)


def _joined(first: ContactPlanes, second: ContactPlanes) -> ContactPlanes:
    names = ("nodes", "weights", "slots", "normal", "offset", "stiffness", "friction", "anchor")
    joined = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names}
    return ContactPlanes.empty(len(joined["nodes"]), ContactLaw()).changed(**joined)


def test_a_body_pressed_on_a_wall_gives_back_what_it_gets() -> None:
    x, triangles = icosphere(2, 0.02)
    body = SoftBody.from_arrays(x, triangles, Film(1e8, 0.3, 1e-4), node_mass=1e-4)
    system = FilmPotential(body)
    surface = ContactSurface.of(body, system.pattern)
    rng = np.random.default_rng(1)
    anchor = surface.points(x) + 1e-4 * rng.normal(size=(len(surface), 3))
    planes = half_space(surface, UP, -0.017, ContactLaw(), 0.5, anchor)
    gradient = np.zeros_like(x)
    planes.add(x, Sums(gradient), hessian=False)
    found = planes.at(x)
    assert found.normal_force.sum() > 1.0
    np.testing.assert_allclose(-gradient.sum(axis=0), found.force.sum(axis=0), rtol=1e-12, atol=1e-12)
    moment = -np.cross(x, gradient).sum(axis=0)
    np.testing.assert_allclose(moment, np.cross(found.point, found.force).sum(axis=0), atol=1e-12)
