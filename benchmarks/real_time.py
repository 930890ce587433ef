"""How fast every scenario runs while it is recorded, counts that hold on any machine, and its tick's error.

    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] [--repeats 7] [--json FILE]
    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] --accuracy [--json FILE]
    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] --against KEY=VALUE [--repeats 3] [--accuracy]
    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] --before-version FOLDER [--repeats 3]
    python benchmarks/real_time.py --json FILE --before FILE --page docs/performance.md

Without names: all that come with cosim; `--set` changes them all. The factor is simulated time over CPU time
of the process in the loop over ticks, the median of the repeats, kernels compiled before. Of a tick, CPU time
of the thread, by which ticks are gathered as well: other work on the machine makes batches no smaller. One
batch in ten is left out of all times: in it calls of functions from Python are counted, the median of these
batches is told. Tangents, gradients and shifted tangents are counted in all ticks, those that plan and state
at rest have taken before the first tick apart from them.

`--accuracy`: instead, the largest distance of the tip, and of what can move, from the same scenario with a
tick a quarter as long, for dynamic scenarios in which the soft robot touches something.

`--against`: instead, CPU time of the loop over that with another value, such as
`solver.integrator=implicit_euler`, without recording. Both are run in turn; median and range of the pairs.
Without names: arms in motion that grasp nothing, and run in real time. With `--accuracy`: the tip's largest
distance from a run with BDF2 and a quarter of the shorter tick, and the root mean square, of both.

`--before-version`: instead, the same CPU time over that of the version in a folder, with its own scenarios,
to which `--set` does not apply: `--set soft_robot.stack.mesh=drawn` compares versions on the mesh of both
where the older one has no graded meshes. The least time of each counts, and the range of the pairs is shown.
A first run of each compiles its kernels, and does not count.

`--json` keeps what was measured; a further call adds to it. `--page` writes the table of what a file holds
into a page and measures nothing more than names ask for; `--before` puts the factors of an earlier file
beside. `--version FOLDER` measures the version that lies in a folder, such as another work tree.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, fields
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.measure.page_tables import put_table
from benchmarks.measure.tally import Counts, Tally

_IN_MOTION = (
    "arm_around_bar", "bending_angle_control", "hexagon_arm_curls", "light_hexagon_arm", "pumped_arm",
    "tip_path", "ur5e_hexagon_arm",
)  # fmt: skip
_COUNTED_ONE_IN = 10  # batches
_HEAD = (
    "| scenario | model | tick, ms | before | times real time | 99 of 100 ticks within | tangents | shifted "
    "| gradients | calls | tangents before | tip, mm | objects, mm |"
)


@final
@dataclass(frozen=True)
class Timed:
    """What was timed and counted of a run.

    Args:
        simulated_s: time [s].
        spent_s: CPU time [s].
        ticks_s: CPU times of its ticks [s].
        plan: counts before the first tick.
        loop: counts of all ticks.
    """

    simulated_s: float
    spent_s: float
    ticks_s: list[float]
    plan: Counts
    loop: Counts

    @property
    def factor(self) -> float:
        """Times real time."""
        return self.simulated_s / self.spent_s


def label(name: str, changes: Mapping[str, Any]) -> str:
    """Return what a scenario with changes is called."""
    return " ".join([name, *(f"{key}={value}" for key, value in changes.items())])


def model_words(scenario: Any, nodes: int) -> str:
    """Return which arm, soft robot and mesh a scenario has."""
    robot = scenario.soft_robot.name + (", the paper's model" if scenario.model.published else "")
    fidelity = "" if scenario.fidelity == "lumped" else f", {scenario.fidelity}"
    statics = ", statics" if scenario.mode == "quasistatic" else ""
    arm = "" if scenario.robot == "none" else f"{scenario.robot}, "
    return f"{arm}{robot}{fidelity}, {nodes} nodes{statics}"


def speed_of(name: str, changes: Mapping[str, Any], repeats: int, tally: Tally) -> dict[str, Any]:
    """Return how fast a scenario runs, and counts of a tick in the mean."""
    import numpy as np

    counted: list[float] = []
    found: dict[str, Any] = {}
    runs = [run_once(name, changes, tally, counted, found) for _ in range(repeats)]
    ticks = repeats * found["ticks"]
    per_tick = {
        what.name: sum(getattr(run.loop, what.name) for run in runs) / ticks for what in fields(Counts)
    }
    late_s = float(np.median([np.percentile(run.ticks_s, 99) for run in runs]))
    factor = statistics.median(run.factor for run in runs)
    return {
        **found,
        "factor": factor,
        **({"p99_s": late_s} if found["mode"] == "dynamic" else {}),
        **per_tick,
        "tangents_before": statistics.median(run.plan.tangents for run in runs),
        **({"calls": statistics.median(counted)} if counted else {}),
    }


def run_once(
    name: str, changes: Mapping[str, Any], tally: Tally, counted: list[float], found: dict[str, Any]
) -> Timed:
    """Run a scenario; `counted` receives calls of a tick, batch by batch, `found` what it is."""
    from cosim.app.driver import build_simulation, prepared, recorded
    from cosim.config.loading import load_scenario
    from cosim.recording import rerun_recorder
    from cosim.stepping import dynamic, stepped_run

    for module in (dynamic, stepped_run, rerun_recorder):  # other work does not count
        vars(module)["time"] = SimpleNamespace(perf_counter=time.thread_time)
    plan, loop = Counts(), Counts()
    tally.now = plan
    scenario = prepared(load_scenario(name, changes or None), lambda _: None, recording=True)
    run = build_simulation(scenario)
    simulated_s, spent_s, ticks_s, here_s = 0.0, 0.0, [], 0.0
    with recorded(scenario, run.stage) as observe:
        batches = iter(run.batches())
        for number in count():
            counts = number % _COUNTED_ONE_IN == 1
            tally.calls = 0
            began = time.process_time()
            with tally.counting_calls() if counts else nullcontext():
                batch = next(batches, None)
                if batch is not None:
                    observe(batch)
            took_s = time.process_time() - began
            if batch is None:
                break
            before_s, here_s = here_s, float(batch.time_s[-1])
            if counts:
                counted.append(tally.calls / len(batch))
            elif number:  # the first one begins with finding the state at rest
                simulated_s, spent_s = simulated_s + here_s - before_s, spent_s + took_s
                ticks_s += batch.tick_wall_s.tolist()
            else:
                tally.now = loop
                nodes = len(batch.snapshot(0).node_position)
                found.update(model=model_words(scenario, nodes), tick_s=run.stage.tick_s)
                found.update(ticks=run.stage.ticks, mode=scenario.mode)
    return Timed(simulated_s, spent_s, ticks_s, plan, loop)


def apart(name: str, *changes: Mapping[str, Any]) -> list[dict[str, float]]:
    """Return how far runs of a scenario are from the last one, every 20 ms [m]: tip, and what can move."""
    import numpy as np

    import cosim

    runs = [cosim.run(name, overrides=each, error=False) for each in changes]
    movable = [each.name for each in cosim.load_scenario(name).objects if each.mass_kg is not None]
    times = np.arange(0.0, min(run.time_s[-1] for run in runs) + 0.01, 0.02)
    sampled = [
        [
            np.transpose([np.interp(times, run.time_s, column) for column in curve.T])
            for curve in (run.tip_position, *(run.body_position[:, run.body(each)] for each in movable))
        ]
        for run in runs
    ]
    found = []
    for each in sampled[:-1]:
        tip, *objects = (
            np.linalg.norm(here - there, axis=1) for here, there in zip(each, sampled[-1], strict=True)
        )
        errors = {"tip_error_m": float(tip.max()), "tip_rms_m": float(np.sqrt((tip**2).mean()))}
        moved = {"object_error_m": float(np.max(objects))} if objects else {}
        found.append({**errors, **moved})
    return found


def accuracy_of(name: str, changes: Mapping[str, Any]) -> dict[str, float]:
    """Return how far a scenario is from itself with a quarter of its tick [m]; nothing without contact."""
    from cosim.config.loading import load_scenario

    own = load_scenario(name, changes or None)
    if own.mode != "dynamic" or not (own.objects or own.wires or own.contact.self_contact):
        return {}
    return apart(name, changes, {**changes, "clock.tick_s": own.clock.tick_s / 4.0})[0]


def spent_s(name: str, changes: Mapping[str, Any]) -> float:
    """Return the CPU time of a run's loop [s]."""
    from cosim.app.driver import build_simulation, prepared
    from cosim.config.loading import load_scenario

    scenario = prepared(load_scenario(name, changes or None), lambda _: None, recording=False)
    batches = iter(build_simulation(scenario).batches())
    next(batches)  # begins with finding the state at rest
    began = time.process_time()
    for _ in batches:
        pass
    return time.process_time() - began


