"""`cosim trade`: a scenario's speed against its accuracy, as a table, JSON and a plot."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TextIO, final

from cosim.app.driver import build_simulation, recorded
from cosim.app.run_files import OutputDirectory, default_directory
from cosim.cli.screen import draw as draw_line
from cosim.cli.screen import printable, tell
from cosim.config import loading, rules
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.recording import colours
from cosim.trade import report
from cosim.trade.candidates import Candidate, candidates_of
from cosim.trade.measuring import Measured, Telling, compile_for_trade, measure

TABLE, FIGURES, PLOT = "trade.md", "trade.json", "trade.png"


def trade_command(options: argparse.Namespace) -> int:
    """Run a scenario's candidates, write table, JSON and plot; return 1 if none meets the requirement.

    Args:
        options: of the command line.

    Raises:
        InputError: wrong words, or a directory that cannot be written; nothing was run.
    """
    requirement, bound = _requirement(options), report.parse_budget(options.slowest)
    scenario = loading.load_scenario(options.scenario, dict(map(parse_assignment, options.assignments)))
    rules.check_ends(scenario)
    scenario = replace(scenario, fidelity="lumped")
    candidates = candidates_of(
        scenario, quick=options.quick, time_scale=options.scale_time, truth=options.against
    )
    out = options.out or default_directory(f"trade_{Path(options.scenario).stem}")
    with OutputDirectory(out) as directory:
        compile_for_trade(scenario, tell, (colours,))
        telling = TradeProgress(sys.stderr, len(candidates)).telling
        results = measure(scenario, candidates, build_simulation, telling, follow=recorded, slowest=bound)
        _write(directory, scenario, results, requirement)
    if requirement is None:
        return 0
    line = report.choice_lines(results, requirement)
    print(printable(line))
    return int(line.startswith("No candidate"))


def _write(
    directory: OutputDirectory,
    scenario: Scenario,
    results: Sequence[Measured],
    requirement: report.Requirement | None,
) -> None:
    table = report.markdown(scenario.title, results)
    # before anything is written: what took long must not be lost with a full disk
    print(printable(table), flush=True)
    directory.make()
    directory.claim(TABLE, FIGURES, PLOT)
    directory.write(TABLE, table)
    directory.write(FIGURES, report.as_json(scenario.name, results, requirement))
    try:
        report.draw(scenario.title, results, directory.path / PLOT)
    except InputError as error:
        tell(f"no plot: {error}")


def _requirement(options: argparse.Namespace) -> report.Requirement | None:
    given = (options.budget, options.tolerance, options.force_tolerance)
    readers = (report.parse_budget, report.parse_tolerance, report.parse_force)
    values = [None if text is None else read(text) for text, read in zip(given, readers, strict=True)]
    return None if values == [None] * 3 else report.Requirement(*values)


@final
class TradeProgress:
    """Draws one line that renews itself on a terminal, and one for every candidate that is done.

    Args:
        stream: where to draw, usually stderr.
        count: of candidates.
    """

    def __init__(self, stream: TextIO, count: int) -> None:
        self._stream, self._count = stream, count
        self._terminal = stream.isatty()
        self._place, self._name = 0, ""
        self.telling = Telling(self.begin, self.advance, self.done)

    def begin(self, place: int, candidate: Candidate) -> None:
        """A candidate begins."""
        self._place, self._name = place, candidate.name
        self.advance(0.0)

    def advance(self, fraction: float) -> None:
        """So much of its run is done; shown on a terminal only."""
        if self._terminal:
            self._write(f"\r\x1b[K{self._head} {self._name}: {100 * fraction:.0f} %")

    def done(self, result: Measured) -> None:
        """A candidate is done."""
        start = "\r\x1b[K" if self._terminal else ""
        self._write(f"{start}{self._head} {report.result_line(result)}\n")

    @property
    def _head(self) -> str:
        return f"[{self._place + 1}/{self._count}]"

    def _write(self, text: str) -> None:
        draw_line(text, self._stream)
