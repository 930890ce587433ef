"""Several gas chambers in one body: each has its own pressure, volume and sealed gas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import InputError, MeshError
from cosim.soft.body.body import GasChamber, SoftBody
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import dihedral_angle
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import hexagon_arm, no_load, shapes

POSES = around_axis(2, 0.1, 0.4)
PAIR = copies(hexagon_arm(1), POSES)


def apart(shape: str) -> Array:
    """Return positions of two copies of a unit, the second one a little larger."""
    x = shapes(1)[shape]
    return np.concatenate([POSES[0].apply(x), POSES[1].apply(1.05 * x)])


def gradient_of(body: SoftBody, x: Array, loads: Loads) -> Array:
    system = FilmPotential(body)
    system.evaluate(x, loads, np.zeros(0), dihedral_angle(x, body.hinges.nodes))
    return system.gradient.copy()


def test_each_chamber_feels_its_own_pressure() -> None:
    x, single = apart("inflated"), hexagon_arm(1)
    both = gradient_of(PAIR, x, Loads((10e3, 30e3)))
    for k, pressure in enumerate((10e3, 30e3)):
        own = slice(k * single.nodes, (k + 1) * single.nodes)
        alone = gradient_of(single, np.ascontiguousarray(x[own]), Loads((pressure,)))
        np.testing.assert_array_equal(both[own], alone)


def test_volume_and_pressure_of_each_are_kept() -> None:
    x, system = apart("inflated"), FilmPotential(PAIR)
    system.evaluate(x, Loads((10e3, 30e3)), np.zeros(0), system.memory.copy())
    first, second = system.gas.enclosed_volumes(x[None])[0].tolist()
    assert second == pytest.approx(1.05**3 * first, rel=1e-12)
    assert system.pressure_Pa == 10e3
    assert system.volume == pytest.approx(first + second, rel=1e-15)


@pytest.mark.parametrize("sealed", [(True, True), (False, True)])
def test_derivatives_with_sealed_chambers(sealed: tuple[bool, bool]) -> None:
    x, system = apart("inflated"), FilmPotential(PAIR)
    gases = tuple(
        SealedGas(STANDARD_ATMOSPHERE_Pa + 2e4, volume) if closed else None
        for closed, volume in zip(sealed, system.gas.enclosed_volumes(x[None])[0].tolist(), strict=True)
    )
    loads = no_load(PAIR, pressure_Pa=(5e3, 0.0), gas=gases)
    reference = dihedral_angle(x, PAIR.hinges.nodes)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(y, loads, np.zeros(0), reference)
        assert system.tangent.low_rank is not None
        matrix = dense(system.pattern, system.blocks) + system.tangent.low_rank.matrix()
        return energy, system.gradient.copy(), matrix

    assert max(derivative_errors(evaluate, x, 5e-7)) < 20.0 * RELATIVE  # stiff film: rounding of 1e-9 J
    assert system.tangent.low_rank is not None
    assert len(system.tangent.low_rank.coefficients) == sum(sealed)


def test_loads_have_a_value_for_each_chamber_or_none() -> None:
    x = apart("inflated")
    np.testing.assert_array_equal(gradient_of(PAIR, x, Loads()), gradient_of(PAIR, x, Loads((0.0, 0.0))))
    assert Loads().interpolated(Loads((2e4, 1e4)), 0.5).pressure_Pa == (1e4, 5e3)
    for wrong in ((1.0,), (1.0, 2.0, 3.0)):
        with pytest.raises(InputError, match=f"{len(wrong)} values for 2 chambers; give one for each"):
            gradient_of(PAIR, x, Loads(wrong))


def test_gases_change_chamber_by_chamber() -> None:
    one, other = (SealedGas(p, 1e-4, 1.0) for p in (1e5, 2e5))
    gas = Loads(gas=(one, None)).interpolated(Loads(gas=(other, other)), 0.5).gas
    assert gas[0] is not None
    assert gas[0].absolute_pressure(1e-4) == pytest.approx(1.5e5)
    assert gas[1] is other


@pytest.mark.parametrize(
    ("chambers", "word"),
    [
        ([GasChamber("a", np.arange(84), (0, 1))], "triangle 84 belongs to 0 chambers"),
        ([GasChamber("a", np.arange(168), (0, 1, 2))], "cap 3 belongs to 0"),
        ([GasChamber("a", np.arange(168), (0, 1, 2, 3, 3))], "cap 3 belongs to 2"),
        ([GasChamber("a", np.arange(169), (0, 1, 2, 3))], "there are 168"),
        ([GasChamber("a", np.arange(84), (0, 1)), GasChamber("a", np.arange(84, 168), (2, 3))], "differ"),
    ],
)
def test_wrong_chambers_are_refused(chambers: list[GasChamber], word: str) -> None:
    with pytest.raises(MeshError, match=word):
        replace(PAIR, chambers=tuple(chambers))


def test_copies_of_a_body_with_chambers_name_them_all() -> None:
    assert [part.name for part in PAIR.chambers] == ["copy_1", "copy_2"]
    assert [part.name for part in copies(PAIR, POSES).chambers] == [
        "copy_1/copy_1", "copy_1/copy_2", "copy_2/copy_1", "copy_2/copy_2",
    ]  # fmt: skip
