"""Speed of the reference scenario: real-time factors, where the time goes, and the quasistatic run.

    python benchmarks/reference_scenario.py [--json FILE] [--repeat N]

Dynamic mode with the recording on, lumped and section; each part of a lumped tick is timed by thread CPU
time. How far the section model's tip is from the film's is measured in two runs besides.
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
MODEL = {"model.published": True}
"""The paper's lumped model, of which the figures in README.md are."""
LENGTH_M = 0.2  # of the arm, about: what the section model's error is compared with
DYNAMIC: dict[str, dict[str, Any]] = {
    "lumped, 2 ms": {},
    "lumped, 1 ms": {"clock.tick_s": 0.001},
    "section, 2 ms": {"fidelity": "section"},
}


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
    from cosim.coupling.schemes.staggered import StaggeredCoupling
    from cosim.kinematics.arm import Arm
    from cosim.recording.rerun_recorder import RerunRecorder
    from cosim.rigid.scene.scene import RigidScene
    from cosim.soft.linear.cholesky import EnvelopeCholesky
    from cosim.soft.solve.assembly import SoftSystem
    from cosim.stepping.parts import Parts

    stopwatch = Stopwatch()
    stopwatch.wrap(SoftSystem, "evaluate", "soft: energy, gradient, Hessian")
    stopwatch.wrap(EnvelopeCholesky, "factor", "soft: factorisation")
    stopwatch.wrap(EnvelopeCholesky, "solve", "soft: triangular solves")
    stopwatch.wrap(RigidScene, "finish_step", "MuJoCo: second half step")
    stopwatch.wrap(RigidScene, "begin_step", "MuJoCo: first half step")
    stopwatch.wrap(StaggeredCoupling, "advance", "exchange, Newton's bookkeeping, ledger")
    stopwatch.wrap(Arm, "inverse_dynamics", "Pinocchio: feedforward")
    stopwatch.wrap(Parts, "snapshot", "snapshot")
    stopwatch.wrap(RerunRecorder, "record", "recording")
    return stopwatch


def dynamic(overrides: dict[str, Any], stopwatch: Stopwatch | None = None) -> dict[str, Any]:
    """Run the scenario in dynamic mode with its recording on; return its figures."""
    from cosim.app.driver import Options, build_simulation, execute, rerun_recorder
    from cosim.config.loading import load_scenario

    scenario = load_scenario(SCENARIO, {**MODEL, **overrides})
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
    from cosim.app.driver import Options, build_simulation, execute
    from cosim.config.loading import load_scenario

    scenario = load_scenario(SCENARIO, {**MODEL, "mode": "quasistatic"})
    return execute(scenario, build_simulation, Options(), time.perf_counter()).summary


def section_error() -> float:
    """Return the largest distance of the section model's tip from the lumped one's in the run [m]."""
    import numpy as np

    import cosim

    film, chain = (
        cosim.run(SCENARIO, overrides={**MODEL, "fidelity": name}) for name in ("lumped", "section")
    )
    return float(np.linalg.norm(chain.tip_position - film.tip_position, axis=1).max())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    runs = {name: [dynamic(overrides) for _ in range(options.repeat)] for name, overrides in DYNAMIC.items()}
    error_m = section_error()
    still = min((quasistatic() for _ in range(options.repeat)), key=lambda run: run["wall_s"])
    stopwatch = watch()
    broken_down = dynamic({}, stopwatch)
    ticks = broken_down["ticks"]
    parts = {label: 1e3 * seconds / ticks for label, seconds in stopwatch.seconds.items()}
    figures = {
        "real_time_factors": {
            name: [run["real_time_factor"] for run in several] for name, several in runs.items()
        },
        "newton_iterations_per_tick": {
            name: several[0]["newton_iterations"] / several[0]["ticks"] for name, several in runs.items()
        },
        "section_tip_error_m": error_m,
        "quasistatic": {
            key: still[key]
            for key in ("wall_s", "ticks", "newton_iterations", "max_equilibrium_residual_N", "startup_s")
        },
        "milliseconds_per_tick": dict(sorted(parts.items(), key=lambda item: -item[1])),
    }
    _show(figures, still)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


def _show(figures: dict[str, Any], still: dict[str, Any]) -> None:
    print("dynamic, recording on, times real time in each run:")
    for name, factors in figures["real_time_factors"].items():
        iterations = figures["newton_iterations_per_tick"][name]
        print(
            f"  {name}: " + ", ".join(f"{f:.2f}" for f in factors) + f"; {iterations:.2f} iterations a tick"
        )
    error_m = figures["section_tip_error_m"]
    share = error_m / LENGTH_M
    print(f"  tip of section from that of lumped: {1e3 * error_m:.2f} mm, {share:.2%} of {LENGTH_M} m")
    print("CPU per tick of lumped, 2 ms [ms] (with the stopwatch on):")
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
