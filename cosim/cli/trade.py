"""`cosim trade`: a scenario's speed against its accuracy, as a table, JSON and a plot."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TextIO, final

from cosim.app.driver import build_simulation, recorded
from cosim.app.run_files import OutputDirectory
from cosim.cli.screen import draw as draw_line
from cosim.cli.screen import printable, tell
from cosim.config.loading import load_scenario
from cosim.config.rules import check_ends
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.reading import parse_assignment
from cosim.recording import colours
from cosim.trade.candidates import Candidate, Truth, candidates_of
from cosim.trade.measuring import SLOWEST, Measured, Telling, compile_for_trade, measure
from cosim.trade.report import (
    Requirement,
    as_json,
    can_draw,
    choice_lines,
    draw,
    markdown,
    parse_budget,
    parse_force,
    parse_tolerance,
    result_line,
)

TABLE, FIGURES, PLOT = "trade.md", "trade.json", "trade.png"


def trade_command(
    scenario_name: str,
    out: Path,
    *,
    budget: str | None = None,
    tolerance: str | None = None,
    force_tolerance: str | None = None,
    assignments: Sequence[str] = (),
    quick: bool = False,
    time_scale: float = 1.0,
    truth: Truth = "finest",
    slowest: str = f"{SLOWEST}x",
) -> int:
    """Run a scenario's candidates, write table, JSON and plot; return 1 if none meets the requirement.

    Args:
        scenario_name: name or path.
        out: directory of the results.
        budget: least real-time factor, such as "1.0x".
        tolerance: largest tip error, such as "1mm".
        force_tolerance: largest error of the flange force's mean over 40 ms, such as "0.1N".
        assignments: changes to the scenario, texts of the form key=value.
        quick: fewer candidates.
        time_scale: factor on the duration of every phase.
        truth: what a choice is measured against.
        slowest: real-time factor below which a candidate is stopped, such as "0.05x".

    Raises:
        InputError: wrong words, or a directory that cannot be written; nothing was run.
    """
    requirement = _requirement(budget, tolerance, force_tolerance)
    bound = parse_budget(slowest)
    scenario = load_scenario(scenario_name, dict(map(parse_assignment, assignments)))
    check_ends(scenario)
    scenario = replace(scenario, fidelity="lumped", auto=None)
    candidates = candidates_of(scenario, quick=quick, time_scale=time_scale, truth=truth)
    with OutputDirectory(out) as directory:
        compile_for_trade(scenario, tell, (colours,))
        progress = TradeProgress(sys.stderr, len(candidates))
        results = measure(
            scenario, candidates, build_simulation, progress.telling, follow=recorded, slowest=bound
        )
        _write(directory, scenario, results, requirement)
    if requirement is None:
        return 0
    line = choice_lines(results, requirement)
    print(printable(line))
    return int(line.startswith("No candidate"))


def _write(
    directory: OutputDirectory,
    scenario: Scenario,
    results: Sequence[Measured],
    requirement: Requirement | None,
) -> None:
    table = markdown(scenario.title, results)
    print(
        printable(table), flush=True
    )  # before anything is written: what took long must not be lost with a full disk
    directory.make()
    directory.claim(TABLE, FIGURES, PLOT)
    directory.write(TABLE, table)
    directory.write(FIGURES, as_json(scenario.name, results, requirement))
    if can_draw():
        draw(scenario.title, results, directory.path / PLOT)
    else:
        tell("no plot: it needs matplotlib (pip install matplotlib)")


def _requirement(budget: str | None, tolerance: str | None, force: str | None) -> Requirement | None:
    if budget is None and tolerance is None and force is None:
        return None
    return Requirement(
        None if budget is None else parse_budget(budget),
        None if tolerance is None else parse_tolerance(tolerance),
        None if force is None else parse_force(force),
    )


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
        self._write(f"{start}{self._head} {result_line(result)}\n")

    @property
    def _head(self) -> str:
        return f"[{self._place + 1}/{self._count}]"

    def _write(self, text: str) -> None:
        draw_line(text, self._stream)
