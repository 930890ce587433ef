"""cosim beside MuJoCo's flex on a contact: the film arm of `case.py` lays itself against a bar (`ON_BAR`).

    python -m benchmarks.peers.on_bar [--json FILE] [--page docs/peers.md]

Every run is measured against its own code with the same integrator at a quarter of its tick, so contact laws
need not be equal; further, against the code's finest run. Beside each of MuJoCo's explicit runs, up to its
longest stable tick, stands cosim's with the longest tick of BDF2 that has no larger error, both run in turn;
the fastest runs of both stand beside each other for allowed errors. CPU time of the loop, one thread; ours
the median of three runs where they are short. `--page` writes the tables into the page.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np

from benchmarks.measure.page_tables import put_table
from benchmarks.peers import lumped, mujoco_flex
from benchmarks.peers.case import ON_BAR, PAIRS_HEAD, SAMPLE_S, Run, alternately, longest_tick
from cosim.soft.solve.step_scheme import StepOptions

EULER, BDF2 = "cosim, implicit Euler", "cosim, BDF2"
EXPLICIT, IMPLICIT = "MuJoCo flex, Euler (explicit)", "MuJoCo flex, discrete (implicit)"
TICKS_S = {
    EULER: (0.0005, 0.001, 0.002, 0.004),
    BDF2: (0.00025, 0.0004, 0.0005, 0.001, 0.002, 0.004),
    EXPLICIT: (0.00005, 0.00008, SAMPLE_S / 240, SAMPLE_S / 230),
    IMPLICIT: (0.0005, 0.001, 0.002),
}
OURS = (EULER, BDF2)
FINEST = {EULER: BDF2, BDF2: BDF2, EXPLICIT: EXPLICIT, IMPLICIT: EXPLICIT}
TOLERANCE_N = 1e-3  # of a tick, as in the grasps
REPEATS, SHORT_S = 3, 4e-4
ALLOWED_m = (1e-4, 2e-4, 5e-4, 1e-3)


@dataclass(frozen=True)
class Row:
    """One run: who, tick, errors of the tip [m] (NaN: blew up), CPU time [s].

    Args:
        quarter_m: largest distance from the same run at a quarter of the tick.
        finest_m: largest distance from the code's finest run.
    """

    name: str
    tick_s: float
    quarter_m: float
    finest_m: float
    cpu_s: float

    @property
    def words(self) -> str:
        """Who, at which tick."""
        return f"{self.name}, {1e3 * self.tick_s:.3g} ms"

    @property
    def markdown(self) -> str:
        """A line of the table."""
        if not np.isfinite(self.quarter_m):
            return f"| {self.name} | {1e3 * self.tick_s:.3g} | blows up | | |"
        return (
            f"| {self.name} | {1e3 * self.tick_s:.3g} | {1e3 * self.quarter_m:.3g} "
            f"| {1e3 * self.finest_m:.3g} | {ON_BAR.duration_s / self.cpu_s:.2g} |"
        )


class Runs:
    """Runs of the case, each made once."""

    def __init__(self) -> None:
        self._body, self._case = lumped.make_case(ON_BAR)
        self._made: dict[tuple[str, float], Run] = {}
        self.take(BDF2, 0.02)  # the kernels are compiled
        self._made.clear()

    def at(self, name: str, tick_s: float) -> Run:
        """Return the run of a simulator at a tick."""
        key = name, round(tick_s, 9)
        if key not in self._made:
            repeats = REPEATS if name in OURS and tick_s in TICKS_S[name] and tick_s >= SHORT_S else 1
            found = [self.take(name, tick_s) for _ in range(repeats)]
            self._made[key] = Run(found[0].tip, statistics.median(run.cpu_s for run in found))
            print(f"{name}, {1e3 * tick_s:g} ms: {self._made[key].cpu_s:.2f} s", flush=True)
        return self._made[key]

    def finest(self, name: str) -> Run:
        """Return what the runs of a simulator should come to."""
        code = FINEST[name]
        return self.at(code, min(TICKS_S[code]) / 4.0)

    def row(self, name: str, tick_s: float) -> Row:
        """Return the row of a run."""
        run = self.at(name, tick_s)
        if not np.isfinite(run.tip).all():
            return Row(name, tick_s, np.nan, np.nan, run.cpu_s)
        quarter, finest = self.at(name, tick_s / 4.0), self.finest(name)
        return Row(name, tick_s, largest(run, quarter), largest(run, finest), run.cpu_s)

    def error_of(self, tick_s: float) -> float:
        """Return the largest distance [m] of cosim's run with BDF2 from that with a quarter of the tick."""
        return largest(self.at(BDF2, tick_s), self.at(BDF2, tick_s / 4.0))

    def take(self, name: str, tick_s: float) -> Run:
        """Make a run."""
        if name not in OURS:
            return mujoco_flex.simulate(
                ON_BAR, self._case, tick_s, "Euler" if name == EXPLICIT else "discrete"
            )
        options = StepOptions("bdf2" if name == BDF2 else "implicit_euler", tolerance_N=TOLERANCE_N)
        return lumped.simulate(ON_BAR, self._body, self._case, tick_s, options)


