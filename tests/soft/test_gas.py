"""Sealed gas: potential and its derivatives, the dense part of the tangent, leak and exchange."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa, exchange, leak
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.linear.cholesky import EnvelopeCholesky
from cosim.soft.linear.linear_solver import GeneralLU, LowRank
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import FILM as BODY_FILM
from tests.soft.bodies import hexagon_arm, icosphere, inflated_positions, no_load, shapes
from tests.soft.enclosed_volume import enclosed_volume

FILM = replace(BODY_FILM, young_modulus_Pa=1e7, thickness_m=1e-4)
RADIUS_M = 0.05
EXPONENTS = [1.0, 1.0 + 1e-9, 1.4]


def air(volume_m3: float, gauge_Pa: float = 3e4, exponent: float = 1.4, **changes: Any) -> SealedGas:
    return SealedGas(STANDARD_ATMOSPHERE_Pa + gauge_Pa, volume_m3, exponent, **changes)


def volume_of(body: SoftBody, x: Array) -> float:
    return enclosed_volume(x, body.triangles, body.caps)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("volume", [2e-5, 1e-4, 3e-4])
def test_the_potential_s_slope_is_the_pressure(exponent: float, volume: float) -> None:
    gas, step = air(1e-4, exponent=exponent), 1e-4 * volume
    slope = (gas.potential(volume + step) - gas.potential(volume - step)) / (2.0 * step)
    # cut off at (step / V)^2 / 6 of the absolute pressures, about 1e-8 of 1e6 Pa
    assert slope == pytest.approx(-gas.gauge_pressure(volume), abs=0.05)


def test_the_isothermal_potential_is_the_limit() -> None:
    for volume in (3e-5, 3e-4):
        limit, near = (air(1e-4, exponent=g).potential(volume) for g in (1.0, 1.0 + 1e-8))
        assert near == pytest.approx(limit, rel=1e-6)
    assert air(1e-4).potential(1e-4) == 0.0
    assert air(1e-4).potential(-1e-6) == np.inf


@pytest.mark.parametrize("shape", ["random", "inflated"])
def test_derivatives_with_a_sealed_gas(shape: str) -> None:
    body, x = hexagon_arm(1), shapes(1)[shape]
    system, gas = FilmPotential(body), air(volume_of(hexagon_arm(1), x), 2e4)
    loads = no_load(body, gas=(gas,))
    reference = dihedral_angle(x, body.hinges.nodes)

    def evaluate(y: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(y, loads, system.losses_at(x, loads), reference)
        matrix = dense(system.pattern, system.blocks)
        assert system.tangent.low_rank is not None
        matrix += system.tangent.low_rank.matrix()
        return energy, system.gradient.copy(), matrix

    assert max(derivative_errors(evaluate, x, 5e-7)) < 20.0 * RELATIVE  # stiff film: rounding of 1e-9 J


def test_a_sealed_gas_pushes_like_the_pressure_it_has() -> None:
    body, x = hexagon_arm(2), inflated_positions(2)
    system, gas = FilmPotential(body), air(0.95 * volume_of(body, x))
    reference = dihedral_angle(x, body.hinges.nodes)
    none = system.losses_at(x, no_load(body))
    system.evaluate(x, no_load(body, gas=(gas,)), none, reference)
    gradient, pressure = system.gradient.copy(), system.pressure_Pa
    assert pressure == pytest.approx(gas.gauge_pressure(volume_of(body, x)), rel=1e-12)
    assert 0.0 < pressure < 3e4
    system.evaluate(x, no_load(body, pressure_Pa=(pressure,)), none, reference)
    assert gradient == pytest.approx(system.gradient, abs=1e-12 * np.abs(gradient).max())
    assert system.tangent.low_rank is None


@pytest.mark.parametrize("kind", [EnvelopeCholesky, GeneralLU])
@pytest.mark.parametrize("coefficient", [1e9, 1e-3, 0.0])
def test_the_dense_term_is_solved_without_a_dense_matrix(
    kind: type[EnvelopeCholesky] | type[GeneralLU], coefficient: float
) -> None:
    body, x = hexagon_arm(1), inflated_positions(1)
    system, random = FilmPotential(body), np.random.default_rng(3)
    system.evaluate(x, no_load(body, gas=(air(volume_of(body, x)),)), np.zeros(0), system.memory)
    assert system.tangent.low_rank is not None
    slope = system.tangent.low_rank.vectors[0]
    free = random.random((body.nodes, 3)) < 0.8
    load = random.normal(size=x.shape)
    matrix = dense(system.pattern, system.blocks) + coefficient * np.outer(slope, slope)
    keep = free.ravel()
    shift = 1e3
    expected = np.zeros(x.size)
    expected[keep] = np.linalg.solve(
        matrix[np.ix_(keep, keep)] + shift * np.eye(keep.sum()), load.ravel()[keep]
    )
    solver = kind(system.pattern, free)
    assert solver.factor(system.blocks, shift, one(slope, coefficient))
    # condition about 1e4, and 1e9 |grad V|^2 = 1e3 times the shift taken off again
    assert solver.solve(load).ravel() == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert solver.factor(system.blocks, shift)
    without = solver.solve(load)
    assert solver.factor(system.blocks, shift, one(slope, 0.0))
    assert (solver.solve(load) == without).all()


def test_a_negative_dense_term_that_spoils_definiteness_is_refused() -> None:
    body, x = hexagon_arm(1), inflated_positions(1)
    system = FilmPotential(body)
    system.evaluate(x, no_load(body), np.zeros(0), system.memory)
    solver = EnvelopeCholesky(system.pattern, np.ones(body.nodes, dtype=bool))
    shift = 1e4
    matrix = dense(system.pattern, system.blocks) + shift * np.eye(x.size)
    direction = np.random.default_rng(4).normal(size=x.shape)
    bound = 1.0 / float(direction.ravel() @ np.linalg.solve(matrix, direction.ravel()))
    assert solver.factor(system.blocks, shift, one(direction, -0.999 * bound))
    assert not solver.factor(system.blocks, shift, one(direction, -1.001 * bound))


@pytest.mark.parametrize("kind", [EnvelopeCholesky, GeneralLU])
def test_several_dense_terms_of_either_sign(kind: type[EnvelopeCholesky] | type[GeneralLU]) -> None:
    body, x = hexagon_arm(1), inflated_positions(1)
    system, random = FilmPotential(body), np.random.default_rng(5)
    system.evaluate(x, no_load(body), np.zeros(0), system.memory)
    free = random.random((body.nodes, 3)) < 0.8
    keep, shift = free.ravel(), 1e4
    terms = LowRank(random.normal(size=(4, *x.shape)), np.array([1e5, -30.0, 0.0, 2e2]))
    matrix = dense(system.pattern, system.blocks) + terms.matrix() + shift * np.eye(x.size)
    assert np.linalg.eigvalsh(matrix[np.ix_(keep, keep)]).min() > 0.0
    load = random.normal(size=x.shape)
    expected = np.zeros(x.size)
    expected[keep] = np.linalg.solve(matrix[np.ix_(keep, keep)], load.ravel()[keep])
    solver = kind(system.pattern, free)
    assert solver.factor(system.blocks, shift, terms)
    # condition about 1e5
    assert solver.solve(load).ravel() == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    spoilt = LowRank(terms.vectors, np.array([1e5, -1e5, 0.0, 2e2]))
    assert not solver.factor(system.blocks, shift, spoilt)


def one(vector: Array, coefficient: float) -> LowRank:
    """Return a single dense term."""
    return LowRank(vector[None], np.array([coefficient]))


def balloon() -> tuple[SoftBody, Array]:
    positions, triangles = icosphere(2, RADIUS_M)
    return SoftBody.from_arrays(positions, triangles, FILM, node_mass=1e-3), positions


def settled(body: SoftBody, x: Array, **loads: Any) -> tuple[NewtonResult, FilmPotential]:
    """Return the equilibrium with six components held, which is no constraint on a balloon's shape."""
    system = FilmPotential(body)
    held = np.zeros((body.nodes, 3), dtype=bool)
    a, b, c = 0, int(np.argmin(x @ x[0])), int(np.argmin(np.abs(x @ x[0])))
    held[a] = True
    tangents = np.eye(3)[np.argsort(np.abs(x[b] - x[a]))][:2]
    held[b] = tangents.any(axis=0)
    held[c] = False
    held[c, int(np.argmax(np.abs(np.cross(x[b] - x[a], x[c]))))] = True
    solver = NewtonSolver(system, held)
    result = solver.solve(x, np.zeros(0), Loads(gravity=(0.0, 0.0, 0.0), **loads), NewtonOptions())
    assert result.converged, result.outcome
    return result, system


