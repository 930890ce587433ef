"""A soft wrist between two bodies: a peg that goes into a hole beside it, and momentum of bodies that float.

    python benchmarks/soft_wrist.py [--sides 24 36] [--seconds 10]

The wrist is an inflated tube of film, 40 mm long and 40 mm wide; its first ring hangs on a carriage, its last
one is glued to the peg. The carriage comes down beside the hole by the offset; a chamfer leads the peg in.
Printed are the mean push down on the way of 30 mm, and at its end the sideways force and the turn of the peg.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import mujoco
import numpy as np

import cosim
from cosim.bench.known_answers import tube
from cosim.build.given_body import NamedBody
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges

RADIUS_M, LENGTH_M = 0.02, 0.04
FILM = Film(20e6, 0.3, 2e-4, "tension_field", 1e-2)
PRESSURES_Pa, OFFSETS_M = (5e3, 10e3, 20e3), (0.0, 1e-3, 2e-3, 3e-3)
DOWN_M, SPEED_M_S, SETTLE_S = 0.03, 0.02, 0.3

SCENE = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic"/>
  <default><geom solref="0.006 1" friction="0.2"/></default>
  <worldbody>
    <body name="carriage" pos="0 0 0.15">
      <joint name="aside" type="slide" axis="1 0 0"/>
      <joint name="down" type="slide" axis="0 0 -1"/>
      <geom type="box" size="0.04 0.04 0.01" mass="5" pos="0 0 0.01"/>
      <site name="wrist" euler="180 0 0"/>
    </body>
    <body name="peg" pos="0 0 {tip}">
      <freejoint/>
      <geom type="capsule" fromto="0 0 -0.01 0 0 -0.05" size="0.01" mass="0.15"/>
    </body>
    {walls}
  </worldbody>
  <actuator>
    <position joint="aside" kp="1e5" kv="2000"/>
    <position joint="down" kp="1e5" kv="2000"/>
  </actuator>
</mujoco>
"""
FREE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="near" pos="0 0 -0.01">
      <freejoint/>
      <geom type="box" size="0.03 0.03 0.01" mass="1"/>
      <site name="wrist" pos="0 0 0.01"/>
    </body>
    <body name="far" pos="0 0 0.05"><freejoint/><geom type="box" size="0.03 0.03 0.01" mass="{mass}"/></body>
  </worldbody>
