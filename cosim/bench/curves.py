"""The model's curves on a bench: an equilibrium for every measured row, and their exact Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.outputs import Slopes, outputs_of, read_at
from cosim.bench.parameters import StaticModel, parameters_of, value_at, with_load, with_values
from cosim.build.options import dynamic_options, fidelity_body, static_options
from cosim.config.benches import BenchTable, Series
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.errors import ConvergenceError, InputError, ScenarioError
from cosim.plan.motion import pose_of
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.stepping.parts import film_law

_TOLERANCE_N: Final = 1e-8
_XYZ: Final = "xyz"


@final
class Curves:
    """The equilibria of all measured rows; each is found from the one it had at the values before.

    Attributes: `scenario`; `start`, (parameters,) where the search begins; `solved`, how many equilibria
    were found.

    Args:
        bench: checked.
        series: its curves.

    Raises:
        InputError: a parameter, load or quantity does not exist, or a start is outside its bounds.
    """

    def __init__(self, bench: BenchTable, series: Sequence[Series]) -> None:
        still = {"robot": "none", "mode": "quasistatic", "phase": [{"name": "bench", "duration_s": 1.0}]}
        self.scenario: Scenario = load_scenario(bench.scenario, {**still, **bench.set})
        self.keys = [(entry.key, *entry.also) for entry in bench.parameter]
        self.series, self.solved = tuple(series), 0
        self.start = np.array([
            value_at(self.scenario, entry.key) if entry.start is None else entry.start
            for entry in bench.parameter
        ])  # fmt: skip
        for entry, value in zip(bench.parameter, self.start.tolist(), strict=True):
            if not entry.low <= value <= entry.high:
                raise InputError(
                    f"{entry.key}: starts at {value:g}, not from {entry.low:g} (low) to {entry.high:g} (high)"
                )
        self._states = [dict[int, Equilibrium]() for _ in series]
        self._arm, self._model = self._built(self.start)
        self._rows = [
            [_loads(curve, row, self._model, self.scenario.gravity_m_s2) for row in range(len(curve.values))]
            for curve in self.series
        ]
        for curve in self.series:
            if len(outputs_of([curve.table.quantity], self._model)) != 1:
                raise ScenarioError(
                    f"series.{curve.table.name}.quantity", "means several numbers; name one, such as by .z"
                )

    def at(self, values: Array) -> Array:
        """Return the model's values (rows,) of all series.

        Raises:
            ConvergenceError: a row has no equilibrium.
        """
        self._arm, self._model = self._built(values)
        solver, clamp, found = self._arm.equilibrium_solver.solver, self._arm.clamp, []
        for number, entry in enumerate(self.series):
            outputs = outputs_of([entry.table.quantity], self._model)
            for row in range(len(entry.values)):
                place = f"series.{entry.table.name}, row {row + 1}"
                try:
                    with self._arm.effort.search(place):
                        here = self._equilibrium(number, row)
                except ConvergenceError as error:
                    raise error.at(place) from None
                found.append(read_at(outputs, solver.system, clamp, here)[0])
        return np.array(found)

    def jacobian(self, quantities: Sequence[str] = ()) -> Array:
        """Return the derivatives (rows, parameters) where `at` was called last; of other quantities if named.

        Args:
            quantities: of all rows, one for each instead of its own; (quantities, rows, parameters).
        """
        model = self._model
        parameters = parameters_of(self.keys, model)
        names = list(quantities) or list(dict.fromkeys(entry.table.quantity for entry in self.series))
        slopes, found = Slopes(parameters, outputs_of(names, model), model), []
        for number, entry in enumerate(self.series):
            for row in range(len(entry.values)):
                here = self._states[number][row]
                _, matrix = slopes.at(self._arm.equilibrium_solver.solver, self._arm.clamp, here)
                found.append(matrix if quantities else matrix[names.index(entry.table.quantity)])
        rows = np.array(found)
        return np.moveaxis(rows, 1, 0) if quantities else rows

    def _built(self, values: Array) -> tuple[SoftArm, StaticModel]:
        pairs = zip(self.keys, values.tolist(), strict=True)
        scenario = with_values(self.scenario, {key: value for keys, value in pairs for key in keys})
        statics = replace(static_options(scenario), tolerance_N=_TOLERANCE_N, start_tolerance_N=_TOLERANCE_N)
        flange = pose_of(scenario.start.flange)
        arm = SoftArm(fidelity_body(scenario), flange, statics, dynamic_options(scenario), film_law(scenario))
        return arm, StaticModel.of(scenario, arm.equilibrium_solver.solver.system)

    def _equilibrium(self, number: int, row: int) -> Equilibrium:
        """Find the equilibrium of a row: from its last one, that of the row before, or the start."""
        solver, loads = self._arm.equilibrium_solver, self._rows[number][row]
        flange, known = pose_of(self.scenario.start.flange), self._states[number]
        self.solved += 1
        try:
            if row not in known:
                raise ConvergenceError("", 0.0, 0)
            found = solver.solve(known[row].state, flange, loads)
        except ConvergenceError:
            before = known.get(row - 1) if row else None
            if before is None:
                drawn = SoftState.drawn(self._arm.body, flange)
                before = solver.hang(drawn, flange, loads.gravity)
            lengths = (None,) * len(loads.cable_tension_N) if loads.cable_length_m else ()
            if not before.loads.cable_length_m and lengths:
                before = replace(before, loads=replace(before.loads, cable_length_m=lengths))
            found = solver.follow(before, flange, loads)
        known[row] = found
        return found


def _loads(series: Series, row: int, model: StaticModel, gravity: tuple[float, float, float]) -> Loads:
    """Return what acts in a row of a series.

    Raises:
        ScenarioError: there is no such load.
    """
    chambers, cables, body = len(model.chambers), len(model.cables), model.system.body
    loads = Loads((0.0,) * chambers, (0.0,) * cables, gravity)
    for name, values in series.loads.items():
        kind, _, of = name.partition(".")
        key = f"series.{series.table.name}.loads.{name}"
        if kind == "force_N":
            ring, _, axis = of.rpartition(".")
            if ring not in body.rings or axis not in tuple(_XYZ):
                rings = ", ".join(body.rings)
                raise ScenarioError(key, f"names no ring and axis; give force_N.RING.x; rings are {rings}")
            force = np.zeros((body.nodes, 3)) if loads.nodal_force is None else loads.nodal_force
            force[body.rings[ring], _XYZ.index(axis)] += values[row] / len(body.rings[ring])
            loads = replace(loads, nodal_force=force)
            continue
        known = model.chambers if kind == "pressure_Pa" else model.cables
        if kind not in ("pressure_Pa", "cable_tension_N", "cable_length_m") or (of and of not in known):
            raise ScenarioError(
                key, "is no load; there are pressure_Pa, cable_tension_N.CABLE, cable_length_m.CABLE and "
                f"force_N.RING.x; chambers: {', '.join(model.chambers)}; cables: {', '.join(model.cables)}",
            )  # fmt: skip
        if kind == "cable_length_m" and not loads.cable_length_m:
            loads = replace(loads, cable_length_m=(None,) * cables)
        for place, each in enumerate(known):
            if of in ("", each):
                loads = with_load(loads, kind, place, values[row], chambers)
    return loads
