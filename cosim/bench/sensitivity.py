"""`cosim.sensitivity`: how an equilibrium, or a film's motion, depends on a robot's values and loads.

A tick ends where g(x', p; x, v) = 0, inertia and losses from the state before it included. So
K dx'/dp = -dg/dp - dg/d(x, v) d(x, v)/dp,
K the tangent of the step. Both terms are one difference quotient at the same shape x', each side with the
state before moved along its own derivative (`cosim.soft.solve.sensitivity`). The flange moves as it did in
the run. A kink of the film's law within a tick, such as a wrinkle that begins, is taken as it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import numpy as np

from cosim.app.simulation import Simulation, stepped_run
from cosim.base.frames import Array, Wrench
from cosim.bench.equilibria import Output, OutputShape, Slopes, change, outputs_of, read
from cosim.bench.parameters import AnyParameter, LoadParameter, ParameterName, StaticModel, parameters_of
from cosim.build.options import dynamic_options
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.lumped_arm import SoftArm, SoftArmState
from cosim.errors import InputError, SensitivityError
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve import newton, step_begin
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
from cosim.stepping.quasistatic import QuasistaticSimulation

_TICK_N: Final = 1e-7
"""Left in a tick at most: what ticks leave acts on the state, and has no derivative."""
Asked: TypeAlias = tuple[Sequence[ParameterName], Sequence[str]]
"""Names of parameters and of outputs."""


@final
class RunSlopes:
    """Derivatives of a film's state by parameters; begins with those of the state at rest.

    Args:
        parameters: of the columns.
        model: of a film that no run uses.
        start: where the run begins, at rest.

    Raises:
        InputError: a parameter does not act, or the film's losses depend on its shape.
        SensitivityError: the state at rest has no derivative.
    """

    def __init__(self, parameters: Sequence[AnyParameter], model: StaticModel, start: SoftArmState) -> None:
        self._parameters, self._model, self._here = parameters, model, start
        self._options = dynamic_options(model.scenario)
        if any(cable.friction_coefficient or cable.remembers for cable in model.film.body.cables):
            raise InputError(
                "sensitivities in time know no losses that follow the shape or the way of a cable; set "
                "friction_coefficient = 0 and losses = 'one_way' of all cables"
            )
        self._moves = [each.moves(model) for each in parameters]
        self._solver, self._clamp = self._newton(start.clamp), start.clamp
        self._rates: dict[tuple[int, int], StrainRates | None] = {}
        shape = EquilibriumSlope(self._solver, start.clamp, _at(start))
        moved = self._moved(start)
        self._found = list(zip(moved, shape.by(moved), strict=True))
        self._shape, still = shape, np.zeros_like(start.soft.positions)
        self._states = [(slope.motion, still, still, still) for _, slope in self._found]

    def _newton(self, clamp: Clamp) -> newton.NewtonSolver:
        return newton.NewtonSolver(self._model.film, clamp.mask(self._model.film.body.nodes))

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
        return Side(0.0, 0.0, 0.0, self._model.film, here.clamp, here.loads)

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
        options, film = self._options_of(place[0], side.offset), side.film
        bed = options.bed(step_s, first=before.earlier is None)
        x, v = before.positions, before.velocities
        earlier_x, earlier_v = before.earlier or (x, v)
        along, base, target = np.zeros_like(x), np.empty_like(x), np.empty_like(x)
        if bed.share > 0.0:
            follow_flange(side.clamp.held, flange_axes(after.flange), x, earlier_x, bed, along)
        step_begin.fill_bed(x, v, earlier_x, earlier_v, along, bed, base, target)
        if place not in self._rates:
            self._rates[place] = StrainRates.of(film.body)
        rates = self._rates[place]
        if rates is not None:
            share = film.losses_at(x, side.loads, before.memory)
            film.evaluate(x, side.loads, share, before.memory, hessian=False)
            rates.fill(x, earlier_x if bed.two_steps else None, film.memory.copy(), bed.span)
        coefficient = film.body.node_mass * inertia_weight(bed.span, options.losses_per_s)
        return Inertia(coefficient, target, step_s, options.closely, rates)

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


@final
@dataclass(frozen=True, repr=False)
class Jacobian:
    """Derivatives of outputs by parameters at an equilibrium.

    Args:
        outputs: names of the rows.
        output_units: of them.
        output_values: (outputs,) [output_units], at the equilibrium.
        parameters: names of the columns.
        parameter_units: of them.
        parameter_values: (parameters,) [parameter_units], at the equilibrium.
        matrix: (outputs, parameters) [output per parameter], the derivatives.
    """

    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    output_values: Array
    parameters: tuple[str, ...]
    parameter_units: tuple[str, ...]
    parameter_values: Array
    matrix: Array

    def of(self, output: str, parameter: str) -> float:
        """Return one derivative, in the unit that `unit` says.

        Args:
            output: name of the row.
            parameter: name of the column.

        Raises:
            InputError: there is no such row or column.
        """
        for name, known in ((output, self.outputs), (parameter, self.parameters)):
            if name not in known:
                raise InputError(f"no {name!r} in the Jacobian; there are {', '.join(known)}")
        return float(self.matrix[self.outputs.index(output), self.parameters.index(parameter)])

    def unit(self, output: str, parameter: str) -> str:
        """Return the unit of a derivative, such as "m per Pa".

        Args:
            output: name of the row.
            parameter: name of the column.
        """
        rows, columns = self.outputs.index(output), self.parameters.index(parameter)
        return f"{self.output_units[rows]} per {self.parameter_units[columns]}"

    @property
    def relative(self) -> Array:
        """(outputs, parameters), change of an output, in its unit, per relative change of a parameter."""
        return np.asarray(self.matrix * self.parameter_values)

    def __repr__(self) -> str:
        """Return a line for each parameter, with the derivatives of all outputs."""
        heads = [f"{n} [{u}]" for n, u in zip(self.outputs, self.output_units, strict=True)]
        lines = [f"d({', '.join(heads)}) per unit of"]
        columns = zip(
            self.parameters, self.parameter_units, self.parameter_values, self.matrix.T, strict=True
        )
        for name, unit, value, column in columns:
            numbers = " ".join(f"{number:12.5g}" for number in column)
            lines.append(f"  {name} = {value:g} {unit}: {numbers}")
        return "\n".join(lines)


def sensitivity(
    source: str | Path | Scenario | Simulation,
    parameters: Sequence[ParameterName],
    outputs: Sequence[str],
    *,
    overrides: Mapping[str, Any] | None = None,
) -> Jacobian:
    """Return the derivatives of outputs by parameters at an equilibrium, or at the end of a run in time.

    dx/dp = -K^-1 dg/dp, one factorisation of the tangent K for all parameters. dg/dp is the difference
    quotient of the assembled forces at a fixed shape, with no solution; it and with it the result are exact
    to some 1e-8 of the column's largest entry (`cosim.soft.solve.sensitivity`). Losses along cables follow
    the shape; what presses on the film stays pressed on it, and an arm does not give way to the wrench.

    In time, the derivatives of the state at rest are carried on by those of each implicit step
    (`cosim.bench.sensitivity`); a load is then shifted alike in all ticks and at rest. A scenario is run with
    solver.dynamic_tolerance_N of at most 1e-7 N, so that what ticks leave does not count.

    Args:
        source: a simulation of fidelity "lumped" or "refined": with mode "quasistatic", taken where it is;
            with "dynamic", a new one, which is stepped to its end. Or a scenario of these kinds, by name,
            path or itself, which is run to its end.
        parameters: names of keys of the soft robot, such as "soft_robot.film.thickness_m" or
            "soft_robot.stack.ring_heights.2", or of loads that act: "pressure_Pa.CHAMBER",
            "gas_mass_kg.CHAMBER" of a sealed one, "cable_tension_N.CABLE", "cable_length_m.CABLE" where that
            is commanded; without .NAME those of all. In time also "solver.damping_per_s" and
            "solver.air_drag_per_s". A tuple of keys is one value that they share, one
            with a minus before it the opposite.
        outputs: "tip_position_m", "tip_direction", "bending_angle_rad", "length_m" (of the centre line),
            "volume_m3", "pressure_Pa", "cable_length_m" (of the route), "cable_tension_N" (at the base end),
            "frame_strain" (largest of the printed frames), "mass_kg", "flange_force_N", "flange_torque_Nm",
            "ring_position_m.RING", "node_position_m.NODE"; world axes;
            an entry alone by .x, .y, .z or the name of its chamber or cable.
        overrides: of the scenario, values by key path.

    Raises:
        InputError: there is no such parameter or output, or the source has no equilibrium of a film.
        SensitivityError: there is no derivative: a fold, a slip or the begin of a contact; in time any
            contact.
        ConvergenceError: it is not stable.
    """
    simulation = _simulation_of(source, overrides)
    run, scenario = stepped_run(simulation), simulation.scenario
    soft = run.soft
    if not isinstance(soft, SoftArm):
        raise InputError(
            f"fidelity = {scenario.fidelity!r} has no film; use fidelity = 'lumped' or 'refined'"
        )
    if isinstance(run, QuasistaticSimulation):
        return _at_rest(scenario, soft, run.equilibrium, (parameters, outputs))
    return _in_time(simulation, soft, (parameters, outputs))


def _at_rest(scenario: Scenario, soft: SoftArm, here: Equilibrium, asked: Asked) -> Jacobian:
    solver = soft.equilibrium_solver.solver
    if solver.film.slides:
        raise InputError(
            "a cable with losses = 'directed' remembers which way it has slid, so its equilibria depend on "
            "the way to them; take losses = 'one_way'"
        )
    model = StaticModel.of(scenario, solver.film)
    wanted, rows = parameters_of(asked[0], model), outputs_of(asked[1], model)
    for each in wanted:
        if each.name.startswith("solver."):
            raise InputError(f"{each.name}: acts in time alone; set mode = 'dynamic', or leave it out")
    found = Slopes(wanted, rows, model).at(solver, soft.clamp, here)
    return _jacobian(wanted, rows, _values(wanted, here.loads, model), found)


def _in_time(simulation: Simulation, soft: SoftArm, asked: Asked) -> Jacobian:
    """Run a simulation to its end, the derivatives carried on tick by tick."""
    if simulation.snapshot.tick:
        raise InputError(
            f"the simulation is at tick {simulation.snapshot.tick}; derivatives in time begin with the state "
            "at rest: pass a new simulation, or a scenario"
        )
    # apart from the run, whose next tick depends on what its film has assembled last
    model = StaticModel.of(simulation.scenario, FilmPotential(soft.body))
    wanted, rows = parameters_of(asked[0], model), outputs_of(asked[1], model)
    for row in rows:
        if row.name.startswith("flange_"):
            raise InputError(
                f"{row.name}: has no derivative in time; set mode = 'quasistatic', or leave it out"
            )
    values, slopes = _values(wanted, soft.loads, model), RunSlopes(wanted, model, soft.full_state)
    for _ in range(simulation.ticks_left):
        snapshot = simulation.step()
        if snapshot.contacts or snapshot.self_contacts:
            raise SensitivityError(
                f"tick {snapshot.tick}: the soft robot touches something, which has no derivative in time; "
                "move it away, or set contact.enabled = false and contact.self_contact = false"
            )
        slopes.tick(soft.full_state, simulation.scenario.clock.tick_s)
    return _jacobian(wanted, rows, values, slopes.read(rows))


def _values(wanted: Sequence[AnyParameter], loads: Loads, model: StaticModel) -> Array:
    count = len(model.chambers)
    return np.array([
        each.value_in(loads, count) if isinstance(each, LoadParameter) else each.value for each in wanted
    ])  # fmt: skip


def _jacobian(
    wanted: Sequence[AnyParameter], rows: Sequence[Output], values: Array, found: tuple[Array, Array]
) -> Jacobian:
    return Jacobian(
        tuple(row.name for row in rows), tuple(row.unit for row in rows), found[0],
        tuple(each.name for each in wanted), tuple(each.unit for each in wanted), values, found[1],
    )  # fmt: skip


def _simulation_of(
    source: str | Path | Scenario | Simulation, overrides: Mapping[str, Any] | None
) -> Simulation:
    if isinstance(source, Simulation):
        if overrides is not None:
            raise InputError(
                "overrides are for a scenario; branch a simulation: simulation.branch(overrides)"
            )
        return source
    scenario = load_scenario(source, overrides)
    if scenario.mode == "dynamic":
        bound_N = min(scenario.solver.dynamic_tolerance_N, _TICK_N)
        scenario = replace(scenario, solver=replace(scenario.solver, dynamic_tolerance_N=bound_N))
    simulation = Simulation(scenario)
    if scenario.mode == "quasistatic":
        simulation.step(ticks=simulation.ticks_left)
    return simulation
