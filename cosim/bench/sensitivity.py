"""`cosim.sensitivity`: how an equilibrium depends on the robot's values and on its loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from cosim.app.simulation import Simulation, stepped_run
from cosim.base.frames import Array
from cosim.bench.outputs import Slopes, outputs_of
from cosim.bench.parameters import ParameterName, StaticModel, parameters_of
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.errors import InputError
from cosim.stepping.quasistatic import QuasistaticSimulation


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
    """Return the derivatives of outputs by parameters at a static equilibrium; the flange stays.

    dx/dp = -K^-1 dg/dp, one factorisation of the tangent K for all parameters. dg/dp is the difference
    quotient of the assembled forces at a fixed shape, with no solution; it and with it the result are exact
    to some 1e-8 of the column's largest entry (`cosim.soft.solve.sensitivity`). Losses along cables follow
    the shape; what presses on the film stays pressed on it, and an arm does not give way to the wrench.

    Args:
        source: a simulation with mode "quasistatic" and fidelity "lumped" or "refined", taken where it is; or
            a scenario of that kind, by name, path or itself, which is run to its end.
        parameters: names of keys of the soft robot, such as "soft_robot.film.thickness_m" or
            "soft_robot.stack.ring_heights.2", or of loads that act: "pressure_Pa.CHAMBER",
            "gas_mass_kg.CHAMBER" of a sealed one, "cable_tension_N.CABLE", "cable_length_m.CABLE" where that
            is commanded; without .NAME those of all. A tuple of keys is one value that they share.
        outputs: "tip_position_m", "tip_direction", "bending_angle_rad", "length_m" (of the centre line),
            "volume_m3", "pressure_Pa", "cable_length_m" (of the route), "cable_tension_N" (at the base end),
            "frame_strain" (largest of the printed frames), "mass_kg", "flange_force_N", "flange_torque_Nm",
            "ring_position_m.RING", "node_position_m.NODE"; world axes;
            an entry alone by .x, .y, .z or the name of its chamber or cable.
        overrides: of the scenario, values by key path.

    Raises:
        InputError: there is no such parameter or output, or the source has no equilibrium of a film.
        SensitivityError: the equilibrium has no derivative: a fold, a slip or the begin of a contact.
        ConvergenceError: it is not stable.
    """
    simulation = _simulation_of(source, overrides)
    run, scenario = stepped_run(simulation), simulation.scenario
    if not isinstance(run, QuasistaticSimulation):
        raise InputError("sensitivities are of equilibria: set mode = 'quasistatic'")
    here, soft = run.equilibrium, run.soft
    if not isinstance(soft, SoftArm):
        raise InputError(
            f"fidelity = {scenario.fidelity!r} has no film; take fidelity = 'lumped' or 'refined'"
        )
    solver = soft.equilibrium_solver.solver
    if solver.system.slides:
        raise InputError(
            "a cable with losses = 'directed' remembers which way it has slid, so its equilibria depend on "
            "the way to them; take losses = 'one_way'"
        )
    model = StaticModel.of(scenario, solver.system)
    wanted, rows = parameters_of(parameters, model), outputs_of(outputs, model)
    values = [
        each.value_in(here.loads, len(model.chambers)) if hasattr(each, "value_in") else each.value
        for each in wanted
    ]
    slopes = Slopes(wanted, rows, model)
    found, matrix = slopes.at(solver, soft.clamp, here)
    return Jacobian(
        tuple(row.name for row in rows), tuple(row.unit for row in rows), found,
        tuple(each.name for each in wanted), tuple(each.unit for each in wanted), np.array(values), matrix,
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
    simulation = Simulation(source, overrides=overrides)
    if simulation.stage.mode == "quasistatic":
        simulation.step(ticks=simulation.ticks_left)
    return simulation