def largest(run: Run, other: Run) -> float:
    """Return the largest distance of two tips [m]."""
    return float(np.linalg.norm(run.tip - other.tip, axis=1).max())


def beside(peer: Row, runs: Runs) -> str:
    """Return a line of the second table: cosim at the longest tick with no larger error, beside a peer."""
    tick_s = longest_tick(runs.error_of, peer.quarter_m)
    if tick_s is None:
        return f"| {peer.words} | {1e3 * peer.quarter_m:.3g} | | none down to 0.25 ms | | | |"
    peer_s, own_s = alternately(
        lambda: runs.take(peer.name, peer.tick_s), lambda: runs.take(BDF2, tick_s), REPEATS
    )
    return (
        f"| {peer.words} | {1e3 * peer.quarter_m:.3g} | {ON_BAR.duration_s / peer_s:.3g} "
        f"| {BDF2}, {1e3 * tick_s:.3g} ms | {1e3 * runs.error_of(tick_s):.3g} "
        f"| {ON_BAR.duration_s / own_s:.3g} | {peer_s / own_s:.0f} times |"
    )


def fastest(rows: list[Row], allowed_m: float) -> Row | None:
    """Return the fastest of runs whose error against its own quarter is no larger than allowed."""
    return min((row for row in rows if row.quarter_m <= allowed_m), key=lambda row: row.cpu_s, default=None)


def allowed(rows: list[Row], allowed_m: float) -> str:
    """Return a line of the third table: the fastest runs of both codes with no larger error than allowed."""
    own = fastest([row for row in rows if row.name in OURS], allowed_m)
    peer = fastest([row for row in rows if row.name not in OURS], allowed_m)
    if own is None or peer is None:
        return (
            f"| {1e3 * allowed_m:g} | {own.words if own else 'none'} | {peer.words if peer else 'none'} | |"
        )
    return f"| {1e3 * allowed_m:g} | {own.words} | {peer.words} | {peer.cpu_s / own.cpu_s:.0f} times |"


def markdown(rows: list[Row], runs: Runs) -> str:
    """Return the tables, and how far the codes are apart."""
    peers = [row for row in rows if row.name == EXPLICIT and np.isfinite(row.quarter_m)]
    apart = np.linalg.norm(runs.finest(BDF2).tip - runs.finest(EXPLICIT).tip, axis=1)
    lines = [
        "| run | tick, ms | from its quarter tick, mm | from the finest run, mm | real-time factor |",
        "|---|---|---|---|---|",
        *(row.markdown for row in rows),
        "",
        PAIRS_HEAD,
        "|---|---|---|---|---|---|---|",
        *(beside(peer, runs) for peer in peers),
        "",
        "| error allowed, mm | fastest of cosim | fastest of MuJoCo | cosim is faster by |",
        "|---|---|---|---|",
        *(allowed(rows, allowed_m) for allowed_m in ALLOWED_m),
        "",
        f"MuJoCo {mujoco.__version__}. The finest runs of the two codes, whose contact laws differ, are "
        f"{1e3 * apart.max():.1f} mm apart at most, {1e3 * apart[-1]:.1f} mm at the end.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    runs = Runs()
    rows = [runs.row(name, tick_s) for name, ticks_s in TICKS_S.items() for tick_s in ticks_s]
    text = markdown(rows, runs)
    print(text)
    if arguments.page:
        put_table(arguments.page, "on the bar", text)
    if arguments.json:
        entries: list[dict[str, Any]] = [
            {**vars(row), "real_time_factor": ON_BAR.duration_s / row.cpu_s} for row in rows
        ]
        arguments.json.write_text(json.dumps(entries, indent=2).replace("NaN", "null") + "\n", "utf-8")


if __name__ == "__main__":
    main()
