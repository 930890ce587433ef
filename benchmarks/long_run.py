"""Many ticks of whole scenarios: does a resting arm creep, does a periodic one drift, does the process grow?

    python benchmarks/long_run.py [--ticks N] [--periods N] [--record] [--json FILE]

UR5e, exchange, inflated soft arm of two units with two tensioned cables, snapshots, summary and checkpoints,
as `cosim run` steps them; `--record` writes a recording as well (one frame in 10 s, curves of every tick).

rest: the flange moves by 2 cm, the valve closes, then nothing is asked for any more. After the first tenth
of the ticks (20 s at the least) the tip may not be more than 1 nm off in any tick. Neither may the energy of
the soft arm (film, hinges, gas, cables, weight and motion) change by more than raising its weight by 1 nm
takes, nor the kinetic energy of both arms exceed that.

periods: pressure and tensions go to and fro once a second. After 30 periods tip and energy must come back to
the same values at the end of every period, within what the tolerance of a tick leaves open: once with the
scenario's own, once with a hundredth of it.

Memory, in both: the blocks that Python has in use may not become more, but for the figures that summary.json
will have of every phase that ends. The resident memory may grow by these, as much again to write them into
checkpoints, and one arena, the 1 MB that Python asks the system for: one may be due at any time, as blocks
come and go in other places.

Exit code 1 if any of this fails. Ctrl-C ends a run early: the ticks so far are judged, the next run begins.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from cosim.app.driver import Options, build_simulation, execute, rerun_recorder
from cosim.base.frames import Array
from cosim.build.arms import find_arm
from cosim.build.options import fidelity_body
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.kinematics.arm import Arm
from cosim.soft.solve.assembly import SoftSystem
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch

TICK_S = 0.002
MOVE_S, SETTLE_S = 0.5, 20.0
PERIOD_S, PERIODS_TO_SETTLE = 1.0, 30
DRIFT_m = 1e-9
ARENA_kB, PHASE_kB = 1024.0, 8.0
GATHERED_BLOCKS, PHASE_BLOCKS = 3000, 40  # of up to 64 ticks that are read together, and of a phase's figures
CHECKPOINT_EVERY_s = 3.0  # so that the memory which writing takes is in use before it is watched
COMPLIANCE_m_N = 1e-2  # of the tip, generously: 2 N more in a cable move it by 4 mm
TOLERANCES_N = {"periods": 1e-4, "periods, fine": 1e-6}


def scenario(phases: list[dict[str, Any]], tolerance_N: float = 1e-4) -> Scenario:
    """Return a scenario of the arm of two units, with the given phases and tolerance of a tick."""
    cables = [
        {"name": name, "corner": corner, "units": [1, 2], "capstan_factor": 0.8}
        for name, corner in (("right", 0), ("left", 1))
    ]
    robot = {"file": "hexagon_arm", "stack": {"units": 2}, "cable": cables}
    changes = {
        "soft_robot": robot,
        "model.published": True,
        "clock.tick_s": TICK_S,
        "solver.dynamic_tolerance_N": tolerance_N,
        "recording.frames_per_s": 0.1,
        "start.pressure_Pa": 30e3,
        "start.cable_tension_N": [2.0, 1.0],
        "phase": phases,
    }
    return load_scenario("ur5e_hexagon_arm", changes)


def resting(ticks: int) -> Scenario:
    """Return a move, and rest for the remaining ticks."""
    move = {"name": "move", "duration_s": MOVE_S, "flange_shift_m": [0.02, 0.0, 0.0]}
    return scenario([move, {"name": "rest", "duration_s": ticks * TICK_S - MOVE_S, "gas": "sealed"}])


def periodic(periods: int, tolerance_N: float) -> Scenario:
    """Return pressure and tensions that go to and fro."""
    phases: list[dict[str, Any]] = []
    for k in range(periods):
        for name, pressure, tensions in (("up", 40e3, [1.0, 3.0]), ("down", 30e3, [2.0, 1.0])):
            values = {"pressure_Pa": pressure, "cable_tension_N": tensions}
            phases.append({"name": f"{name}_{k + 1}", "duration_s": 0.5 * PERIOD_S, **values})
    return scenario(phases, tolerance_N)


def resident_kB() -> float:
    """Return the memory that the process holds; where the system does not tell, the most it ever held."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return pages * resource.getpagesize() / 1024.0


