"""Loads scenarios with several arms: `[[arm]]` tables next to the keys that all arms share. An arm's keys
with the shared ones make a scenario of one arm, so every key has the same meaning as there.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, final

import tomli_w

from cosim.base.resources import scenario_path
from cosim.config.loading import HEADER, by_key, loaded_scenario, to_table
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.toml import keys, reading
from cosim.config.toml.rules import Faults
from cosim.errors import ScenarioError

ARMS: Final = "arm"
OF_AN_ARM: Final = (
    "robot", "arm_base", "soft_robot", "start", "phase", "fidelity", "payload_compensation", "solver",
    "model", "gas", "pump", "winch", "controller", "sensor", "command",
)  # fmt: skip
"""Keys that each arm may give. A key above the arms applies to all; an arm's key overrides it."""
_NAME: Final = "[A-Za-z][A-Za-z0-9_-]*"


@final
@dataclass(frozen=True)
class ArmsScenario:
    """Several arms in one scene.

    Args:
        name: of the scenario.
        title: one line for people.
        arms: the scenario of each arm by its name; they have equal durations and equal shared keys.
    """

    name: str
    title: str
    arms: Mapping[str, Scenario]

    def text(self) -> str:
        """Return it as TOML text that loads to an equal scenario."""
        tables = {name: to_table(scenario) for name, scenario in self.arms.items()}
        shared = {key: value for key, value in next(iter(tables.values())).items() if key not in OF_AN_ARM}
        arms = [
            {"name": name, **{key: table[key] for key in OF_AN_ARM if key in table}}
            for name, table in tables.items()
        ]
        return HEADER + tomli_w.dumps({**shared, "name": self.name, "title": self.title, ARMS: arms})


def has_arms(source: str | Path) -> bool:
    """Return whether a scenario's file has several arms.

    Args:
        source: name of a scenario that comes with cosim, or path of a .toml file.

    Raises:
        InputError: there is no such scenario, or it is not TOML.
    """
    return ARMS in reading.read_table(scenario_path(source))


def load_arms(source: str | Path, overrides: Mapping[str, Any] | None = None) -> ArmsScenario:
    """Return a checked scenario of several arms.

    Args:
        source: name of a scenario that comes with cosim, or path of a .toml file with `[[arm]]`.
        overrides: values by key path, such as {"arm.left.phase.lift.duration_s": 2.0, "clock.tick_s": 1e-3}.

    Raises:
        InputError: there is no such scenario, or the overrides are no values by key path.
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    path, changes = scenario_path(source), by_key(overrides)
    table = reading.read_table(path)
    table.setdefault("name", path.stem)
    table |= {key: changes.pop(key) for key in ("name", "title") if key in changes}
    entries = _entries(table.pop(ARMS, None))
    found, faults = dict[str, Scenario](), Faults()
    common = {key: value for key, value in changes.items() if not key.startswith(f"{ARMS}.")}
    for name in {key.split(".")[1] for key in changes if key.startswith(f"{ARMS}.")} - entries.keys():
        faults.add(f"{ARMS}.{name}", f"no such arm; there are: {', '.join(entries)}")
    for name, entry in entries.items():
        given = {key: value for key, value in entry.items() if key != "name"}
        changed = _changes_of(name, changes)
        with faults, of_arm(name):
            _check_keys(name, [*given, *changed])
            merged = reading.merge(deepcopy(table), deepcopy(given))
            for key, text in (("name", f"_{name}"), ("title", f": {name}")):
                if isinstance(table.get(key), str):
                    merged[key] = table[key] + text
            found[name] = loaded_scenario(merged, path.parent, common | changed)
            _check(found[name])
            objects, wires = found[name].objects, found[name].wires
            if name in {"cell", *(one.name for one in objects), *(one.name for one in wires)}:
                raise ScenarioError(
                    f"{ARMS}.{name}", "is the name of something else in the scene; rename one"
                )
    faults.raise_all()
    return ArmsScenario(str(table["name"]), str(table["title"]), _with_equal_durations(found))


def _entries(given: Any) -> dict[str, dict[str, Any]]:
    """Return the tables of arms by their names.

    Raises:
        ScenarioError: there are fewer than two, or names are missing or not unique.
    """
    entries = given if isinstance(given, list) and all(isinstance(each, dict) for each in given) else []
    if len(entries) < 2:
        raise ScenarioError(ARMS, "must be two or more tables [[arm]]; the keys of one arm need no [[arm]]")
    found, faults = dict[str, dict[str, Any]](), Faults()
    for place, entry in enumerate(entries, 1):
        name, key = entry.get("name"), f"{ARMS}.{place}.name"
        if name is None:
            faults.add(key, "is missing; it has no default")
        elif not (isinstance(name, str) and re.fullmatch(_NAME, name)):
            faults.add(key, f"{keys.shown(name)} must be a letter followed by letters, digits, '_' or '-'")
        elif name in found:
            faults.add(key, f"{name!r} is the name of another arm; give each arm its own")
        else:
            found[name] = entry
    faults.raise_all()
    return found


def _check_keys(name: str, given: Sequence[str]) -> None:
    """Check that the keys of an arm exist and are not among those that all arms share.

    Raises:
        ScenarioError: one is wrong.
    """
    known, faults = {keys.key_of(entry) for entry in fields(Scenario)}, Faults()
    for key in given:
        head = key.partition(".")[0]
        if head in known.difference(OF_AN_ARM):
            text = (
                f"is shared by all arms: give it above the first [[arm]]; an arm has {', '.join(OF_AN_ARM)}"
            )
            faults.add(f"{ARMS}.{name}.{key}", text)
        elif head not in OF_AN_ARM:
            faults.add(f"{ARMS}.{name}.{head}", keys.unknown_key_message(head, OF_AN_ARM))
    faults.raise_all()


def _changes_of(name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the overrides of one arm, without the arm's name in their keys."""
    prefix = f"{ARMS}.{name}."
    return {key.removeprefix(prefix): value for key, value in changes.items() if key.startswith(prefix)}


