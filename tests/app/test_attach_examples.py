"""A soft robot in loops of others: mink's inverse kinematics, a gymnasium environment, MuJoCo's viewer."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import cosim
from cosim.errors import InputError

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="4"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" mass="3"/>
        <site name="wrist" pos="0.2 0 0" euler="0 180 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="4000" kv="200"/>
    <position joint="elbow" kp="2000" kv="100"/>
  </actuator>
</mujoco>
"""
ROBOT = "square_core"
CALM: dict[str, Any] = {"solver.damping_per_s": 5.0, "start.pressure_Pa": 5e3}


def test_inverse_kinematics_of_mink_brings_the_wrist_with_its_soft_robot() -> None:
    """The soft robot weighs on servos that do not know it: the wrist ends within their give of its target."""
    mink = pytest.importorskip("mink", reason="needs mink")
    spec = mujoco.MjSpec.from_string(ARM)
    soft = cosim.attach(spec, "wrist", ROBOT, overrides=CALM)
    model = spec.compile()
    data = mujoco.MjData(model)
    wanted = mink.Configuration(model)
    wanted.update(np.array([0.2, 0.3]))
    target = wanted.get_transform_frame_to_world("wrist", "site")
    task = mink.FrameTask("wrist", "site", position_cost=1.0, orientation_cost=0.1)
    task.set_target(target)
    way = mink.Configuration(model)
    way.update(np.array([0.1, 0.1]))
    data.qpos[:] = data.ctrl[:] = way.q
    soft.reset(model, data)
    for _ in range(250):
        velocity = mink.solve_ik(way, [task], model.opt.timestep, "daqp", 1e-6)
        way.integrate_inplace(np.clip(velocity, -1.0, 1.0), model.opt.timestep)
        data.ctrl[:] = way.q
        soft.step(model, data)
    np.testing.assert_allclose(way.q, [0.2, 0.3], rtol=0.0, atol=1e-4)
    assert np.linalg.norm(data.site("wrist").xpos - target.translation()) < 5e-3
    assert np.linalg.norm(soft.tip_position - data.site("wrist").xpos) > 0.02


@pytest.mark.filterwarnings("ignore")
def test_an_environment_of_gymnasium_carries_a_soft_robot() -> None:
    """Its steps are the soft robot's; from a saved state it repeats an episode to the bit."""
    gymnasium = pytest.importorskip("gymnasium", reason="needs gymnasium")
    pytest.importorskip("imageio", reason="its MuJoCo environments need imageio")
    env = gymnasium.make("Pusher-v5").unwrapped
    model, data = env.model, env.data
    overrides = {**CALM, "contact.enabled": False}
    soft = cosim.attach(model, "r_wrist_roll_link", ROBOT, overrides=overrides)

    def step(control: Any, frames: int) -> None:
        data.ctrl[:] = control
        soft.step(model, data, frames)

    env._step_mujoco_simulation = step
    env.reset(seed=1)
    soft.reset(model, data)
    start, ends = soft.save(), []
    for _ in range(2):
        soft.restore(start)
        seen = [env.step(np.full(7, 0.2))[0] for _ in range(5)]
        ends.append((np.array(seen).tolist(), soft.tip_position.tolist(), soft.tick))
    assert ends[0] == ends[1]
    assert ends[0][2] == 5 * env.frame_skip
    assert np.isfinite(ends[0][0]).all()


def test_the_film_is_drawn_into_a_scene_of_the_viewer() -> None:
    """A passive viewer draws `user_scn`, a scene as here: every triangle has its corners at its nodes."""
    spec = mujoco.MjSpec.from_string(ARM)
    soft = cosim.attach(spec, "wrist", ROBOT, overrides={"fidelity": "rigid"})
    model = spec.compile()
    data = mujoco.MjData(model)
    scene = mujoco.MjvScene(model, 2000)
    soft.step(model, data)
    soft.draw(scene)
    film, triangles = soft.film, soft.triangles
    assert scene.ngeom == len(triangles)
    for k, nodes in enumerate(triangles.tolist()):
        geom = scene.geoms[k]
        corners = geom.pos + np.vstack([np.zeros(3), geom.mat.T[:2] * geom.size[:2, None]])
        np.testing.assert_allclose(corners, film[nodes], rtol=0.0, atol=1e-6)
    with pytest.raises(InputError, match="room for 1; raise maxgeom"):
        soft.draw(mujoco.MjvScene(model, 1))
