"""Contact between films: exact derivatives, momentum, who meets whom, two cushions against one on a plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.self_contact_pairs import FilmPairs, add_pair_blocks, add_pairs
from cosim.soft.contact.triangle_foot import feet
from cosim.soft.linear.pattern import BlockPattern
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import random_rotation

LAW = ContactLaw(stiffness_N_m3=3e8, smoothing_m=1e-3, stick_m=1e-3)
COUNT = 24


def rubbing(pairs: FilmPairs, friction: Array, stretch: Array) -> FilmPairs:
    """Return the same pairs with friction up to (k,) [N] by stick springs stretched by (k, 3) [m]."""
    out = np.empty_like(pairs.rows.out)
    return replace(pairs, rows=pairs.rows._replace(friction=friction, stretch=stretch, out=out))


def scattered_pairs(seed: int = 0) -> tuple[FilmPairs, Array]:
    """Return points on either side of triangles of some 10 mm, feet in and around them; and positions."""
    rng = np.random.default_rng(seed)
    x = np.empty((6 * COUNT, 3))
    nodes = np.arange(6 * COUNT).reshape(COUNT, 6)
    for row in nodes:
        turn, origin = random_rotation(int(row[0]) + seed), rng.normal(size=3)
        flat = 1e-3 * np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [2.0, 9.0, 0.0]])
        flat += 1e-3 * rng.normal(size=(3, 3))
        above = flat.mean(axis=0) + 3e-3 * rng.normal(size=(3, 3))
        above[:, 2] = rng.uniform(-3e-3, 1.5e-3) + 1e-4 * rng.normal(size=3)
        x[row] = np.concatenate([above, flat]) @ turn.T + origin
    weights = np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1.0 / 3.0] * 3])[rng.integers(3, size=COUNT)]
    places, stiffness = np.arange(COUNT), rng.uniform(1e2, 1e4, COUNT)
    friction = rng.uniform(0.0, 2.0, COUNT) * (places % 3 > 0)
    pairs = FilmPairs.slack(places, places, nodes, weights, stiffness, LAW, x)
    return rubbing(pairs, friction, 1e-3 * rng.normal(size=(COUNT, 3))), x


def evaluate(pairs: FilmPairs, x: Array) -> tuple[float, Array, Array]:
    pattern = BlockPattern.from_elements(len(x), [pairs.rows.nodes])
    force, blocks = np.zeros_like(x), np.zeros((pattern.blocks, 3, 3))
    at = np.ascontiguousarray(x)
    energy = add_pairs(at, pairs.rows, force)
    assert not add_pair_blocks(at, pairs.rows, pattern.rows, np.zeros(pattern.blocks, np.int64), blocks)
    return energy, force, dense(pattern, blocks)


def test_derivatives_are_exact_in_front_within_the_transition_and_beyond() -> None:
    pairs, x = scattered_pairs()
    depth = 0.5 * LAW.smoothing_m - feet(x, pairs.rows.nodes, pairs.rows.weights)[2]
    for low, high in ((-1.0, 0.0), (0.0, LAW.smoothing_m), (LAW.smoothing_m, 1.0)):
        assert ((low < depth) & (depth < high)).sum() > 2  # every branch is met
    # away from where the feet were taken
    moved = x + 2e-4 * np.random.default_rng(1).normal(size=x.shape)
    assert max(derivative_errors(lambda y: evaluate(pairs, y), moved, 1e-7)) < 20.0 * RELATIVE
    smooth = rubbing(pairs, np.zeros(COUNT), pairs.rows.stretch)
    assert max(derivative_errors(lambda y: evaluate(smooth, y), moved, 1e-7)) < 20.0 * RELATIVE


def test_pairs_that_act_once_they_are_a_bit_nearer_are_named_with_those_that_do() -> None:
    pairs, x = scattered_pairs()
    rows = pairs.rows._replace(widths=np.array([2e-4, 1e-3]), friction=np.zeros(COUNT))
    narrow, distance = replace(pairs, rows=rows), feet(x, rows.nodes, rows.weights)[2]
    evaluate(narrow, x)
    wanted = rows.nodes[distance < 4e-4]  # two widths in front, and all that press
    assert len(narrow.acting) < len(wanted) < COUNT
    np.testing.assert_array_equal(narrow.near, wanted)


def test_pressing_keeps_momentum_and_angular_momentum_rubbing_keeps_momentum() -> None:
    pairs, x = scattered_pairs()
    for friction, angular in ((0.0, True), (1.0, False)):
        force = evaluate(rubbing(pairs, friction * pairs.rows.friction, pairs.rows.stretch), x)[1]
        size = np.abs(force).max()
        for row in pairs.rows.nodes:
            assert np.abs(force[row].sum(axis=0)).max() < 1e-12 * size
            moment = np.cross(x[row] - x[row[0]], force[row]).sum(axis=0)
            if angular:
                assert np.abs(moment).max() < 1e-14 * size * 10.0
            else:  # what is left: the gap and the stretch times the friction
                assert np.abs(moment).max() < 1e-2 * size


def test_rigid_motion_changes_nothing_but_the_axes() -> None:
    pairs, x = scattered_pairs()
    turn = random_rotation(5)
    moved = x @ turn.T + np.array([0.3, -1.0, 2.0])
    energy, force, _ = evaluate(rubbing(pairs, np.zeros(COUNT), pairs.rows.stretch), x)
    again, turned, _ = evaluate(rubbing(pairs, np.zeros(COUNT), pairs.rows.stretch), moved)
    assert again == pytest.approx(energy, rel=1e-11)
    np.testing.assert_allclose(turned, force @ turn.T, atol=1e-10 * np.abs(force).max())
