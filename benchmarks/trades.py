"""Runs a trade of docs/trade.md anew, and puts its tables, picture and choices into the document.

    python benchmarks/trades.py reference    # about 3 minutes of an idle core
    python benchmarks/trades.py grasp        # about 2 minutes

Writes docs/trade_NAME.png and docs/trade_NAME.json, and replaces what stands between the marks of that
name in docs/trade.md.
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

from cosim.driver import build_simulation
from cosim.scenario.loading import load_scenario
from cosim.trade.choice import Wish
from cosim.trade.measuring import Measured, measure
from cosim.trade.members import members_of
from cosim.trade.plot import draw
from cosim.trade.report import as_json, choice_lines, markdown

DOCS = Path(__file__).resolve().parents[1] / "docs"


@dataclass(frozen=True)
class Trade:
    """What is run for the document.

    Args:
        scenario: name.
        changes: to it, by key path.
        quick: fewer members, no refined mesh.
        time_scale: factor on the phases' durations.
        wishes: whose choices are shown.
    """

    scenario: str
    changes: Mapping[str, Any]
    quick: bool
    time_scale: float
    wishes: tuple[Wish, ...]


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
TRADES = {
    "reference": Trade("ur5e_hexagon_arm", {}, False, 0.5, (Wish(tolerance_m=1e-3), Wish(budget=1.0))),
    "grasp": Trade("gripper_lifts_roll", SHORT_GRASP, True, 1.0, (Wish(tolerance_m=5e-3), Wish(budget=0.5))),
}


def tables(results: list[Measured]) -> str:
    """Return the tables without their title."""
    text = markdown("", results).split("## ", 1)[1]
    return "### " + text.replace("\n## ", "\n### ")


def main() -> int:
    """Run one trade, write its files; return 1 where no member meets a wish."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trade", choices=tuple(TRADES))
    name = parser.parse_args().trade
    trade = TRADES[name]
    from cosim.rigid.compilation import KERNEL_MODULES
    from cosim.soft.compilation import compile_kernels

    compile_kernels(print, KERNEL_MODULES)
    scenario = load_scenario(trade.scenario, trade.changes)
    members = members_of(scenario, quick=trade.quick, time_scale=trade.time_scale)
    began = time.process_time()
    results = measure(
        scenario, members, build_simulation, lambda r: print(r.member.name, r.failure, flush=True)
    )
    spent = time.process_time() - began
    choices = [choice_lines(results, wish) for wish in trade.wishes]
    draw(scenario.title, results, DOCS / f"trade_{name}.png")
    (DOCS / f"trade_{name}.json").write_text(as_json(scenario.name, results, None), encoding="utf-8")
    picture = f"![errors of tip and flange force against the real-time factor](trade_{name}.png)\n"
    body = "\n".join([picture, tables(results), *(f"- {line}" for line in choices)])
    document = DOCS / "trade.md"
    begin, end = f"<!-- {name}: made by benchmarks/trades.py -->\n", f"<!-- end of {name} -->\n"
    before, rest = document.read_text(encoding="utf-8").split(begin)
    document.write_text(before + begin + "\n" + body + "\n" + end + rest.split(end)[1], encoding="utf-8")
    print(body, f"\n{spent:.0f} s of CPU time")
    return int(any(line.startswith("No member") for line in choices))


if __name__ == "__main__":
    sys.exit(main())