class Energies:
    """Energies [J] of both arms in a simulation's present state.

    Args:
        simulation: whose.
        of: its scenario.
    """

    def __init__(self, simulation: SteppedRun, of: Scenario) -> None:
        body = fidelity_body(of)
        self._simulation, self._system = simulation, SoftSystem(body)
        self._arm = Arm(find_arm(of.robot), gravity=of.gravity_m_s2)
        self.weight_N = float(body.node_mass.sum()) * float(np.linalg.norm(of.gravity_m_s2))

    def now(self, before: Array, here: Array) -> Array:
        """Return (soft arm, its kinetic energy, that of the rigid arm).

        Args:
            before: (joints,) [rad], one tick ago.
            here: (joints,) [rad], now.
        """
        soft, system = self._simulation.save_state().soft, self._system
        x, angles, v = soft.soft.positions, soft.soft.memory, soft.soft.velocities
        tension = system.segment_share(x, soft.loads)
        potential = system.evaluate(x, soft.loads, tension, angles, hessian=False)
        kinetic = 0.5 * float(np.einsum("n,nr,nr->", system.body.node_mass, v, v))
        rate = (here - before) / TICK_S
        rigid = 0.5 * float(rate @ self._arm.mass_matrix(here) @ rate)
        return np.array([potential + kinetic, kinetic, rigid])


