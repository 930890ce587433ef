"""cosim beside other simulators on one case (see `case.py`): error of the tip, speed, speed at equal error.

    python -m benchmarks.peers.compare [--newton PYTHON] [--json FILE] [--page docs/peers.md]

MuJoCo comes with cosim. newton runs in an environment of its own, which `--newton` names by its Python
(`pip install newton numpy numba`); without it, its rows are left out. One process at a time, all on one
thread. Truth is cosim with BDF2 and a tick of 0.1 ms, every step converged to 1e-6 N. Beside each of MuJoCo's
explicit runs, up to its longest stable tick, stands cosim's with the longest tick of BDF2 that has no larger
error; the two run in turn, three times. `--page` writes the tables into the page.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np

from benchmarks.measure.page_tables import put_table
from benchmarks.peers import lumped, mujoco_flex
from benchmarks.peers.case import PAIRS_HEAD, SAMPLE_S, SWING, Case, Run, alternately, longest_tick
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.step_scheme import StepOptions

ROOT = Path(__file__).resolve().parents[2]
TRUTH_TICK_S = 1e-4
OURS = ("cosim, implicit Euler", "cosim, BDF2")
LUMPED_TICKS_S = (0.0005, 0.001, 0.002, 0.005, 0.01)
EXPLICIT = "MuJoCo flex, Euler"
EXPLICIT_TICKS_S = (2e-5, 5e-5, 8e-5, SAMPLE_S / 240, SAMPLE_S / 230)
"""The last but one is the longest stable one."""
DISCRETE_TICKS_S = (0.0005, 0.002)
REPEATS = 3
NEWTON_RUNS = ((1e-4, 20), (2e-4, 20), (0.001, 20))


@dataclass(frozen=True)
class Row:
    """One run: who, tick, largest and final error of the tip [m] (NaN: blew up), CPU time [s]."""

    name: str
    tick_s: float
    largest_m: float
    final_m: float
    cpu_s: float

    @classmethod
    def of(cls, name: str, tick_s: float, found: Run, truth: Run) -> Row:
        """Return the row of a run."""
        error = np.linalg.norm(found.tip - truth.tip, axis=1)
        return cls(name, tick_s, float(error.max()), float(error[-1]), found.cpu_s)

    @property
    def real_time_factor(self) -> float:
        """Simulated over CPU time; 0 for a run that blew up."""
        return SWING.duration_s / self.cpu_s if np.isfinite(self.largest_m) else 0.0


@dataclass(frozen=True)
class Pair:
    """A peer's run and cosim's of no larger error, with the CPU times [s] of both in turn."""

    peer: Row
    own: Row
    peer_s: float
    own_s: float

    @property
    def markdown(self) -> str:
        """A line of the second table."""
        peer, own = self.peer, self.own
        return (
            f"| {peer.name}, {1e3 * peer.tick_s:.3g} ms | {1e3 * peer.largest_m:.3g} "
            f"| {SWING.duration_s / self.peer_s:.3g} | {own.name}, {1e3 * own.tick_s:.3g} ms "
            f"| {1e3 * own.largest_m:.3g} | {SWING.duration_s / self.own_s:.3g} "
            f"| {self.peer_s / self.own_s:.0f} times |"
        )


def newton_run(python: str, case: Case, tick_s: float, iterations: int) -> Run:
    """Run newton in the environment of another Python."""
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "case.npz"), Path(folder, "result.npz")
        case.save(given)
        words = [python, "-m", "benchmarks.peers.newton_cloth", given, repr(tick_s), str(iterations), result]
        subprocess.run([str(word) for word in words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        with np.load(result) as data:
            return Run(data["tip"], float(data["cpu_s"]))


def measure(newton: str | None) -> tuple[list[Row], list[Pair]]:
    """Return all rows, each printed as it comes, and what is of equal error."""
    body, case = lumped.make_case(SWING)
    lumped.simulate(SWING, body, case, 0.02, "bdf2")  # the kernels are compiled
    mujoco_flex.simulate(SWING, case, SAMPLE_S, "Euler")
    truth = lumped.simulate(
        SWING, body, case, TRUTH_TICK_S, StepOptions("bdf2", tolerance_N=1e-6, iterations=20)
    )
    rows: list[Row] = []

    def add(name: str, tick_s: float, found: Run) -> None:
        rows.append(Row.of(name, tick_s, found, truth))
        print(line(rows[-1]), flush=True)

    for tick_s in LUMPED_TICKS_S:
        add(OURS[0], tick_s, lumped.simulate(SWING, body, case, tick_s, "implicit_euler"))
        add(OURS[1], tick_s, lumped.simulate(SWING, body, case, tick_s, "bdf2"))
    for tick_s in EXPLICIT_TICKS_S:
        add(EXPLICIT, tick_s, mujoco_flex.simulate(SWING, case, tick_s, "Euler"))
    for tick_s in DISCRETE_TICKS_S:
        add("MuJoCo flex, discrete", tick_s, mujoco_flex.simulate(SWING, case, tick_s, "discrete"))
    for tick_s, iterations in NEWTON_RUNS if newton else ():
        name = f"newton VBD, {iterations} sweeps"
        add(name, tick_s, newton_run(str(newton), case, tick_s, iterations))
    explicit = [row for row in rows if row.name == EXPLICIT and np.isfinite(row.largest_m)]
    return rows, [pair for row in explicit if (pair := at_equal_error(row, body, case, truth)) is not None]


def at_equal_error(peer: Row, body: SoftBody, case: Case, truth: Run) -> Pair | None:
    """Return a run of MuJoCo beside cosim's at the longest tick with no larger error; None without any."""

    def own_run(tick_s: float) -> Run:
        return lumped.simulate(SWING, body, case, tick_s, "bdf2")

    def error_of(tick_s: float) -> float:
        return Row.of(OURS[1], tick_s, own_run(tick_s), truth).largest_m

    tick_s = longest_tick(error_of, peer.largest_m)
    if tick_s is None:
        return None
    peer_s, own_s = alternately(
        lambda: mujoco_flex.simulate(SWING, case, peer.tick_s, "Euler"), lambda: own_run(tick_s), REPEATS
    )
    pair = Pair(peer, Row.of(OURS[1], tick_s, own_run(tick_s), truth), peer_s, own_s)
    print(pair.markdown, flush=True)
    return pair


