"""The command `cosim trade`: measures a scenario's speed against its accuracy, and writes a table, a plot and
a recommended setting.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from cosim.app.output_directory import OutputDirectory
from cosim.app.preparation import warm_up
from cosim.cli.screen import printable, tell
from cosim.config import loading, rules
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.sweeps import trade, trade_choice, trade_report
from cosim.sweeps.candidates import candidates_of
from cosim.sweeps.engines import Engine
from cosim.sweeps.study_run import Tell

_LENGTHS_m: Final = {"mm": 1e-3, "um": 1e-6, "cm": 1e-2, "m": 1.0}


def trade_command(options: argparse.Namespace, progress: Tell) -> int:
    """Run a scenario's candidates, write table and plot; return 1 if none meets the requirement.

    Args:
        options: of the command line.
        progress: called with the progress of the candidates.

    Raises:
        InputError: an option is wrong, or the directory cannot be written; nothing was run.
    """
    requirement, slowest = _requirement(options), parse_budget(options.slowest)
    scenario = loading.load_scenario(options.scenario, dict(map(parse_assignment, options.assignments)))
    rules.check_ends(scenario)
    scenario = replace(scenario, fidelity="lumped")
    candidates = candidates_of(
        scenario, quick=options.quick, time_scale=options.scale_time, truth=options.against, slowest=slowest
    )
    with OutputDirectory(options.out or Path("runs", f"trade_{Path(options.scenario).stem}")) as directory:
        warm_up()
        results = trade.measure(scenario, candidates, directory, Engine(workers=1), options.modules, progress)
        table = trade_report.markdown(scenario.title, results)
        print(printable(table), flush=True)
        directory.write(trade.REPORT, table)
        try:
            trade_report.draw(scenario.title, results, directory.path / trade.PLOT)
        except InputError as error:
            tell(f"no plot: {error}")
    if requirement is None:
        return 0
    choice = trade_choice.choice_line(results, requirement)
    print(printable(choice))
    return int(choice.startswith("No candidate"))


def _requirement(options: argparse.Namespace) -> trade_choice.Requirement | None:
    given = (options.budget, options.tolerance, options.force_tolerance)
    readers = (parse_budget, parse_tolerance, parse_force)
    values = [None if text is None else read(text) for text, read in zip(given, readers, strict=True)]
    return None if values == [None] * 3 else trade_choice.Requirement(*values)


def parse_budget(text: str) -> float:
    """Return the real-time factor of a text such as "1.0x"."""
    return _positive(text, {"x": 1.0}, "a real-time factor, such as 1.0x")


def parse_tolerance(text: str) -> float:
    """Return the length [m] of a text such as "1mm"; metres if there is no unit."""
    return _positive(text, _LENGTHS_m, "a length, such as 1mm")


def parse_force(text: str) -> float:
    """Return the force [N] of a text such as "0.1N"."""
    return _positive(text, {"N": 1.0}, "a force, such as 0.1N")


def _positive(text: str, units: Mapping[str, float], wanted: str) -> float:
    """Return a positive number times its unit.

    Raises:
        InputError: the text is no such number.
    """
    number = text.strip()
    unit = next((unit for unit in units if number.endswith(unit)), "")
    try:
        value = float(number.removesuffix(unit)) * units.get(unit, 1.0)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise InputError(f"'{text}' is not {wanted}")
    return value