@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_a_sealed_balloon_finds_the_pressure_of_its_amount(exponent: float) -> None:
    # Blow up by a prescribed pressure, seal that gas at the same volume, cool it by a fifth of its pressure:
    # the balloon shrinks to the point where p V^gamma and the prescribed-pressure balance agree.
    body, x = balloon()
    blown, system = settled(body, x, pressure_Pa=(2e3,))
    volume = system.volume
    gas = air(volume, 2e3, exponent)
    same, system = settled(body, blown.positions, gas=(gas,))
    assert system.volume == pytest.approx(volume, rel=1e-9)
    assert same.iterations <= 1
    less, system = settled(body, blown.positions, gas=(gas.with_mass(0.995 * gas.mass_kg),))
    constant = 0.995 * gas.pressure_Pa * gas.volume_m3**exponent
    absolute = system.pressure_Pa + STANDARD_ATMOSPHERE_Pa
    assert absolute * system.volume**exponent == pytest.approx(constant, rel=1e-10)
    again, system_again = settled(body, less.positions, pressure_Pa=(system.pressure_Pa,))
    assert again.positions == pytest.approx(less.positions, abs=1e-9)
    assert system_again.volume < volume
    assert less.iterations <= 8  # Newton's method with the exact tangent


def test_sealed_gas_resists_when_the_arm_is_loaded() -> None:
    # A dead load against the tip: the sealed arm gains pressure, and gives way less than at fixed pressure.
    body, x = hexagon_arm(2), inflated_positions(2)
    held = np.zeros(body.nodes, dtype=bool)
    held[body.base] = True
    system = FilmPotential(body)
    solver = NewtonSolver(system, held)
    angles = dihedral_angle(x, body.hinges.nodes)
    calm = {"gravity": (0.0, 0.0, 0.0)}
    begin = solver.solve(x, angles, no_load(body, pressure_Pa=(3e4,), **calm), NewtonOptions())
    gas = air(system.volume, 3e4, 1.0)
    force = np.zeros_like(x)
    force[body.tip, 2] = 2.0 / len(body.tip)  # pushes towards the base: the arm hangs
    moved = []
    for changes in ({"pressure_Pa": (3e4,)}, {"gas": (gas,)}):
        loads = no_load(body, nodal_force=force, **calm, **changes)
        result = solver.solve(begin.positions, begin.memory, loads, NewtonOptions())
        assert result.converged
        moved.append(float((result.positions - begin.positions)[body.tip, 2].mean()))
    assert system.pressure_Pa > 3e4
    assert 0.0 < moved[1] < moved[0]


