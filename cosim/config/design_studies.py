"""Design studies: which values of a robot may change, what is wanted of it, and what bounds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, final

from annotated_types import Interval, Len

from cosim.base.resources import is_file, list_scenarios
from cosim.config.benches import FreeTable
from cosim.config.studies import flat
from cosim.config.toml.keys import Name, Text, unknown_name_message
from cosim.config.toml.parsing import parse
from cosim.config.toml.reading import Fault, Faults, Told, check, copy_with, read_table, rule
from cosim.errors import InputError, ScenarioError


@final
@dataclass(frozen=True)
class CaseTable:
    """An equilibrium that is looked at.

    Args:
        name: of it.
        loads: values by load, or names of parameters: "pressure_Pa", "cable_tension_N.CABLE",
            "cable_length_m.CABLE", and dead loads "force_N.RING.x", .y or .z, world axes (numbers alone).
    """

    name: Name
    loads: Mapping[str, Any]


@final
@dataclass(frozen=True)
class GoalTable:
    """What shall be least or most.

    Args:
        quantity: an output of `cosim.sensitivity`, such as "tip_position_m.z", "mass_kg", "frame_strain".
        case: in which equilibrium; omitted: the first.
        minus: an equilibrium whose value is subtracted; omitted: nothing is.
        sense: "least" or "most".
    """

    quantity: Text
    case: Text | None = None
    minus: Text | None = None
    sense: Literal["least", "most"] = "least"


@final
@dataclass(frozen=True)
class LimitTable:
    """What a quantity has to be; one of the last three keys.

    Args:
        quantity: see `GoalTable`.
        case: the same.
        minus: the same.
        at_least: lower bound.
        at_most: upper bound.
        equal: value.
    """

    quantity: Text
    case: Text | None = None
    minus: Text | None = None
    at_least: float | None = None
    at_most: float | None = None
    equal: float | None = None

    @rule
    def _has_a_bound(self) -> Told:
        if sum(bound is not None for bound in (self.at_least, self.at_most, self.equal)) != 1:
            yield Fault("quantity", f"{self.quantity} needs one of at_least, at_most and equal")

    @property
    def bound(self) -> float:
        """The number that it gives."""
        found = [value for value in (self.at_least, self.at_most, self.equal) if value is not None]
        return found[0]


@final
@dataclass(frozen=True)
class ChoiceTable:
    """One of several kinds of the robot; each is designed, and the best is taken.

    Args:
        name: of it.
        set: values by key path, such as the number of units with the cables that run through them.
    """

    name: Name
    set: Mapping[str, Any]


@final
@dataclass(frozen=True)
class DesignStudyTable:
    """A design study.

    Args:
        scenario: name of one that comes with cosim, or path of a .toml file: its soft robot, the flange's
            pose, gravity and contact; its phases are not run.
        parameter: `[[parameter]]` in the file.
        case: `[[case]]` in the file.
        goal: what shall be least or most.
        limit: `[[limit]]` in the file.
        choice: `[[choice]]` in the file.
        set: values by key path, on top of the scenario.
        evaluations: designs that are solved at most, from each start of each choice.
        starts: how often each choice is searched: from the file's values first, then from random ones.
        seed: of the random values.
    """

    scenario: Text
    parameter: Annotated[tuple[FreeTable, ...], Len(min_length=1)]
    case: Annotated[tuple[CaseTable, ...], Len(min_length=1)]
    goal: GoalTable
    limit: tuple[LimitTable, ...] = ()
    choice: tuple[ChoiceTable, ...] = ()
    set: Mapping[str, Any] = field(default_factory=dict)
    evaluations: Annotated[int, Interval(ge=2, le=10_000)] = 30
    starts: Annotated[int, Interval(ge=1, le=1000)] = 1
    seed: Annotated[int, Interval(ge=0, lt=2**31)] = 0


def load_design_study(source: str | Path) -> DesignStudyTable:
    """Return a checked design study.

    Args:
        source: path of a .toml file; paths in it are seen from there.

    Raises:
        InputError: there is no such file.
        ScenarioError: keys or values are wrong.
    """
    path = Path(source)
    if not is_file(path):
        raise InputError(f"no design study {str(source)!r}; give the path of a .toml file")
    faults = Faults()
    study = parse(DesignStudyTable, read_table(path), "", faults)
    check(study, "", None, (), faults)
    faults.tell()
    cases = tuple(replace(case, loads=flat(case.loads)) for case in study.case)
    names = tuple(case.name for case in cases)
    for case in cases:
        for load, value in case.loads.items():
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise ScenarioError(
                    f"case.{case.name}.loads.{load}", f"is {value!r:.40}; give a number or a parameter"
                )
    wanted: tuple[GoalTable | LimitTable, ...] = (study.goal, *study.limit)
    for entry in wanted:
        for key in ("case", "minus"):
            name = getattr(entry, key)
            if name is not None and name not in names:
                raise ScenarioError(f"{entry.quantity}: {key}", unknown_name_message("case", name, names))
    changes: dict[str, Any] = {
        "set": flat(study.set),
        "case": cases,
        "choice": tuple(replace(choice, set=flat(choice.set)) for choice in study.choice),
    }
    if study.scenario not in list_scenarios():
        changes["scenario"] = str(path.parent / study.scenario)
    return copy_with(study, **changes)
