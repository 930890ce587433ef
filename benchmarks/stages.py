"""Where the time of whole commands goes: start-up, ticks, recording and files, error bars.

    python benchmarks/stages.py [NAME ...] [--repeats 3] [--no-error] [--page docs/performance.md]

A run states the wall time of its stages in summary.json, and that of each tick among its results. CPU time of
the command, all threads, is divided in proportion to these, since other work on the machine delays all stages
alike. Start-up is from the command to the first tick, "recording, files" what is left: summary, recording and
files, within the loop and after it. "one value changed" plans again, all else is in the caches: the first run
of each command fills them and does not count. The least of the repeats counts, as other work only adds.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cosim
from benchmarks.measure.page_tables import put_table
from benchmarks.real_time import spent

COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "flagship": ("ur5e_hexagon_arm",),
    "one value changed": ("ur5e_hexagon_arm", "phase.inflate.pressure_Pa"),
    "section": ("ur5e_hexagon_arm", "fidelity=section"),
    "published": ("ur5e_hexagon_arm", "model.published=true"),
    "roll": ("gripper_lifts_roll",),
    "curls": ("hexagon_arm_curls",),
    "closes on itself": ("gripper_closes_on_itself",),
    "three units": ("three_unit_inflation",),
}
"""Scenario and changes KEY=VALUE of each column; a key alone gets another pressure in each run."""
STAGES: Final = ("start-up", "ticks", "recording, files", "error bars", "sum")


def _new_pressure_Pa() -> float:
    return round(29_000.0 + time.time() % 900.0, 3)


def stages(name: str, changes: Sequence[str], *more: str) -> tuple[float, ...]:
    """Run a scenario by the command, and return the CPU time of each of `STAGES` [s].

    Args:
        name: of a scenario or a file.
        changes: KEY=VALUE.
        more: arguments of `cosim run`.
    """
    words = [word for change in changes for word in ("--set", change)]
    before_s = spent("list")[0]  # interpreter and command line, of which the summary knows nothing
    with TemporaryDirectory() as folder:
        wall_s, cpu_s = spent("run", name, "--out", f"{folder}/run", "--quiet", *words, *more)
        result = cosim.load_run(Path(folder, "run"))
    summary = result.summary
    start_s, ticks_s = before_s + summary["startup_s"], float(result.tick_wall_s[1:].sum())
    error_s = summary["error"]["wall_s"]
    found = start_s, ticks_s, wall_s - start_s - ticks_s - error_s, error_s, wall_s
    return tuple(cpu_s / wall_s * each for each in found)


def least(name: str, changes: Sequence[str], repeats: int, *more: str) -> tuple[float, ...]:
    """Return the stages of the quickest of so many commands, after one that fills the caches."""
    runs = []
    for _ in range(repeats + 1):
        values = [change if "=" in change else f"{change}={_new_pressure_Pa()}" for change in changes]
        runs.append(stages(name, values, *more))
    return min(runs[1:], key=lambda found: found[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help=f"of {', '.join(COMMANDS)}; or scenarios")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--no-error", action="store_true")
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    more = ("--no-error",) if options.no_error else ()
    names = options.names or list(COMMANDS)
    columns = []
    for name in names:
        scenario, *changes = COMMANDS.get(name, (name,))
        columns.append(least(scenario, changes, options.repeats, *more))
        cells = (f"{stage} {cpu_s:.1f}" for stage, cpu_s in zip(STAGES, columns[-1], strict=True))
        print(f"{name}: {', '.join(cells)}", file=sys.stderr)
    rows = [f"| CPU s | {' | '.join(names)} |", "|---|" + "---:|" * len(names)]
    for stage, values in zip(STAGES, zip(*columns, strict=True), strict=True):
        rows.append(f"| {stage} | {' | '.join(f'{value:.1f}' for value in values)} |")
    print("\n".join(rows))
    if options.page:
        put_table(options.page, "stages", "\n".join(rows))


if __name__ == "__main__":
    main()
