"""Speed of the reference scenario: real-time factor, where the time goes, and the quasistatic run.

    python benchmarks/reference_scenario.py [--json FILE] [--repeat N]

Dynamic mode at the scenario's tick with the recording on; each part of a tick is timed by thread CPU time.
Times are of one core (the script asks for single-threaded algebra before numpy is loaded).
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

SCENARIO = "ur5e_hexagon_arm"


class Stopwatch:
    """Adds up the CPU time spent in wrapped methods, those called inside them not counted twice."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner = [0.0]

    def wrap(self, owner: Any, method: str, label: str) -> None:
        """Time every call of owner.method under a label."""
        function: Callable[..., Any] = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            began = time.thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.thread_time() - began
                inside = self._inner.pop()
                self._inner[-1] += spent
                self.seconds[label] = self.seconds.get(label, 0.0) + spent - inside

        setattr(owner, method, timed)


def watch() -> Stopwatch:
    """Wrap the parts of a tick."""
    from cosim.coupling.staggered import StaggeredCoupling
    from cosim.kinematics.arm import Arm
    from cosim.recording.rerun_recorder import RerunRecorder
    from cosim.rigid.scene import RigidScene
    from cosim.scenario.parts import Parts
    from cosim.soft.envelope_cholesky import EnvelopeCholesky
    from cosim.soft.system import SoftSystem

    stopwatch = Stopwatch()
    stopwatch.wrap(SoftSystem, "evaluate", "soft: energy, gradient, Hessian")
    stopwatch.wrap(EnvelopeCholesky, "factor", "soft: factorisation")
    stopwatch.wrap(EnvelopeCholesky, "solve", "soft: triangular solves")
    stopwatch.wrap(RigidScene, "finish_step", "MuJoCo: second half step")
    stopwatch.wrap(RigidScene, "begin_step", "MuJoCo: first half step")
    stopwatch.wrap(StaggeredCoupling, "tick", "exchange, Newton's bookkeeping, ledger")
    stopwatch.wrap(Arm, "inverse_dynamics", "Pinocchio: feedforward")
    stopwatch.wrap(Parts, "snapshot", "snapshot")
    stopwatch.wrap(RerunRecorder, "record", "recording")
    return stopwatch


def dynamic(stopwatch: Stopwatch | None) -> dict[str, Any]:
    """Run the scenario in dynamic mode with its recording on; return its figures."""
    from cosim.driver import Options, build_simulation, execute, rerun_recorder
    from cosim.scenario.loading import load_scenario

    scenario = load_scenario(SCENARIO)
    with tempfile.TemporaryDirectory() as folder:
        if stopwatch is not None:
            stopwatch.seconds.clear()
        began = time.thread_time()
        options = Options(Path(folder) / "run", rerun_recorder)
        summary = execute(scenario, build_simulation, options, time.perf_counter()).summary
        spent = time.thread_time() - began
    return {**summary, "cpu_s": spent}


def quasistatic() -> dict[str, Any]:
    """Run the scenario in quasistatic mode, without a recording; return its figures."""
    from cosim.driver import Options, build_simulation, execute
    from cosim.scenario.loading import load_scenario

    scenario = load_scenario(SCENARIO, {"mode": "quasistatic"})
    return execute(scenario, build_simulation, Options(), time.perf_counter()).summary


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    from cosim.soft.compilation import compile_kernels

    compile_kernels(print)
    runs = [dynamic(None) for _ in range(options.repeat)]
    best = max(runs, key=lambda run: run["real_time_factor"])
    still = min((quasistatic() for _ in range(options.repeat)), key=lambda run: run["wall_s"])
    stopwatch = watch()
    broken_down = dynamic(stopwatch)
    ticks = broken_down["ticks"]
    parts = {label: 1e3 * seconds / ticks for label, seconds in stopwatch.seconds.items()}
    figures = {
        "dynamic": {key: best[key] for key in ("real_time_factor", "wall_s", "ticks", "newton_iterations")},
        "dynamic_real_time_factors": [run["real_time_factor"] for run in runs],
        "quasistatic": {
            key: still[key]
            for key in ("wall_s", "ticks", "newton_iterations", "max_equilibrium_residual_N", "startup_s")
        },
        "milliseconds_per_tick": dict(sorted(parts.items(), key=lambda item: -item[1])),
    }
    _show(figures, best, still)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


def _show(figures: dict[str, Any], best: dict[str, Any], still: dict[str, Any]) -> None:
    factors = ", ".join(f"{factor:.2f}" for factor in figures["dynamic_real_time_factors"])
    print(
        f"dynamic, {best['tick_s'] * 1e3:g} ms tick, recording on: x{best['real_time_factor']:.2f} real time"
    )
    print(f"  all runs: {factors}; {best['newton_iterations'] / best['ticks']:.2f} Newton iterations a tick")
    print("  CPU per tick [ms] (with the stopwatch on):")
    for label, milliseconds in figures["milliseconds_per_tick"].items():
        print(f"    {milliseconds:7.4f}  {label}")
    print(
        f"quasistatic, {still['ticks']} increments: {still['wall_s']:.2f} s, "
        f"{still['newton_iterations']} Newton iterations, "
        f"largest residual {still['max_equilibrium_residual_N']:.1e} N"
    )
    for phase in still["phases"]:
        tip = ", ".join(f"{1e3 * value:.2f}" for value in phase["tip_position_m"])
        print(f"    {phase['name']:<8} tip ({tip}) mm")


if __name__ == "__main__":
    main()