def compare(name: str, changes: Mapping[str, Any], others: Mapping[str, Any], pairs: int) -> None:
    """Print what a scenario costs over what it costs with other values."""
    found = []
    for _ in range(pairs):
        here, there = spent_s(name, changes), spent_s(name, {**changes, **others})
        found.append(here / there)
    middle, cost = statistics.median(found), f"{here:.1f} and {there:.1f} s in the last pair"
    print(f"| {name} | {middle:.2f} | {min(found):.2f} to {max(found):.2f} | {cost} |", flush=True)


def spent_apart_s(name: str, options: argparse.Namespace, *, before: bool) -> float:
    """Return the CPU time of a run's loop in a separate process, of this version or the one before [s]."""
    changes = [each for change in options.changes for each in ("--set", change)]
    more = ["--version", str(options.before_version)] if before else changes
    command = [sys.executable, __file__, name, "--spent", *more]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1])


def compare_versions(name: str, options: argparse.Namespace) -> None:
    """Print what a scenario costs over what it cost in another version."""
    pairs = [
        [spent_apart_s(name, options, before=before) for before in (False, True)]
        for _ in range(options.repeats + 1)
    ][1:]  # the first ones compile
    found = [here / there for here, there in pairs]
    here, there = map(min, zip(*pairs, strict=True))  # other work on the machine only adds
    spread, cost = f"{min(found):.2f} to {max(found):.2f}", f"{here:.2f} and {there:.2f} s at least"
    print(f"| {name} | {here / there:.2f} | {spread} | {cost} |", flush=True)


