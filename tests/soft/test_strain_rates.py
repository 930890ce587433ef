"""Losses of the film's material: what they are, in all that a step does, and what they leave alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates, hinge_times
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.solve.branching import MODES
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.stability import assess_stability, material_losses
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import Integrator, StepOptions, mode_decay
from cosim.soft.solve.time_step import Stepper
from tests.derivatives import RELATIVE, dense, derivative_errors, differences
from tests.soft.bodies import FILM, HANGING, Held, PRESSURE_Pa, held, hexagon_arm, hung, no_load, shapes
from tests.soft.test_dynamics import INTEGRATORS, TIGHT, X, swung

LAWS: dict[str, dict[str, Any]] = {
    "plain": {},
    "wrinkling": {"law": "wrinkling", "wrinkle_panel_m": 0.03},
    "tension_field": {"law": "tension_field", "compressive_fraction": 1e-4},
    "edge_strain": {"law": "edge_strain"},
}
NOTHING = Loads((), (), (0.0, 0.0, 0.0))
STEP_S = 1e-3


def lossy(body: SoftBody, loss_factor: float = 0.05, frequency_Hz: float = 2.0, **law: Any) -> SoftBody:
    """Return a body whose film has a loss factor."""
    changes = {"loss_factor": loss_factor, "loss_frequency_Hz": frequency_Hz, **law}
    films = (replace(each, film=replace(each.film, **changes)) for each in body.membranes)
    return body.with_other(Membranes, *films)


class Resisting:
    """What a body resists rates with in a step from a shape, as the sum of all its terms has it."""

    def __init__(self, body: SoftBody, x: Array, earlier: Array | None, span: float = STEP_S) -> None:
        self.film, found = FilmPotential(body), StrainRates.of(body)
        assert found is not None
        self.rates = found
        self.rates.begin(np.ascontiguousarray(x), earlier, span)
        self._loads, self._memory = no_load(body, gravity=(0.0, 0.0, 0.0)), body.first_memory()
        self._memory[found.angles] = dihedral_angle(x, found.hinges)
        self._share = self.film.losses_at(x, self._loads)
        self._bed = Inertia(np.zeros(body.nodes), np.zeros((body.nodes, 3)), span)

    def of(self, x: Array) -> tuple[float, Array, Array]:
        """Return potential, gradient and Hessian of what resists alone."""
        found = []
        for rates in (self.rates, None):
            bed, at = replace(self._bed, rates=rates), np.ascontiguousarray(x)
            energy = self.film.evaluate(at, self._loads, self._share, self._memory, inertia=bed)
            blocks = dense(self.film.pattern, self.film.blocks)
            found.append((energy, self.film.gradient.copy(), blocks))
        return found[0][0] - found[1][0], found[0][1] - found[1][1], found[0][2] - found[1][2]

    def gradient(self, x: Array) -> Array:
        """Return the same gradient as it is summed without a Hessian, which takes another way."""
        found = []
        for rates in (self.rates, None):
            bed, at = replace(self._bed, rates=rates), np.ascontiguousarray(x)
            self.film.evaluate(at, self._loads, self._share, self._memory, inertia=bed, hessian=False)
            found.append(self.film.gradient.copy())
        return np.asarray(found[0] - found[1])


@pytest.mark.parametrize("two_steps", [False, True])
@pytest.mark.parametrize("law", LAWS)
def test_derivatives(law: str, two_steps: bool) -> None:
    body, random = lossy(hexagon_arm(1), **LAWS[law]), np.random.default_rng(0)
    x = shapes(1)["inflated"]
    earlier, end = (x + 1e-3 * random.normal(size=x.shape) for _ in range(2))
    resisting = Resisting(body, x, earlier if two_steps else None)
    assert max(derivative_errors(resisting.of, end, 5e-6)) < RELATIVE
    assert resisting.rates.potential(end) == pytest.approx(resisting.of(end)[0], rel=1e-9)
    gradient = resisting.of(end)[1]
    assert resisting.gradient(end) == pytest.approx(gradient, abs=1e-12 * np.abs(gradient).max())


@pytest.mark.parametrize("law", LAWS)
def test_rigid_motion_is_not_resisted(law: str) -> None:
    body, x = lossy(hexagon_arm(2), **LAWS[law]), shapes(2)["inflated"]
    way = [Pose(rotation_from_vector(k * np.array([0.3, -0.2, 0.9])), k * X) for k in range(3)]
    before, here, there = (np.ascontiguousarray(pose.apply(x)) for pose in way)
    # strains are known to rounding of places a metre away, on edges of a centimetre
    rounding = 1e-12 * FILM.young_modulus_Pa * FILM.thickness_m
    for earlier in (None, before):
        assert np.abs(Resisting(body, here, earlier).gradient(there)).max() < rounding
    assert np.abs(Resisting(body, here, None).gradient(there * 1.001)).max() > 1e6 * rounding


@pytest.mark.parametrize("law", LAWS)
def test_no_step_gives_energy_or_momentum(law: str) -> None:
    body, random = lossy(hexagon_arm(1), **LAWS[law]), np.random.default_rng(1)
    x, rates = shapes(1)["inflated"], Resisting(body, shapes(1)["inflated"], None).rates
    for k in range(2000):
        earlier, here, end = (x + 10.0 ** random.uniform(-6, -3) * random.normal(size=x.shape) for _ in "abc")
        rates.begin(here, earlier if k % 2 else None, STEP_S)
        assert rates.potential(end) > 0.0
    force = Resisting(body, here, earlier).gradient(end)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * size
    assert np.abs(np.cross(end, force).sum(axis=0)).max() < 1e-13 * size * np.abs(end).max()


@pytest.mark.parametrize("loss_factor", [0.02, 0.4])
def test_a_cycle_loses_what_the_loss_factor_says(loss_factor: float) -> None:
    # of strains that swing at its frequency: 2 pi tan delta times the largest elastic energy
    frequency, ticks = 2.0, 400
    body = lossy(hexagon_arm(1), loss_factor, frequency)
    system, motion = FilmPotential(body), np.random.default_rng(2).normal(size=(body.nodes, 3))
    h, lost = 1.0 / (frequency * ticks), 0.0
    x = [body.positions + 1e-7 * np.sin(2.0 * np.pi * k / ticks) * motion for k in range(-2, ticks)]
    rates = Resisting(body, x[0], None).rates
    for earlier, here, end in zip(x[:-2], x[1:-1], x[2:], strict=True):
        rates.begin(here, earlier, 2.0 * h / 3.0)
        lost += h * 2.0 * rates.potential(end) / (2.0 * h / 3.0)
    loads = no_load(body, gravity=(0.0, 0.0, 0.0))
    furthest = body.positions + 1e-7 * motion
    held_energy = system.evaluate(
        furthest, loads, system.losses_at(furthest, loads), body.first_memory(), hessian=False
    )
    assert lost == pytest.approx(2.0 * np.pi * loss_factor * held_energy, rel=1e-3)


def test_hinges_lose_as_the_films_beside_them_do() -> None:
    body = hexagon_arm(1)
    (film,) = body.membranes
    parts = [
        replace(
            film, triangles=film.triangles[rows], shape_gradients=film.shape_gradients[rows],
            areas=film.areas[rows], wrinkle_panel_m=film.wrinkle_panel_m[rows],
            film=replace(film.film, loss_factor=loss_factor),
        )
        for rows, loss_factor in ((slice(0, None, 2), 0.1), (slice(1, None, 2), 0.3))
    ]  # fmt: skip
    times = hinge_times(body.with_other(Membranes, *parts), body.hinges.nodes)
    found = np.unique(times.round(12) * 2.0 * np.pi)
    assert found == pytest.approx([0.1, 0.2, 0.3], abs=1e-9)
    assert hinge_times(lossy(body), body.hinges.nodes) == pytest.approx(0.05 / (4.0 * np.pi))


def test_statics_and_free_flight_know_no_losses() -> None:
    plain, arm = held(hexagon_arm(2)), held(lossy(hexagon_arm(2)))
    there, here = (hung(each, pressure_Pa=(PRESSURE_Pa,)) for each in (plain, arm))
    assert np.array_equal(here.state.positions, there.state.positions)
    free = held(lossy(hexagon_arm(1, base=())))
    drawn, speed = free.body.positions, np.array([1.0, 0.2, -0.5])
    state = SoftState(drawn.copy(), np.tile(speed, (len(drawn), 1)), free.body.first_memory())
    move = stepper(free, "bdf2")
    for _ in range(20):
        state, _ = move.step(state, Pose(), NOTHING, 0.002)
    assert state.velocities == pytest.approx(np.tile(speed, (len(drawn), 1)), abs=1e-8)


def stepper(arm: Held, integrator: Integrator, **changes: Any) -> Stepper:
    given = {"tolerance_N": 1e-8, "iterations": 50, "residual_bound_N": 0.0, "newton": TIGHT, **changes}
    return Stepper(arm.newton, arm.clamp, StepOptions(integrator, **given))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_steady_motion_feels_weight_alone(integrator: Integrator) -> None:
    arm, h, speed = held(lossy(hexagon_arm(2), 0.2)), 0.002, 0.25
    begin = hung(arm, pressure_Pa=(PRESSURE_Pa,))
    move = stepper(arm, integrator)
    state = replace(begin.state, velocities=np.tile(speed * X, (arm.body.nodes, 1)))
    for k in range(1, 31):
        flange = Pose(HANGING.rotation, HANGING.translation + speed * k * h * X)
        state, _ = move.step(state, flange, begin.loads, h)
    assert move.wrench(state, flange).force == pytest.approx(begin.wrench.force, abs=1e-6)
    still = begin.state.positions + (flange.translation - HANGING.translation)
    assert state.positions == pytest.approx(still, abs=1e-8)


def test_order_of_convergence() -> None:
    arm = held(lossy(hexagon_arm(2)))
    start = hung(arm, pressure_Pa=(PRESSURE_Pa,)).state
    exact = swung(arm, start, "bdf2", 1920)
    errors = [np.abs(swung(arm, start, "bdf2", n) - exact).max() for n in (240, 480)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)
    without = swung(held(hexagon_arm(2)), start, "bdf2", 480)
    assert np.abs(without - exact).max() > 10.0 * errors[1]


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_modes_decay_as_the_complex_eigenvalues_say(integrator: Integrator) -> None:
    arm, h = held(lossy(hexagon_arm(2), 0.03)), 0.00025
    begin, mass = hung(arm, pressure_Pa=(PRESSURE_Pa,)), np.repeat(arm.body.node_mass, 3)
    x, free = begin.state.positions, arm.newton.free
    weights, share = mass[free.ravel()], arm.film.losses_at(x, begin.loads)

    def gradient(at: Array) -> Array:
        arm.film.evaluate(at, begin.loads, share, begin.state.memory, hessian=False)
        return arm.film.gradient[free]

    resisting = Resisting(arm.body, x, None, 1.0)
    tangent, damping = (
        differences(function, x, 1e-7)[free.ravel()]
        for function in (gradient, lambda at: resisting.gradient(at)[free])
    )
    none, one = np.zeros_like(tangent), np.eye(len(tangent))
    whole = np.block([[none, one], [-tangent / weights[:, None], -damping / weights[:, None]]])
    values, vectors = np.linalg.eig(whole)
    lowest = np.flatnonzero(values.imag > 1.0)
    lowest = lowest[np.argsort(np.abs(values[lowest]))][:MODES]
    tested = NewtonSolver(arm.film, arm.newton.clamped, symmetric=True)
    found = assess_stability(tested, begin.state, begin.loads, HANGING.rotation)
    for k, frequency, own in zip(lowest, found.frequencies_Hz, found.losses_per_s, strict=True):
        declared, numerical = mode_decay(integrator, h, 0.0, frequency, own)
        assert declared == pytest.approx(-values[k].real, rel=0.02)
        mode, rate = np.zeros((2, *x.shape)), np.zeros((2, *x.shape))
        vector = vectors[: len(weights), k]
        vector = vector / vector[np.argmax(np.abs(vector))]
        mode[0][free], mode[1][free] = vector.real, vector.imag
        rate[0][free] = (values[k] * vector).real
        state, move = begin.state, stepper(arm, integrator)
        state = replace(state, positions=x + 1e-6 * mode[0], velocities=1e-6 * rate[0])
        ringing = []
        for _ in range(80):
            state, _ = move.step(state, HANGING, begin.loads, h)
            ringing.append(float(mass @ (mode[0] * (state.positions - x)).ravel()))
        q = np.array(ringing[10:])  # by then what a two-step scheme begins with is gone
        (a, b), *_ = np.linalg.lstsq(np.column_stack([q[1:-1], q[:-2]]), q[2:], rcond=None)
        assert -0.5 * np.log(-b) / h == pytest.approx(-values[k].real + numerical, rel=0.02)
        assert np.arccos(0.5 * a / np.sqrt(-b)) / h == pytest.approx(values[k].imag, rel=0.02)


def test_a_film_without_loss_factor_has_none() -> None:
    arm = held(hexagon_arm(1))
    assert StrainRates.of(arm.body) is None
    assert material_losses(arm.film, arm.body.positions, np.ones((2, arm.body.nodes, 3))) == (0.0, 0.0)
    for wrong in ({"loss_factor": -0.1}, {"loss_factor": np.inf}, {"loss_frequency_Hz": 0.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            Film(1e9, 0.3, 1e-4, **wrong)
