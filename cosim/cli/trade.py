"""`cosim trade`: a scenario's speed against its accuracy, as a table, JSON and a plot."""

from __future__ import annotations

import sys
from pathlib import Path

from cosim.driver import build_simulation
from cosim.errors import InputError
from cosim.run_files import check_directory
from cosim.scenario.loading import load_scenario
from cosim.soft.compilation import compile_kernels
from cosim.trade.choice import Wish, parse_budget, parse_tolerance
from cosim.trade.measuring import Measured, measure
from cosim.trade.members import members_of
from cosim.trade.plot import can_draw, draw
from cosim.trade.report import as_json, choice_lines, markdown

TABLE, FIGURES, PLOT = "trade.md", "trade.json", "trade.png"


def trade_command(
    scenario_name: str,
    out: Path,
    *,
    budget: str | None = None,
    tolerance: str | None = None,
    quick: bool = False,
    time_scale: float = 1.0,
) -> int:
    """Run a scenario's members, write table, JSON and plot; return 0, or 1 if no member meets the wish.

    Args:
        scenario_name: name or path.
        out: directory of the results.
        budget: least real-time factor, such as "1.0x".
        tolerance: largest tip error, such as "1mm".
        quick: fewer members.
        time_scale: factor on the duration of every phase.

    Raises:
        InputError: wrong words, or a directory that cannot be written; nothing was run.
    """
    wish = _wish(budget, tolerance)
    scenario = load_scenario(scenario_name)
    members = members_of(scenario, quick=quick, time_scale=time_scale)
    check_directory(out)
    compile_kernels(_tell)
    results = measure(scenario, members, build_simulation, lambda result: _tell(_line(result)))
    out.mkdir(parents=True, exist_ok=True)
    table = markdown(scenario.title, results)
    (out / TABLE).write_text(table, encoding="utf-8")
    (out / FIGURES).write_text(as_json(scenario.name, results, wish), encoding="utf-8")
    print(table)
    if can_draw():
        draw(scenario.title, results, out / PLOT)
    else:
        _tell("no plot: it needs matplotlib (pip install matplotlib)")
    if wish is None:
        return 0
    line = choice_lines(results, wish)
    print(line)
    return int(line.startswith("No member"))


def _wish(budget: str | None, tolerance: str | None) -> Wish | None:
    if budget is not None and tolerance is not None:
        raise InputError("give --budget or --tolerance, not both")
    if budget is not None:
        return parse_budget(budget)
    return None if tolerance is None else parse_tolerance(tolerance)


def _line(result: Measured) -> str:
    if result.failure:
        return f"{result.member.name}: failed: {result.failure}"
    return (
        f"{result.member.name}: x{result.real_time_factor:.2f} real time, "
        f"tip {1e3 * result.tip_error_m:.3g} mm, force {result.force_error_N:.3g} N"
    )


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
