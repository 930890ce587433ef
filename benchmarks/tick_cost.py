"""What a tick costs around the soft step: exchange, servos, MuJoCo, loads, snapshot; without a recording.

    python benchmarks/tick_cost.py [--fidelity section] [--scenario NAME] [--ticks 2000] [--json FILE]

CPU time of the thread. Where many ticks go in one call, first what one of them costs so. Then the whole tick
and the soft step in it, one by one; then the same tick with a soft step that answers at once, in which the
parts are warm in the caches: the least of several rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

_ROUNDS, _TICKS_PER_ROUND = 12, 400


def together(run: Any) -> float:
    """Return the least CPU time of a tick [us] of those taken together; the run goes back after it."""
    saved, least = run.save_state(), float("inf")
    for _ in range(_ROUNDS):
        began = time.thread_time_ns()
        ticks = sum(map(len, run.batches(most=_TICKS_PER_ROUND)))
        least = min(least, 1e-3 * (time.thread_time_ns() - began) / ticks)
        run.restore_state(saved)
    return least


def in_a_run(run: Any, soft: Any, ticks: int) -> dict[str, float]:
    """Return the CPU time of a tick in all, of its soft step, and of the rest: medians [us]."""
    import numpy as np

    whole, inside = [], [0]
    advance: Callable[..., Any] = soft.advance

    def timed(*args: Any) -> Any:
        began = time.thread_time_ns()
        reply = advance(*args)
        inside[-1] += time.thread_time_ns() - began
        return reply

    vars(soft)["advance"] = timed
    steps = run.steps()
    for _ in range(ticks):
        inside.append(0)
        began = time.thread_time_ns()
        next(steps)
        whole.append(time.thread_time_ns() - began)
    del vars(soft)["advance"]
    all_of_it, step = 1e-3 * np.array(whole), 1e-3 * np.array(inside[1:])
    named = {"tick": all_of_it, "soft step": step, "around it": all_of_it - step}
    return {name: float(np.median(values)) for name, values in named.items()}


def alone(run: Any, soft: Any) -> float:
    """Return the least CPU time of a tick [us] whose soft step costs nothing; the run goes back after it."""
    from cosim.coupling.soft_sides.soft_side import SoftReply

    saved, least = run.save_state(), float("inf")
    reply = SoftReply(saved.carrier.coupling.interface.wrench, 1e-6, 1)
    vars(soft)["advance"] = lambda *_: reply
    for _ in range(_ROUNDS):
        run.restore_state(saved)
        began = time.thread_time_ns()
        ticks = sum(1 for _ in islice(run.steps(), _TICKS_PER_ROUND))
        least = min(least, 1e-3 * (time.thread_time_ns() - began) / ticks)
    del vars(soft)["advance"]
    run.restore_state(saved)
    return least


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", default="section")
    parser.add_argument("--scenario", default="ur5e_hexagon_arm")
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    from cosim.app.driver import build_simulation
    from cosim.config.loading import load_scenario
    from cosim.coupling.schemes.soft_halves import SoftHalves

    overrides = {"fidelity": options.fidelity, "coupling.scheme": "staggered"}
    run: Any = build_simulation(load_scenario(options.scenario, overrides))
    soft, carrier = run._parts.soft, run._parts.carrier
    for _ in islice(run.steps(), 20):
        pass
    figures = {}
    if carrier.joint_names:
        figures["tick of a batch"] = together(run)
        carrier._coupling._halves = SoftHalves(carrier._coupling.interface)
    figures |= in_a_run(run, soft, options.ticks) | {"around it, alone": alone(run, soft)}
    for name, microseconds in figures.items():
        print(f"{microseconds:9.1f} us  {name}")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
