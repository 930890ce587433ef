"""The cases in plain MuJoCo: a 2D flex with stretching elasticity, follower pressure written by hand."""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.peers.case import Case, Course, FollowerPressure, Run, run
from cosim.rigid.scene.warnings import set_up_engine


def _numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


_RADIUS_M = 5e-4  # of the flex; the film touches with it
_CONTACT_S = 0.001  # time constant of contact; MuJoCo takes two ticks at least


def model_of(course: Course, case: Case, tick_s: float, integrator: str) -> mujoco.MjModel:
    """Return the arm as a flex whose vertices slide along the world's axes; the base is pinned."""
    flag, bar = 'contact="disable"', ""
    if course.bar is not None:
        flag, bar = "", course.bar.mjcf(_RADIUS_M)
    xml = f"""
    <mujoco>
      <option timestep="{tick_s}" integrator="{integrator}" solver="Newton" tolerance="1e-10">
        <flag {flag} autoreset="disable"/>
      </option>
      <default><geom solref="{_CONTACT_S} 1"/></default>
      <worldbody>
        {bar}
        <flexcomp name="arm" type="direct" dim="2" mass="1" radius="{_RADIUS_M}"
                  point="{_numbers(case.drawn)}" element="{_numbers(case.triangles)}">
          <pin id="{_numbers(case.base)}"/>
          <contact selfcollide="none" solref="{_CONTACT_S} 1"/>
          <elasticity young="{case.young_Pa}" poisson="{case.poisson}" thickness="{case.thickness_m}"
                      elastic2d="stretch"/>
        </flexcomp>
      </worldbody>
    </mujoco>"""
    return mujoco.MjModel.from_xml_string(xml)


def simulate(course: Course, case: Case, tick_s: float, integrator: str = "discrete") -> Run:
    """Return the run of MuJoCo at a tick; `integrator` as MuJoCo names it."""
    set_up_engine()
    model = model_of(course, case, tick_s, integrator)
    data = mujoco.MjData(model)
    moving = np.setdiff1d(np.arange(len(case.drawn)), case.base)
    bodies = model.flex_vertbodyid[moving]
    model.body_mass[bodies] = case.mass[moving]
    model.dof_damping[:] = np.repeat(course.damping_per_s * case.mass[moving], 3)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    mujoco.mj_resetData(model, data)
    data.qpos[:] = (case.start - case.drawn)[moving].ravel()
    mujoco.mj_forward(model, data)
    pressure, positions = FollowerPressure(case), np.array(case.drawn)

    def place() -> np.ndarray:
        positions[moving] = case.drawn[moving] + data.qpos.reshape(-1, 3)
        return positions

    def step(time_s: float) -> None:
        model.opt.gravity[:] = course.gravity_at(time_s)
        data.xfrc_applied[bodies, :3] = pressure(place(), course.pressure_at(time_s))[moving]
        mujoco.mj_step(model, data)

    return run(course, case, tick_s, step, place)
