"""Gas: derivatives, closed and open chambers, balance, volume."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.soft.body.loads import Loads
from cosim.soft.elements.pressure import add_cap, add_cap_force, add_pressure, cap_stiffness
from cosim.soft.film.film import FilmPotential
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors, differences, relative_error
from tests.soft.bodies import hexagon_arm, icosphere, random_rotation, shapes
from tests.soft.enclosed_volume import enclosed_volume

UNITS = 1
P = 30e3
STEP_M = 1e-5
"""Everything here is a cubic polynomial of the positions: the differences have no truncation error."""
SHAPES = ("random", "nearly flat", "inflated")


def film(triangles: IntArray, nodes: int) -> Evaluate:
    def add(x, slots, force, blocks):  # type: ignore[no-untyped-def]
        return -P * add_pressure(x, triangles, P, slots, force, blocks)

    return assembled(triangles, add, nodes)


def cap(ring: IntArray, nodes: int) -> Evaluate:
    def add(x, slots, force, blocks):  # type: ignore[no-untyped-def]
        return -P * add_cap(x, ring, P, slots[0], force, blocks)

    return assembled(ring[None], add, nodes)


@cache
def closed_parts() -> tuple[Evaluate, ...]:
    body = hexagon_arm(UNITS)
    caps = (cap(ring, body.nodes) for ring in body.caps)
    return film(body.triangles, body.nodes), *caps


def closed_gas(x: Array) -> tuple[float, Array, Array]:
    """Return energy, gradient and Hessian of film and caps together."""
    parts = [evaluate(x) for evaluate in closed_parts()]
    energy, gradient, hessian = (sum(part[k] for part in parts) for k in range(3))
    return energy, gradient, hessian


def cap_force(positions: Array, ring: IntArray) -> Array:
    """Return the pressure force (k, 3) [N] that a cap would put on its ring."""
    force = np.zeros(positions.shape)
    add_cap_force(np.ascontiguousarray(positions), ring, P, force)
    return force[ring]


@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_of_every_film_triangle(shape: str) -> None:
    x, random = shapes(UNITS)[shape], np.random.default_rng(1)
    for triangle in hexagon_arm(UNITS).triangles:
        order = random.permutation(3)
        y = np.empty((3, 3))
        y[order] = x[triangle]
        assert max(derivative_errors(film(order[None], 3), y, STEP_M)) < RELATIVE


@pytest.mark.parametrize("count", [3, 4, 5, 6, 12])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_a_cap(count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    ring = random.permutation(count)
    x = 0.02 * random.normal(size=(count, 3)) + (0.3, 0.0, 0.7)
    assert max(derivative_errors(cap(ring, count), x, 1e-4)) < RELATIVE


@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_of_a_closed_chamber(shape: str) -> None:
    assert max(derivative_errors(closed_gas, shapes(UNITS)[shape], 1e-4)) < RELATIVE


@pytest.mark.parametrize("count", [3, 6])
def test_derivative_of_the_missing_cap_force(count: int) -> None:
    random = np.random.default_rng(count)
    x, ring = 0.02 * random.normal(size=(count + 2, 3)), 1 + random.permutation(count)
    derivative = cap_stiffness(x, ring, P)

    def force(points: Array) -> Array:
        moved = x.copy()
        moved[ring] = points
        return cap_force(moved, ring).ravel()

    assert relative_error(derivative, differences(force, x[ring], 1e-4).T) < RELATIVE


@pytest.mark.parametrize("shape", SHAPES)
def test_closed_gas_is_conservative_and_the_open_one_is_not(shape: str) -> None:
    # Both stiffnesses by differences of forces alone: the assembled one is symmetric by storage.
    x, body = shapes(UNITS)[shape], hexagon_arm(UNITS)

    def open_gas(y: Array) -> Array:
        gradient = closed_gas(y)[1].copy()
        for ring in body.caps:
            gradient[ring] += cap_force(y, ring)
        return gradient.ravel()

    closed = differences(lambda y: closed_gas(y)[1].ravel(), x, 1e-4)
    opened = differences(open_gas, x, 1e-4)
    assert relative_error(closed, closed.T) < 1e-9  # rounding of 1e-16 on coordinates over steps of 1e-4 m
    assert relative_error(opened, opened.T) > 1e-3


def test_open_chamber_puts_a_third_of_each_triangles_load_on_its_nodes() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS, closed=False)
    system = FilmPotential(body)
    gradients = []
    for pressure in (0.0, P):
        system.evaluate(x, Loads((pressure,), ()), np.zeros(0), system.memory.copy())
        gradients.append(system.gradient.copy())
    a, b, c = (x[body.triangles[:, k]] for k in range(3))
    third = P * 0.5 * np.cross(b - a, c - a) / 3.0
    load = np.zeros_like(x)
    for k in range(3):
        np.add.at(load, body.triangles[:, k], third)
    # film forces of some 10 N in both gradients
    assert gradients[0] - gradients[1] == pytest.approx(load, abs=1e-12 * np.abs(gradients[0]).max())


def test_the_missing_cap_force_is_pressure_times_area() -> None:
    angle = 2.0 * np.pi / 6.0 * np.arange(6)
    ring = 0.01 * np.stack([np.cos(angle), np.sin(angle), np.full(6, 3.0)], axis=1)
    force = cap_force(ring, np.arange(6))
    area = 1.5 * np.sqrt(3.0) * 0.01**2
    assert force.sum(axis=0) == pytest.approx([0.0, 0.0, P * area], abs=1e-12)
    assert force == pytest.approx(np.tile([0.0, 0.0, P * area / 6.0], (6, 1)), abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_closed_gas_puts_no_net_load_on_the_body(shape: str) -> None:
    x = shapes(UNITS)[shape]
    _, gradient, _ = closed_gas(x)
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-13 * size
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-13 * size * np.abs(x).max()


def test_closed_gas_turns_with_the_body() -> None:
    x, turn = shapes(UNITS)["random"], random_rotation(7)
    energy, gradient, _ = closed_gas(x)
    turned_energy, turned_gradient, _ = closed_gas(x @ turn.T + (0.3, -0.2, 0.4))
    # volumes of single fans from a far origin are some 100 times the whole
    assert turned_energy == pytest.approx(energy, rel=1e-11)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-11 * np.abs(gradient).max())


def test_energy_is_minus_pressure_times_the_enclosed_volume() -> None:
    x, body = shapes(UNITS)["inflated"], hexagon_arm(UNITS)
    volume = enclosed_volume(x, body.triangles, body.caps)
    assert volume > 0.0
    assert closed_gas(x)[0] == pytest.approx(-P * volume, rel=1e-12)
    system = FilmPotential(body)
    system.evaluate(x, Loads((P,), ()), np.zeros(0), system.memory.copy())
    assert system.volume == pytest.approx(volume, rel=1e-12)


def test_volume_and_force_of_a_sphere() -> None:
    radius = 0.05
    x, triangles = icosphere(3, radius)
    energy, gradient, _ = film(triangles, len(x))(x)
    # inscribed polyhedron: 1 % below the sphere at 1,280 triangles
    assert -energy / P == pytest.approx(4.0 / 3.0 * np.pi * radius**3, rel=0.01)
    # Euler on a homogeneous function of degree 3: the forces do three times the energy's work on scaling
    assert np.einsum("nr,nr->", gradient, x) == pytest.approx(3.0 * energy, rel=1e-12)
    outward = -(gradient * x).sum(axis=1)
    assert (outward > 0.0).all()


def test_without_slots_the_forces_are_the_same() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    triangles, ring = body.triangles, body.caps[1]
    force, blocks = np.zeros_like(x), np.zeros((1, 3, 3))
    volume = add_pressure(x, triangles, P, np.zeros((0, 0), np.int64), force, blocks)
    assert -P * volume == film(triangles, body.nodes)(x)[0]
    assert (force == film(triangles, body.nodes)(x)[1]).all()
    force[:] = 0.0
    add_cap(x, ring, P, np.zeros(0, np.int64), force, blocks)
    assert (force == cap(ring, body.nodes)(x)[1]).all()
    assert not blocks.any()
