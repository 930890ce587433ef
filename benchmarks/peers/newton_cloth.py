"""The case in newton (on the CPU): cloth stepped by vertex block descent, follower pressure by hand.

Runs in an environment of its own, which needs newton and numpy only:

    python -m benchmarks.peers.newton_cloth CASE.npz TICK_S ITERATIONS RESULT.npz
"""

from __future__ import annotations

import sys
from pathlib import Path

import newton
import numpy as np
import warp

from benchmarks.peers.case import SWING, Case, FollowerPressure, Run, run


def model_of(case: Case) -> newton.Model:
    """Return the film as triangles with Lame's constants of plane stress times the thickness."""
    membrane = case.young_Pa * case.thickness_m
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, 0.0))
    mass = np.array(case.mass)
    mass[case.base] = 0.0  # does not move
    builder.add_particles(
        [warp.vec3(*x) for x in case.drawn.tolist()], [warp.vec3(0.0, 0.0, 0.0)] * len(mass), mass.tolist()
    )
    i, j, k = case.triangles.T
    count = len(case.triangles)
    builder.add_triangles(
        i, j, k,
        tri_ke=[membrane / (2.0 * (1.0 + case.poisson))] * count,
        tri_ka=[membrane * case.poisson / (1.0 - case.poisson**2)] * count,
        tri_kd=[0.0] * count,
    )  # fmt: skip
    builder.color()
    return builder.finalize(device="cpu")


def simulate(case: Case, tick_s: float, iterations: int) -> Run:
    """Return the run of newton at a tick with so many sweeps over the nodes per step."""
    model = model_of(case)
    solver = newton.solvers.SolverVBD(model, iterations=iterations)
    before, after, control = model.state(), model.state(), model.control()
    before.particle_q.assign(case.start.astype(np.float32))
    pressure = FollowerPressure(case)
    weight = case.mass[:, None]

    def step(time_s: float) -> None:
        nonlocal before, after
        x, v = before.particle_q.numpy(), before.particle_qd.numpy()
        force = pressure(x.astype(float), SWING.pressure_at(time_s))
        force += weight * (np.array(SWING.gravity_at(time_s)) - SWING.damping_per_s * v)
        before.particle_f.assign(force.astype(np.float32))
        solver.step(before, after, control, None, tick_s)
        before, after = after, before

    return run(SWING, case, tick_s, step, lambda: before.particle_q.numpy())


def main() -> None:
    """Run the case in a file and write the trajectory to another."""
    path, tick_s, iterations, result = sys.argv[1:]
    case = Case.load(Path(path))
    warp.config.quiet = True
    simulate(case, 0.02, 1)  # compiles
    found = simulate(case, float(tick_s), int(iterations))
    np.savez(result, tip=found.tip, cpu_s=found.cpu_s, version=newton.__version__)


if __name__ == "__main__":
    main()
