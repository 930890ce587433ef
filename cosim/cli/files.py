"""`cosim check`, `cosim upgrade`: scenario and robot files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cosim.base.resources import is_file, scenario_path
from cosim.cli.screen import printable
from cosim.config.loading import check_file
from cosim.config.schema.old_keys import SCHEMA
from cosim.config.upgrading import upgrade_file
from cosim.errors import InputError, ScenarioError


def check_command(files: Sequence[str]) -> bool:
    """Print a line for every fault of scenario and robot files; return whether all are fine.

    Args:
        files: paths, or names of scenarios that come with cosim.
    """
    fine = [_checked(name, "fine") for name in files]
    return all(fine)


def upgrade_command(files: Sequence[str]) -> bool:
    """Rewrite files of the schema number before, then check them; return whether all are fine.

    Raises:
        InputError: a file is not there, or cannot be rewritten; those before it have been.
        OutputError: a file cannot be written.
    """
    done = {}
    for name in files:
        if not is_file(Path(name)):
            raise InputError(f"upgrade {name}: no such file")
        count = upgrade_file(Path(name))
        done[name] = f"upgraded to schema {SCHEMA}, {count} changes" if count else "nothing to upgrade"
    fine = [_checked(name, text) for name, text in done.items()]
    return all(fine)


def _checked(name: str, fine: str) -> bool:
    """Print the faults of a file, or that it is fine; return whether it is."""
    path = Path(name)
    faults: tuple[tuple[str, str], ...] = ()
    try:
        check_file(path if is_file(path) else scenario_path(name))
    except ScenarioError as error:
        faults = error.faults
    for place, problem in faults:
        line = problem if place == name else f"{place}: {problem}"
        print(printable(f"{name}: {line}".replace("\n", " ")))
    if not faults:
        print(printable(f"{name}: {fine}"))
    return not faults
