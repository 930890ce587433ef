"""Reads scenarios, soft robots and studies: files, changes on top of them, and what they name; writes them.

Resolves what a scenario names, cable tensions and tip-path files, into values.

Cable tensions that a scenario gives by name: tables become lists when the scenario is resolved.

`cable_tension_N = { right = 8.0, gripper = 1.5 }` names cables, groups ("gripper" for all whose names begin
with "gripper/") or patterns; what it leaves out stays as it was.

Paths of the tip in a scenario's tables: read from their CSV files, with the time that they take.

Loads scenario and soft-robot files into their frozen dataclasses.

Makes kinds of tables known that are not part of cosim: those of a module, and of installed packages.

A package offers its kinds as entry points; a module is named by who runs a scenario. A file cannot name
either: reading one runs no code that was not there before.

Puts together the table of a soft robot from the files that it starts from and attaches.
"""

import csv
import importlib.util
import inspect
import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar, final

import tomli_w

from cosim.base.files import note_file, read_text
from cosim.base.resources import is_file, scenario_path, soft_robot_path
from cosim.config import arm_files, rules, studies
from cosim.config.schema.phase import HOLD, MOST_POINTS, PhaseTable, StartTable, TipPathTable, by_name
from cosim.config.schema.scenario import GivenBodyTable, Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml import keys, parsing, reading, tables
from cosim.config.toml.rules import Faults, blamed_on, check
from cosim.errors import InputError, ScenarioError

Table = TypeVar("Table", StartTable, PhaseTable)
_KEY: Final = "cable_tension_N"


def with_listed_tensions(scenario: Scenario, faults: Faults) -> Scenario:
    """Return a scenario whose start and phases give tensions as lists; omitted ones at the start are zeros.

    Args:
        scenario: as its file gives it.
        faults: gets names that match no cable, and tensions that are not known before.
    """
    cables = scenario.soft_robot.cable_names()
    none = (0.0,) * len(cables)
    start, phases = scenario.start, []
    with faults:
        start = _with_list(start, none, cables, "start")
        start = replace(start, cable_tension_N=start.cable_tension_N or none)
    before: tuple[float, ...] | None = start.cable_tension_N
    for phase in scenario.phases:
        listed = phase
        with faults:
            listed = _with_list(phase, before, cables, f"phase.{phase.name}")
            before = before if listed.cable_tension_N is None else listed.cable_tension_N
            if listed.tip_target is not None and listed.tip_target.reach_with == "cables":
                before = None
        phases.append(listed)
    return replace(scenario, start=start, phases=tuple(phases))


def _with_list(table: Table, before: tuple[float, ...] | None, cables: Sequence[str], path: str) -> Table:
    """Return a start or phase whose tensions are a list, or None.

    Raises:
        ScenarioError: a name matches no cable, or the tensions before are not known.
    """
    given: Any = table.cable_tension_N
    if not isinstance(given, Mapping):
        return table
    found = by_name(given, cables, "cable", f"{path}.{_KEY}")
    missing = [name for name in cables if name not in found]
    if missing and (before is None or len(before) != len(cables)):
        raise ScenarioError(
            f"{path}.{_KEY}",
            f"leaves out {missing[0]}, whose tension before is not known here; name all cables",
        )
    tensions = dict(zip(cables, before or (), strict=False)) | found
    return replace(table, cable_tension_N=tuple(tensions[name] for name in cables))


_POINT: Final = ("x_m", "y_m", "z_m")
_DIRECTION: Final = ("direction_x", "direction_y", "direction_z")


def complete_tip_paths(table: dict[str, Any], folder: Path, faults: Faults) -> None:
    """Put into each phase that has a tip path the path's points, its duration and its ramp.

    Args:
        table: of a scenario, as TOML gives it; changed in place.
        folder: that files of points are relative to.
        faults: gets files that cannot be read.
    """
    phases = table.get("phase")
    for place, phase in enumerate(phases if isinstance(phases, list) else [], start=1):
        path = phase.get("tip_path") if isinstance(phase, dict) else None
        if isinstance(path, dict):
            del phase["tip_path"]
            with faults:
                phase["tip_path"] = _read(path, folder, f"phase.{phase.get('name', place)}.tip_path")
            phase.setdefault("ramp", "linear")
            if "duration_s" not in phase:
                phase["duration_s"] = _duration_s(phase.get("tip_path", {}))


