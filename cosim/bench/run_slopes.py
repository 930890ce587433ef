"""How a film's motion depends on parameters, carried on tick by tick: the derivative of its implicit steps.

A tick ends where g(x', p; x, v) = 0, inertia and losses from the state before it included. So
K dx'/dp = -dg/dp - dg/d(x, v) d(x, v)/dp,
K the tangent of the step. Both terms are one difference quotient at the same shape x', each side with the
state before moved along its own derivative (`cosim.soft.solve.sensitivity`). The flange moves as it did in
the run. A kink of the film's law within a tick, such as a wrinkle that begins, is taken as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.bench.outputs import Output, OutputShape, change, read
from cosim.bench.parameters import AnyParameter, StaticModel
from cosim.build.options import dynamic_options
from cosim.coupling.soft_sides.lumped_arm import SoftArmState
from cosim.errors import InputError, SensitivityError
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.sensitivity import EquilibriumSlope, Moved, Side
from cosim.soft.solve.state import (
    Clamp,
    Equilibrium,
    SoftState,
    StepOptions,
    flange_axes,
    follow_flange,
    inertia_weight,
)
from cosim.soft.solve.step_begin import fill_bed


@final
class RunSlopes:
    """Derivatives of a film's state by parameters; begins with those of the state at rest.

    Args:
        parameters: of the columns.
        model: of a system that no run uses.
        start: where the run begins, at rest.

    Raises:
        InputError: a parameter does not act, or the film's losses depend on its shape.
        SensitivityError: the state at rest has no derivative.
    """

    def __init__(self, parameters: Sequence[AnyParameter], model: StaticModel, start: SoftArmState) -> None:
        self._parameters, self._model, self._here = parameters, model, start
        self._options = dynamic_options(model.scenario)
        if any(cable.friction_coefficient or cable.remembers for cable in model.system.body.cables):
            raise InputError(
                "sensitivities in time know no losses that follow the shape or the way of a cable; set "
                "friction_coefficient = 0 and losses = 'one_way' of all cables"
            )
        if self._options.substep_error_m is not None:
            raise InputError("sensitivities in time are of whole ticks; leave out solver.substep_error_m")
        self._moves = [each.moves(model) for each in parameters]
        self._solver, self._clamp = self._newton(start.clamp), start.clamp
        self._rates: dict[tuple[int, int], StrainRates | None] = {}
        shape = EquilibriumSlope(self._solver, start.clamp, _at(start))
        moved = self._moved(start)
        self._found = list(zip(moved, shape.by(moved), strict=True))
        self._shape, still = shape, np.zeros_like(start.soft.positions)
        self._states = [(slope.motion, still, still, still) for _, slope in self._found]

    def _newton(self, clamp: Clamp) -> NewtonSolver:
        return NewtonSolver(self._model.system, clamp.mask(self._model.system.body.nodes))

    def _moved(self, here: SoftArmState) -> list[Moved]:
        return [moves(_at(here), here.clamp) for moves in self._moves]

    def tick(self, after: SoftArmState, step_s: float) -> None:
        """Carry the derivatives on over a tick.

        Args:
            after: where it has ended.
            step_s: its length [s].

        Raises:
            SensitivityError: it has no derivative: something touches, or it was taken in halves.
        """
        before, earlier = self._here.soft, after.soft.earlier
        if earlier is None or not np.array_equal(earlier[0], before.positions):
            raise SensitivityError(
                "a tick was taken in halves, which has no derivative; set a smaller clock.tick_s"
            )
        if after.soft.touching is not None:
            raise SensitivityError(
                "films press on one another, which has no derivative in time: contact.self_contact = false"
            )
        if not after.clamp.holds_as(self._clamp):
            self._solver, self._clamp = self._newton(after.clamp), after.clamp
        own = self._inertia((-1, 0), self._own_side(after), before, after, step_s)
        self._shape = EquilibriumSlope(self._solver, after.clamp, _at(after), kinks=True, inertia=own)
        bed = self._options.bed(step_s, first=before.earlier is None)
        moved = self._moved(after)
        for k, each in enumerate(moved):
            begins = [_moved(before, self._states[k], side.offset) for side in each.sides]
            sides = tuple(
                side._replace(inertia=self._inertia((k, j), side, begin, after, step_s))
                for j, (side, begin) in enumerate(zip(each.sides, begins, strict=True))
            )
            moved[k] = each._replace(sides=sides)
        states, self._found = self._states, list(zip(moved, self._shape.by(moved), strict=True))
        self._here, self._states = after, []
        for (x, v, earlier_x, _), (_, slope) in zip(states, self._found, strict=True):
            base = (4.0 * x - earlier_x) / 3.0 if bed.two_steps else x
            self._states.append((slope.motion, (slope.motion - base) / bed.span, x, v))

    def read(self, outputs: Sequence[Output]) -> tuple[Array, Array]:
        """Return outputs (m,), and their Jacobian (m, parameters), where the last tick has ended."""
        flange, positions = self._here.flange, self._here.soft.positions
        values = read(
            outputs, OutputShape(self._own_side(self._here), positions, self._shape.gradient, flange)
        )
        columns = [change(outputs, self._shape, each, slope, flange) for each, slope in self._found]
        return values, np.stack(columns, axis=1) if columns else np.zeros((len(values), 0))

    def _own_side(self, here: SoftArmState) -> Side:
        return Side(0.0, 0.0, 0.0, self._model.system, here.clamp, here.loads)

    def _inertia(
        self, place: tuple[int, int], side: Side, before: SoftState, after: SoftArmState, step_s: float
    ) -> Inertia:
        """Return inertia and losses of a tick on a side.

        Args:
            place: of the parameter and of the side.
            side: whose.
            before: state where the tick begins, on that side.
            after: where it ends.
            step_s: h [s].
        """
        options, system = self._options_of(place[0], side.offset), side.system
        bed = options.bed(step_s, first=before.earlier is None)
        x, v = before.positions, before.velocities
        earlier_x, earlier_v = before.earlier or (x, v)
        along, base, target = np.zeros_like(x), np.empty_like(x), np.empty_like(x)
        if bed.share > 0.0:
            follow_flange(side.clamp.held, flange_axes(after.flange), x, earlier_x, bed, along)
        fill_bed(x, v, earlier_x, earlier_v, along, bed, base, target)
        if place not in self._rates:
            self._rates[place] = StrainRates.of(system.body, system.film)
        rates = self._rates[place]
        if rates is not None:
            share = system.segment_share(x, side.loads, before.memory)
            system.evaluate(x, side.loads, share, before.memory, hessian=False)
            rates.fill(x, earlier_x if bed.two_steps else None, system.memory.copy(), bed.span)
        coefficient = system.body.node_mass * inertia_weight(bed.span, options.losses_per_s)
        return Inertia(coefficient, target, step_s, options.closely, 0 if rates is None else rates.address)

    def _options_of(self, number: int, offset: float) -> StepOptions:
        if number < 0:
            return self._options
        return self._parameters[number].step_options(self._options, offset)


def _at(here: SoftArmState) -> Equilibrium:
    return Equilibrium(here.soft, here.flange, here.loads, Wrench(), here.residual_N, 0, 0.0, 0)


def _moved(state: SoftState, slopes: tuple[Array, Array, Array, Array], offset: float) -> SoftState:
    """Return a state moved along its derivatives: positions, velocities, and both one step before."""
    here, earlier = (state.positions, state.velocities), state.earlier
    x, v = (np.ascontiguousarray(one + offset * each) for one, each in zip(here, slopes[:2], strict=True))
    if earlier is None:
        return replace(state, positions=x, velocities=v)
    first, second = (one + offset * each for one, each in zip(earlier, slopes[2:], strict=True))
    return replace(state, positions=x, velocities=v, earlier=(first, second))
