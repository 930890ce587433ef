"""How fast every scenario runs while it is recorded: CPU real-time factor, and counts that hold anywhere.

    python benchmarks/real_time.py [NAME ...] [--repeats 7] [--json FILE] [--before FILE]

Without names: all that come with cosim, at their own settings. The factor is simulated time over CPU time of
the process in the loop over ticks, the median of the repeats, kernels compiled before. One batch of ticks
in ten is counted instead of timed: new tangents, gradients, and calls of Python and C functions from Python.
Times of ticks are wall times: they want an idle machine. `--before` puts the factors of an earlier `--json`
beside.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any, final

os.environ.setdefault("OMP_NUM_THREADS", "1")

_COUNTED_ONE_IN = 10  # batches


@final
@dataclass
class Tally:
    """What has happened while batches were counted."""

    tangents: int = 0
    gradients: int = 0
    calls: int = 0
    ticks: int = 0
    counting: bool = False

    def event(self, _frame: object, event: str, _what: object) -> None:
        """Take note of a call, as `sys.setprofile` tells it."""
        self.calls += event in ("call", "c_call")

    def watch(self) -> None:
        """Count from now on what every solver evaluates."""
        from cosim.soft.solve.problem import Problem

        evaluate: Any = Problem.at

        def counted(problem: Problem, *places: Any, hessian: bool = False) -> Any:
            self.tangents += hessian and self.counting
            self.gradients += self.counting
            return evaluate(problem, *places, hessian=hessian)

        setattr(Problem, "at", counted)  # noqa: B010


@final
@dataclass(frozen=True)
class Speed:
    """How fast a scenario ran; counts are of a tick in the mean."""

    simulated_s: float
    ticks: int
    factor: float
    p99_ms: float
    tangents: float
    gradients: float
    calls: float


def run_once(name: str, tally: Tally) -> tuple[float, float, list[float]]:
    """Return simulated and CPU time of what was timed of a run, and the wall times of its ticks [s]."""
    from cosim.app.driver import build_simulation, recorded
    from cosim.app.first_run import prepared
    from cosim.config.loading import load_scenario

    scenario = prepared(load_scenario(name), lambda _: None, recording=True)
    run = build_simulation(scenario)
    simulated_s, spent_s, walls, here_s = 0.0, 0.0, [], 0.0
    with recorded(scenario, run.stage) as observe:
        batches = iter(run.batches())
        for number in count():
            tally.counting = number % _COUNTED_ONE_IN == 1
            sys.setprofile(tally.event if tally.counting else None)
            began = time.process_time()
            batch = next(batches, None)
            if batch is not None:
                observe(batch)
            sys.setprofile(None)
            took_s = time.process_time() - began
            if batch is None:
                break
            before_s, here_s = here_s, float(batch.time_s[-1])
            if tally.counting:
                tally.ticks += len(batch)
            elif number:  # the first one begins with finding the state at rest
                simulated_s, spent_s = simulated_s + here_s - before_s, spent_s + took_s
                walls += batch.tick_wall_s.tolist()
    return simulated_s, spent_s, walls


def speed_of(name: str, repeats: int, tally: Tally) -> Speed:
    """Return how fast a scenario runs."""
    import numpy as np

    tally.tangents = tally.gradients = tally.calls = tally.ticks = 0
    runs = [run_once(name, tally) for _ in range(repeats)]
    ticks = max(tally.ticks, 1)
    return Speed(
        sum(simulated for simulated, _, _ in runs),
        sum(len(walls) for _, _, walls in runs),
        statistics.median(simulated / spent for simulated, spent, _ in runs),
        1e3 * float(np.median([np.percentile(walls, 99) for _, _, walls in runs])),
        tally.tangents / ticks,
        tally.gradients / ticks,
        tally.calls / ticks,
    )


def row(name: str, speed: Speed, before: dict[str, dict[str, float]]) -> str:
    """Return a line of the table."""
    earlier = f"{before[name]['factor']:.2f}" if name in before else "-"
    return (
        f"| {name} | {earlier} | {speed.factor:.2f} | {speed.p99_ms:.1f} | {speed.tangents:.2f} "
        f"| {speed.gradients:.1f} | {speed.calls:.0f} |"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--before", type=Path)
    options = parser.parse_args()
    from cosim.base.resources import list_scenarios

    before = json.loads(options.before.read_text()) if options.before else {}
    tally, found = Tally(), {}
    tally.watch()
    print(
        "| scenario | before | times real time | p99 of a tick [ms] | tangents | gradients | calls a tick |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name in options.names or list_scenarios():
        speed = speed_of(name, options.repeats, tally)
        found[name] = asdict(speed)
        print(row(name, speed, before), flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
