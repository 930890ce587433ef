"""The soft body as a rigid mass; bounds of its algorithmic mass."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.coupling.robots.stability_ratio import stability_ratio
from tests.soft.bodies import random_rotation

RANDOM = np.random.default_rng(0)
MASS = RANDOM.uniform(0.1, 1.0, 30)
POSITIONS = RANDOM.normal(size=(30, 3)) + np.array([0.3, -0.2, 0.7])
ORIGIN = np.array([0.1, 0.4, -0.2])


def node_sum(origin: Array) -> Array:
    """Return sum m G^T G, G (3, 6) a node's velocity per linear and angular velocity at the origin."""
    matrix = np.zeros((6, 6))
    for mass, position in zip(MASS, POSITIONS, strict=True):
        g = np.concatenate([np.eye(3), np.cross(np.eye(3), position - origin)]).T
        matrix += mass * g.T @ g
    return matrix


def test_spatial_mass_is_the_sum_over_nodes() -> None:
    properties = MassProperties.of(MASS, POSITIONS)
    assert properties.mass_kg == pytest.approx(MASS.sum())
    assert properties.spatial(ORIGIN) == pytest.approx(node_sum(ORIGIN), rel=1e-12, abs=1e-12)


def test_frames_carry_what_their_nodes_weigh() -> None:
    # nodes at an origin and shares of three axes, in two frames that are turned and moved
    shares = np.concatenate([np.ones((30, 1)), RANDOM.normal(size=(30, 3))], axis=1)
    points = RANDOM.normal(size=(2, 4, 3))
    halves = [(MASS[:12], shares[:12], points[0]), (MASS[12:], shares[12:], points[1])]
    blocks = np.stack([np.einsum("n,nj,nk->jk", mass, share, share) for mass, share, _ in halves])
    found = MassProperties.of_blocks(blocks, points)
    expected = MassProperties.of(MASS, np.concatenate([share @ frame for _, share, frame in halves]))
    assert found.mass_kg == pytest.approx(expected.mass_kg, rel=1e-14)
    assert found.center == pytest.approx(expected.center, rel=1e-12, abs=1e-14)
    assert found.inertia == pytest.approx(expected.inertia, rel=1e-12, abs=1e-12)


def test_what_weighs_nothing_has_a_centre_all_the_same() -> None:
    properties = MassProperties.of(np.zeros(30), POSITIONS)
    assert properties.center == pytest.approx(POSITIONS.mean(axis=0))
    assert not properties.spatial(ORIGIN).any()


def test_spatial_mass_gives_kinetic_energy() -> None:
    linear, angular = np.array([0.3, -0.4, 0.1]), np.array([1.0, 2.0, -0.5])
    twist = np.concatenate([linear, angular])
    velocity = linear + np.cross(angular, POSITIONS - ORIGIN)
    energy = 0.5 * float(MASS @ (velocity**2).sum(axis=1))
    matrix = MassProperties.of(MASS, POSITIONS).spatial(ORIGIN)
    assert 0.5 * twist @ matrix @ twist == pytest.approx(energy, rel=1e-13)


def test_inertia_of_a_ring() -> None:
    angle = 2.0 * np.pi / 12.0 * np.arange(12)
    ring = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.full(12, 0.5)], axis=1)
    properties = MassProperties.of(np.full(12, 0.25), ring)
    assert properties.center == pytest.approx([0.0, 0.0, 0.5])
    assert properties.inertia == pytest.approx(np.diag([0.06, 0.06, 0.12]), abs=1e-15)


def test_properties_in_a_frame() -> None:
    frame = Pose(random_rotation(3), np.array([1.0, 2.0, 3.0]))
    inside = MassProperties.of(MASS, POSITIONS)
    center, inertia = MassProperties.of(MASS, frame.apply(POSITIONS)).in_frame(frame)
    assert center == pytest.approx(inside.center)
    assert inertia == pytest.approx(inside.inertia)
    there, own = inside.moved(frame), MassProperties.of(MASS, frame.apply(POSITIONS))
    assert there.mass_kg == pytest.approx(own.mass_kg)
    assert there.center == pytest.approx(own.center)
    assert there.inertia == pytest.approx(own.inertia)


def test_ratio_of_two_masses() -> None:
    # a free mass of 2 kg carrying 3 kg: 3 / 2
    assert stability_ratio(np.eye(6) / 2.0, 3.0 * np.eye(6)) == pytest.approx(1.5)
    half = np.random.default_rng(5).normal(size=(6, 6))
    mobility = half @ half.T
    matrix = MassProperties.of(MASS, POSITIONS).spatial(ORIGIN)
    root = np.linalg.cholesky(matrix)
    largest = np.linalg.eigvalsh(root.T @ mobility @ root).max()
    assert stability_ratio(mobility, matrix) == pytest.approx(largest, rel=1e-9)
