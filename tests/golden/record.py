"""Records all golden runs and their spreads: python -m tests.golden.record [NAME ...], some 10 minutes."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.golden import comparison, runs
from tests.golden.figures import Figures

NUDGES: tuple[runs.Nudge, ...] = (
    runs.STILL, (1e-6, 0.0, 0.0), (-1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6),
)  # fmt: skip


def timed(name: str, nudge: runs.Nudge) -> tuple[Figures, float]:
    """Return the figures of a run, and its CPU time [s]."""
    with tempfile.TemporaryDirectory() as made:
        began = time.process_time()
        figures = runs.figures_of(name, Path(made), nudge=nudge)
        took = time.process_time() - began
    return figures, took


def main(names: list[str]) -> None:
    """Run in two processes, and store."""
    with ProcessPoolExecutor(2) as pool:
        found = {name: [pool.submit(timed, name, nudge) for nudge in NUDGES] for name in names}
        for name, futures in found.items():
            comparison.write(name, [future.result()[0] for future in futures])
            golden, took = comparison.read(name), futures[0].result()[1]
            counts = f"{len(golden.values)} figures, {len(golden.spreads)} by their spread"
            print(f"{name}: {counts}, {took:.1f} s of CPU time", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(runs.RUNS))