def _duration_s(path: dict[str, Any]) -> float:
    """Return how long a path takes; 1 for one that is wrong, as the check of the path names that."""
    try:
        return parsing.parse(TipPathTable, path, "", Faults()).course().duration_s
    except InputError:
        return 1.0


def _read(path: dict[str, Any], folder: Path, key: str) -> dict[str, Any]:
    """Return the table of a path with points and directions in place of its file."""
    if not isinstance(path.get("file"), str):
        return path
    for given in ("points_m", "directions"):
        if given in path:
            raise ScenarioError(f"{key}.{given}", "cannot be combined with file, which gives the points")
    points, directions = read_tip_path(folder / path["file"], f"{key}.file")
    kept = {name: value for name, value in path.items() if name != "file"}
    return {**kept, "points_m": points, **({"directions": directions} if directions else {})}


def read_tip_path(file: Path, key: str) -> tuple[list[list[float]], list[list[float]]]:
    """Return points [m] and directions of a CSV file; the latter empty where it has none.

    Args:
        file: with a header that names its columns; lines that begin with # are left out.
        key: of the scenario that names it.

    Raises:
        ScenarioError: it cannot be read, or lacks columns or numbers.
    """
    try:
        text = read_text(file)
    except OSError as error:
        raise ScenarioError(key, f"{str(file)!r} cannot be read: {error.strerror}") from error
    lines = [
        (k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"
    ]
    rows = [(k, [cell.strip() for cell in next(csv.reader([line]))]) for k, line in lines]
    header = rows[0][1] if rows else []
    known = (*_POINT, *_DIRECTION)
    wrong = [name for name in header if name not in known or header.count(name) > 1]
    lacks = [name for name in (known if set(header) & set(_DIRECTION) else _POINT) if name not in header]
    if wrong or lacks:
        problem = f"has the column {wrong[0]!r}" if wrong else f"lacks the column {lacks[0]}"
        raise ScenarioError(
            key,
            f"{file.name} {problem}; its header names {', '.join(_POINT)}, and for directions "
            f"{', '.join(_DIRECTION)}",
        )
    if len(rows) - 1 > MOST_POINTS:
        raise ScenarioError(key, f"{file.name} has {len(rows) - 1} points; at most {MOST_POINTS} are read")
    numbers = [_numbers(row, len(header), f"{file.name}, line {k}", key) for k, row in rows[1:]]
    found = [dict(zip(header, row, strict=True)) for row in numbers]
    points = [[row[name] for name in _POINT] for row in found]
    return points, [[row[name] for name in _DIRECTION] for row in found if _DIRECTION[0] in row]


def _numbers(row: list[str], count: int, place: str, key: str) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError as error:
        raise ScenarioError(key, f"{place}: {error}") from error
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ScenarioError(key, f"{place}: {', '.join(row)!r} must be {count} finite numbers")
    return values


GROUP: Final = "cosim.kinds"
"""Of entry points; each names a module that holds kinds, or a kind."""


@cache
def register_installed() -> None:
    """Register the kinds that installed packages offer, once.

    Raises:
        InputError: one cannot be imported, or holds no kind.
    """
    from importlib.metadata import entry_points  # here, because it takes long to load

    for entry in sorted(entry_points(group=GROUP)):
        what = f"entry point '{entry.name}' of the group {GROUP} ({entry.value})"
        _register(_loaded(what, entry.load), what)


def register_module(name: str) -> None:
    """Register every kind that a module holds.

    Args:
        name: of a module that can be imported, or path of a .py file.

    Raises:
        InputError: there is no such module, it cannot be imported, or holds no kind.
    """
    load = (lambda: module_of_file(Path(name))) if name.endswith(".py") else (lambda: import_module(name))
    _register(_loaded(f"--import {name}", load), f"--import {name}")


def note_kinds(value: Any) -> None:
    """Note the modules of all kinds in a scenario that are not those of cosim, see `files_read`."""
    if isinstance(value, tables.KindTable) and not type(value).__module__.startswith("cosim."):
        with suppress(OSError, TypeError):  # typed in at a prompt
            note_file(Path(inspect.getfile(type(value))))
    parts = vars(value).values() if is_dataclass(value) else value
    for part in parts:
        if is_dataclass(part) or (isinstance(part, tuple) and part and not isinstance(part[0], float)):
            note_kinds(part)


def _loaded(what: str, load: Any) -> Any:
    try:
        return load()
    except Exception as error:  # a user's module may raise anything
        raise InputError(f"{what}: cannot be imported: {type(error).__name__}: {error}") from error


def module_of_file(path: Path) -> ModuleType:
    """Return the module that a .py file holds, loaded once.

    Raises:
        ImportError: there is no such file, or another module of that name is loaded.
    """
    name, place = path.stem, str(path.resolve())
    loaded = sys.modules.get(name)
    if loaded is not None and loaded.__file__ == place:
        return loaded
    if loaded is not None:
        raise ImportError(f"a module called '{name}' is loaded already; give the file another name")
    spec = importlib.util.spec_from_file_location(name, place)
    assert spec is not None, "its name ends in .py"
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(
        spec
    )  # where dataclasses look annotations up
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _register(loaded: Any, what: str) -> None:
    found = [
        entry
        for entry in (vars(loaded).values() if isinstance(loaded, ModuleType) else (loaded,))
        if isinstance(entry, type) and issubclass(entry, tables.KindTable) and entry is not tables.KindTable
    ]
    kinds = [table for table in found if tables.name_of(table) is not None]
    if not kinds:
        raise InputError(f"{what}: holds no kind of tables, such as a subclass of ElementTable")
    for table in kinds:
        tables.register_kind(table)


MOST_FILES: Final = 64
LONGEST_CHAIN: Final = 8


@final
class RobotFiles:
    """The files of one soft robot: each is read once, and none may lead to itself."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._read: dict[Path, dict[str, Any]] = {}
        self._used = 0

    def expand(self, value: Any, folder: Path, path: str, chain: tuple[Path, ...] = ()) -> Any:
        """Return the full table of a soft robot given by name, path, or changes to a file.

        A file that is not there is a fault; no more is said of that robot.

        Args:
            value: as in the file; what is neither a text nor a table is returned as it is.
            folder: that relative paths start from.
            path: of the value, for messages.
            chain: files that led here.

        Raises:
            ScenarioError: a file is wrong, leads to itself, or there are too many.
        """
        if isinstance(value, str):
            return self._based(value, {}, folder, path, chain)
        return self._complete(value, folder, path, chain) if isinstance(value, Mapping) else value

    def _complete(
        self, table: Mapping[str, Any], folder: Path, path: str, chain: tuple[Path, ...]
    ) -> dict[str, Any]:
        """Return a soft robot's table with the files that it and its attachments start from put in."""
        full: dict[str, Any] = reading.plain(table, path, self._faults.unread)
        body = full.get("body")
        if isinstance(body, dict) and isinstance(body.get("file"), str) and is_file(folder / body["file"]):
            body["file"] = str((folder / body["file"]).resolve())
        if "file" in full:
            full = self._based(full.pop("file"), full, folder, f"{path}.file", chain)
        entries = full.get("attach")
        for place, entry in enumerate(entries if isinstance(entries, list) else (), start=1):
            if isinstance(entry, dict) and "robot" in entry:
                where = keys.join(keys.join(f"{path}.attach", keys.label(entry, place)), "robot")
                entry["robot"] = self.expand(entry["robot"], folder, where, chain)
        return full

    def _based(
        self, name: Any, changes: dict[str, Any], folder: Path, path: str, chain: tuple[Path, ...]
    ) -> dict[str, Any]:
        """Return the table of a soft robot's file, given by name or path, with changes on top."""
        self._used += 1
        if self._used > MOST_FILES:
            raise ScenarioError(path, f"is one robot too many; at most {MOST_FILES} files make a soft robot")
        file = None
        if not self._faults.leaves_out(path):
            with self._faults:
                file = _found(name, folder, path)
        if file is None:
            self._faults.unread[path.removesuffix(".file")] = ""
            return changes
        return reading.merge(self._table(file, name, path, chain), changes)

    def _table(self, file: Path, name: str, path: str, chain: tuple[Path, ...]) -> dict[str, Any]:
        here = file.resolve()
        if here in chain:
            raise ScenarioError(path, f"'{name}' leads back to itself; a soft robot cannot hold itself")
        if len(chain) >= LONGEST_CHAIN:
            raise ScenarioError(path, f"'{name}' comes after {LONGEST_CHAIN} files that lead to one another")
        if here not in self._read:
            self._read[here] = reading.read_table(file)
        return self._complete(self._read[here], file.parent, path.removesuffix(".file"), (*chain, here))


def _found(name: Any, folder: Path, path: str) -> Path:
    """Return the file of a soft robot.

    Raises:
        ScenarioError: the name is no text, or there is no such file.
    """
    if not isinstance(name, str):
        raise ScenarioError(path, f"expected a name or path, got {keys.describe(name)}")
    beside = folder / name
    with blamed_on(path):
        return beside if beside.suffix == ".toml" and is_file(beside) else soft_robot_path(name)


def load_scenario(
    source: str | Path | Scenario,
    overrides: Mapping[str, Any] | None = None,
    body: GivenBodyTable | None = None,
) -> Scenario:
    """Return a checked scenario.

    Args:
        source: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.inflate.pressure_Pa": 20e3}.
        body: takes the place of the scenario's soft robot, if it has one.

    Raises:
        InputError: there is no such scenario, or the overrides are no values by key path.
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    if isinstance(source, Scenario):
        return loaded_scenario(to_table(source), Path(), by_key(overrides), body)
    path = scenario_path(source)
    table = reading.read_table(path)
    table.setdefault("name", path.stem)
    if "arm" in table:
        raise ScenarioError(
            "arm",
            f"{path.name} has several arms, which `cosim run` and `cosim.run_arms` step together; for all "
            "else give a file with the keys of one arm, without [[arm]]",
        )
    return loaded_scenario(table, path.parent, by_key(overrides), body)


def loaded_scenario(
    table: dict[str, Any], folder: Path, overrides: Mapping[str, Any], body: GivenBodyTable | None = None
) -> Scenario:
    """Return the checked scenario of a file's tables.

    Args:
        table: of the file; it is changed.
        folder: that relative paths start from.
        overrides: values by key path; paths in them start from the working directory.
        body: takes the place of the scenario's soft robot, if it has one.

    Raises:
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    register_installed()
    overrides, faults = dict(overrides), Faults()
    place = folder
    arm_folder = Path() if "robot" in overrides else folder
    scene_folder = Path() if any(key.partition(".")[0] == "scene" for key in overrides) else folder
    if body is not None:
        with faults:
            _check_no_robot(overrides, body)
        overrides = {key: value for key, value in overrides.items() if key.partition(".")[0] != "soft_robot"}
        table["soft_robot"] = to_table(body)
    elif "soft_robot" in overrides:
        table["soft_robot"] = overrides.pop("soft_robot")
        folder = Path()
    if "soft_robot" in table and body is None:
        table["soft_robot"] = _full_robot(table["soft_robot"], folder, faults)
    for key, value in overrides.items():
        if not faults.leaves_out(key):
            with faults:
                reading.apply_override(table, key, reading.plain(value, key, faults.unread))
    path_folder = Path() if any(".tip_path" in key for key in overrides) else place
    complete_tip_paths(table, path_folder, faults)
    _find_files(table, place, scene_folder)
    scenario = parsing.parse(Scenario, table, "", faults)
    with faults:
        scenario = replace(scenario, robot=arm_files.with_arm_path(scenario.robot, arm_folder))
    return _resolved(scenario, faults)


def _full_robot(robot: Any, folder: Path, faults: Faults) -> Any:
    """Return the full table of a scenario's soft robot; of one whose files are wrong, no more is said."""
    with faults:
        _check_in_file(robot)
        return RobotFiles(faults).expand(robot, folder, "soft_robot")
    faults.unread["soft_robot"] = ""
    return {}


def _find_files(table: dict[str, Any], folder: Path, scene_folder: Path) -> None:
    """Put absolute paths in place of mesh files beside a scenario, and of the file of its scene."""
    objects, scene = table.get("object"), table.get("scene")
    for entry in [each for each in objects if isinstance(each, dict)] if isinstance(objects, list) else ():
        parts = entry.get("part")
        for solid in (entry, *(parts if isinstance(parts, list) else ())):
            file = solid.get("file") if isinstance(solid, dict) else None
            if isinstance(file, str) and is_file(folder / file):
                solid["file"] = str((folder / file).resolve())
    if isinstance(scene, dict) and isinstance(scene.get("mjcf"), str):
        file = scene_folder / scene["mjcf"]
        scene["mjcf"] = str(file.resolve() if is_file(file) else file)


def by_key(overrides: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of overrides.

    Raises:
        InputError: they are none.
    """
    if overrides is None:
        return {}
    if not isinstance(overrides, Mapping) or not all(isinstance(key, str) for key in overrides):
        raise InputError(
            f"overrides or changes are {overrides!r:.60}; give values by key path, such as "
            '{"clock.tick_s": 1e-3}'
        )
    return dict(overrides)


def _check_no_robot(overrides: Mapping[str, Any], body: GivenBodyTable) -> None:
    for key in overrides:
        if key.partition(".")[0] == "soft_robot":
            raise ScenarioError(key, f"cannot be set: the soft body '{body.name}' is given as arrays")


def _check_in_file(soft_robot: object) -> None:
    """Refuse a soft robot's table that a run with a body given from Python has written."""
    if isinstance(soft_robot, dict) and "arrays" in soft_robot:
        raise ScenarioError(
            "soft_robot",
            f"'{soft_robot.get('name')}' was given as arrays, which are in no file: run this from Python, "
            "cosim.run(..., body=...), or continue with cosim.Simulation(..., body=..., start=...)",
        )


def load_soft_robot(name_or_path: str | Path) -> SoftRobotTable:
    """Return a checked soft robot, by name or path of its file.

    Raises:
        InputError: there is no such soft robot.
        ScenarioError: keys or values are wrong.
    """
    register_installed()
    path, faults = soft_robot_path(name_or_path), Faults()
    table = RobotFiles(faults).expand(str(path), Path(), "soft_robot")
    robot = parsing.parse(SoftRobotTable, table, "soft_robot", faults)
    check(robot, "soft_robot", None, (), faults)
    faults.tell()
    return robot


def is_scenario(table: Mapping[str, Any]) -> bool:
    """Return whether a file's tables are those of a scenario; otherwise they are those of a soft robot."""
    return bool({"phase", "start", "soft_robot", "robot"} & table.keys())


def load_file(path: Path) -> Scenario | SoftRobotTable | studies.StudyTable:
    """Return what a scenario, robot or study file describes, checked without building anything.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    table = reading.read_table(path)
    if studies.is_study(table):
        return studies.load_study(path)
    return load_scenario(path) if is_scenario(table) else load_soft_robot(path)


def resolve(scenario: Scenario) -> Scenario:
    """Return the scenario with its rules checked and its tensions listed, zeros where the start omits them.

    Raises:
        ScenarioError: see `cosim.config.rules`.
    """
    return _resolved(scenario, Faults())


def _resolved(scenario: Scenario, faults: Faults) -> Scenario:
    with faults:
        scenario = scenario if scenario.phases else replace(scenario, phases=(HOLD,))
    with faults:
        scenario = with_listed_tensions(scenario, faults)
    with faults:
        rules.check_scenario(scenario, faults)
    faults.tell()
    return scenario


_HEADER = "# The scenario as it ran, every value spelled out. Run it again with: cosim run <this file>\n"
_HEADER_GIVEN = (
    "# The scenario as it ran, every value spelled out; its soft body is in no file.\n"
    "# Run it again from Python: cosim.run(<this file>, body=...)\n"
)


def to_table(value: Any) -> Any:
    """Return the nested dicts and lists that describe a schema dataclass; absent values are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        entries = ((keys.key_of(entry), getattr(value, entry.name)) for entry in fields(value))
        return {key: to_table(item) for key, item in entries if item is not None}
    if isinstance(value, tuple):
        return [to_table(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_table(item) for key, item in value.items()}
    return value


def scenario_text(scenario: Scenario) -> str:
    """Return the resolved scenario as TOML text, which loads to an equal one with the same body."""
    given = isinstance(scenario.soft_robot, GivenBodyTable)
    return (_HEADER_GIVEN if given else _HEADER) + tomli_w.dumps(to_table(scenario))