</mujoco>
"""
EXACT = {"solver.dynamic_tolerance_N": 1e-12, "solver.integrator": "implicit_euler"}
EXACT |= {"solver.residual_tolerance_N": 1e-12, "solver.dynamic_newton_iterations": 20}


def wrist(sides: int) -> NamedBody:
    """Return the wrist with so many nodes around, and rows as high as they are wide."""
    rows = round(sides * LENGTH_M / (2.0 * np.pi * RADIUS_M))
    positions, triangles = tube(RADIUS_M, LENGTH_M, sides, rows)
    ring = np.arange(len(positions)).reshape(rows + 1, sides)
    area = 2.0 * np.pi * RADIUS_M * LENGTH_M
    mass = np.full(ring.shape, 1200.0 * FILM.thickness_m * area / (sides * rows))
    mass[[0, -1]] *= 0.5
    body = SoftBody.from_arrays(
        positions, triangles, FILM, wrinkle_panel_m=0.0, hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=FILM.bending_stiffness_Nm, caps=(ring[0][::-1], ring[-1]), node_mass=mass.ravel(),
        base=ring[0], tip=ring[-1],
    )  # fmt: skip
    return NamedBody(body, "wrist")


def walls(half_m: float = 0.0102, chamfer_m: float = 0.004) -> str:
    """Return the four walls of a square hole in the plane z = 0, with a chamfer of 45 degrees."""
    found = []
    for turn in (0, 90, 180, 270):
        found.append(f'<body euler="0 0 {turn}">')
        found.append(f'<geom type="box" size="0.02 0.04 0.02" pos="{half_m + 0.02} 0 {-0.02 - chamfer_m}"/>')
        slant, thick = chamfer_m * 2.0**0.5 / 2.0, 0.004
        x, z = half_m + 0.5 * chamfer_m + thick / 2.0**0.5, -0.5 * chamfer_m - thick / 2.0**0.5
        found.append(f'<geom type="box" size="{slant} 0.04 {thick}" pos="{x} 0 {z}" euler="0 -45 0"/></body>')
    return "\n".join(found)


def insert(sides: int, pressure_Pa: float, offset_m: float) -> tuple[float, float, float]:
    """Return the mean push down [N], then the force aside [N] and the turn [rad] of a peg in its hole."""
    text = SCENE.format(tip=0.15 - LENGTH_M, walls=walls())
    spec = mujoco.MjSpec.from_string(text)
    given = {"solver.damping_per_s": 10.0, "start.pressure_Pa": pressure_Pa}
    soft = cosim.attach(spec, ("wrist", "peg"), body=wrist(sides), overrides=given)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = data.qpos[2] = data.ctrl[0] = offset_m
    clear = 0.15 - LENGTH_M - 0.06 - 0.002  # from the peg's end to just above the chamfer
    data.qpos[1] = data.ctrl[1] = clear
    data.qpos[4] -= clear
    soft.reset(model, data)
    hold, way = 100, round(DOWN_M / SPEED_M_S / soft.tick_s)
    down = []
    for tick in range(hold + way + round(SETTLE_S / soft.tick_s)):
        data.ctrl[1] = clear + DOWN_M * min(max(tick - hold, 0) / way, 1.0)
        soft.step(model, data)
        down.append(float(soft.wrench.force[2]))
    push = np.mean(down[hold : hold + way]) - down[hold - 1]
    turn = float(np.linalg.norm(data.qpos[6:9]) * 2.0)
    return float(push), float(soft.wrench.force[0]), turn


def momentum(sides: int, seconds: float, mass_kg: float) -> None:
    """Print by how much the momentum of two floating bodies with the wrist between them changes."""
    spec = mujoco.MjSpec.from_string(FREE.format(mass=mass_kg))
    soft = cosim.attach(spec, ("wrist", "far"), body=wrist(sides), overrides=EXACT)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    data.qvel[:3], soft.pressure_Pa = (0.05, -0.02, 0.03), 3e3
    data.qvel[3:6] = 0.3, 0.2, -0.1
    h, film, found, moved = soft.tick_s, soft.film, [], 0.0
    for _ in range(round(seconds / h)):
        speed, before = data.qvel[:3].copy(), film
        soft.step(model, data)
        film = soft.film
        found.append(data.qvel[:3] + mass_kg * data.qvel[6:9] + soft.node_mass_kg @ (film - before) / h)
        found[-1] += h * (soft.wrench.force + soft.far_wrench.force)  # what is on its way to both
        moved += float(np.abs(data.qvel[:3] - speed).max())
    change = float(np.abs(np.array(found) - found[0]).max())
    size = float(np.abs(found[0]).max())
    print(f"momentum over {seconds:g} s, {mass_kg:g} kg: {change:.2g} kg m/s off, {change / size:.2g} of its")
    print(f"size, {change / moved:.2g} of what moved; ledger of the loads {soft.ledger.momentum_error:.2g}")


def table(meshes: Sequence[int]) -> None:
    """Print the forces over pressure and offset of the last mesh, and how far the one before is from them."""
    print("| pressure [kPa] | offset [mm] | push [N] | force aside [N] | turn [deg] | coarser mesh off by |")
    print("|---:|---:|---:|---:|---:|---:|")
    worst = 0.0
    for pressure in PRESSURES_Pa:
        for offset in OFFSETS_M:
            found = np.array([insert(sides, pressure, offset) for sides in meshes])
            off = np.abs(found[-2] / found[-1] - 1.0)[: 3 if offset else 0].max(initial=0.0)
            worst, (push, aside, turn) = max(worst, off), found[-1]
            forces = f"{push:.3f} | {abs(aside):.3f} | {np.degrees(turn):.2f}"
            print(f"| {1e-3 * pressure:g} | {1e3 * offset:g} | {forces} | {1e2 * off:.1f} % |", flush=True)
    print(f"meshes of {meshes[-2]} and {meshes[-1]} sides are at most {1e2 * worst:.1f} % apart")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sides", type=int, nargs="+", default=[24, 36])
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    began = time.process_time()
    for mass_kg in (0.5, 0.01):
        momentum(8, given.seconds, mass_kg)
    table(given.sides)
    print(f"{time.process_time() - began:.0f} s of processor time")
