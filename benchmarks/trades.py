"""Run the trades of docs/trade.md, and put their tables, pictures and choices into the document.

    python benchmarks/trades.py reference grasp

The exit code is 1 where a requirement is not met.

Writes docs/trade_NAME.json, of a trade docs/trade_NAME.png as well, and replaces what stands between the
marks of that name in docs/trade.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cosim.app.driver import build_simulation, recorded
from cosim.cli.trade import TradeProgress
from cosim.config.loading import load_scenario
from cosim.recording import colours
from cosim.trade.candidates import candidates_of
from cosim.trade.measuring import Measured, compile_for_trade, measure
from cosim.trade.report import Requirement, as_json, choice_lines, draw, markdown

DOCS = Path(__file__).resolve().parents[1] / "docs"


@dataclass(frozen=True)
class Trade:
    """What is run for the document.

    Args:
        scenario: name.
        changes: to it, by key path.
        quick: fewer candidates, no refined mesh.
        time_scale: factor on the phases' durations.
        requirements: whose choices are shown.
    """

    scenario: str
    changes: Mapping[str, Any]
    quick: bool
    time_scale: float
    requirements: tuple[Requirement, ...]


SHORT_GRASP = {
    "phase.inflate.duration_s": 0.4,
    "phase.lower.duration_s": 0.5,
    "phase.close.duration_s": 0.6,
    "phase.close.settle_s": 0.1,
    "phase.lift.duration_s": 0.6,
    "phase.shake.duration_s": 0.76,
    "phase.shake.flange_shake": {"axis": [1.0, 0.0, 0.0], "amplitude_m": 0.005, "frequency_Hz": 4.0},
    "phase.hold.duration_s": 0.1,
}
ARM_ASKED = (Requirement(tolerance_m=1e-3), Requirement(budget=1.0))
GRASP_ASKED = (Requirement(tolerance_m=5e-3), Requirement(budget=0.25))
TRADES = {
    "reference": Trade("ur5e_hexagon_arm", {}, False, 0.5, ARM_ASKED),
    "grasp": Trade("gripper_lifts_roll", SHORT_GRASP, True, 1.0, GRASP_ASKED),
}


def tables(results: list[Measured]) -> str:
    """Return the tables without their title."""
    text = markdown("", results).split("## ", 1)[1]
    return "### " + text.replace("\n## ", "\n### ")


def run_trade(name: str) -> tuple[str, bool]:
    """Run one trade and write its files; return what the document shows, whether requirements are met."""
    trade = TRADES[name]
    scenario = load_scenario(trade.scenario, trade.changes)
    compile_for_trade(scenario, print, (colours,))
    candidates = candidates_of(scenario, quick=trade.quick, time_scale=trade.time_scale)
    telling = TradeProgress(sys.stdout, len(candidates)).telling
    results = measure(scenario, candidates, build_simulation, telling, follow=recorded)
    choices = [choice_lines(results, requirement) for requirement in trade.requirements]
    draw(scenario.title, results, DOCS / f"trade_{name}.png")
    (DOCS / f"trade_{name}.json").write_text(as_json(scenario.name, results, None), encoding="utf-8")
    picture = f"![errors of tip and flange force's mean against the real-time factor](trade_{name}.png)\n"
    body = "\n".join([picture, tables(results), *(f"- {line}" for line in choices)])
    return body, not any(line.startswith("No candidate") for line in choices)


def put_into_document(name: str, body: str) -> None:
    """Replace what stands between the marks of a name in the document."""
    document = DOCS / "trade.md"
    begin, end = f"<!-- {name}: made by benchmarks/trades.py -->\n", f"<!-- end of {name} -->\n"
    before, rest = document.read_text(encoding="utf-8").split(begin)
    text = before + begin + "\n" + body + "\n" + end + rest.split(end)[1]
    document.write_text(text, encoding="utf-8")


def main() -> int:
    """Run what is asked for and write its files; return 1 where a requirement is not met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="+", choices=tuple(TRADES))
    all_met = True
    for name in parser.parse_args().names:
        began = time.process_time()
        body, met = run_trade(name)
        put_into_document(name, body)
        print(body, f"\n{time.process_time() - began:.0f} s of CPU time", flush=True)
        all_met = all_met and met
    return int(not all_met)


if __name__ == "__main__":
    sys.exit(main())
