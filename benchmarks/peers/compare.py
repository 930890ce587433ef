"""cosim beside other simulators on one case (see `case.py`): error of the tip, speed, speed at equal error.

    python -m benchmarks.peers.compare [--newton PYTHON] [--json FILE] [--markdown FILE]

MuJoCo comes with cosim. newton runs in an environment of its own, which `--newton` names by its Python
(`pip install newton numpy`); without it, its rows are left out. One process at a time, all on one thread.
Truth is cosim with BDF2 and a tick of 0.1 ms, every step converged to 1e-6 N.
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

from benchmarks.peers import lumped, mujoco_flex
from benchmarks.peers.case import SWING, Case, Run
from cosim.soft.solve.time_scheme import StepOptions

ROOT = Path(__file__).resolve().parents[2]
TRUTH_TICK_S = 1e-4
OURS = ("cosim, implicit Euler", "cosim, BDF2")
LUMPED_TICKS_S = (0.0005, 0.001, 0.002, 0.005, 0.01)
EXPLICIT_TICKS_S = (2e-5, 5e-5, 1e-4)
DISCRETE_TICKS_S = (0.0005, 0.002)
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


def newton_run(python: str, case: Case, tick_s: float, iterations: int) -> Run:
    """Run newton in the environment of another Python."""
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "case.npz"), Path(folder, "result.npz")
        case.save(given)
        words = [python, "-m", "benchmarks.peers.newton_cloth", given, repr(tick_s), str(iterations), result]
        subprocess.run([str(word) for word in words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        with np.load(result) as data:
            return Run(data["tip"], float(data["cpu_s"]))


def measure(newton: str | None) -> list[Row]:
    """Return all rows; each is printed as it comes."""
    body, case = lumped.make_case(SWING)
    lumped.simulate(SWING, body, case, 0.02, "bdf2")  # the kernels are compiled
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
        add("MuJoCo flex, Euler", tick_s, mujoco_flex.simulate(SWING, case, tick_s, "Euler"))
    for tick_s in DISCRETE_TICKS_S:
        add("MuJoCo flex, discrete", tick_s, mujoco_flex.simulate(SWING, case, tick_s, "discrete"))
    for tick_s, iterations in NEWTON_RUNS if newton else ():
        name = f"newton VBD, {iterations} sweeps"
        add(name, tick_s, newton_run(str(newton), case, tick_s, iterations))
    return rows


def at_equal_error(rows: list[Row]) -> list[tuple[Row, Row | None]]:
    """Return every peer's run with cosim's fastest one whose largest error is no larger."""
    ours = [row for row in rows if row.name in OURS]
    pairs: list[tuple[Row, Row | None]] = []
    for peer in (row for row in rows if row.name not in OURS and np.isfinite(row.largest_m)):
        fit = [row for row in ours if row.largest_m <= peer.largest_m]
        pairs.append((peer, min(fit, key=lambda row: row.cpu_s, default=None)))
    return pairs


def line(row: Row) -> str:
    """Return a row as markdown."""
    if not np.isfinite(row.largest_m):
        return f"| {row.name} | {1e3 * row.tick_s:g} | blows up | | |"
    return (
        f"| {row.name} | {1e3 * row.tick_s:g} | {1e3 * row.largest_m:.3g} | {1e3 * row.final_m:.3g} "
        f"| {row.real_time_factor:.2g} |"
    )


def markdown(rows: list[Row]) -> str:
    """Return both tables."""
    text = [
        "| run | tick, ms | largest error of the tip, mm | at the end, mm | real-time factor |",
        "|---|---|---|---|---|",
    ]
    text += [line(row) for row in rows]
    text += [
        "",
        "| peer | its error, mm | cosim at no larger error | cosim is faster by |",
        "|---|---|---|---|",
    ]
    for peer, own in at_equal_error(rows):
        name = f"{peer.name}, {1e3 * peer.tick_s:g} ms"
        if own is None:
            text.append(f"| {name} | {1e3 * peer.largest_m:.3g} | none of the runs above | |")
            continue
        text.append(
            f"| {name} | {1e3 * peer.largest_m:.3g} | {own.name}, {1e3 * own.tick_s:g} ms: "
            f"{1e3 * own.largest_m:.3g} mm | {peer.cpu_s / own.cpu_s:.0f} times |"
        )
    return "\n".join(text) + "\n"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--newton", metavar="PYTHON", help="Python of the environment that has newton")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    arguments = parser.parse_args()
    print(f"MuJoCo {mujoco.__version__}")
    rows = measure(arguments.newton)
    print(markdown(rows))
    if arguments.markdown:
        arguments.markdown.write_text(markdown(rows), encoding="utf-8")
    if arguments.json:
        entries = [vars(row) | {"real_time_factor": row.real_time_factor} for row in rows]
        text = json.dumps(entries, indent=2)
        arguments.json.write_text(text.replace("NaN", "null") + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
