"""The cases in plain MuJoCo: a 2D flex with stretching elasticity, follower pressure written by hand."""

from __future__ import annotations

import mujoco
import numba
import numpy as np

from benchmarks.peers.case import Case, Course, FollowerPressure, Run, run
from cosim.rigid.build.engine import set_up_engine


def _numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


_RADIUS_M = 5e-4  # of the flex; the film touches with it
_UNUSED = " ".join(
    f'{what}="disable"' for what in ("actuation", "equality", "limit", "frictionloss", "sensor")
)
"""What the cases need no work for; steps without `eulerdamp` save 6 % for errors larger by 12 to 40 %."""
_CONTACT_S = 0.001  # time constant of contact; MuJoCo takes two ticks at least


def model_of(course: Course, case: Case, tick_s: float, integrator: str) -> mujoco.MjModel:
    """Return the arm as a flex whose vertices slide along the world's axes; the base is pinned."""
    flag, bar = f'{_UNUSED} constraint="disable"', ""
    if course.bar is not None:
        flag, bar = _UNUSED, course.bar.mjcf(_RADIUS_M)
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
    bodies = model.flex_vertbodyid[moving].astype(np.int64)
    model.body_mass[bodies] = case.mass[moving]
    model.dof_damping[:] = np.repeat(course.damping_per_s * case.mass[moving], 3)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    mujoco.mj_resetData(model, data)
    data.qpos[:] = (case.start - case.drawn)[moving].ravel()
    mujoco.mj_forward(model, data)
    pressure, positions = FollowerPressure(case), np.array(case.drawn)
    moved, applied, gravity = data.qpos, data.xfrc_applied, model.opt.gravity

    def place() -> np.ndarray:
        _place(case.drawn, moved, moving, positions)
        return positions

    def step(time_s: float) -> None:
        gravity[:] = course.gravity_at(time_s)
        _hand_over(pressure(place(), course.pressure_at(time_s)), moving, bodies, applied)
        mujoco.mj_step(model, data)

    return run(course, case, tick_s, step, place)


@numba.njit
def _place(drawn: np.ndarray, moved: np.ndarray, moving: np.ndarray, out: np.ndarray) -> None:
    """Fill out (n, 3) where nodes move, from their displacements along the world's axes."""
    for k in range(moving.shape[0]):
        for r in range(3):
            out[moving[k], r] = drawn[moving[k], r] + moved[3 * k + r]


@numba.njit
def _hand_over(force: np.ndarray, moving: np.ndarray, bodies: np.ndarray, applied: np.ndarray) -> None:
    """Fill applied (bodies, 6) with forces (n, 3) on nodes."""
    for k in range(moving.shape[0]):
        for r in range(3):
            applied[bodies[k], r] = force[moving[k], r]
