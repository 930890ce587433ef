"""Derivatives of the motion of a film by parameters, tick by tick. A tick ends at g(x', p; x, v) = 0, where g
includes inertia and losses from the state before. So K dx'/dp = -dg/dp - dg/d(x, v) d(x, v)/dp with the
tangent K of the step. Both terms are one difference quotient at the same shape x'; each of its sides starts
from the state before, moved along its own derivative (`cosim.soft.solve.sensitivity`). The motion of the
flange does not depend on the parameters. A kink of the film's law within a tick, such as a wrinkle that
begins, is not treated.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.bench.outputs import Output, OutputShape, change, read
from cosim.bench.parameters import AnyParameter, StaticModel
from cosim.build.options import dynamic_options
from cosim.coupling.robots.film_robot import FilmRobotState
from cosim.errors import InputError, SensitivityError
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve import newton, step_prediction
from cosim.soft.solve.clamp import Clamp, fill_flange_velocity, flange_axes
from cosim.soft.solve.parameter_derivatives import EquilibriumDerivatives, ParameterChange, PerturbedModel
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.solve.step_scheme import StepOptions, inertia_weight


class _StateSlope(NamedTuple):
    """Derivative of a film's state by a parameter, per unit of it.

    Args:
        positions: (n, 3) [m].
        velocities: (n, 3) [m/s].
        earlier_positions: (n, 3) [m], one step before.
        earlier_velocities: (n, 3) [m/s], one step before.
    """

    positions: Array
    velocities: Array
    earlier_positions: Array
    earlier_velocities: Array


@final
class RunSlopes:
    """Derivatives of a film's state by parameters, from the state at rest on.

    Args:
        parameters: columns of the Jacobian.
        model: of a film that no run uses.
        start: initial state of the run, at rest.

    Raises:
        InputError: a parameter does not act, or the film's losses depend on its shape.
        SensitivityError: the state at rest has no derivative.
    """

    def __init__(self, parameters: Sequence[AnyParameter], model: StaticModel, start: FilmRobotState) -> None:
        self._parameters, self._model, self._here = parameters, model, start
        self._options = dynamic_options(model.scenario)
        if any(cable.friction_coefficient or cable.remembers for cable in model.film.body.cables):
            raise InputError(
                "derivatives in time do not include losses that depend on the shape or the sliding direction "
                "of a cable; set friction_coefficient = 0 and losses = 'one_way' for all cables"
            )
        self._moves = [each.moves(model) for each in parameters]
        self._solver, self._clamp = self._newton(start.clamp), start.clamp
        self._rates: dict[tuple[int, int], StrainRates | None] = {}
        shape = EquilibriumDerivatives(self._solver, start.clamp, _at(start))
        moved = self._moved(start)
        self._found = list(zip(moved, shape.by(moved), strict=True))
        self._shape, still = shape, np.zeros_like(start.soft.positions)
        self._states = [_StateSlope(slope.motion, still, still, still) for _, slope in self._found]

    def _newton(self, clamp: Clamp) -> newton.NewtonSolver:
        return newton.NewtonSolver(self._model.film, clamp.mask(self._model.film.body.nodes))

    def _moved(self, here: FilmRobotState) -> list[ParameterChange]:
        return [moves(_at(here), here.clamp) for moves in self._moves]

    def tick(self, after: FilmRobotState, step_s: float) -> None:
        """Update the derivatives for a tick.

        Args:
            after: state at the end of the tick.
            step_s: length of the tick [s].

        Raises:
            SensitivityError: the tick has no derivative: there is contact, or it was divided into substeps.
        """
        before, earlier = self._here.soft, after.soft.earlier
        if earlier is None or not np.array_equal(earlier[0], before.positions):
            raise SensitivityError(
                "a tick was divided into substeps, which have no derivative; set a smaller clock.tick_s"
            )
        if after.soft.touching is not None:
            raise SensitivityError(
                "films press on one another, which has no derivative in time: contact.self_contact = false"
            )
        if not after.clamp.holds_as(self._clamp):
            self._solver, self._clamp = self._newton(after.clamp), after.clamp
        own = self._inertia(-1, 0, self._own_side(after), before, after, step_s)
        self._shape = EquilibriumDerivatives(self._solver, after.clamp, _at(after), kinks=True, inertia=own)
        coefficients = self._options.coefficients(step_s, first=before.earlier is None)
        moved = self._moved(after)
        for k, each in enumerate(moved):
            begins = [_moved(before, self._states[k], side.offset) for side in each.sides]
            sides = tuple(
                side._replace(inertia=self._inertia(k, j, side, begin, after, step_s))
                for j, (side, begin) in enumerate(zip(each.sides, begins, strict=True))
            )
            moved[k] = each._replace(sides=sides)
        states, self._found = self._states, list(zip(moved, self._shape.by(moved), strict=True))
        self._here, self._states = after, []
        for (x, v, earlier_x, _), (_, slope) in zip(states, self._found, strict=True):
            base = (4.0 * x - earlier_x) / 3.0 if coefficients.two_steps else x
            rate = (slope.motion - base) / coefficients.span
            self._states.append(_StateSlope(slope.motion, rate, x, v))

    def read(self, outputs: Sequence[Output]) -> tuple[Array, Array]:
        """Return outputs (m,), and their Jacobian (m, parameters), at the end of the last tick."""
        flange, positions = self._here.flange, self._here.soft.positions
        values = read(
            outputs, OutputShape(self._own_side(self._here), positions, self._shape.gradient, flange)
        )
        columns = [change(outputs, self._shape, each, slope, flange) for each, slope in self._found]
        return values, np.stack(columns, axis=1) if columns else np.zeros((len(values), 0))

    def _own_side(self, here: FilmRobotState) -> PerturbedModel:
        return PerturbedModel(0.0, 0.0, 0.0, self._model.film, here.clamp, here.loads)

    def _inertia(
        self,
        parameter: int,
        side_index: int,
        side: PerturbedModel,
        before: SoftState,
        after: FilmRobotState,
        step_s: float,
    ) -> Inertia:
        """Return inertia and losses of a tick, for one side of a difference quotient.

        Args:
            parameter: index of the parameter; -1 for the unchanged model.
            side_index: index of the side.
            side: of the difference quotient.
            before: state at the beginning of the tick, on that side.
            after: state at the end of the tick.
            step_s: h [s].
        """
        options, film = self._options_of(parameter, side.offset), side.film
        coefficients = options.coefficients(step_s, first=before.earlier is None)
        x, v = before.positions, before.velocities
        earlier_x, earlier_v = before.earlier or (x, v)
        along, base, target = np.zeros_like(x), np.empty_like(x), np.empty_like(x)
        if coefficients.alpha_s > 0.0:
            fill_flange_velocity(
                side.clamp.held, flange_axes(after.flange), x, earlier_x, coefficients, along
            )
        step_prediction.fill_inertia_target(x, v, earlier_x, earlier_v, along, coefficients, base, target)
        if (parameter, side_index) not in self._rates:
            self._rates[parameter, side_index] = StrainRates.of(film.body)
        rates = self._rates[parameter, side_index]
        if rates is not None:
            losses = film.losses_at(x, side.loads, before.memory)
            film.evaluate(x, side.loads, losses, before.memory, hessian=False)
            rates.fill(
                x, earlier_x if coefficients.two_steps else None, film.memory.copy(), coefficients.span
            )
        coefficient = film.body.node_mass * inertia_weight(coefficients.span, options.losses_per_s)
        return Inertia(coefficient, target, step_s, options.closely, rates)

    def _options_of(self, number: int, offset: float) -> StepOptions:
        if number < 0:
            return self._options
        return self._parameters[number].step_options(self._options, offset)


def _at(here: FilmRobotState) -> Equilibrium:
    return Equilibrium(here.soft, here.flange, here.loads, Wrench(), here.residual_N, 0, 0.0, 0)


def _moved(state: SoftState, slope: _StateSlope, offset: float) -> SoftState:
    """Return a state whose parameter is changed by an offset, to first order."""
    x = np.ascontiguousarray(state.positions + offset * slope.positions)
    v = np.ascontiguousarray(state.velocities + offset * slope.velocities)
    if state.earlier is None:
        return replace(state, positions=x, velocities=v)
    earlier_x, earlier_v = state.earlier
    earlier = earlier_x + offset * slope.earlier_positions, earlier_v + offset * slope.earlier_velocities
    return replace(state, positions=x, velocities=v, earlier=earlier)
