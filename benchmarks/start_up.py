"""Processor time before the first tick: of `cosim run`, of further simulations, of resets with a change.

    python benchmarks/start_up.py [NAME ...]

Kernels and section models are there already. `cosim run` is started anew each time, first with plans to
solve, then with those that the first run has kept on disk, and then without pandas as well: cosim alone does
not install it, but where it is installed pyarrow loads it for the recording. Python keeps its bytecode.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import cosim

REPEATS = 5
STILL: dict[str, Any] = {"phase": [], "contact.enabled": False}
"""No phases to plan, as environments for learning have it."""
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "ur5e_hexagon_arm": ("ur5e_hexagon_arm", {}),
    "gripper_lifts_roll": ("gripper_lifts_roll", {}),
    "lumped": ("ur5e_hexagon_arm", STILL),
    "section": ("ur5e_hexagon_arm", {**STILL, "fidelity": "section"}),
}
CHANGES: dict[str, Callable[[int], dict[str, Any]]] = {
    "pressure": lambda k: {"start.pressure_Pa": 1e3 * (1.0 + 0.1 * k)},
    "gravity": lambda k: {"gravity_m_s2": [0.0, 0.0, -9.7 - 0.01 * k]},
    "tick": lambda k: {"clock.tick_s": 1e-3 * (1.0 + k)},
    "exchange": lambda k: {"payload_compensation": bool(k % 2)},
}
STARTED = """
import os, sys, time
class Without:
    def find_spec(self, name, path=None, target=None):
        if name in sys.argv[3:]:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Without())
from cosim.cli import main
run = main._run
def started(*given):
    import cosim.app.driver as driver
    def drive(*_given, **_more):
        print(time.process_time(), flush=True)
        os._exit(0)
    driver.drive = drive
    return run(*given)
main._run = started
main.main(["run", "--quiet", sys.argv[1], "--out", sys.argv[2]])
"""
"""Ends where the first tick would be taken."""


def spent_ms(what: Callable[[], object]) -> float:
    """Return the processor time of a call [ms]."""
    began = time.process_time()
    what()
    return 1e3 * (time.process_time() - began)


def command_s(name: str) -> tuple[float, float, float]:
    """Return the processor time [s] of `cosim run` to its first tick: the first, then, and without pandas."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(2 * REPEATS + 1):
            # section models and plans go where nothing is yet
            environment = {**os.environ, "XDG_CACHE_HOME": folder}
            environment.pop("PYTHONDONTWRITEBYTECODE", None)
            without = ["pandas"] * (k % 2)
            arguments = [sys.executable, "-c", STARTED, name, f"{folder}/run_{k}", *without]
            done = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=True)
            found.append(float(done.stdout.split()[-1]))
    return found[0], min(found[2::2]), min(found[1::2])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(CASES), metavar="NAME", help=", ".join(CASES))
    for name in parser.parse_args().names:
        scenario, overrides = CASES[name]
        if not overrides:
            first, again, alone = command_s(scenario)
            print(f"{name}: cosim run {first:.2f} s, plan on disk {again:.2f}, without pandas {alone:.2f}")
        kept = cosim.KeptParts()

        def made() -> cosim.Simulation:
            return cosim.Simulation(scenario, overrides=overrides, kept=kept)  # noqa: B023

        simulation = made()
        further = min(spent_ms(made) for _ in range(REPEATS))
        print(f"{name}: a further simulation {further:.0f} ms; resets with a change of")
        for what, change in CHANGES.items():
            times = [spent_ms(lambda k=k: simulation.reset(changes=change(k))) for k in range(REPEATS)]  # type: ignore[misc]  # noqa: B023
            print(f"  {what}: {min(times[1:]):.0f} ms")


if __name__ == "__main__":
    main()
