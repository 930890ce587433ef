"""Several copies of one body on one flange."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import center_rings
from cosim.soft.film.film import FilmPotential
from tests.soft.bodies import hexagon_arm, shapes

POSES = around_axis(3, 0.1, 0.4, 0.3, 0.02)


def evaluated(body: SoftBody, x: Array, loads: Loads) -> tuple[float, Array, float]:
    """Return potential [J], gradient (n, 3) [N] and volume [m^3]."""
    system = FilmPotential(body)
    energy = system.evaluate(x, loads, system.losses_at(x, loads), system.memory)
    return energy, system.gradient.copy(), system.volume


def test_each_copy_feels_what_the_original_does_in_its_own_frame() -> None:
    single, x = hexagon_arm(2), shapes(2)["inflated"]
    triple = copies(single, POSES)
    weightless = (0.0, 0.0, 0.0)
    one = evaluated(single, x, Loads((30e3,), (6.0, 9.0), weightless))
    moved = np.concatenate([pose.apply(x) for pose in POSES])
    three = evaluated(triple, moved, Loads((30e3,) * 3, (6.0, 9.0) * 3, weightless))
    assert three[0] == pytest.approx(3.0 * one[0], rel=1e-9)
    assert three[2] == pytest.approx(3.0 * one[2], rel=1e-9)
    turned = np.concatenate([one[1] @ pose.rotation.T for pose in POSES])
    np.testing.assert_allclose(three[1], turned, atol=1e-9 * np.abs(one[1]).max())
    assert triple.mass_kg == pytest.approx(3.0 * single.mass_kg, rel=1e-12)


def test_they_stand_evenly_around_the_axis_and_lean_outwards() -> None:
    origins = np.array([pose.translation for pose in POSES])
    np.testing.assert_allclose(origins.sum(axis=0), [0.0, 0.0, 0.06], atol=1e-15)
    np.testing.assert_allclose(origins[0], [0.1, 0.0, 0.02], atol=1e-15)
    for pose, origin in zip(POSES, origins, strict=True):
        outwards = origin * (1.0, 1.0, 0.0) / 0.1
        np.testing.assert_allclose(
            pose.rotation[:, 2], np.sin(0.4) * outwards + [0.0, 0.0, np.cos(0.4)], atol=1e-15
        )


def test_names_and_tip_are_those_of_the_first_copy() -> None:
    single = hexagon_arm(2)
    triple = copies(single, POSES)
    np.testing.assert_array_equal(triple.tip, single.tip)
    np.testing.assert_array_equal(center_rings(triple), center_rings(single))
    np.testing.assert_array_equal(triple.rings["copy_3/tip"], single.tip + 2 * single.nodes)
    assert len(triple.base) == 3 * len(single.base)
    with pytest.raises(MeshError, match="at least one copy"):
        copies(single, ())
