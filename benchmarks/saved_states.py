"""What saved states cost, in ticks of the same scenario: keeping them in memory, writing and reading one.

    python benchmarks/saved_states.py [--json FILE]

Plain and saving ticks alternate in blocks of one run, in processor time; differences below some percent
need an idle machine.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from benchmarks.measure.calls import median_s
from cosim.app.driver import build_simulation
from cosim.base.state_archive import read_archive, write_archive

_BLOCK = 20
_BLOCKS = 60
SCENARIOS = ("ur5e_hexagon_arm", "gripper_lifts_roll")


def saving_tick(name: str, every: int) -> float:
    """Return the time of a tick while every n-th state is saved, over that of a plain tick."""
    simulation = build_simulation(cosim.load_scenario(name))
    steps = simulation.steps()
    list(islice(steps, 1 + _BLOCK))
    spent: dict[bool, list[float]] = {False: [], True: []}
    for block in range(_BLOCKS):
        saving = bool(block % 2)
        began = time.process_time()
        for k, _ in enumerate(islice(steps, _BLOCK)):
            if saving and k % every == 0:
                simulation.save_state()
        spent[saving].append((time.process_time() - began) / _BLOCK)
    return float(np.median(spent[True]) / np.median(spent[False]))


def measure(name: str) -> dict[str, Any]:
    """Return the costs on one scenario, from its start."""
    simulation = build_simulation(cosim.load_scenario(name))
    steps = simulation.steps()
    list(islice(steps, 1 + _BLOCK))
    tick_s = median_s(lambda: next(steps))
    state = simulation.save_state()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.npz"
        return {
            "scenario": name,
            "saving_every_tick": saving_tick(name, 1),
            "saving_every_20_ticks": saving_tick(name, 20),
            "write_over_tick": median_s(lambda: write_archive(path, {}, state)) / tick_s,
            "read_over_tick": median_s(lambda: read_archive(path)) / tick_s,
            "file_MB": 1e-6 * path.stat().st_size,
        }


def main() -> None:
    """Print a table; write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    results = [measure(name) for name in SCENARIOS]
    print("cost in ticks:        saving every tick  every 20 ticks  write  read  file")
    for row in results:
        print(
            f"{row['scenario']:<22}{row['saving_every_tick']:>17.3f}  {row['saving_every_20_ticks']:>14.3f}  "
            f"{row['write_over_tick']:>5.1f}  {row['read_over_tick']:>4.1f}  {row['file_MB']:.1f} MB"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
