"""What saved states cost, in ticks of the same scenario: keeping them, writing, reading; and resets.

    python benchmarks/saved_states.py [--json FILE]

Resets are in processor time; a tick is taken before each of those from a saved state. Plain and saving ticks
alternate in blocks of one run, in processor time; differences below some percent need an idle machine.
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
_RESETS, _CHANGED = 500, 5
CHANGES: dict[str, tuple[str, float, float]] = {
    "ur5e_hexagon_arm": ("phase.inflate.pressure_Pa", 25e3, 30e3),
    "gripper_lifts_roll": ("object.roll.mass_kg", 0.08, 0.12),
}
"""What a changed reset draws, from where to where."""


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


def resets(name: str) -> dict[str, Any]:
    """Return what resets of a simulation cost: from a state some ticks after its start, and with a change."""
    simulation, spent = cosim.Simulation(name), 0.0
    simulation.step(_BLOCK)
    saved = simulation.save()
    for _ in range(_RESETS):
        simulation.step()
        began = time.process_time()
        simulation.reset(saved)
        spent += time.process_time() - began
    key, low, high = CHANGES[name]
    values = np.random.default_rng(0).uniform(low, high, _CHANGED)
    changed_s = []
    for start in (saved, None):
        began = time.process_time()
        for value in values.tolist():
            simulation.reset(start, {key: value})
        changed_s.append((time.process_time() - began) / _CHANGED)
    return {
        "resets_per_s": _RESETS / spent,
        "changed": key,
        "changed_reset_ms": 1e3 * changed_s[0],
        "changed_reset_at_rest_ms": 1e3 * changed_s[1],
    }


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
            **resets(name),
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
    print("\nresets:              from a saved state  changed, from it  changed, at rest  what changes")
    for row in results:
        print(
            f"{row['scenario']:<22}{row['resets_per_s']:>12.0f} a s  {row['changed_reset_ms']:>13.1f} ms  "
            f"{row['changed_reset_at_rest_ms']:>13.1f} ms  {row['changed']}"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
