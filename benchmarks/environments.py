"""Steps of environments per second of processor time, at 50 Hz; and how batches of runs go in processes.

    python benchmarks/environments.py [NAME ...] [--steps 300] [--workers 1 2] [--batch 64]

Actions are random. `--workers` steps the vector form of the section model with so many processes, in wall
time, and wants idle cores. `--batch` compares runs with changes and commands of their own, bit for bit, alone
and with 1, 2, 4 workers, of which one is then killed.
"""

from __future__ import annotations

import argparse
import os
import signal
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np

import cosim
import cosim.gym  # registers the environments
from cosim.app.workers import THREADS

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "rigid": ("cosim/TipReach-v0", {"fidelity": "rigid"}),
    "section": ("cosim/TipReach-v0", {"fidelity": "section"}),
    "follow": ("cosim/TipFollow-v0", {"fidelity": "section"}),
    "lumped": ("cosim/TipReach-v0", {"fidelity": "lumped"}),
    "lumped, paper's mesh": (
        "cosim/TipReach-v0",
        {"fidelity": "lumped", "overrides": {"soft_robot": "hexagon_arm", "model.published": True}},
    ),
    "grasp": ("cosim/GraspLift-v0", {}),
    "grasp, section": ("cosim/GraspLift-v0", {"fidelity": "section"}),
}
RANDOM: dict[str, Any] = {"phase": [], "fidelity": "rigid", "contact.enabled": False, "clock.tick_s": 0.01}


def steps_per_s(name: str, given: dict[str, Any], steps: int) -> tuple[float, int]:
    """Return steps per second of processor time, and how many could not be solved."""
    environment = gymnasium.make(name, **given)
    environment.reset(seed=0)
    random, failed, resets_s = np.random.default_rng(0), 0, 0.0
    began = time.process_time()
    for _ in range(steps):
        action = random.uniform(-1.0, 1.0, environment.action_space.shape or ()).astype(np.float32)
        *_, truncated, info = environment.step(action)
        if truncated:
            failed += "failure" in info
            here = time.process_time()
            environment.reset()
            resets_s += time.process_time() - here
    return steps / (time.process_time() - began - resets_s), failed


def with_workers(workers: int, steps: int) -> float:
    """Return steps per second of wall time of four environments in so many processes."""
    found = gymnasium.make_vec(
        "cosim/TipReach-v0", num_envs=4, vectorization_mode="vector_entry_point", workers=workers
    )
    found.reset(seed=0)
    random = np.random.default_rng(0)
    began = time.perf_counter()
    for _ in range(steps):
        found.step(random.uniform(-1.0, 1.0, found.action_space.shape or ()).astype(np.float32))
    spent = time.perf_counter() - began
    found.close()
    return 4 * steps / spent


def bits(seen: cosim.Measurement) -> tuple[bytes, ...]:
    """Return what two equal runs have in common."""
    return seen.joint_position.tobytes(), seen.joint_torque.tobytes(), seen.tip_position.tobytes()


def compare_batches(runs: int) -> None:
    """Print whether runs are the same bits alone and in processes."""
    random = np.random.default_rng(0)
    changes = [{"start.pressure_Pa": float(p)} for p in random.uniform(10e3, 30e3, runs)]
    commands = [
        cosim.Command(flange_twist=(*twist, 0.0, 0.0, 0.0)) for twist in random.uniform(-0.1, 0.1, (runs, 3))
    ]
    expected = []
    for change, command in zip(changes, commands, strict=True):
        here = cosim.Simulation("ur5e_hexagon_arm", overrides={**RANDOM, **change})
        here.step(command, ticks=20)
        expected.append(bits(here.measure()))
    for workers in (1, 2, 4):
        began = time.perf_counter()
        with cosim.Batch(
            "ur5e_hexagon_arm", runs, workers=workers, overrides=RANDOM, changes=changes
        ) as batch:
            found = [one and bits(one) for one in batch.step(commands, ticks=20)]
            same = sum(a == b for a, b in zip(found, expected, strict=True))
            text = f"batch of {runs}, {workers} workers: {same} same bits"
            if workers > 1:
                os.kill(batch.processes[0], signal.SIGKILL)
                left = [one is not None for one in batch.step(ticks=20)]
                named = sum("SIGKILL" in str(error) for error in batch.failed.values())
                text += f"; one worker killed: {named} runs named, {sum(left)} went on"
        print(f"{text}; {time.perf_counter() - began:.0f} s", flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CASES))
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--workers", type=int, nargs="*", default=[])
    parser.add_argument("--batch", type=int)
    options = parser.parse_args()
    for name in options.names or ([] if options.workers or options.batch else CASES):
        speed, failed = steps_per_s(*CASES[name], options.steps)
        print(f"{name}: {speed:.0f} steps/s, {failed} of {options.steps} not solved", flush=True)
    for workers in options.workers:
        print(
            f"{workers} workers ({THREADS[0]}=1): {with_workers(workers, options.steps):.0f} steps/s",
            flush=True,
        )
    if options.batch:
        compare_batches(options.batch)


if __name__ == "__main__":
    main()
