"""The function `cosim.sensitivity`: derivatives of quantities by a robot's values and loads, at an
equilibrium or at the end of a run in time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim.app.simulation import Simulation, stepped_run
from cosim.base.frames import Array
from cosim.bench.outputs import Output, Slopes, outputs_of
from cosim.bench.parameters import AnyParameter, ParameterName, StaticModel, parameters_of
from cosim.bench.run_slopes import RunSlopes
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError, SensitivityError
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.state import Equilibrium
from cosim.stepping.quasistatic import QuasistaticSimulation

_TICK_N: Final = 1e-7
"""Largest residual of a tick; residuals change the state, and have no derivative."""


@final
@dataclass(frozen=True, repr=False)
class Jacobian:
    """Derivatives of outputs by parameters at an equilibrium.

    Args:
        outputs: names of the rows.
        output_units: units of the outputs.
        output_values: (outputs,) [output_units], at the equilibrium.
        parameters: names of the columns.
        parameter_units: units of the parameters.
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
        """Return one derivative, in the unit that `unit` returns.

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
    """Return the derivatives of outputs by parameters, at an equilibrium or at the end of a run in time.

    At an equilibrium, dx/dp = -K^-1 dg/dp, with one factorisation of the tangent K for all parameters. dg/dp
    is a difference quotient of the assembled forces at a fixed shape. The result is exact to some 1e-8 of the
    column's largest entry (`cosim.soft.solve.sensitivity`). Losses along cables depend on the shape. Contacts
    on the film remain closed, and the arm does not yield to the wrench.

    In time, the derivatives start from the state at rest and are updated in each implicit step
    (`cosim.bench.run_slopes`). The derivative by a load is that of equal changes at rest and in all ticks. A
    scenario runs with solver.dynamic_tolerance_N of at most 1e-7 N, so that residuals of ticks do not matter.

    Args:
        source: a simulation with fidelity "lumped" or "refined". With mode "quasistatic", it is used in its
            present state; with "dynamic" it must be new, and is stepped to its end. Or a scenario of these
            kinds, by name, path or as an object, which is run to its end.
        parameters: names of keys of the soft robot, such as "soft_robot.film.thickness_m" or
            "soft_robot.stack.ring_heights.2", or of active loads: "pressure_Pa.CHAMBER",
            "gas_mass_kg.CHAMBER" of a sealed chamber, "cable_tension_N.CABLE", or "cable_length_m.CABLE" if
            the length is commanded; without .NAME, of all chambers or cables. In time also
            "solver.damping_per_s" and "solver.air_drag_per_s". A tuple of keys is one parameter with the same
            value for each key, or the opposite value for a key with a minus before it.
        outputs: "tip_position_m", "tip_direction", "bending_angle_rad", "length_m" (of the centre line),
            "volume_m3", "pressure_Pa", "cable_length_m" (of the route), "cable_tension_N" (at the base end),
            "frame_strain" (largest of the printed frames), "mass_kg", "flange_force_N", "flange_torque_Nm",
            "ring_position_m.RING", "node_position_m.NODE"; in world axes. A single entry has .x, .y, .z or
            the name of its chamber or cable appended.
        overrides: values of the scenario by key path.

    Raises:
        InputError: there is no such parameter or output, or the source has no equilibrium of a film.
        SensitivityError: there is no derivative: at a fold, a slip or the beginning of a contact; in time at
            any contact.
        ConvergenceError: the equilibrium is not stable.
    """
    simulation = _simulation_of(source, overrides)
    run, scenario = stepped_run(simulation), simulation.scenario
    soft = run.soft
    if not isinstance(soft, FilmRobot):
        raise InputError(
            f"fidelity = {scenario.fidelity!r} has no film; use fidelity = 'lumped' or 'refined'"
        )
    if isinstance(run, QuasistaticSimulation):
        return _at_rest(scenario, soft, run.equilibrium, parameters, outputs)
    return _in_time(simulation, soft, parameters, outputs)


def _at_rest(
    scenario: Scenario,
    soft: FilmRobot,
    here: Equilibrium,
    parameters: Sequence[ParameterName],
    outputs: Sequence[str],
) -> Jacobian:
    solver = soft.equilibrium_solver.solver
    if solver.film.slides:
        raise InputError(
            "a cable with losses = 'directed' has equilibria that depend on its previous sliding; use "
            "losses = 'one_way'"
        )
    model = StaticModel.of(scenario, solver.film)
    wanted, rows = parameters_of(parameters, model), outputs_of(outputs, model)
    for each in wanted:
        if each.name.startswith("solver."):
            raise InputError(
                f"{each.name}: has an effect only in time; set mode = 'dynamic', or leave it out"
            )
    values, matrix = Slopes(wanted, rows, model).at(solver, soft.clamp, here)
    return _jacobian(wanted, _values(wanted, here.loads, model), rows, values, matrix)


def _in_time(
    simulation: Simulation, soft: FilmRobot, parameters: Sequence[ParameterName], outputs: Sequence[str]
) -> Jacobian:
    """Run a simulation to its end, and update the derivatives tick by tick."""
    if simulation.snapshot.tick:
        raise InputError(
            f"the simulation is at tick {simulation.snapshot.tick}; derivatives in time begin with the state "
            "at rest: pass a new simulation, or a scenario"
        )
    # a separate film, as the next tick of the run depends on the last assembly of its film
    model = StaticModel.of(simulation.scenario, FilmPotential(soft.body))
    wanted, rows = parameters_of(parameters, model), outputs_of(outputs, model)
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
    return _jacobian(wanted, values, rows, *slopes.read(rows))


def _values(wanted: Sequence[AnyParameter], loads: Loads, model: StaticModel) -> Array:
    return np.array([each.value_in(loads, len(model.chambers)) for each in wanted])


def _jacobian(
    parameters: Sequence[AnyParameter],
    parameter_values: Array,
    outputs: Sequence[Output],
    output_values: Array,
    matrix: Array,
) -> Jacobian:
    """Return the Jacobian with the names and units of its rows and columns."""
    return Jacobian(
        tuple(output.name for output in outputs), tuple(output.unit for output in outputs), output_values,
        tuple(each.name for each in parameters), tuple(each.unit for each in parameters), parameter_values,
        matrix,
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
