"""Equilibria under rows of loads as a robot's values change, their exact Jacobian, and a bench's curves.

Quantities of an equilibrium have names: what is measured on a bench, and what a Jacobian is of.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.bench import parameters
from cosim.bench.parameters import AnyParameter, Moves, StaticModel
from cosim.build.options import dynamic_options, fidelity_body, static_options
from cosim.config.benches import BenchTable, FreeTable, Series
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import unit_of, unit_text, unknown_name_message
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.errors import ConvergenceError, InputError, ScenarioError
from cosim.plan.flange_motion import pose_of
from cosim.soft.beams.beam_rings import stiffener_strain
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import center_line_length, center_rings
from cosim.soft.elements.cable import base_tension
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import newton
from cosim.soft.solve.sensitivity import EquilibriumSlope, Moved, Side, Slope
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState
from cosim.stepping.parts import film_law

_XYZ: Final = "xyz"
_LINEAR: Final = "tip_position_m"
"""A mean of positions, so that its derivative is its value at dx/dp, as of places."""
_PLACES: Final = ("ring_position_m", "node_position_m")
_TOLERANCE_N: Final = 1e-8
_ROBOT: Final = "soft_robot."
_STILL: Final[dict[str, Any]] = {
    "robot": "none", "mode": "quasistatic", "phase": [{"name": "bench", "duration_s": 1.0}]
}  # fmt: skip


class OutputShape(NamedTuple):
    """A shape that quantities are read from.

    Args:
        side: the model and its loads.
        positions: (n, 3) [m], world.
        gradient: (n, 3) [N], of the potential there.
        flange: world from flange.
    """

    side: Side
    positions: Array
    gradient: Array
    flange: Pose


def _tip(shape: OutputShape) -> Array:
    return shape.side.film.body.tip_position(shape.positions)


def _direction(shape: OutputShape) -> Array:
    return shape.side.film.body.tip_direction(shape.positions)


def _bending(shape: OutputShape) -> Array:
    axis, direction = shape.flange.rotation[:, 2], _direction(shape)
    return np.array([np.arctan2(np.linalg.norm(np.cross(axis, direction)), axis @ direction)])


def _length(shape: OutputShape) -> Array:
    body = shape.side.film.body
    return np.array([center_line_length(center_rings(body), shape.positions)])


def _volumes(shape: OutputShape) -> Array:
    return np.asarray(shape.side.film.gas.enclosed_volumes(shape.positions[None])[0])


def _pressures(shape: OutputShape) -> Array:
    return np.array(shape.side.loads.pressures_at(tuple(_volumes(shape).tolist())))


def _routes(shape: OutputShape) -> Array:
    return np.array([cable.length(shape.positions) for cable in shape.side.film.body.cables])


def _tensions(shape: OutputShape) -> Array:
    cables, loads = shape.side.film.body.cables, shape.side.loads
    lengths = loads.cable_length_m or (None,) * len(cables)
    given = zip(cables, lengths, loads.cable_tension_N, strict=True)
    return np.array([
        pull if length is None else base_tension(cable, shape.positions, length)
        for cable, length, pull in given
    ])  # fmt: skip


def _wrench(shape: OutputShape) -> Array:
    wrench = shape.side.clamp.wrench(shape.gradient, shape.positions, shape.flange)
    return np.concatenate([wrench.force, wrench.torque])


def _frame_strain(shape: OutputShape) -> Array:
    found = stiffener_strain(shape.side.film.body, shape.positions)
    if found is None:
        raise InputError("frame_strain: the soft robot has no printed frames")
    return np.array([found.peak])


Read: TypeAlias = Callable[[OutputShape], Array]

_READ: Final[dict[str, tuple[str, Read]]] = {
    "tip_position_m": ("xyz", _tip),
    "tip_direction": ("xyz", _direction),
    "bending_angle_rad": ("", _bending),
    "length_m": ("", _length),
    "volume_m3": ("chamber", _volumes),
    "pressure_Pa": ("chamber", _pressures),
    "cable_length_m": ("cable", _routes),
    "cable_tension_N": ("cable", _tensions),
    "frame_strain": ("", _frame_strain),
    "mass_kg": ("", lambda shape: np.array([shape.side.film.body.node_mass.sum()])),
    "flange_force_N": ("xyz", lambda shape: _wrench(shape)[:3]),
    "flange_torque_Nm": ("xyz", lambda shape: _wrench(shape)[3:]),
}
"""By name, what the entries are of, and how they are read."""


@final
@dataclass(frozen=True)
class Output:
    """A number that is read from an equilibrium.

    Args:
        name: of it.
        read: returns an array that it is in.
        place: in that array.
        linear: whether it is linear in the positions, and depends on nothing else.
    """

    name: str
    read: Read
    place: int
    linear: bool = False

    @property
    def unit(self) -> str:
        """As people write it; "1" without one."""
        return unit_text(unit_of(self.name.partition(".")[0])) or "1"


def outputs_of(names: Sequence[str], model: StaticModel) -> list[Output]:
    """Return outputs by name; a name without the last part means all its entries.

    Raises:
        InputError: there is no such output.
    """
    return [found for name in names for found in _found(name, model)]


def read(outputs: Sequence[Output], shape: OutputShape) -> Array:
    """Return the values (outputs,) at a shape."""
    arrays = {output.read: output.read(shape) for output in outputs}
    return np.array([arrays[output.read][output.place] for output in outputs])


def read_at(outputs: Sequence[Output], film: FilmPotential, clamp: Clamp, here: Equilibrium) -> Array:
    """Return the values (outputs,) at an equilibrium."""
    x, memory = np.array(here.state.positions, order="C"), film.fresh(here.state.memory)
    film.evaluate(x, here.loads, film.losses_at(x, here.loads, memory), memory, hessian=False)
    side = Side(0.0, 0.0, 0.0, film, clamp, here.loads)
    return read(outputs, OutputShape(side, x, film.gradient.copy(), here.world_from_flange))


def _found(name: str, model: StaticModel) -> Iterator[Output]:
    kind, _, of = name.partition(".")
    if kind in _PLACES:
        yield from _of_nodes(kind, of, model)
        return
    if kind not in _READ:
        raise InputError(
            f"no output {name!r}; there are {', '.join((*_READ, *_PLACES))}, those of a place with .NAME, "
            "vectors with .x, .y or .z"
        )
    what, reader = _READ[kind]
    known = {"xyz": tuple(_XYZ), "chamber": model.chambers, "cable": model.cables, "": ("",)}[what]
    if of and of not in known:
        raise InputError(f"{name}: {unknown_name_message(what or 'entry', of, known)}")
    for place, each in enumerate(known):
        if of in ("", each):
            yield Output(f"{kind}.{each}" if each else kind, reader, place, kind == _LINEAR)


def _of_nodes(kind: str, of: str, model: StaticModel) -> Iterator[Output]:
    body, axis = model.film.body, of[-1:] if of[-2:-1] == "." and of[-1:] in _XYZ else ""
    place = of[:-2] if axis else of
    if kind == "ring_position_m":
        if place not in body.rings:
            raise InputError(f"{kind}.{of}: {unknown_name_message('ring', place, tuple(body.rings))}")
        nodes = body.rings[place]
    else:
        if not place.isdecimal() or int(place) >= body.nodes:
            raise InputError(f"{kind}.{of}: no node {place!r}; there are 0 to {body.nodes - 1}")
        nodes = np.array([int(place)])

    def mean(shape: OutputShape) -> Array:
        return np.asarray(shape.positions[nodes].mean(axis=0))

    for k, each in enumerate(_XYZ):
        if axis in ("", each):
            yield Output(f"{kind}.{place}.{each}", mean, k, linear=True)


def change(
    outputs: Sequence[Output], slopes: EquilibriumSlope, moved: Moved, slope: Slope, flange: Pose
) -> Array:
    """Return the derivatives (outputs,) by a parameter.

    Args:
        outputs: of them.
        slopes: of the equilibrium.
        moved: the parameter.
        slope: by it.
        flange: world from flange.
    """
    if all(output.linear for output in outputs):
        return read(outputs, OutputShape(slopes.own, slope.motion, slope.quotient, flange))
    found = np.zeros(len(outputs))
    for side in moved.sides:
        found += side.weight * read(outputs, OutputShape(side, *slopes.moved(side, slope), flange))
    return found


@final
class Slopes:
    """Jacobians of the same outputs by the same parameters, at any equilibria of one model.

    Args:
        parameters: of the columns.
        outputs: of the rows.
        model: that has both.
        kinks: see `EquilibriumSlope`.
    """

    def __init__(
        self,
        parameters: Sequence[AnyParameter],
        outputs: Sequence[Output],
        model: StaticModel,
        *,
        kinks: bool = False,
    ) -> None:
        self._kinks, self._outputs = kinks, outputs
        self._moves: list[Moves] = [each.moves(model) for each in parameters]

    def at(
        self, solver: newton.NewtonSolver, clamp: Clamp, here: Equilibrium, only: Sequence[int] | None = None
    ) -> tuple[Array, Array]:
        """Return the outputs (m,), and their Jacobian (m, parameters), at an equilibrium.

        Args:
            solver: for the body with the clamp in force.
            clamp: in force.
            here: the equilibrium.
            only: of some parameters, by their places; of all unless given.
        """
        slopes, flange = EquilibriumSlope(solver, clamp, here, kinks=self._kinks), here.world_from_flange
        moved = [self._moves[k](here, clamp) for k in (range(len(self._moves)) if only is None else only)]
        found = read(self._outputs, OutputShape(slopes.own, here.state.positions, slopes.gradient, flange))
        columns = [
            change(self._outputs, slopes, each, slope, flange)
            for each, slope in zip(moved, slopes.by(moved), strict=True)
        ]
        return found, np.stack(columns, axis=1) if columns else np.zeros((len(found), 0))


@final
@dataclass(frozen=True)
class LoadRow:
    """What acts in an equilibrium.

    Args:
        key: of it in its file, for messages about loads.
        place: of it, for messages about solutions.
        group: of rows that follow one another.
        loads: values by load; a name is that of a parameter.
    """

    key: str
    place: str
    group: str
    loads: Mapping[str, float | str]


def bench_scenario(scenario: str, changes: Mapping[str, Any]) -> Scenario:
    """Return the scenario whose soft robot, flange, gravity and contact equilibria are of."""
    return load_scenario(scenario, {**_STILL, **changes})


@final
class Equilibria:
    """Equilibria of rows of loads; each is found from the one it had at the values before.

    Attributes: `scenario`; `keys` of each parameter; `start`, (parameters,) where the search begins;
    `solved`, how many equilibria were found.

    Args:
        scenario: of `bench_scenario`.
        unknowns: the parameters.
        rows: loads.

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
        """Find all equilibria at some values (parameters,).

        Raises:
            ConvergenceError: a row has none.
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
        """Return outputs (rows, outputs) where `solve` has been called last."""
        outputs, film = outputs_of(names, self.model), self._arm.equilibrium_solver.solver.film
        states = [self._states[number] for number in range(len(self.rows))]
        return np.array([read_at(outputs, film, self._arm.clamp, here) for here in states])

    def jacobian(self, names: Sequence[str], *, kinks: bool = False) -> Array:
        """Return the derivatives (rows, outputs, parameters) of outputs there.

        Args:
            names: of the outputs.
            kinks: see `EquilibriumSlope`.
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

    def _built(self, values: Array) -> tuple[SoftArm, parameters.StaticModel]:
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
        arm = SoftArm(fidelity_body(scenario), flange, statics, dynamic_options(scenario), film_law(scenario))
        return arm, parameters.StaticModel.of(scenario, arm.equilibrium_solver.solver.film)

    def _equilibrium(self, number: int) -> Equilibrium:
        """Find the equilibrium of a row: from its last one, that of the row before, or the start."""
        solver, loads, row = self._arm.equilibrium_solver, self._acting[number], self.rows[number]
        flange, known = pose_of(self.scenario.start.flange), self._states
        self.solved += 1
        try:
            if number not in known:
                raise ConvergenceError("", 0.0, 0)
            return solver.solve(known[number].state, flange, loads)
        except ConvergenceError:
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
        """Return the loads of a row that parameters give, with the parameters' places."""
        place = {self.keys[k][0]: k for k in range(len(self.keys)) if k not in self._robot}
        found = []
        for name, value in row.loads.items():
            if isinstance(value, str):
                if name.startswith("force_N"):
                    raise ScenarioError(f"{row.key}.{name}", "is a force, which no parameter moves")
                found += [
                    (each, place[value])
                    for each in parameters.parameters_of([name], self.model)
                    if isinstance(each, parameters.LoadParameter)
                ]
        return found

    def _loads(self, row: LoadRow) -> Loads:
        """Return what acts in a row.

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
                if ring not in body.rings or axis not in tuple(_XYZ):
                    rings = ", ".join(body.rings)
                    raise ScenarioError(
                        key, f"names no ring and axis; give force_N.RING.x; rings are {rings}"
                    )
                force = np.zeros((body.nodes, 3)) if loads.nodal_force is None else loads.nodal_force
                force[body.rings[ring], _XYZ.index(axis)] += value / len(body.rings[ring])
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
    """The model's values of all measured rows.

    Attributes: `rows`, their equilibria.

    Args:
        bench: checked.
        series: its curves.

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
        """Return the derivatives (rows, parameters) where `at` was called last; of other quantities if named.

        At a kink of the forces, as where film begins to wrinkle, they are those across it.

        Args:
            quantities: of all rows, one for each instead of its own; (quantities, rows, parameters).
        """
        if quantities:
            return np.moveaxis(self.rows.jacobian(quantities, kinks=True), 1, 0)
        return np.asarray(self.rows.jacobian(self._names, kinks=True)[self._own])
