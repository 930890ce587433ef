"""Newton's method: speed, named ends, indefinite tangents, films that must not cross."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.state import SoftState
from tests.soft.bodies import HANGING, Held, PRESSURE_Pa, held, hexagon_arm, hung, no_load

EXACT = NewtonOptions(tolerance_N=1e-9, start_tolerance_N=1e-9)


def inflated(arm: Held, options: NewtonOptions, **loads: object) -> NewtonResult:
    """Return what one solution from the drawn shape gives under pressure at once."""
    drawn = SoftState.drawn(arm.body, HANGING)
    given = no_load(arm.body, **{"pressure_Pa": (PRESSURE_Pa,), **loads})
    return arm.newton.solve(drawn.positions, drawn.memory, given, options)


def residuals(arm: Held, start: Array, angles: Array, count: int, **loads: object) -> list[float]:
    """Return the residuals after 0, 1, ..., count iterations."""
    given = no_load(arm.body, **loads)
    return [
        arm.newton.solve(start, angles, given, replace(EXACT, iterations_max=k)).residual_N
        for k in range(count + 1)
    ]


@pytest.mark.parametrize("closed", [True, False])
def test_convergence_is_quadratic(closed: bool) -> None:
    # Not so with any wrong term in the Hessian; open chambers have an unsymmetric one.
    arm = held(hexagon_arm(3, closed=closed))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(2.0, 3.0)).state
    given = {"pressure_Pa": (1.02 * PRESSURE_Pa,), "cable_tension_N": (2.0, 3.0)}
    r = residuals(arm, begin.positions, begin.memory, 4, **given)
    # once below 0.01 N each residual is about the square of the last (in N, factor 2 as measured)
    assert r[2] < 0.01, r
    assert r[3] < 5.0 * r[2] ** 2, r
    assert r[4] < 5.0 * r[3] ** 2 + 1e-10, r


def test_deflated_arm_takes_the_full_pressure_in_one_increment() -> None:
    # the tangent of the flat arm under 30 kPa is indefinite
    arm = held(hexagon_arm(10))
    # 176 iterations with code for AVX2, 220 for AVX-512, which rounds in another way, to the same equilibrium
    result = inflated(arm, NewtonOptions(iterations_max=300))
    assert result.outcome is Outcome.CONVERGED
    assert result.shifted > 0
    assert result.factorisations > result.iterations
    slow = hung(arm)
    for k in range(1, 11):
        slow = arm.equilibrium.follow(slow, HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa * k / 10,)))
    # residuals of 1e-6 N on a bending stiffness of 0.02 N/m
    assert arm.body.tip_position(result.positions) == pytest.approx(
        arm.body.tip_position(slow.state.positions), abs=1e-4
    )


def test_iteration_limit() -> None:
    result = inflated(held(hexagon_arm(2)), NewtonOptions(iterations_max=2))
    assert result.outcome is Outcome.ITERATION_LIMIT
    assert result.iterations == 2
    assert result.residual_N > 1e-6
    assert not result.converged


def test_positions_that_are_not_finite() -> None:
    arm = held(hexagon_arm(1))
    drawn = SoftState.drawn(arm.body, HANGING)
    drawn.positions[20, 1] = np.nan
    result = arm.newton.solve(drawn.positions, drawn.memory, no_load(arm.body), NewtonOptions())
    assert result.outcome is Outcome.NOT_FINITE
    assert result.iterations == 0


def test_crossed_films_part_again() -> None:
    # where a flight may take them: two rims of a hanging arm as far behind each other as they were apart
    arm = held(hexagon_arm(2))
    found = hung(arm)
    crossed = found.state.positions.copy()
    lower, upper = (arm.body.rings[f"unit_2.{ring}"] for ring in ("lower", "upper"))
    crossed[upper] += 2.0 * (crossed[lower] - crossed[upper])
    result = arm.newton.solve(crossed, found.state.memory, found.loads, EXACT)
    assert result.converged
    # residuals of 1e-9 N over the lowest_mode stiffness
    assert result.positions == pytest.approx(found.state.positions, abs=1e-7)


def test_no_shift_makes_the_tangent_definite() -> None:
    result = inflated(held(hexagon_arm(2)), NewtonOptions(shift_start_N_m=1e-6, shift_max_N_m=1e-5))
    assert result.outcome is Outcome.INDEFINITE
    # 0, 1e-6 and 6e-6; 3.6e-5 is above the bound
    assert result.factorisations == 3


def test_no_descent() -> None:
    # one trial only, of a step that overshoots
    result = inflated(held(hexagon_arm(2)), NewtonOptions(halvings_max=1, step_max_m=1.0))
    assert result.outcome is Outcome.NO_DESCENT
    assert np.isfinite(result.positions).all()
    assert result.residual_N > 1e-6


def test_a_solution_is_left_as_it_is() -> None:
    arm = held(hexagon_arm(2))
    found = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    again = arm.newton.solve(found.state.positions, found.state.memory, found.loads, NewtonOptions())
    assert again.outcome is Outcome.CONVERGED
    assert again.iterations == 0
    assert (again.positions == found.state.positions).all()


def test_clamped_nodes_stay_and_carry_the_residual() -> None:
    arm = held(hexagon_arm(2))
    result = inflated(arm, NewtonOptions())
    drawn = SoftState.drawn(arm.body, HANGING)
    assert (result.positions[arm.body.base] == drawn.positions[arm.body.base]).all()
    assert np.abs(arm.film.gradient[arm.body.base]).max() > 0.01
    assert np.abs(arm.film.gradient[arm.newton.free]).max() == result.residual_N < 1e-6


@pytest.mark.parametrize(
    "loads",
    [
        {"pressure_Pa": (), "gravity": (0.0, 0.0, 40.0)},
        {"pressure_Pa": (), "cable_tension_N": (8.0, 8.0)},
        {"pressure_Pa": (PRESSURE_Pa,), "cable_tension_N": (20.0, 0.0)},
    ],
    ids=["pushed together", "pulled together", "bent"],
)
def test_films_never_cross(loads: dict[str, object]) -> None:
    # without the barrier these loads fold films through each other
    arm = held(hexagon_arm(4))
    here = hung(arm)
    for k in range(1, 6):
        share = k / 5
        here = arm.equilibrium.follow(
            here, HANGING, here.loads.interpolated(no_load(arm.body, **loads), share)
        )
        assert here.state.memory.min() > 0.0
        assert here.state.memory.max() < 2.0 * np.pi
    barrier = arm.body.hinges.fold_barrier_rad
    assert min(here.state.memory.min(), 2.0 * np.pi - here.state.memory.max()) < barrier


def test_a_kept_factorisation_gives_the_same_solution() -> None:
    arm = held(hexagon_arm(3))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    loads = no_load(arm.body, pressure_Pa=(1.01 * PRESSURE_Pa,))
    fresh = arm.newton.solve(begin.state.positions, begin.state.memory, loads, EXACT)
    kept = arm.newton.solve(begin.state.positions, begin.state.memory, loads, replace(EXACT, reuse_max=30))
    assert kept.converged
    assert kept.factorisations < fresh.factorisations
    # residuals of 1e-9 N over the lowest_mode stiffness
    assert kept.positions == pytest.approx(fresh.positions, abs=1e-7)


def test_far_from_the_solution_new_tangents_lead_where_that_is_asked_for() -> None:
    arm = held(hexagon_arm(3))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,)).state
    loads = no_load(arm.body, pressure_Pa=(1.02 * PRESSURE_Pa,))
    first, second, third = residuals(arm, begin.positions, begin.memory, 2, pressure_Pa=(1.02 * PRESSURE_Pa,))
    assert first > 2.0 * third
    near = replace(EXACT, reuse_max=30, reuse_below_N=2.0 * third)
    assert second > near.reuse_below_N
    found = arm.newton.solve(begin.positions, begin.memory, loads, near)
    assert found.converged
    assert found.factorisations == 2  # the third and fourth iteration of Newton's method proper are spared
    never = arm.newton.solve(begin.positions, begin.memory, loads, replace(near, reuse_below_N=0.0))
    assert never.factorisations == never.iterations > 2
    assert found.positions == pytest.approx(never.positions, abs=1e-7)


def test_a_kept_factorisation_turns_with_the_flange() -> None:
    # the whole problem turned by half a right angle, gravity too: no new tangent is needed
    arm = held(hexagon_arm(3))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    turn = Pose(rotation_from_vector(np.array([0.3, -0.7, 0.2])), np.zeros(3))
    loads = no_load(arm.body, pressure_Pa=(1.001 * PRESSURE_Pa,))
    arm.newton.solve(begin.state.positions, begin.state.memory, loads, EXACT, frame=HANGING.rotation)
    carried = begin.state.carried(turn)
    gx, gy, gz = (turn.rotation @ np.array(begin.loads.gravity)).tolist()
    loads = no_load(arm.body, pressure_Pa=(1.002 * PRESSURE_Pa,), gravity=(gx, gy, gz))
    result = arm.newton.solve(
        carried.positions, carried.memory, loads, replace(EXACT, reuse_max=40, tolerance_N=1e-7),
        frame=turn.rotation @ HANGING.rotation,
    )  # fmt: skip
    assert result.converged
    assert result.iterations > 0
    assert result.factorisations == 0


def test_a_start_is_accepted_by_its_own_bound_only() -> None:
    arm = held(hexagon_arm(2))
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa * (1.0 + 1e-6),))
    start = arm.newton.solve(
        begin.state.positions, begin.state.memory, loads, replace(EXACT, iterations_max=0)
    )
    assert 1e-9 < start.residual_N < 1e-4
    loose = NewtonOptions(tolerance_N=1e-3, start_tolerance_N=1e-3)
    strict = replace(loose, start_tolerance_N=0.5 * start.residual_N)
    for options, iterations in ((loose, 0), (strict, 1)):
        result = arm.newton.solve(begin.state.positions, begin.state.memory, loads, options)
        assert result.converged
        assert result.iterations == iterations


def test_small_forces_of_one_sense_are_not_left_out_of_balance() -> None:
    # 0.9 of the tolerance at each of 168 free nodes: 15 mN at the flange that are not there
    arm = held(hexagon_arm(4))
    found = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    tolerance = 1e-4
    force = np.tile([0.0, 0.9 * tolerance, 0.0], (arm.body.nodes, 1))
    options = NewtonOptions(tolerance_N=tolerance, start_tolerance_N=tolerance)
    loads = replace(found.loads, nodal_force=force)
    result = arm.newton.solve(found.state.positions, found.state.memory, loads, options)
    assert result.converged
    left = np.where(arm.newton.free, arm.film.gradient, 0.0)
    assert np.linalg.norm(left.sum(axis=0)) < 100.0 * tolerance
    assert result.iterations > 0