class Watch:
    """Follows a run: where tip and flange are, energies and memory.

    After the run: `moved` (3,) [m], how far tip, flange, and tip on the flange were from where they were at
    first; `samples` (samples, 8): tip [m], energies [J], memory [kB], blocks; so many were `taken`.

    Args:
        of: scenario.
        every: ticks between two samples of energy and memory, each at the end of a batch.
        settled: first tick that counts, a multiple of `every`.
    """

    def __init__(self, of: Scenario, every: int, settled: int) -> None:
        self.scenario, self._every, self._settled = of, every, settled
        self.energies: Energies | None = None
        self.samples = np.zeros((0, 8))
        self.taken = 0
        self.moved = np.zeros(3)
        self._joints = np.zeros((0, 0))
        self._first: Array | None = None

    def build(self, of: Scenario) -> SteppedRun:
        """Build the simulation and keep it in sight."""
        simulation = build_simulation(of)
        self.energies = Energies(simulation, of)
        return simulation

    def open(self, stage: RunInfo) -> None:
        """Make room for all samples at once, so that memory tells of the run alone."""
        self.samples = np.full(((stage.ticks - self._settled) // self._every + 1, 8), np.nan)

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        joints = batch.joint_position
        self._joints = np.concatenate([self._joints.reshape(-1, joints.shape[1]), joints])[-2:]
        counted = (batch.tick >= self._settled) & (batch.tick > 0)
        if not counted.any():
            return
        tip, flange = batch.tip_position[counted], batch.flange_position[counted]
        on_flange = np.einsum("kji,kj->ki", batch.flange_rotation[counted], tip - flange)
        here = np.stack([tip, flange, on_flange], axis=1)
        self._first = here[0].copy() if self._first is None else self._first
        self.moved = np.maximum(self.moved, np.linalg.norm(here - self._first, axis=2).max(axis=0))
        if batch.tick[-1] // self._every > (batch.tick[counted][0] - 1) // self._every:
            assert self.energies is not None, "build() comes before observe()"
            energies, memory = self.energies.now(*self._joints), (resident_kB(), sys.getallocatedblocks())
            self.samples[self.taken] = (*tip[-1], *energies, *memory)
            self.taken += 1

    def close(self) -> None:
        """Nothing is left to do."""


def run(watch: Watch, record: bool) -> dict[str, Any]:
    """Run a scenario as the command does, in a directory of its own; return figures of all samples."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        make = rerun_recorder if record else None
        options = Options(
            Path(folder) / "run", make, watchers=(watch,), checkpoint_every_s=CHECKPOINT_EVERY_s
        )
        outcome = execute(watch.scenario, watch.build, options, time.perf_counter())
        files = sum(path.stat().st_size for path in (Path(folder) / "run").iterdir())
    if outcome.error is not None and not (isinstance(outcome.error, KeyboardInterrupt) and watch.taken):
        raise outcome.error
    spent = time.process_time() - began
    samples = watch.samples[: watch.taken]
    tips, energies, memory, blocks = samples[:, :3], samples[:, 3:6], samples[:, 6], samples[:, 7]
    assert watch.energies is not None, "the run has been built"
    tenths = np.linspace(0, len(tips) - 1, 11).astype(int)
    few = -(-len(blocks) // 10)  # the least of a few counts has least of what is about to be freed
    return {
        "ticks": outcome.summary["ticks"],
        "planned_ticks": outcome.summary["planned_ticks"],
        "cpu_ms_per_tick": 1e3 * spent / outcome.summary["ticks"],
        "newton_iterations": outcome.summary["newton_iterations"],
        "samples": len(tips),
        "tip_span_m": float(np.linalg.norm(tips - tips[0], axis=1).max()),
        "energy_change_J": float(np.abs(energies[:, 0] - energies[0, 0]).max()),
        "kinetic_J": energies[:, 1:].max(axis=0).tolist(),
        "weight_N": watch.energies.weight_N,
        "tenths_m": np.linalg.norm(tips - tips[0], axis=1)[tenths].tolist(),
        "tenths_kB": memory[tenths].tolist(),
        "growth_kB": float((memory - memory[0]).max()),
        "growth_blocks": int(blocks[-few:].min() - blocks[:few].min()),
        "resident_MB": float(memory[-1] / 1024.0),
        "files_MB": 1e-6 * files,
    }


def memory(figures: dict[str, Any], phases: int) -> dict[str, bool]:
    """Return the checks of a run's memory; so many phases have ended while it was watched."""
    kB, blocks = ARENA_kB + PHASE_kB * phases, GATHERED_BLOCKS + PHASE_BLOCKS * phases
    return {
        f"{figures['growth_blocks']} blocks more in use, of {blocks}": figures["growth_blocks"] <= blocks,
        f"resident memory grown by {figures['growth_kB']:.0f} kB of {kB:.0f} kB": figures["growth_kB"] <= kB,
    }


def rest(ticks: int, record: bool) -> tuple[dict[str, Any], dict[str, bool]]:
    """Return figures and checks of the resting arm."""
    settled = max(ticks // 10, round((MOVE_S + SETTLE_S) / TICK_S))
    every = max(1, (ticks - settled) // 1000)
    watch = Watch(resting(ticks), every, every * -(-settled // every))
    figures = run(watch, record)
    names = ("tip_moved_m", "flange_moved_m", "tip_moved_on_flange_m")
    figures |= dict(zip(names, watch.moved.tolist(), strict=True))
    bound_J = DRIFT_m * figures["weight_N"]
    checks = {
        f"tip moved by {figures['tip_moved_m']:.1e} m, flange by {figures['flange_moved_m']:.1e} m, "
        f"tip on the flange by {figures['tip_moved_on_flange_m']:.1e} m": figures["tip_moved_m"] <= DRIFT_m,
        f"energy of the soft arm changed by {figures['energy_change_J']:.1e} J of {bound_J:.1e} J": (
            figures["energy_change_J"] <= bound_J
        ),
        "kinetic energy of soft and rigid arm at most {:.1e} and {:.1e} J".format(*figures["kinetic_J"]): (
            max(figures["kinetic_J"]) <= bound_J
        ),
    }
    return figures, checks | memory(figures, 0)


def periods(count: int, record: bool, tolerance_N: float) -> tuple[dict[str, Any], dict[str, bool]]:
    """Return figures and checks of the arm that moves to and fro; energy is compared in the same phase."""
    every = round(PERIOD_S / TICK_S)
    watch = Watch(periodic(count, tolerance_N), every, every * PERIODS_TO_SETTLE)
    figures = run(watch, record)
    figures["tip_swing_m"] = float(watch.moved[0])
    bound_m = COMPLIANCE_m_N * tolerance_N
    bound_J = bound_m * figures["weight_N"]
    checks = {
        f"tip swings by {figures['tip_swing_m']:.1e} m, comes back within {figures['tip_span_m']:.1e} m of "
        f"{bound_m:.0e} m": figures["tip_span_m"] <= bound_m < 1e-3 * figures["tip_swing_m"],
        f"energy comes back within {figures['energy_change_J']:.1e} J of {bound_J:.1e} J": (
            figures["energy_change_J"] <= bound_J
        ),
    }
    return figures, checks | memory(figures, 2 * (count - PERIODS_TO_SETTLE))


def main() -> int:
    """Run, print, write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=100_000, help="of the resting arm")
    parser.add_argument("--periods", type=int, default=100, help="of the moving arm, after which it ends")
    parser.add_argument("--record", action="store_true", help="write a recording as well")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.ticks * TICK_S < 2.0 * (MOVE_S + SETTLE_S) or options.periods <= PERIODS_TO_SETTLE:
        parser.error(f"give at least 20500 ticks and {PERIODS_TO_SETTLE + 1} periods: the arm settles first")
    found = {"rest": rest(options.ticks, options.record)}
    for name, tolerance_N in TOLERANCES_N.items():
        found[name] = periods(options.periods, options.record, tolerance_N)
    for name, (figures, checks) in found.items():
        done = f"{figures['ticks']} of {figures['planned_ticks']} ticks"
        print(f"{name}: {done}, {figures['newton_iterations']} Newton iterations")
        for text, held in checks.items():
            print(f"  {'ok    ' if held else 'FAILED'}  {text}")
    if options.json:
        text = json.dumps({name: figures for name, (figures, _) in found.items()}, indent=2)
        options.json.write_text(text + "\n", encoding="utf-8")
    return int(not all(held for _, checks in found.values() for held in checks.values()))


if __name__ == "__main__":
    sys.exit(main())
