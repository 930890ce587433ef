"""The commands `cosim check` and `cosim upgrade`: check files without a run, and rewrite files of the
previous schema.
"""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from cosim.base import resources
from cosim.cli.late_collection import LateCollection
from cosim.cli.screen import printable
from cosim.config import arm_files, loading, menagerie, studies, upgrading
from cosim.config.schema.scenario import Scenario
from cosim.config.several_arms import ArmsScenario, has_arms, load_arms
from cosim.config.toml.old_keys import SCHEMA
from cosim.config.toml.reading import read_table
from cosim.config.toml.rules import errors_at
from cosim.errors import InputError, ScenarioError


def check_command(files: Sequence[str]) -> bool:
    """Print every error of scenarios, robots, arms and studies, one line each; return whether all are valid.

    Args:
        files: paths, or names of scenarios that come with cosim.
    """
    fine = True
    with LateCollection() as collection:
        for name in files:
            fine = _checked(name, "fine") and fine
            collection.begin()
    return fine


def upgrade_command(files: Sequence[str]) -> bool:
    """Rewrite files of the previous schema, then check them; return whether there is no error.

    Raises:
        InputError: a file does not exist; no file has been rewritten.
        ScenarioError: a file cannot be rewritten, such as a read-only one; all others have been rewritten.
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


def _arm_line(name: str) -> str:
    """Return the line of a valid arm file: joints, notes, and the flange at home in both engines.

    Raises:
        ScenarioError: the file cannot be used.
    """
    from cosim.build.file_checks import checked_arm, flange_at_home  # here: other files need no engine

    with errors_at(name):
        arm = checked_arm(name)
        home = flange_at_home(arm)
    return "; ".join((f"{len(arm.joint_names)} joints", *arm.notes, home, "both engines agree"))


def _check_built(path: Path) -> str:
    """Check a scenario, robot or study file; return warnings, and the checks that only a run can do.

    Raises:
        ScenarioError: keys or values are wrong, or the model cannot be built.
    """
    if path.suffix == ".toml" and studies.is_search(table := read_table(path)):
        return _check_search(path, "series" in table)
    found = load_arms(path) if path.suffix == ".toml" and has_arms(path) else loading.load_file(path)
    # imported here: a file that cannot be read needs no engine
    from cosim.build.file_checks import check_arms, check_built, check_designs, check_robot, left_to_runs
    from cosim.plan.whole_ticks import rounding_warnings

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
    rounded = "".join(f"; warning: {text}" for text in chain.from_iterable(map(rounding_warnings, scenarios)))
    left = "; ".join(dict.fromkeys(chain.from_iterable(map(left_to_runs, scenarios))))
    return rounded + (left and f"; only a run shows: {left}")


def _check_search(path: Path, of_curves: bool) -> str:
    """Check the file of `cosim identify` (with curves) or `cosim design`; return as `_check_built` does."""
    # imported here, as few files need them
    from cosim.bench import design_problem, equilibria
    from cosim.config.benches import load_bench, load_design_study

    try:
        if not of_curves:
            design_problem.DesignProblem(load_design_study(path))
            return ""
        equilibria.Curves(*load_bench(path))
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError("", str(error)) from error
    return f"; which values the curves determine: cosim identify {path} --check"


def _checked(name: str, fine: str) -> bool:
    """Print the errors of a file, or that it has none; return whether it has none."""
    path = Path(name)
    faults: tuple[tuple[str, str], ...] = ()
    try:
        if menagerie.is_of_menagerie(name) or (resources.is_file(path) and arm_files.is_arm_file(path)):
            fine = f"{fine}: {_arm_line(name)}"
        else:
            fine += _check_built(path if resources.is_file(path) else resources.scenario_path(name))
    except ScenarioError as error:
        faults = error.faults
    for key, problem in faults:
        line = problem if key in ("", name) else f"{key}: {problem}"
        print(printable(f"{name}: {line}".replace("\n", " ")))
    if not faults:
        print(printable(f"{name}: {fine}"))
    return not faults
