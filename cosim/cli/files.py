"""`cosim check`, `cosim upgrade`, `cosim schema`, `cosim new`, `cosim export`: files in and out.

`cosim export`: what a run saw, for other programs.
"""

import json
import re
from collections.abc import Collection, Sequence
from itertools import chain
from pathlib import Path
from typing import Final

from cosim.app.ended_run import load_run
from cosim.app.run_files import SCENARIO, OutputDirectory
from cosim.base import kept_parts, resources, writing
from cosim.base.writing import write_whole
from cosim.build.arms import find_arm
from cosim.cli.screen import printable
from cosim.config import arm_files, loading, menagerie, studies, upgrading
from cosim.config.json_schema import Kind, json_schema
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.several_arms import ArmsScenario, has_arms, load_arms
from cosim.config.toml.old_keys import SCHEMA
from cosim.config.toml.reading import read_table
from cosim.config.toml.rules import errors_at
from cosim.errors import InputError, ScenarioError
from cosim.results import exports, ros_bag
from cosim.results.result import RunResult, figure_kind

SCHEMA_FILE: Final = "cosim-scenario.schema.json"
_STARTING_SCENARIO: Final = Path(__file__).with_name("starting_scenario.toml")
CSV: Final = "arrays.csv"
PLOT: Final = "curves.png"


def check_command(files: Sequence[str]) -> bool:
    """Print a line for every fault of scenarios, robots, arms and studies; return whether all are fine.

    Args:
        files: paths, or names of scenarios that come with cosim.
    """
    fine = [_checked(name, "fine") for name in files]
    return all(fine)


def upgrade_command(files: Sequence[str]) -> bool:
    """Rewrite files of the schema number before, then check them; return whether all are fine.

    Raises:
        InputError: a file is not there; nothing has been rewritten.
        ScenarioError: some cannot be rewritten, such as read-only ones; all others have been.
        OutputError: a file cannot be written.
    """
    absent = [name for name in files if not resources.is_file(Path(name))]
    if absent:
        raise InputError(f"upgrade {absent[0]}: no such file")
    done: dict[str, str] = {}
    left: list[tuple[str, str]] = []
    for name in files:
        try:
            count = upgrading.upgrade_file(Path(name))
        except ScenarioError as error:
            left += error.faults
            continue
        done[name] = f"upgraded to schema {SCHEMA}, {count} changes" if count else "nothing to upgrade"
    fine = [_checked(name, text) for name, text in done.items()]
    if left:
        raise ScenarioError(*left[0], tuple(left[1:]))
    return all(fine)


def schema_text(kind: Kind) -> str:
    """Return the JSON Schema of a kind of files, as a text."""
    return json.dumps(json_schema(kind), indent=2, ensure_ascii=False) + "\n"


