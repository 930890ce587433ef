"""Parameters of an equilibrium by name: keys of the soft robot's file, and loads. For a key of the file, the
body is built again with a changed value, so every number of the file can be a parameter, if the mesh keeps
its nodes and triangles.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias, final

import numpy as np

from cosim.base.identity import content_name
from cosim.build.options import fidelity_body
from cosim.config.loading import load_scenario, to_table
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import unit_of, unit_text, unknown_name_message
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.parameter_derivatives import ParameterChange, PerturbedModel
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import StepOptions
from cosim.stepping.film_contact import film_law

_ROBOT: Final = "soft_robot."
_SOLVER: Final = ("solver.damping_per_s", "solver.air_drag_per_s")
"""Losses in time, which are no property of the soft body."""
_STEP: Final = 3e-5  # of a parameter
_DRAWN_STEP: Final = 1e-5, 1e-4  # at rest and in time, if the drawn film changes, with more rounding
_LOSSES: Final = {*_SOLVER, "soft_robot.film.loss_factor"}
_LOSS_STEP: Final = 1e-3  # forces are linear in a loss, and smaller steps only change the rounding
_ZERO_STEP: Final = 1e-8  # of a key that is 0, such as a mass, in which forces are linear
_STEPS: Final = {"cable_length_m": 1e-6}  # a cable gets taut within 0.02 mm
_SCALE: Final = {"pressure_Pa": 1e4, "cable_tension_N": 10.0, "cable_length_m": 0.01, "gas_mass_kg": 0.0}
"""Smallest reference value of a step, for parameters that are nearly 0."""

_STRAIGHT: Final = ("young_modulus_Pa", "density_kg_m3", "node_mass_kg", "stiffness_factor")
"""Keys in which forces are linear."""

Moves: TypeAlias = Callable[[Equilibrium, Clamp], ParameterChange]
"""Function of an equilibrium and its active clamp, which returns the difference quotient of a parameter."""

_CENTRAL: Final = ((-1.0, -0.5, 1.0), (1.0, 0.5, 1.0))
_FOURTH: Final = (
    (-2.0, 1.0 / 12.0, 0.0),
    (-1.0, -2.0 / 3.0, 1.0),
    (1.0, 2.0 / 3.0, 1.0),
    (2.0, -1.0 / 12.0, 0.0),
)
"""Of fourth order, for long steps, as a wrinkling film is far from linear in its drawn shape."""
_FORWARD: Final = ((0.0, -1.5, 1.0), (1.0, 2.0, -2.0), (2.0, -0.5, 1.0))
_BACKWARD: Final = ((0.0, 1.5, 1.0), (-1.0, -2.0, -2.0), (-2.0, 0.5, 1.0))
"""(offset, weight, weight in the second difference), in steps; one-sided for a value at its bound."""

ParameterName: TypeAlias = str | Sequence[str]
"""A name, or names of equal values that are one parameter."""
_OTHER: Final = {
    "pressure_Pa": "the gas is sealed: ask for gas_mass_kg",
    "cable_tension_N": "the cable's length is commanded: ask for cable_length_m",
    "cable_length_m": "the cable's tension is commanded: ask for cable_tension_N",
    "gas_mass_kg": "the pressure is given: ask for pressure_Pa",
}


@final
@dataclass(frozen=True)
class StaticModel:
    """A static model of a scenario.

    Args:
        scenario: checked.
        film: of its body.
        chambers: names of the chambers.
        cables: names of the cables.
    """

    scenario: Scenario
    film: FilmPotential
    chambers: tuple[str, ...]
    cables: tuple[str, ...]

    @classmethod
    def of(cls, scenario: Scenario, film: FilmPotential) -> "StaticModel":
        """Return the model of a scenario.

        Args:
            scenario: checked.
            film: of its body.
        """
        chambers = tuple(chamber.name for chamber in film.body.gas_chambers)
        return cls(scenario, film, chambers, tuple(scenario.soft_robot.cable_names()))


@final
@dataclass(frozen=True)
class ModelParameter:
    """A value of the soft robot's file as a parameter.

    Args:
        name: its keys.
        keys: key paths; several keys have the same value, or the opposite one with a minus before the key.
        value: present value.
    """

    name: str
    keys: tuple[str, ...]
    value: float

    @property
    def unit(self) -> str:
        """Unit for people; "1" without one."""
        return unit_text(unit_of(_last(self.keys[0]))) or "1"

    def value_in(self, _loads: Loads, _chambers: int) -> float:
        """Return its value, which does not depend on loads."""
        return self.value

    def step_options(self, options: StepOptions, offset: float) -> StepOptions:
        """Return the options of a tick with the parameter changed by an offset."""
        if self.keys[0] not in _SOLVER:
            return options
        changes: dict[str, Any] = {_last(key): self.value + offset for key in self.keys}
        return replace(options, **changes)

    def moves(self, model: StaticModel) -> Moves:
        """Return the difference quotient of the parameter, as a function of equilibrium and clamp.

        Raises:
            InputError: nodes or triangles of the mesh change with it, or no value near it is allowed.
        """
        step = _STEP * abs(self.value) if self.value else _ZERO_STEP
        if _LOSSES.issuperset(self.keys):
            step = _LOSS_STEP * (abs(self.value) or 1.0)

        def built(offset: float) -> FilmPotential:
            if not offset or self.keys[0] in _SOLVER:
                return model.film
            changed = with_values(model.scenario, shared(self.keys, self.value + offset))
            body = fidelity_body(changed)
            _check_alike(model.film.body, body, self.name)
            return FilmPotential(body)

        drawn = model.film.body
        made, in_time = _sided(built, step, self.name), model.scenario.mode == "dynamic"
        if len(made) == len(_CENTRAL) and not np.array_equal(made[0][3].body.positions, drawn.positions):
            step *= _DRAWN_STEP[in_time] / _STEP
            with suppress(InputError):  # twice the step may not be allowed
                made = _scheme(built, _FOURTH if in_time else _CENTRAL, step)
        law, straight = film_law(model.scenario), all(_last(key) in _STRAIGHT for key in self.keys)
        alike = [content_name(film.body.cables) == content_name(drawn.cables) for *_, film in made]
        held = list[Clamp]()  # clamps of the sides, then the clamp that they were made for

        def moves(here: Equilibrium, clamp: Clamp) -> ParameterChange:
            if not held or held[-1] is not clamp:
                held[:] = [*(_redrawn_clamp(clamp, drawn, film.body) for *_, film in made), clamp]
            sides = tuple(
                PerturbedModel(
                    offset, weight, bend, film, own, _redrawn_loads(own is clamp, here, film, law), same
                )
                for (offset, weight, bend, film), own, same in zip(made, held[:-1], alike, strict=True)
            )
            return ParameterChange(self.name, sides, straight)

        return moves


@final
@dataclass(frozen=True)
class LoadParameter:
    """An active load as a parameter.

    Args:
        name: kind, with the name of the chamber or cable.
        kind: pressure_Pa, cable_tension_N, cable_length_m or gas_mass_kg.
        index: of its chamber or cable.
    """

    name: str
    kind: str
    index: int

    @property
    def unit(self) -> str:
        """Unit for people."""
        return unit_text(unit_of(self.kind))

    def value_in(self, loads: Loads, chambers: int) -> float:
        """Return its value.

        Raises:
            InputError: it is not commanded.
        """
        values = _commanded(self.kind, loads, chambers)
        value = values[self.index] if values else None
        if value is None:
            raise InputError(
                f"{self.name}: is not commanded at this equilibrium, but a result; {_OTHER[self.kind]}"
            )
        return value

    def moves(self, model: StaticModel) -> Moves:
        """Return the difference quotient of the load, as a function of equilibrium and clamp."""

        def moves(here: Equilibrium, clamp: Clamp) -> ParameterChange:
            loads = here.loads
            value = self.value_in(loads, len(model.chambers))
            step = _STEPS.get(self.kind, _STEP) * max(abs(value), _SCALE[self.kind])
            made = _sided(lambda offset: self.changed(loads, value + offset, model), step, self.name)
            sides = tuple(
                PerturbedModel(offset, weight, bend, model.film, clamp, own)
                for offset, weight, bend, own in made
            )
            return ParameterChange(self.name, sides, straight=self.kind != "cable_length_m")

        return moves

    def step_options(self, options: StepOptions, offset: float) -> StepOptions:
        """Return the options of a tick, which do not depend on loads."""
        return options

    def changed(self, loads: Loads, value: float, model: StaticModel) -> Loads:
        """Return loads with another value of this one."""
        return with_load(loads, self.kind, self.index, value, len(model.chambers))


AnyParameter: TypeAlias = ModelParameter | LoadParameter


def with_load(loads: Loads, kind: str, index: int, value: float, chambers: int) -> Loads:
    """Return loads with one of them changed.

    Args:
        loads: previous loads.
        kind: of the load, see `LoadParameter`.
        index: of its chamber or cable.
        value: new value.
        chambers: number of chambers.
    """
    if kind == "gas_mass_kg":
        gas = loads.gases(chambers)
        return replace(loads, gas=_with(gas, index, _sealed(gas[index]).with_mass(value)))
    values: Any = loads.pressures(chambers) if kind == "pressure_Pa" else getattr(loads, kind)
    changed: dict[str, Any] = {kind: _with(values, index, value)}
    return replace(loads, **changed)


def _sealed(gas: Any) -> Any:
    assert gas is not None, "value_in comes before"
    return gas


def _with(values: tuple[Any, ...], index: int, value: Any) -> tuple[Any, ...]:
    return (*values[:index], value, *values[index + 1 :])


def _commanded(kind: str, loads: Loads, chambers: int) -> tuple[float | None, ...]:
    """Return the values of a kind of loads; None for each that is not commanded."""
    gases, lengths = loads.gases(chambers), loads.cable_length_m or (None,) * len(loads.cable_tension_N)
    if kind == "pressure_Pa":
        pairs = zip(gases, loads.pressures(chambers), strict=True)
        return tuple(value if gas is None else None for gas, value in pairs)
    if kind == "gas_mass_kg":
        return tuple(None if gas is None else gas.mass_kg for gas in gases)
    if kind == "cable_length_m":
        return lengths
    pulls = zip(lengths, loads.cable_tension_N, strict=True)
    return tuple(value if length is None else None for length, value in pulls)


def parameters_of(names: Sequence[ParameterName], model: StaticModel) -> list[AnyParameter]:
    """Return parameters by name; a name without chamber or cable, such as "pressure_Pa", means all of them.

    Raises:
        InputError: there is no such parameter.
    """
    return [found for name in names for found in _found(name, model)]


def _found(name: ParameterName, model: StaticModel) -> Iterator[AnyParameter]:
    keys = (name,) if isinstance(name, str) else tuple(name)
    if not keys or not all(isinstance(key, str) for key in keys):
        raise InputError(f"a parameter is {name!r}; give a name, or a list of names that are moved together")
    if all(key.removeprefix("-").startswith(_ROBOT) or key in _SOLVER for key in keys):
        values = [sign * value_at(model.scenario, key) for key, sign in shared(keys, 1.0).items()]
        if len(set(values)) > 1:
            raise InputError(
                f"{', '.join(keys)}: differ, {values}; values that are moved together must be equal"
            )
        yield ModelParameter(" = ".join(keys), keys, values[0])
        return
    if len(keys) > 1:
        raise InputError(f"{', '.join(keys)}: only keys of the soft robot are moved together")
    kind, _, of = keys[0].partition(".")
    if kind not in _SCALE:
        raise InputError(
            f"no parameter {keys[0]!r}; there are keys of the soft robot, such as "
            f"soft_robot.film.thickness_m, and {', '.join(_SCALE)}, each with .NAME of its chamber or cable"
        )
    own = "chamber" if kind in ("pressure_Pa", "gas_mass_kg") else "cable"
    known = model.chambers if own == "chamber" else model.cables
    if of and of not in known:
        raise InputError(f"{keys[0]}: {unknown_name_message(own, of, known)}")
    for index, each in enumerate(known):
        if of in ("", each):
            yield LoadParameter(f"{kind}.{each}", kind, index)


def shared(keys: Sequence[str], value: float) -> dict[str, float]:
    """Return the values of keys with a common value; a key with a minus before it has the opposite."""
    return {key.removeprefix("-"): -value if key.startswith("-") else value for key in keys}


def value_at(scenario: Scenario, key: str) -> float:
    """Return the number at a key path of a scenario; entries of a list of numbers count from 1.

    Raises:
        InputError: there is no number at the path.
    """
    here: Any = to_table(scenario)
    if isinstance(scenario.soft_robot, GivenBodyTable):
        raise InputError(f"{key}: the soft body is given as arrays, which have no keys; only its loads vary")
    for part in key.split("."):
        here = _entry(here, part)
    if isinstance(here, bool) or not isinstance(here, int | float):
        what = "is not set" if here is None else f"is {here!r:.60}"
        raise InputError(
            f"{key}: {what}; a parameter must be a number that the robot's file or scenario gives"
        )
    return float(here)


def _entry(here: Any, part: str) -> Any:
    if isinstance(here, dict):
        return here.get(part)
    if not isinstance(here, list):
        return None
    named = [entry for entry in here if isinstance(entry, dict) and entry.get("name") == part]
    if named:
        return named[0]
    return here[int(part) - 1] if part.isdecimal() and 0 < int(part) <= len(here) else None


def with_values(scenario: Scenario, values: dict[str, float]) -> Scenario:
    """Return a scenario with other numbers at some key paths.

    Raises:
        ScenarioError: the numbers are not allowed.
    """
    changes, table = dict[str, Any](), None
    for key, value in values.items():
        parent, indices = _listed(key)
        if not indices:
            changes[key] = value
            continue
        table = to_table(scenario) if table is None else table  # a list of numbers is set as a whole
        if parent not in changes:
            here: Any = table
            for part in parent.split("."):
                here = _entry(here, part)
            changes[parent] = deepcopy(here)
        entry = changes[parent]
        for index in indices[:-1]:
            entry = entry[index]
        entry[indices[-1]] = value
    return load_scenario(scenario, changes)


def _listed(key: str) -> tuple[str, list[int]]:
    """Return the path of a list, and the indices of a number in it; no indices if the key is no entry."""
    parts, indices = key.split("."), list[int]()
    while parts[-1].isdecimal():
        indices.insert(0, int(parts.pop()) - 1)
    return ".".join(parts), indices


def _last(key: str) -> str:
    return _listed(key)[0].rpartition(".")[2]


def _sided(made: Callable[[float], Any], step: float, name: str) -> list[tuple[float, float, float, Any]]:
    """Return offset, weight, second weight and model for each side of a difference quotient."""
    reason: InputError | None = None
    for scheme in (_CENTRAL, _FORWARD, _BACKWARD):
        try:
            return _scheme(made, scheme, step)
        except InputError as error:
            reason = error
    raise InputError(f"{name}: no value near it is allowed: {reason}")


def _scheme(
    made: Callable[[float], Any], scheme: Sequence[tuple[float, float, float]], step: float
) -> list[tuple[float, float, float, Any]]:
    return [(place * step, weight / step, bend, made(place * step)) for place, weight, bend in scheme]


def _check_alike(one: SoftBody, other: SoftBody, name: str) -> None:
    same = one.nodes == other.nodes and np.array_equal(one.triangles, other.triangles)
    if not same or one.memory_slices != other.memory_slices or not np.array_equal(one.base, other.base):
        raise InputError(
            f"{name}: nodes or triangles of the mesh change with it, so results are not smooth in it"
        )


def _redrawn_clamp(clamp: Clamp, drawn: SoftBody, changed: SoftBody) -> Clamp:
    """Return a clamp with the drawn positions of a changed body, for nodes that were held as drawn."""
    if np.array_equal(drawn.positions, changed.positions):
        return clamp
    as_drawn = (clamp.offsets == drawn.positions[clamp.nodes]).all(axis=1)
    offsets = np.where(as_drawn[:, None], changed.positions[clamp.nodes], clamp.offsets)
    return Clamp(clamp.nodes, offsets, clamp.components)


def _redrawn_loads(
    same: bool, here: Equilibrium, changed: FilmPotential, law: FilmContactLaw | None
) -> Loads:
    """Return loads with the self-contact areas of a changed body, unless its drawn shape is the same."""
    loads = here.loads
    if same or loads.self_contact is None or law is None:
        return loads
    pairs = SelfContact(changed.body, law).same_pairs(loads.self_contact, here.state.positions)
    return replace(loads, self_contact=pairs)
