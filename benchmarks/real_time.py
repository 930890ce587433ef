"""How long whole commands take: `cosim run` of scenarios, from the command to the prompt, kernels compiled.

    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] [--repeats 3] [--page docs/performance.md]
    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] --against KEY=VALUE [--repeats 3]
    python benchmarks/real_time.py [NAME ...] [--set KEY=VALUE] --against-version FOLDER [--repeats 3]

Without names: all that come with cosim. The least of the repeats counts, as other work only adds. CPU time is
of all threads; "loop" is the wall time of the ticks with their recording, as the summary states it.

`--against`: instead, commands with and without another value, in turn: median and range of the ratio of their
CPU times. `--against-version`: the same over the version in a folder, such as another work tree, with its own
scenarios, to which `--set` does not apply. The first pair fills caches and does not count.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.measure.page_tables import put_table

ROOT = Path(__file__).resolve().parents[1]
HEAD = (
    "| scenario | simulated, s | command, wall s | CPU s | loop, wall s | error bars, wall s "
    "| times real time: command | loop |"
)


@final
@dataclass(frozen=True)
class Command:
    """What a command took.

    Args:
        simulated_s: time of the run [s].
        wall_s: from the command to its end [s].
        cpu_s: of all its threads [s].
        loop_s: wall time of the ticks [s].
        error_s: wall time of the error bars [s].
    """

    simulated_s: float
    wall_s: float
    cpu_s: float
    loop_s: float
    error_s: float

    def row(self, name: str) -> str:
        """Return its line of the table."""
        cells = [
            name, f"{self.simulated_s:.2f}", f"{self.wall_s:.1f}", f"{self.cpu_s:.1f}", f"{self.loop_s:.1f}",
            f"{self.error_s:.1f}", f"{self.simulated_s / self.wall_s:.2f}",
            f"{self.simulated_s / self.loop_s:.2f}",
        ]  # fmt: skip
        return f"| {' | '.join(cells)} |"


def run(name: str, changes: Sequence[str] = (), version: Path = ROOT) -> Command:
    """Run a scenario by the command, recording and error bars included.

    Args:
        name: of a scenario or a file.
        changes: KEY=VALUE.
        version: folder of the version that runs it.
    """
    words = [word for change in changes for word in ("--set", change)]
    with TemporaryDirectory() as folder:
        wall_s, cpu_s = spent("run", name, "--out", f"{folder}/run", "--quiet", *words, version=version)
        summary = json.loads(Path(folder, "run", "summary.json").read_text(encoding="utf-8"))
    error_s = (summary.get("error") or {}).get("wall_s") or 0.0
    return Command(summary["simulated_s"], wall_s, cpu_s, summary["wall_s"], error_s)


def spent(*words: str, version: Path = ROOT) -> tuple[float, float]:
    """Run a command of cosim, and return its wall and CPU time [s].

    Args:
        words: of the command.
        version: folder of the version that runs it.
    """
    given = {"OMP_NUM_THREADS": "1"} | os.environ | {"PYTHONPATH": str(version)}
    command = [sys.executable, "-m", "cosim", *words]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, env=given, cwd=version, check=True, capture_output=True)
    wall_s, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def least(name: str, changes: Sequence[str], repeats: int) -> Command:
    """Return the quickest of so many commands."""
    return min((run(name, changes) for _ in range(repeats)), key=lambda command: command.cpu_s)


def compare(name: str, options: argparse.Namespace) -> None:
    """Print what a command takes over what it takes with another value, or took in another version."""
    pairs = []
    for _ in range(options.repeats + 1):
        here = run(name, options.changes)
        if options.against_version:
            there = run(name, version=options.against_version.resolve())
        else:
            there = run(name, [*options.changes, *options.against])
        pairs.append(here.cpu_s / there.cpu_s)
    ratios = pairs[1:]
    spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
    print(
        f"| {name} | {statistics.median(ratios):.2f} | {spread} | {here.cpu_s:.1f} and {there.cpu_s:.1f} s |"
    )


def scenarios() -> list[str]:
    """Return the names of all scenarios of one arm that come with cosim."""
    import cosim

    return [name for name in cosim.list_scenarios() if not name.startswith("two_arms")]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--against", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--against-version", type=Path, metavar="FOLDER")
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    names = options.names or scenarios()
    if options.against or options.against_version:
        for name in names:
            compare(name, options)
        return
    rows = [HEAD, "|---|" + "---:|" * 7]
    print("\n".join(rows))
    for name in names:
        rows.append(least(name, options.changes, options.repeats).row(" ".join([name, *options.changes])))
        print(rows[-1], flush=True)
    if options.page:
        put_table(options.page, "real time", "\n".join(rows))


if __name__ == "__main__":
    main()