@contextmanager
def of_arm(name: str) -> Iterator[None]:
    """Add the arm's name to the keys of a ScenarioError that is raised within.

    Args:
        name: of the arm.

    Raises:
        ScenarioError: with keys such as "arm.NAME.phase.lift".
    """
    try:
        yield
    except ScenarioError as error:
        first, *more = [
            (f"{ARMS}.{name}.{place}" if place.partition(".")[0] in OF_AN_ARM else place, problem)
            for place, problem in error.faults
        ]
        raise ScenarioError(*first, further=tuple(more)) from error.__cause__


def _check(scenario: Scenario) -> None:
    """Check that several arms in a scene support the settings of a scenario.

    Raises:
        ScenarioError: they do not.
    """
    faults = list(_unsupported(scenario))
    if faults:
        raise ScenarioError(*faults[0], further=tuple(faults[1:]))


def _unsupported(scenario: Scenario) -> Iterator[tuple[str, str]]:
    if scenario.mode != "dynamic":
        yield "mode", "several arms need 'dynamic'; for equilibria, run a scenario of each arm alone"
    if scenario.coupling.scheme != "staggered":
        yield "coupling.scheme", "several arms need 'staggered'"
    if scenario.robot == NO_ARM:
        yield "robot", "is 'none'; each of several arms needs a robot"
    if scenario.endless:
        yield "phase", "is missing: each of several arms needs phases"
    if scenario.cameras:
        yield "camera", "several arms have none: pictures show one soft robot; leave cameras out"
    for entry in scenario.controllers:
        if entry.kind == "python":
            yield f"controller.{entry.name}.kind", "several arms need 'bang_bang' or 'pi'"


def _with_equal_durations(arms: Mapping[str, Scenario]) -> dict[str, Scenario]:
    """Return scenarios that last as long as the longest: the others settle longer in their last phase."""
    ticks = {name: sum(one.ticks(each) for each in one.phases) for name, one in arms.items()}
    most, found = max(ticks.values()), dict[str, Scenario]()
    for name, scenario in arms.items():
        *before, last = scenario.phases
        left_s = (most - ticks[name]) * scenario.clock.tick_s
        if left_s:
            last = replace(last, settle_s=last.settle_s + left_s)
        found[name] = replace(scenario, phases=(*before, last))
    return found