def line(row: Row) -> str:
    """Return a row as markdown."""
    if not np.isfinite(row.largest_m):
        return f"| {row.name} | {1e3 * row.tick_s:.3g} | blows up | | |"
    return (
        f"| {row.name} | {1e3 * row.tick_s:.3g} | {1e3 * row.largest_m:.3g} | {1e3 * row.final_m:.3g} "
        f"| {row.real_time_factor:.2g} |"
    )


def markdown(rows: list[Row], pairs: list[Pair]) -> str:
    """Return both tables."""
    text = [
        "| run | tick, ms | largest error of the tip, mm | at the end, mm | real-time factor |",
        "|---|---|---|---|---|",
        *(line(row) for row in rows),
        "",
        PAIRS_HEAD,
        "|---|---|---|---|---|---|---|",
        *(pair.markdown for pair in pairs),
    ]
    return "\n".join(text) + "\n"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--newton", metavar="PYTHON", help="Python of the environment that has newton")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    print(f"MuJoCo {mujoco.__version__}")
    rows, pairs = measure(arguments.newton)
    print(markdown(rows, pairs))
    if arguments.page:
        put_table(arguments.page, "swing", markdown(rows, pairs))
    if arguments.json:
        entries = [vars(row) | {"real_time_factor": row.real_time_factor} for row in rows]
        text = json.dumps(entries, indent=2)
        arguments.json.write_text(text.replace("NaN", "null") + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
