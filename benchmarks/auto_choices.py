"""What `fidelity = "auto"` chooses for the scenarios of docs/trade.md, and whether the run that follows
meets the requirement.

Every requirement goes the user's way: the figures are measured once (in an empty cache directory), the
choice is made, and the chosen scenario is run as `cosim run` runs it, recording on. Speed is then that of
this run; errors are those of its tip, objects and mean flange force against the reference candidate, run
once more.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cosim.app.driver import Options, build_simulation, execute, recorded, rerun_recorder
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch
from cosim.trade.candidates import Candidate, durations, short_candidates
from cosim.trade.measuring import FORCE_MEAN, Curve, CurveBuilder, compared, trace
from cosim.trade.report import Requirement, chosen_fidelity


@dataclass
class CurveWatcher:
    """Keeps the curve of a run, and the time it takes.

    Args:
        scenario: that is run.
    """

    scenario: Scenario

    def open(self, stage: RunInfo) -> None:
        """The run begins."""
        self._builder = CurveBuilder(self.scenario, stage)
        self._began = time.process_time()

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        self._builder.observe(batch)

    def close(self) -> None:
        """The run has ended."""
        self.curve = self._builder.curve(time.process_time() - self._began)


def check_choices(trades: Mapping[str, Any], figures: Path) -> tuple[str, bool]:
    """Return a table of all requirements, and whether every one is met.

    Args:
        trades: what is run, and the requirements; see benchmarks/trades.py.
        figures: the file that the rows are written to, as JSON.
    """
    rows = []
    for trade in trades.values():
        scenario = load_scenario(trade.scenario, trade.changes)
        scenario = load_scenario(scenario, durations(scenario, trade.time_scale))
        reference: Curve | None = None
        with tempfile.TemporaryDirectory() as cache:
            for requirement in trade.requirements:
                try:
                    chosen = _chosen(scenario, requirement, Path(cache))
                except ScenarioError as error:  # nothing meets it
                    print(error, flush=True)
                    rows.append(_refused(scenario, requirement))
                    continue
                if reference is None:  # after the measurement, when everything is loaded
                    finest = short_candidates(scenario)[0]
                    reference = trace(load_scenario(scenario, finest.changes), build_simulation)
                rows.append(_row(scenario, requirement, chosen, reference))
                print(_line(rows[-1]), flush=True)
    figures.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    head = [
        "| scenario | requirement | chosen | as measured for the choice | the run: real-time factor (wall) "
        f"| (CPU) | position [mm] | force, {FORCE_MEAN} [N] | met |",
        "|---|---|---|---|---:|---:|---:|---:|---|",
    ]
    return "\n".join([*head, *map(_line, rows)]), all(row["met"] for row in rows)


def _chosen(scenario: Scenario, requirement: Requirement, cache: Path) -> Scenario:
    words = {
        "auto.budget": requirement.budget,
        "auto.tolerance_m": requirement.tolerance_m,
        "auto.force_tolerance_N": requirement.force_N,
    }
    given = {key: value for key, value in words.items() if value is not None}
    asking = load_scenario(scenario, {"fidelity": "auto", **given})
    return chosen_fidelity(asking, build_simulation, cache, lambda text: print(text, flush=True), recorded)


def _refused(scenario: Scenario, requirement: Requirement) -> dict[str, Any]:
    """Return the row of a requirement that no candidate meets."""
    figures = ("real_time_factor_wall", "real_time_factor_cpu", "position_error_m", "force_error_N")
    row = {"scenario": scenario.name, "requirement": requirement.words, "chosen": "none", "measured": ""}
    return {**row, **dict.fromkeys(figures), "met": False}


def _row(scenario: Scenario, requirement: Requirement, chosen: Scenario, reference: Curve) -> dict[str, Any]:
    """Run what was chosen, and compare it with the requirement."""
    watcher = CurveWatcher(chosen)
    with tempfile.TemporaryDirectory() as directory:
        options = Options(Path(directory) / "run", rerun_recorder, [watcher])
        outcome = execute(chosen, build_simulation, options, time.perf_counter())
    if outcome.error is not None:
        raise outcome.error
    assert chosen.auto is not None
    assert chosen.auto.chosen is not None
    name, _, figures = chosen.auto.chosen.partition(": ")
    run = compared(Candidate(name, "time", {}), watcher.curve, reference)
    wall_factor = float(outcome.summary["real_time_factor"])
    # on a machine with other work the wall time says nothing; on an idle one both are met
    best = replace(run, real_time_factor=max(wall_factor, run.real_time_factor))
    return {
        "scenario": scenario.name,
        "requirement": requirement.words,
        "chosen": name,
        "measured": figures,
        "real_time_factor_wall": wall_factor,
        "real_time_factor_cpu": run.real_time_factor,
        "position_error_m": run.position_error_m,
        "force_error_N": run.force_error_N,
        "met": requirement.met_by(best),
    }


def _line(row: Mapping[str, Any]) -> str:
    def number(key: str, factor: float = 1.0) -> str:
        return "" if row[key] is None else f"{factor * row[key]:.3g}"

    cells = [
        f"`{row['scenario']}`",
        row["requirement"],
        row["chosen"],
        row["measured"],
        number("real_time_factor_wall"),
        number("real_time_factor_cpu"),
        number("position_error_m", 1e3),
        number("force_error_N"),
        "yes" if row["met"] else "**no**",
    ]
    return "| " + " | ".join(cells) + " |"
