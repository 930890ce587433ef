"""A foreign loop around the reference scenario against `Simulation`: results, cost; momentum of a free body.

python benchmarks/attached.py [TICKS]
"""

from __future__ import annotations

import copy
import sys
import time
from typing import Any

import mujoco
import numpy as np

import cosim
from cosim.app.simulation import stepped_run

FREE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="2"/></body>
  </worldbody>
</mujoco>
"""
EXACT = {"solver.dynamic_tolerance_N": 1e-10, "solver.integrator": "implicit_euler"}
EXACT |= {"solver.residual_tolerance_N": 1e-10, "solver.dynamic_newton_iterations": 20}


def loops(ticks: int, pairs: int = 3) -> None:
    """Print the largest differences of a foreign loop to a simulation, and CPU times of both."""
    simulation = cosim.Simulation("ur5e_hexagon_arm")
    carrier: Any = stepped_run(simulation)._parts.carrier
    inside = carrier._scene
    model = copy.copy(inside._model)
    data = mujoco.MjData(model)
    data.qpos[:] = inside._data.qpos
    soft = cosim.attach(model, "flange", "hexagon_arm", overrides={"solver.damping_per_s": 2.0})
    soft.reset(model, data)
    start, begun, controls, seen = simulation.save(), soft.save(), [], []
    for _ in range(ticks):
        seen.append(simulation.step())
        controls.append(inside._data.ctrl.copy())
    pressures = [each.chamber_pressure_Pa.tolist() for each in seen]
    worst, carried = np.zeros(3), 0
    for k in range(ticks):
        data.ctrl[:], soft.pressure_Pa = controls[k], pressures[k]
        soft.step(model, data)
        wrench, other = soft.wrench, seen[k].wrench
        apart = np.abs(wrench.force - other.force).max(), np.abs(wrench.torque - other.torque).max()
        joints, tip = data.qpos - seen[k].joint_position, soft.tip_position - seen[k].tip_position
        worst = np.maximum(worst, [np.abs(joints).max(), np.abs(tip).max(), max(apart)])
        carried += soft.ledger.algorithmic_mass
    print(f"{ticks} ticks, {carried} with algorithmic mass: joints {worst[0]:g} rad, tip {worst[1]:g} m, ")
    print(f"wrench {worst[2]:g} N, N m apart")
    for _ in range(pairs):
        simulation.restore(start)
        began = time.process_time()
        simulation.step(ticks)
        together = time.process_time() - began
        simulation.restore(start)
        began = time.process_time()
        for _ in range(ticks):
            simulation.step()
        each = time.process_time() - began
        soft.restore(begun)
        began = time.process_time()
        for k in range(ticks):
            data.ctrl[:] = controls[k]
            if pressures[k] != pressures[k - 1]:
                soft.pressure_Pa = pressures[k]
            soft.before(model, data)
            mujoco.mj_step(model, data)
            soft.after(model, data)
        foreign = time.process_time() - began
        times = [1e3 * spent / ticks for spent in (together, each, foreign)]
        print("ms a tick: step(n) {:.3f}, step() {:.3f}, foreign loop {:.3f}".format(*times), end="")
        print(f": {foreign / each:.2f} of step(), {foreign / together:.2f} of step(n)")


def momentum(ticks: int) -> None:
    """Print by how much the momentum of a free body with a soft robot changes."""
    spec = mujoco.MjSpec.from_string(FREE)
    soft = cosim.attach(spec, "base", "square_core", overrides=EXACT)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    data.qvel[:3], soft.pressure_Pa = (0.05, -0.02, 0.03), 3e3
    h, mass, film, found, moved = soft.tick_s, soft.node_mass_kg, soft.film, [], 0.0
    for _ in range(ticks):
        speed, before = data.qvel[:3].copy(), film
        soft.step(model, data)
        film = soft.film
        found.append(2.0 * data.qvel[:3] + mass @ (film - before) / h + h * soft.wrench.force)
        moved += 2.0 * float(np.abs(data.qvel[:3] - speed).max())
    change = float(np.abs(np.array(found) - found[0]).max())
    size = float(np.abs(found[0]).max())
    print(
        f"momentum over {ticks * h:g} s: {change:.2g} kg m/s off, {change / size:.2g} of its size, "
        f"{change / moved:.2g} of what moved"
    )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    momentum(5 * count // 2)
    loops(count)
