"""Mutated files of scenarios and soft robots: refused with the key's path, solved, or unsolved by name.

A traceback, a refusal without the key's path and what `cosim check` alone accepts or refuses are findings.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from random import Random
from typing import ClassVar, Final, Literal, final

from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.schema.scenario import Scenario
from cosim.errors import MOST_LINES, InputError, ScenarioError, SolverError
from tests.fuzz.sources import put_beside, sources
from tests.fuzz.tables import broken, mutated, mutations_of, toml_text
from tests.fuzz.verdict import FINDING, Trial, Verdict, traceback_verdict

TICKS = 3
LONGEST_REFUSAL = 1500
UNCHECKED = ("the static plan fails", ".tip_target: ", ".tip_path: ", ".tip_path.speed_m_s: ")
_FITS_ALL: Final = {  # in place of what fits only the reference scenario's own robot
    "gravity_m_s2": [0.0, 0.0, 0.0],
    "phase": [{"name": "inflate", "duration_s": 0.1, "pressure_Pa": 1e3, "increments": TICKS}],
    "start": {"flange": {"position_m": [0.4, 0.0, 0.6], "direction": [1.0, 0.0, 0.0]}, "pressure_Pa": 1e3},
}
Level = Literal["load", "build"]


@final
@dataclass(frozen=True)
class Case:
    """A mutated file.

    Args:
        source: what it was made from.
        changes: in words.
        text: of the file.
        robot: whether it is that of a soft robot, not a scenario.
        other_mode: whether it is loaded in the quasistatic mode instead of the dynamic one, or the reverse.
        alone: text of the file with each of several mutations alone; empty where there is one.
    """

    source: str
    changes: str
    text: str
    robot: bool
    other_mode: bool
    alone: tuple[str, ...] = ()

    def write(self, folder: Path) -> Path:
        """Write the file into a folder; return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        return _written(self.text, folder)


class Loaded(Trial):
    """Files that are loaded."""

    memory_limit_bytes = 1 << 30
    level: ClassVar[Level] = "load"

    def begin(self, folder: Path) -> None:
        try_case(unchanged("ur5e_hexagon_arm"), self.level, folder)

    def tried(self, seed: int, folder: Path) -> Verdict:
        case = case_of(seed)
        return replace(try_case(case, self.level, folder), case=f"{case.source}: {case.changes}")


@final
class Built(Loaded):
    """Files that are built and taken three ticks on, if they load."""

    memory_limit_bytes = 4 << 30
    level = "build"


def case_of(seed: int) -> Case:
    """Return the mutated file of a seed."""
    rng = Random(seed)
    name, table, robot = rng.choice(sources())
    text = toml_text(table)
    other_mode = rng.random() < 0.3
    if rng.random() < 0.08:
        text, what = broken(text, rng)
        return Case(name, what, text, robot, other_mode)
    mutations = mutations_of(table, rng)
    changed, done = mutated(table, mutations)
    alone = tuple(toml_text(mutated(table, [one])[0]) for one in mutations) if len(mutations) > 1 else ()
    return Case(name, "; ".join(done), toml_text(changed), robot, other_mode, alone)


def unchanged(scenario: str) -> Case:
    """Return the file of a scenario as it is."""
    table = next(table for name, table, _ in sources() if name == scenario)
    return Case(scenario, "none", toml_text(table), robot=False, other_mode=False)


def try_case(case: Case, level: Level, folder: Path) -> Verdict:
    """Return what a case leads to.

    Args:
        case: of `case_of`.
        level: "load": all that needs no build; "build": built, and three ticks, after `cosim check` has
            checked it. It is a finding if the check accepts what the run refuses, or refuses it with another
            text. The static plan of tip targets and paths is left out, which no check solves.
        folder: for its file, which `mesh.obj` and the like may stand beside.
    """
    path = case.write(folder)
    refused = "refused when loaded"
    checked = ""
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            scenario = _loaded(path, case)
            refused = "refused when built"
            if level == "build":
                checked = _check(scenario)
                _run(scenario)
                if checked:
                    return Verdict(FINDING, f"the check alone refuses it: {checked}")
    except InputError as error:
        problem = _wrong_refusal(error)
        told = checked == str(error) or any(words in str(error) for words in UNCHECKED)
        if not problem and refused == "refused when built" and not told:
            problem = f"the check says {checked or 'nothing'!r}: "
        what = f"{problem}{type(error).__name__}: {error}"
        if not problem and case.alone and level == "load" and (hidden := _hidden(case, error, folder)):
            return Verdict("refused in part", f"not told: {hidden}; {what}")
        return Verdict(FINDING if problem else refused, what)
    except SolverError as error:
        return Verdict("unsolved", f"{type(error).__name__}: {error}")
    except Exception as error:
        return traceback_verdict(error)
    return Verdict("completed", "")


def _hidden(case: Case, error: InputError, folder: Path) -> str:
    """Return the refusal of a mutation that is refused alone and not told beside the others; or empty."""
    told = [place for place, _ in getattr(error, "faults", ())]
    for text in case.alone:
        try:
            (load_soft_robot if case.robot else load_scenario)(_written(text, folder))
        except ScenarioError as alone:
            if not any(_same(place, other) for place, _ in alone.faults for other in told):
                return str(alone)
    return ""


def _same(first: str, second: str) -> bool:
    """Return whether two paths mean one key, one leads to the other, or only the name of a table differs.

    Places in one list mean one key: what another mutation has taken out moves those behind it.
    """
    nested = f"{first}.".startswith(f"{second}.") or f"{second}.".startswith(f"{first}.")
    (table, _, last), (other, _, end) = first.rpartition("."), second.rpartition(".")
    return nested or last == end or (table == other and last.isdecimal() and end.isdecimal())


def _written(text: str, folder: Path) -> Path:
    put_beside(folder)
    path = folder / "case.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


def _loaded(path: Path, case: Case) -> Scenario:
    if case.robot:
        load_soft_robot(path)
        scenario = load_scenario("ur5e_hexagon_arm", {"soft_robot": str(path), **_FITS_ALL})
    else:
        scenario = load_scenario(path)
    if not case.other_mode:
        return scenario
    mode = "dynamic" if scenario.mode == "quasistatic" else "quasistatic"
    return load_scenario(scenario, {"mode": mode})


def _check(scenario: Scenario) -> str:
    """Return what `cosim check` refuses about a scenario; empty if it accepts it."""
    from cosim.build.file_checks import check_built  # here: the level "load" needs no engine

    try:
        check_built(scenario)
    except InputError as error:
        return str(error)
    return ""


def _run(scenario: Scenario) -> None:
    from cosim.app.preparation import build_simulation  # here: the level "load" needs no engine

    if scenario.fidelity == "section":  # its model takes longer than a trial may
        scenario = replace(scenario, fidelity="lumped")
    for _ in islice(build_simulation(scenario).steps(), TICKS + 1):
        pass


def _wrong_refusal(error: InputError) -> str:
    """Return what is wrong with how an input is refused; empty if nothing is."""
    if not isinstance(error, ScenarioError) or not all(path for path, _ in error.faults):
        return "no path: "
    lines = str(error).split("\n")
    if len(lines) != min(len(error.faults), MOST_LINES + 1) or not all(line.isprintable() for line in lines):
        return "not one printable line for each fault: "
    longest = max(map(len, lines))
    return f"{longest} characters: " if longest > LONGEST_REFUSAL else ""
