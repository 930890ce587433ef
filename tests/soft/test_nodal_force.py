"""Dead loads on nodes."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from tests.soft.bodies import hexagon_arm, shapes

GRAVITY = (1.0, -2.0, -9.81)
TENSION = (6.0, 9.0)


def evaluated(loads: Loads) -> tuple[float, Array]:
    """Return potential and gradient of an inflated arm of two units."""
    body, x = hexagon_arm(2), shapes(2)["inflated"]
    system = FilmPotential(body)
    energy = system.evaluate(x, loads, system.losses_at(x, loads), system.memory, hessian=False)
    return energy, system.gradient.copy()


def test_forces_in_proportion_to_the_masses_are_gravity() -> None:
    force = hexagon_arm(2).node_mass[:, None] * np.array(GRAVITY)
    by_force = evaluated(Loads((30e3,), TENSION, (0.0, 0.0, 0.0), force))
    by_gravity = evaluated(Loads((30e3,), TENSION, GRAVITY))
    assert np.abs(force).max() > 1e-3
    # both are sums of the same terms up to their order
    np.testing.assert_allclose(by_force[1], by_gravity[1], atol=1e-12 * np.abs(by_gravity[1]).max())
    assert abs(by_force[0] - by_gravity[0]) < 1e-12 * abs(by_gravity[0])


def test_they_change_in_proportion_to_the_share() -> None:
    force = np.random.default_rng(0).normal(size=(4, 3))
    without, with_force, doubled = Loads(), Loads(nodal_force=force), Loads(nodal_force=2.0 * force)
    for begin, end, factor in (
        (without, with_force, 0.25),
        (with_force, without, 0.75),
        (with_force, doubled, 1.25),
    ):
        found = begin.interpolated(end, 0.25).nodal_force
        assert found is not None
        np.testing.assert_allclose(found, factor * force, rtol=1e-15)
    assert without.interpolated(Loads((1.0,)), 0.5).nodal_force is None