def new_command(name: str) -> None:
    """Write a starting scenario, and the schema that editors check it by, into the working directory.

    Args:
        name: of the scenario.

    Raises:
        InputError: the name is none, or a file of that name is there.
        OutputError: a file cannot be written.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_-]{0,63}", name):
        raise InputError(
            f"new {name!r}: give a letter followed by letters, digits, '_' or '-', without .toml"
        )
    path, schema, text = Path(f"{name}.toml"), Path(SCHEMA_FILE), schema_text("scenario")
    if path.exists():
        raise InputError(f"new {name}: {path} is there and is not overwritten")
    if schema.exists() and schema.read_text(encoding="utf-8") != text:
        raise InputError(f"new {name}: another {schema} is there and is not overwritten; move it away")
    scenario = f"#:schema ./{SCHEMA_FILE}\n{_STARTING_SCENARIO.read_text(encoding='utf-8')}"
    with writing.writing(path):
        write_whole(schema, text)
        write_whole(path, scenario)
    print(f"{path} written, with {schema} for editors; run it: cosim run {path}")


def _arm_line(name: str) -> str:
    """Return what to say about an arm's file, which both engines have read alike.

    Raises:
        ScenarioError: it is not usable.
    """
    from cosim.build.file_checks import checked_arm, flange_at_home  # here: other files wait for no engine

    with errors_at(name):
        arm = checked_arm(name)
        home = flange_at_home(arm)
    return "; ".join((f"{len(arm.joint_names)} joints", *arm.notes, home, "both engines agree"))


def _check_built(path: Path) -> str:
    """Check what a scenario, robot or study file describes; return what is left to runs, empty for nothing.

    Raises:
        ScenarioError: keys or values are wrong, or it cannot be built.
    """
    if path.suffix == ".toml" and studies.is_search(table := read_table(path)):
        return _check_search(path, "series" in table)
    found = load_arms(path) if path.suffix == ".toml" and has_arms(path) else loading.load_file(path)
    # imported here: a file that cannot be read needs no engine
    from cosim.build.file_checks import check_arms, check_built, check_designs, check_robot, left_to_runs

    if isinstance(found, studies.StudyTable):
        from cosim.sweeps.figure_names import check_figures

        check_designs(found)
        check_figures(found)
        return ""
    if isinstance(found, ArmsScenario):
        check_arms(found)
    elif isinstance(found, Scenario):
        check_built(found)
    else:
        check_robot(found)
        return ""
    scenarios = found.arms.values() if isinstance(found, ArmsScenario) else (found,)
    left = "; ".join(dict.fromkeys(chain.from_iterable(map(left_to_runs, scenarios))))
    return left and f"; only a run shows: {left}"


def _check_search(path: Path, of_curves: bool) -> str:
    """Check the file of `cosim identify` (of curves), or of `cosim design`; return as `_check_built` does."""
    # imported here, as only few files need them
    from cosim.bench import design, equilibria
    from cosim.config.benches import load_bench, load_design_study

    try:
        if not of_curves:
            design.DesignProblem(load_design_study(path))
            return ""
        equilibria.Curves(*load_bench(path))
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError("", str(error)) from error
    return f"; which values the curves determine: cosim identify {path} --check"


def arm_lines() -> list[str]:
    """Return a line for each arm that comes with cosim: its name, joints, flange, and what it is."""
    rows = []
    for name in resources.list_arms():
        try:
            arm = find_arm(name)
        except InputError as error:
            rows.append((name, str(error)))
            continue
        title = arm_files.read_arm_table(resources.arm_path(name)).title or ""
        rows.append((name, f"{len(arm.joint_names)} joints, {arm.notes[0].partition(',')[0]}  {title}"))
    width = max((len(name) for name, _ in rows), default=0)
    return [f"{name:<{width}}  {text}" for name, text in rows]


def _checked(name: str, fine: str) -> bool:
    """Print the faults of a file, or that it is fine; return whether it is."""
    path = Path(name)
    faults: tuple[tuple[str, str], ...] = ()
    try:
        if menagerie.is_of_menagerie(name) or (resources.is_file(path) and arm_files.is_arm_file(path)):
            fine = f"{fine}: {_arm_line(name)}"
        else:
            fine += _check_built(path if resources.is_file(path) else resources.scenario_path(name))
    except ScenarioError as error:
        faults = error.faults
    for place, problem in faults:
        line = problem if place in ("", name) else f"{place}: {problem}"
        print(printable(f"{name}: {line}".replace("\n", " ")))
    if not faults:
        print(printable(f"{name}: {fine}"))
    return not faults


def export_command(
    directory: Path, out: Path | None, wanted: Collection[str], times_s: Sequence[float] = ()
) -> None:
    """Write files of a run for other programs, and print where they are.

    Args:
        directory: of the run.
        out: directory of the files; None: that of the run.
        wanted: of `EXPORTS`.
        times_s: of the film; none: all frames.

    Raises:
        InputError: there is no such run or time, or nothing was asked for.
        OutputError: a file cannot be written.
    """
    if not wanted:
        raise InputError(f"export: say what to write: --{', --'.join(EXPORTS)}, or several of them")
    if times_s and "vtk" not in wanted:
        raise InputError("--at: chooses times of the film; give --vtk as well")
    if "plot" in wanted:
        figure_kind()
    if "bag" in wanted:
        ros_bag.check_bags()
    if "usd" in wanted:
        exports.check_usd()
    result = load_run(directory)
    with OutputDirectory(directory if out is None else out) as target:
        target.make()
        for kind in EXPORTS:
            if kind in wanted:
                _tell(*EXPORTS[kind](result, target, times_s))


def _export_csv(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(CSV)
    exports.write_csv(result, target.path / CSV)
    return target.path / CSV, ""


def _export_plot(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(PLOT)
    with writing.writing(target.path / PLOT):
        result.plot().savefig(target.path / PLOT, dpi=110)
    return target.path / PLOT, ""


def _export_film(result: RunResult, target: OutputDirectory, times_s: Sequence[float]) -> tuple[Path, str]:
    written = exports.write_film(result, target.path, times_s, target.claim)
    return target.path / exports.COLLECTION, f", {len(written) - 1} times; open it in ParaView"


def _export_bag(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    target.claim(ros_bag.BAG)
    messages = ros_bag.write_bag(result, target.path / ros_bag.BAG)
    return target.path / ros_bag.BAG, f", {messages} messages; ros2 bag play, or open its .mcap in Foxglove"


def _export_usd(result: RunResult, target: OutputDirectory, _: Sequence[float]) -> tuple[Path, str]:
    from cosim.build.arm_parts import ArmParts  # here: it brings both engines

    target.claim(exports.USD)
    assert result.directory is not None, "it was loaded from there"
    scenario = loading.load_scenario(result.directory / SCENARIO)
    shapes = () if scenario.robot == NO_ARM else ArmParts(scenario, kept_parts.KeptParts()).scene.shapes
    times = exports.write_usd(result, shapes, target.path / exports.USD)
    return target.path / exports.USD, f", {times} times; open it in usdview, Blender or Omniverse"


EXPORTS: Final = {
    "csv": _export_csv, "vtk": _export_film, "plot": _export_plot, "bag": _export_bag, "usd": _export_usd,
}  # fmt: skip
"""What `cosim export` writes, each by the option of its name."""


def _tell(path: Path, more: str) -> None:
    print(printable(f"{path}{more}"))