def test_an_open_body_cannot_be_sealed() -> None:
    body = replace(hexagon_arm(1), closed=False)
    system = FilmPotential(body)
    with pytest.raises(InputError, match="closed body"):
        system.evaluate(inflated_positions(1), no_load(body, gas=(air(1e-5),)), np.zeros(0), system.memory)


def test_a_volume_that_is_gone_costs_infinitely_much() -> None:
    body, x = hexagon_arm(1), inflated_positions(1)
    system = FilmPotential(body)
    inside_out = np.ascontiguousarray(x * (1.0, 1.0, -1.0))
    loads = no_load(body, gas=(air(1e-5),))
    assert system.evaluate(inside_out, loads, np.zeros(0), system.memory, hessian=False) == np.inf


def test_a_leak_decays_at_its_rate_whatever_the_step() -> None:
    gas, volume, conductance = air(1e-4), 1e-4, 1e-9
    rate = conductance * gas.gas_constant_J_kg_K * gas.temperature_K / volume
    expected = 3e4 * np.exp(-rate * 2.0)
    for steps in (1, 7, 200):
        left = gas
        for _ in range(steps):
            left = leak(left, volume, conductance, 2.0 / steps)
        assert left.gauge_pressure(volume) == pytest.approx(expected, rel=1e-12)
    assert leak(gas, volume, conductance, 1e9).gauge_pressure(volume) == pytest.approx(0.0, abs=1e-6)
    # below the atmosphere it leaks inwards
    assert leak(air(volume, -1e4), volume, conductance, 1.0).gauge_pressure(volume) > -1e4


