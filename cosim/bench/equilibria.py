"""Equilibria of a soft robot under rows of loads, as functions of the robot's values, with exact Jacobians.
The curves of a bench are such rows. Each equilibrium is found by continuation from that of the previous
values.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.bench import parameters
from cosim.bench.outputs import XYZ, Slopes, outputs_of, read_at
from cosim.build.options import dynamic_options, fidelity_body, static_options
from cosim.config.benches import BenchTable, FreeTable, Series
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import ConvergenceError, InputError, ScenarioError
from cosim.plan.flange_motion import pose_of
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.stepping.film_contact import film_law

_TOLERANCE_N: Final = 1e-8
_ROBOT: Final = "soft_robot."
_STILL: Final[dict[str, Any]] = {
    "robot": "none", "mode": "quasistatic", "phase": [{"name": "bench", "duration_s": 1.0}]
}  # fmt: skip


@final
@dataclass(frozen=True)
class LoadRow:
    """The loads of one equilibrium.

    Args:
        key: key path in its file, for messages about loads.
        place: series and row, for messages about solutions.
        group: name of rows whose equilibria follow from one another.
        loads: values by load; a text is the name of a parameter.
    """

    key: str
    place: str
    group: str
    loads: Mapping[str, float | str]


def bench_scenario(scenario: str, changes: Mapping[str, Any]) -> Scenario:
    """Return the scenario with soft robot, flange, gravity and contact of the equilibria."""
    return load_scenario(scenario, {**_STILL, **changes})


@final
class Equilibria:
    """Equilibria under rows of loads; each is found from that of the previous values.

    Attributes: `scenario`; `keys` of each parameter; `start`, initial values (parameters,) of a search;
    `solved`, number of equilibria so far.

    Args:
        scenario: of `bench_scenario`.
        unknowns: parameters.
        rows: rows of loads.

    Raises:
        InputError: a parameter or load does not exist, or a start is outside its bounds.
    """

    def __init__(self, scenario: Scenario, unknowns: Sequence[FreeTable], rows: Sequence[LoadRow]) -> None:
        self.scenario, self.rows, self.solved = scenario, tuple(rows), 0
        self.keys = [(entry.key, *entry.also) for entry in unknowns]
        self._robot = [k for k, keys in enumerate(self.keys) if keys[0].startswith(_ROBOT)]
        self.start = np.array([self._start(entry) for entry in unknowns])
        used = {value for row in rows for value in row.loads.values() if isinstance(value, str)}
        names = {self.keys[k][0] for k in range(len(self.keys)) if k not in self._robot}
        for name in used ^ names:
            raise InputError(
                f"{name}: is {'a parameter that no load names' if name in names else 'no parameter'}; "
                f"a parameter is a key of the soft robot, or a name that a load has in place of a number"
            )
        self._values = self.start
        self._states: dict[int, Equilibrium] = {}
        self._arm, self.model = self._built(self.start)
        self._acting = [self._loads(row) for row in self.rows]

    def _start(self, entry: FreeTable) -> float:
        if entry.start is not None:
            value = entry.start
        elif entry.key.startswith(_ROBOT):
            value = parameters.value_at(self.scenario, entry.key)
        else:
            raise InputError(f"{entry.key}: needs a start, as no file has a value of it")
        if not entry.low <= value <= entry.high:
            raise InputError(
                f"{entry.key}: starts at {value:g}, not from {entry.low:g} (low) to {entry.high:g} (high)"
            )
        return value

    def solve(self, values: Array) -> None:
        """Find the equilibria of all rows at some values (parameters,).

        Raises:
            ConvergenceError: a row has no equilibrium.
        """
        before, self._values = self._arm.body, values
        self._arm, self.model = self._built(values)
        if not np.array_equal(before.triangles, self._arm.body.triangles):
            self._states.clear()  # of another mesh
        self._acting = [self._loads(row) for row in self.rows]
        for number, row in enumerate(self.rows):
            try:
                with self._arm.effort.search(row.place):
                    self._states[number] = self._equilibrium(number)
            except ConvergenceError as error:
                raise error.at(row.place) from None

    def read(self, names: Sequence[str]) -> Array:
        """Return outputs (rows, outputs) at the values of the last `solve`."""
        outputs, film = outputs_of(names, self.model), self._arm.equilibrium_solver.solver.film
        states = [self._states[number] for number in range(len(self.rows))]
        return np.array([read_at(outputs, film, self._arm.clamp, here) for here in states])

    def jacobian(self, names: Sequence[str], *, kinks: bool = False) -> Array:
        """Return the derivatives (rows, outputs, parameters) of outputs at the values of the last `solve`.

        Args:
            names: names of the outputs.
            kinks: see `EquilibriumDerivatives`.
        """
        model, outputs = self.model, outputs_of(names, self.model)
        robot = parameters.parameters_of([self.keys[k] for k in self._robot], model)
        acting = [list(self._free(row)) for row in self.rows]
        loads = list(dict.fromkeys(each for row in acting for each, _ in row))
        columns: list[parameters.AnyParameter] = [*robot, *loads]
        slopes, found = Slopes(columns, outputs, model, kinks=kinks), []
        solver, clamp = self._arm.equilibrium_solver.solver, self._arm.clamp
        for number, row in enumerate(acting):
            own = [*range(len(robot)), *(len(robot) + loads.index(each) for each, _ in row)]
            _, matrix = slopes.at(solver, clamp, self._states[number], own)
            whole = np.zeros((len(outputs), len(self.keys)))
            whole[:, self._robot] = matrix[:, : len(robot)]
            for (_, place), column in zip(row, matrix[:, len(robot) :].T, strict=True):
                whole[:, place] += column
            found.append(whole)
        return np.array(found)

    def _built(self, values: Array) -> tuple[FilmRobot, parameters.StaticModel]:
        changes = dict[str, float]()
        for k in self._robot:
            changes |= parameters.shared(self.keys[k], float(values[k]))
        try:
            scenario = parameters.with_values(self.scenario, changes)
        except ScenarioError as error:
            (path, problem), *further = error.faults
            tried = ", ".join(f"{self.keys[k][0]} = {values[k]:g}" for k in self._robot)
            problem = f"{problem}; this was tried: {tried}; narrow low and high of the parameters"
            raise ScenarioError(path, problem, tuple(further)) from None
        statics = replace(static_options(scenario), tolerance_N=_TOLERANCE_N, start_tolerance_N=_TOLERANCE_N)
        flange = pose_of(scenario.start.flange)
        arm = FilmRobot(
            fidelity_body(scenario), flange, statics, dynamic_options(scenario), film_law(scenario)
        )
        return arm, parameters.StaticModel.of(scenario, arm.equilibrium_solver.solver.film)

    def _equilibrium(self, number: int) -> Equilibrium:
        """Find the equilibrium of a row: from its last one, that of the row before, or the start."""
        solver, loads, row = self._arm.equilibrium_solver, self._acting[number], self.rows[number]
        flange, known = pose_of(self.scenario.start.flange), self._states
        self.solved += 1
        if number in known:
            with suppress(ConvergenceError):
                return solver.solve(known[number].state, flange, loads)
        follows = number > 0 and self.rows[number - 1].group == row.group
        before = known.get(number - 1) if follows else None
        if before is None:
            drawn = SoftState.drawn(self._arm.body, flange)
            before = solver.hang(drawn, flange, loads.gravity)
        lengths = (None,) * len(loads.cable_tension_N) if loads.cable_length_m else ()
        if not before.loads.cable_length_m and lengths:
            before = replace(before, loads=replace(before.loads, cable_length_m=lengths))
        return solver.follow(before, flange, loads)

    def _free(self, row: LoadRow) -> list[tuple[parameters.LoadParameter, int]]:
        """Return the loads of a row that are parameters, with the indices of the parameters."""
        indices = {self.keys[k][0]: k for k in range(len(self.keys)) if k not in self._robot}
        loads = []
        for name, value in row.loads.items():
            if isinstance(value, str):
                if name.startswith("force_N"):
                    raise ScenarioError(f"{row.key}.{name}", "is a force, which cannot be a parameter")
                loads += [
                    (each, indices[value])
                    for each in parameters.parameters_of([name], self.model)
                    if isinstance(each, parameters.LoadParameter)
                ]
        return loads

    def _loads(self, row: LoadRow) -> Loads:
        """Return the loads of a row.

        Raises:
            ScenarioError: there is no such load.
        """
        model = self.model
        chambers, cables, body = len(model.chambers), len(model.cables), model.film.body
        loads = Loads((0.0,) * chambers, (0.0,) * cables, self.scenario.gravity_m_s2)
        given = {keys[0]: float(value) for keys, value in zip(self.keys, self._values, strict=True)}
        for name, what in row.loads.items():
            value = given[what] if isinstance(what, str) else what
            kind, _, of = name.partition(".")
            key = f"{row.key}.{name}"
            if kind == "force_N":
                ring, _, axis = of.rpartition(".")
                if ring not in body.rings or axis not in tuple(XYZ):
                    rings = ", ".join(body.rings)
                    raise ScenarioError(
                        key, f"names no ring and axis; give force_N.RING.x; rings are {rings}"
                    )
                force = np.zeros((body.nodes, 3)) if loads.nodal_force is None else loads.nodal_force
                force[body.rings[ring], XYZ.index(axis)] += value / len(body.rings[ring])
                loads = replace(loads, nodal_force=force)
                continue
            known = model.chambers if kind == "pressure_Pa" else model.cables
            if kind not in ("pressure_Pa", "cable_tension_N", "cable_length_m") or (of and of not in known):
                raise ScenarioError(
                    key, "is no load; there are pressure_Pa, cable_tension_N.CABLE, cable_length_m.CABLE and "
                    f"force_N.RING.x; chambers: {', '.join(model.chambers)}; "
                    f"cables: {', '.join(model.cables)}",
                )  # fmt: skip
            if kind == "cable_length_m" and not loads.cable_length_m:
                loads = replace(loads, cable_length_m=(None,) * cables)
            for place, each in enumerate(known):
                if of in ("", each):
                    loads = parameters.with_load(loads, kind, place, value, chambers)
        return loads


@final
class Curves:
    """Curves of the model in the rows of a bench.

    Attributes: `rows`, their equilibria.

    Args:
        bench: checked table.
        series: measured curves of the bench.

    Raises:
        InputError: a parameter, load or quantity does not exist, or a start is outside its bounds.
    """

    def __init__(self, bench: BenchTable, series: Sequence[Series]) -> None:
        rows = [
            LoadRow(
                f"series.{entry.table.name}.loads", f"series.{entry.table.name}, row {row + 1}",
                entry.table.name, {name: values[row] for name, values in entry.loads.items()},
            )
            for entry in series for row in range(len(entry.values))
        ]  # fmt: skip
        self.rows = Equilibria(bench_scenario(bench.scenario, bench.set), bench.parameter, rows)
        self._names = list(dict.fromkeys(entry.table.quantity for entry in series))
        own = [self._names.index(entry.table.quantity) for entry in series for _ in entry.values]
        self._own = np.arange(len(rows)), np.array(own)
        for entry in series:
            if len(outputs_of([entry.table.quantity], self.rows.model)) != 1:
                raise ScenarioError(
                    f"series.{entry.table.name}.quantity", "means several numbers; name one, such as by .z"
                )

    def at(self, values: Array) -> Array:
        """Return the model's values (rows,) of all series.

        Raises:
            ConvergenceError: a row has no equilibrium.
        """
        self.rows.solve(values)
        return np.asarray(self.rows.read(self._names)[self._own])

    def jacobian(self, quantities: Sequence[str] = ()) -> Array:
        """Return the derivatives (rows, parameters) at the values of the last `at`.

        At a kink of the forces, such as the beginning of a wrinkle, they are difference quotients across it.

        Args:
            quantities: other quantities, instead of that of each series; the result is then (quantities,
                rows, parameters).
        """
        if quantities:
            return np.moveaxis(self.rows.jacobian(quantities, kinks=True), 1, 0)
        return np.asarray(self.rows.jacobian(self._names, kinks=True)[self._own])