def compare_accuracy(name: str, changes: Mapping[str, Any], others: Mapping[str, Any]) -> None:
    """Print how far a scenario is from a finer run, with its values and with other ones."""
    from cosim.config.loading import load_scenario

    both = [changes, {**changes, **others}]
    tick_s = min(load_scenario(name, each or None).clock.tick_s for each in both) / 4.0
    found = apart(name, *both, {**changes, "clock.tick_s": tick_s, "solver.integrator": "bdf2"})
    errors = (f"{1e3 * each['tip_error_m']:.2f} ({1e3 * each['tip_rms_m']:.2f})" for each in found)
    print(f"| {name} | {' | '.join(errors)} |", flush=True)


def row(name: str, found: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    """Return a line of the table."""

    def shown(key: str, digits: int, scale: float = 1.0) -> str:
        return f"{scale * found[key]:.{digits}f}" if key in found else ""

    earlier = f"{before[name]['factor']:.2f}" if "factor" in before.get(name, {}) else ""
    late = f"{found['p99_s'] / found['tick_s']:.2f} ticks" if "p99_s" in found else ""
    tip = f"{shown('tip_error_m', 2, 1e3)} ({shown('tip_rms_m', 2, 1e3)})" if "tip_error_m" in found else ""
    cells = [
        name, str(found.get("model", "")), f"{1e3 * found['tick_s']:g}" if "tick_s" in found else "", earlier,
        shown("factor", 2), late, shown("tangents", 2), shown("shifted", 2), shown("gradients", 1),
        shown("calls", 0), shown("tangents_before", 0), tip, shown("object_error_m", 2, 1e3),
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def table(found: Mapping[str, Any], before: Mapping[str, Any]) -> str:
    """Return what a file holds as Markdown."""
    rows = [row(name, figures, before) for name, figures in sorted(found.items())]
    return "\n".join([_HEAD, "|---|---|" + "---:|" * 11, *rows])


def options_of() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--accuracy", action="store_true")
    parser.add_argument("--against", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--version", type=Path, metavar="FOLDER")
    parser.add_argument("--before-version", type=Path, metavar="FOLDER")
    parser.add_argument("--spent", action="store_true", help=argparse.SUPPRESS)  # asked of itself
    return parser.parse_args()


def compare_all(options: argparse.Namespace, changes: Mapping[str, Any]) -> bool:
    """Print what costs are compared with; return whether options ask for that."""
    from cosim.config.toml.reading import parse_assignment

    if options.spent:
        print(spent_s(options.names[0], changes))
        return True
    others = dict(map(parse_assignment, options.against))
    if not (others or options.before_version):
        return False
    for name in options.names or _IN_MOTION:
        if options.before_version:
            compare_versions(name, options)
        elif options.accuracy:
            compare_accuracy(name, changes, others)
        else:
            compare(name, changes, others, options.repeats)
    return True


def main() -> None:
    """Measure, keep and print."""
    options = options_of()
    if options.version:
        sys.path.insert(0, str(options.version.resolve()))
    from cosim.config.toml.reading import parse_assignment

    changes = dict(parse_assignment(each) for each in options.changes)
    if compare_all(options, changes):
        return
    before = json.loads(options.before.read_text()) if options.before else {}
    kept = options.json is not None and options.json.exists()
    found: dict[str, dict[str, Any]] = json.loads(options.json.read_text()) if kept else {}
    tally = Tally()
    if not options.accuracy:
        tally.watch()
    from cosim.base.resources import list_scenarios
    from cosim.config.several_arms import has_arms  # older versions have none

    shipped = [name for name in list_scenarios() if not has_arms(name)]
    for name in options.names or ([] if options.page else shipped):
        key = label(name, changes)
        new = (
            accuracy_of(name, changes)
            if options.accuracy
            else speed_of(name, changes, options.repeats, tally)
        )
        found[key] = found.get(key, {}) | new
        print(row(key, found[key], before), flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=2) + "\n")
    if options.page:
        put_table(options.page, "real time", table(found, before))


if __name__ == "__main__":
    main()