def test_an_orifice_keeps_the_mass_and_levels_the_pressure() -> None:
    gases, volumes = (air(1e-4, 3e4), air(3e-4, 1e3, temperature_K=310.0)), (0.9e-4, 3.2e-4)
    total = sum(gas.mass_kg for gas in gases)
    for step in (1e-3, 1.0, 1e6):
        after = exchange(gases, volumes, 1e-8, step)
        assert sum(gas.mass_kg for gas in after) == pytest.approx(total, rel=1e-14)
        assert after[0].mass_kg < gases[0].mass_kg
    pressures = [gas.absolute_pressure(volume) for gas, volume in zip(after, volumes, strict=True)]
    assert pressures[0] == pytest.approx(pressures[1], rel=1e-12)


def test_restating_a_gas_changes_nothing() -> None:
    gas = air(1e-4)
    there = gas.at(2.5e-4)
    assert there.mass_kg == pytest.approx(gas.mass_kg, rel=1e-14)
    assert there.temperature_K < gas.temperature_K
    assert there.absolute_pressure(1e-4) == pytest.approx(gas.pressure_Pa, rel=1e-14)


def test_loads_between_two_gases() -> None:
    begin, end = air(1e-4, 1e4), air(2e-4, 3e4)
    middle = Loads(gas=(begin,)).interpolated(Loads(gas=(end,)), 0.5).gas[0]
    assert middle is not None
    assert middle.absolute_pressure(1e-4) == pytest.approx(
        0.5 * (begin.pressure_Pa + end.absolute_pressure(1e-4)), rel=1e-12
    )
    assert Loads(gas=(begin,)).interpolated(Loads(gas=(end,)), 1.0).gas == (end,)
    assert Loads().interpolated(Loads(gas=(end,)), 0.5).gas == (end,)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pressure_Pa": 0.0}, "pressure_Pa of a sealed gas is 0.0"),
        ({"volume_m3": -1.0}, "volume_m3 of a sealed gas is -1.0"),
        ({"exponent": 0.9}, "exponent of a sealed gas is 0.9"),
        ({"temperature_K": float("nan")}, "temperature_K of a sealed gas is nan"),
        ({"ambient_Pa": -1.0}, "ambient_Pa is -1.0"),
    ],
)
def test_impossible_gases_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(air(1e-4), **changes)


def test_on_the_way_to_another_gas_pressure_and_temperature_go_evenly() -> None:
    warm = replace(air(1e-4, 3e4), temperature_K=350.0)
    cold = replace(air(2e-4, 1e4), temperature_K=280.0)
    there = cold.at(1e-4)
    for share in (0.0, 0.25, 1.0):
        between = warm.towards(cold, share)
        assert between.volume_m3 == 1e-4
        for name in ("pressure_Pa", "temperature_K"):
            begin, end = getattr(warm, name), getattr(there, name)
            assert getattr(between, name) == pytest.approx(begin + share * (end - begin))
    assert warm.towards(cold, 1.0).mass_kg == pytest.approx(cold.mass_kg)
