"""A soft robot on anybody's MuJoCo model: as in `Simulation`, momentum conserved, the rest refused."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cosim
from cosim.app.simulation import stepped_run
from cosim.errors import InputError, InstabilityError

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1"/>
    <body name="upper" pos="0 0 1.0">
      <joint name="shoulder" axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="2"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="1"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" mass="1"/>
        <site name="wrist" pos="0.2 0 0" euler="0 180 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="400" kv="20"/>
    <position joint="elbow" kp="200" kv="10"/>
  </actuator>
</mujoco>
"""
FREE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="{mass}"/></body>
  </worldbody>
</mujoco>
"""
LIGHT: dict[str, Any] = {"fidelity": "rigid"}
ROBOT = "square_core"


def hung(text: str = ARM, at: str = "wrist", **given: Any) -> tuple[cosim.Attached, Any, Any]:
    """Return a soft robot attached to an MJCF, with its compiled model and data."""
    spec = mujoco.MjSpec.from_string(text)
    soft = cosim.attach(spec, at, ROBOT, **given)
    model = spec.compile()
    return soft, model, mujoco.MjData(model)


def take(soft: cosim.Attached, model: Any, data: Any, count: int) -> None:
    """Take some ticks."""
    for _ in range(count):
        soft.step(model, data)


BALL = {"name": "ball", "shape": "sphere", "size_m": [0.03], "position_m": [0.0, 0.6, 0.03], "mass_kg": 0.1}


@pytest.mark.parametrize("steps", [1, 4])
def test_a_foreign_loop_around_a_scene_is_the_simulation_to_the_bit(steps: int) -> None:
    """The UR5e carries algorithmic mass with such a heavy soft arm; a command of every tick changes both.

    A light ball in the scene lets MuJoCo take four steps in a tick, in which servos go on at their speed.
    """
    node_kg = 0.02 if steps == 1 else 0.015  # up to a ratio of 1 all of it is carried
    heavy = {"soft_robot.mass.node_mass_kg": node_kg, "solver.damping_per_s": 2.0, "start.pressure_Pa": 5e3}
    changes: dict[str, Any] = {"soft_robot": ROBOT, "phase": [], "start.cable_tension_N": [], **heavy}
    changes |= {"clock.tick_s": 0.004, "object": [BALL] if steps > 1 else []}
    simulation = cosim.Simulation("ur5e_hexagon_arm", overrides=changes)
    carrier: Any = stepped_run(simulation)._parts.carrier
    inside = carrier._scene
    assert inside.substeps == steps
    model = copy.copy(inside._model)
    data = mujoco.MjData(model)
    data.qpos[:] = inside._data.qpos
    soft = cosim.attach(model, "flange", ROBOT, tick_s=simulation.stage.tick_s, overrides=heavy)
    soft.reset(model, data)
    (chamber,), carried = simulation.stage.chamber_names, 0
    for tick in range(30):
        command = cosim.Command(pressure_Pa={chamber: 5e3 + 20.0 * tick})
        seen = simulation.step(command)
        soft.command(command)
        control = inside._data.ctrl.reshape(-1, 3)
        for left in reversed(range(steps)):
            data.ctrl[:] = control.ravel()
            data.ctrl[::3] -= left * model.opt.timestep * control[:, 1]
            soft.before(model, data)
            mujoco.mj_step(model, data)
            soft.after(model, data)
        carried += seen.algorithmic_mass
        assert steps == 1 or 0.5 < soft.ledger.stability_ratio < 1.0
        bound = 0.0 if steps == 1 else 1e-12  # servos' ways are added up in another order
        np.testing.assert_allclose(data.qpos[:6], seen.joint_position, rtol=0.0, atol=bound)
        np.testing.assert_allclose(soft.tip_position, seen.tip_position, rtol=0.0, atol=bound)
        np.testing.assert_allclose(soft.wrench.force, seen.wrench.force, rtol=0.0, atol=1e3 * bound)
        np.testing.assert_allclose(soft.wrench.torque, seen.wrench.torque, rtol=0.0, atol=1e3 * bound)
        if steps == 1:
            for name in (
                "soft_power_W",
                "residual_N",
                "newton_iterations",
                "stability_ratio",
                "momentum_error",
            ):
                assert getattr(soft.ledger, name) == getattr(seen, name)
    assert carried == 30
    assert soft.ledger.momentum_error < 1e-10


EXACT: dict[str, Any] = {
    "solver.dynamic_tolerance_N": 1e-10, "solver.residual_tolerance_N": 1e-10,
    "solver.dynamic_newton_iterations": 20, "solver.integrator": "implicit_euler",
}  # fmt: skip


def test_momentum_is_conserved_on_a_free_body() -> None:
    """That of body and film, and of the wrench on its way to the body; both move to and fro meanwhile."""
    mass = 2.0
    soft, model, data = hung(FREE.format(mass=mass), "base", overrides=EXACT)
    soft.reset(model, data)
    h, node_mass, film, moved = soft.tick_s, soft.node_mass_kg, soft.film, []
    data.qvel[:3] = 0.05, -0.02, 0.03  # the film starts at rest
    soft.pressure_Pa = 3e3
    momentum = []
    for _ in range(20):
        before, film_before = data.qvel[:3].copy(), film
        soft.step(model, data)
        film = soft.film
        of_film = node_mass @ (film - film_before) / h
        momentum.append(mass * data.qvel[:3] + of_film + h * soft.wrench.force)
        moved.append(mass * np.abs(data.qvel[:3] - before).max())
        assert not soft.ledger.algorithmic_mass
    assert sum(moved) > 0.01
    np.testing.assert_allclose(momentum, [momentum[0]] * 20, rtol=0.0, atol=1e-10 * sum(moved))


def test_a_light_free_body_carries_what_hangs_on_it() -> None:
    """MuJoCo keeps no whole mass matrix of such a body: a specification gets a child, a model cannot."""
    soft, model, data = hung(FREE.format(mass=0.1), "base")
    data.qvel[:3] = 0.05, -0.02, 0.03
    take(soft, model, data, 30)
    assert soft.ledger.algorithmic_mass
    assert np.abs(data.qvel[:3]).max() < 0.06
    alone = mujoco.MjModel.from_xml_string(FREE.format(mass=0.1))
    with pytest.raises(InputError, match="attach to the MjSpec"):
        cosim.attach(alone, "base", ROBOT).step(alone, mujoco.MjData(alone))


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "no_such_site": (ARM, {"at": "hand"}, r"at is 'hand'.*sites: wrist; bodies: upper, lower"),
    "rk4": (ARM.replace("implicitfast", "RK4"), {}, "RK4.*use Euler"),
    "tick": (ARM, {"tick_s": 0.003}, "tick_s is 0.003; must be one or several timesteps of 0.002"),
    "not_finite": (ARM.replace('mass="2"', 'mass="-2"'), {}, "MuJoCo refuses it"),
    "gravity": (ARM, {"overrides": {"gravity_m_s2": [0.0, 0.0, 0.0]}}, "gravity_m_s2 cannot be set here"),
    "scheme": (ARM, {"overrides": {"coupling.scheme": "iterated"}}, "coupling.scheme 'staggered'"),
    "key": (ARM, {"overrides": {"no.such": 1}}, "no"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_will_not_do_is_refused_by_name(name: str) -> None:
    text, given, words = REFUSED[name]
    arguments: dict[str, Any] = {"at": "wrist", "overrides": LIGHT, **given}
    with pytest.raises(InputError, match=words):
        cosim.attach(mujoco.MjSpec.from_string(text), robot=ROBOT, **arguments)


def test_a_robot_or_a_body_and_a_model_are_required() -> None:
    with pytest.raises(InputError, match="give one of them"):
        cosim.attach(mujoco.MjSpec.from_string(ARM), "wrist")
    with pytest.raises(InputError, match=r"spec is dict; give a mujoco\.MjSpec"):
        cosim.attach({}, "wrist", ROBOT)


def test_a_loop_that_calls_in_the_wrong_order_is_refused() -> None:
    soft, model, data = hung(overrides=LIGHT)
    with pytest.raises(InputError, match="is not mounted yet"):
        soft.save()
    with pytest.raises(InputError, match="without before"):
        soft.after(model, data)
    soft.before(model, data)
    with pytest.raises(InputError, match="called twice"):
        soft.before(model, data)
    with pytest.raises(InputError, match="a tick is in progress"):
        soft.save()
    with pytest.raises(InputError, match="exactly one mj_step"):
        soft.after(model, data)
    soft.reset(model, data)
    soft.before(model, data)
    data.xfrc_applied[:] = 0.0
    mujoco.mj_step(model, data)
    with pytest.raises(InputError, match="xfrc_applied was written to between"):
        soft.after(model, data)
    with pytest.raises(InputError, match="another model and data"):
        soft.before(model, mujoco.MjData(model))
    model.opt.timestep = 0.001
    with pytest.raises(InputError, match=r"model\.opt\.timestep is 0\.001, and was 0\.002"):
        soft.reset(model, data)


def test_a_model_that_becomes_unstable_is_reported() -> None:
    """Euler takes the damping of servos explicitly: MuJoCo begins anew, which is no error of the loop."""
    soft, model, data = hung(ARM.replace("implicitfast", "Euler").replace('"10"', '"60"'), overrides=LIGHT)
    data.ctrl[:] = 1.0
    with pytest.raises(InstabilityError, match=r"became unstable at 0\.\d+ s"):
        take(soft, model, data, 200)


def test_loads_of_the_loop_itself_stay_as_they_are() -> None:
    """A push on the arm and a torque are there before, while MuJoCo steps, and after, beside the wrench."""
    soft, model, data = hung(overrides={"fidelity": "rigid"})
    data.xfrc_applied[1, :3], data.qfrc_applied[:] = (0.1, 0.2, 0.3), 0.01
    given = data.xfrc_applied.copy(), data.qfrc_applied.copy()
    for _ in range(3):
        soft.before(model, data)
        lower, force = data.xfrc_applied[2] - given[0][2], soft.wrench.force
        lever = data.site_xpos[0] - data.xipos[2]  # MuJoCo takes loads at centres of mass
        np.testing.assert_array_equal(lower[:3], force)
        np.testing.assert_allclose(lower[3:], soft.wrench.torque + np.cross(lever, force), atol=1e-12)
        mujoco.mj_step(model, data)
        soft.after(model, data)
        np.testing.assert_array_equal(data.xfrc_applied, given[0])
        np.testing.assert_array_equal(data.qfrc_applied, given[1])


def test_a_saved_state_repeats_the_ticks_to_the_bit(tmp_path: Path) -> None:
    """Light arm: it carries algorithmic mass; from memory, from a file, and in a new pair of both."""
    soft, model, data = hung(overrides={"solver.damping_per_s": 2.0})

    def walk(soft: cosim.Attached, model: Any, data: Any) -> bytes:
        for tick in range(8):
            data.ctrl[:] = 0.02 * tick
            soft.step(model, data)
        return b"".join(part.tobytes() for part in (data.qpos, data.qvel, soft.film, soft.wrench.force))

    soft.reset(model, data)
    start = soft.save()
    begun = walk(soft, model, data)
    assert soft.ledger.algorithmic_mass
    saved = soft.save()
    saved.write(tmp_path / "here.npz")
    ledger, first = repr(soft.ledger), walk(soft, model, data)
    soft.restore(saved)
    assert repr(soft.ledger) == ledger
    assert walk(soft, model, data) == first
    soft.restore(start)  # where nothing is carried yet
    assert walk(soft, model, data) == begun
    other, model, data = hung(overrides={"solver.damping_per_s": 2.0})
    other.reset(model, data)
    other.restore(tmp_path / "here.npz")
    assert walk(other, model, data) == first


def test_a_restored_mount_gives_back_nothing_that_it_does_not_carry() -> None:
    """With heavy rotors nothing is carried; without them it is, until the state before is restored."""
    soft, model, data = hung()
    model.dof_armature[:] = 5.0
    soft.reset(model, data)
    start = soft.save()
    take(soft, model, data, 3)
    first, carried = data.qpos.copy(), [soft.ledger.algorithmic_mass]
    model.dof_armature[:] = 0.0
    soft.restore(start)
    take(soft, model, data, 3)
    assert [*carried, soft.ledger.algorithmic_mass] == [False, True]
    model.dof_armature[:] = 5.0
    soft.restore(start)
    take(soft, model, data, 3)
    np.testing.assert_array_equal(data.qpos, first)


def test_what_a_loop_reads_leaves_no_trace() -> None:
    """Whatever is read between ticks, or within one, changes none of them."""
    ends: list[Any] = []
    text = ARM.replace('mass="2"', 'mass="4"').replace('mass="1"', 'mass="3"')
    for reads in (False, True):
        soft, model, data = hung(text, overrides={"solver.damping_per_s": 5.0, "start.pressure_Pa": 5e3})
        names = soft.scenario.soft_robot.chamber_names()
        command = cosim.Command(pressure_Pa=dict.fromkeys(names, 6e3))
        soft.reset(model, data)
        for tick in range(90):
            if tick == 20:
                soft.command(command, over_s=0.03)
            soft.before(model, data)
            if reads and tick % 3 == 0:
                assert np.array_equal(soft.measure().tip_position, soft.tip_position)
            mujoco.mj_step(model, data)
            if reads and tick % 7 == 0:
                assert soft.ledger.wrench.force.tolist() == soft.wrench.force.tolist()
            soft.after(model, data)
            if reads and tick in (19, 40):  # a command acts from the next tick on
                assert soft.pressure_Pa == (5e3 if tick == 19 else 6e3,)
            ends.append((soft.tip_position.tolist(), soft.wrench.torque.tolist(), data.qpos.tolist()))
        ends.append((repr(soft.ledger), soft.film.tolist(), soft.save().parts["scene"].given_back.tolist()))
    half = len(ends) // 2
    assert ends[:half] == ends[half:]


def test_several_steps_of_mujoco_make_a_tick() -> None:
    """The wrench stays the same within a tick; the soft robot moves at its end alone."""
    text = ARM.replace("0.002", "0.0005")
    soft, model, data = hung(text, tick_s=0.002, overrides={"solver.damping_per_s": 2.0})
    acts: Any = None
    for step in range(1, 25):
        soft.before(model, data)
        last, acts = acts, data.xfrc_applied.copy()
        mujoco.mj_step(model, data)
        film = soft.film
        soft.after(model, data)
        assert soft.tick == step // 4
        assert np.array_equal(soft.film, film) == (step % 4 != 0)
        assert np.array_equal(acts, last) == (step % 4 != 1)
    assert soft.ledger.momentum_error < 1e-10


TWO = """
<mujoco>
  <worldbody>
    <body name="left" pos="-1 0 1"><joint axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="2"/>
      <site name="left_wrist" pos="0.3 0 0" euler="0 180 0"/></body>
    {other}
  </worldbody>
</mujoco>
"""
OTHER = """
    <body name="right" pos="1 0 1"><joint axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" mass="1"/>
      <site name="right_wrist" pos="0.2 0 0" euler="0 180 0"/></body>
"""


def test_two_soft_robots_in_one_model_do_not_disturb_each_other() -> None:
    """Each goes as it does alone, whichever is called first; both mounts carry algorithmic mass."""
    spec = mujoco.MjSpec.from_string(TWO.format(other=OTHER))
    both = [cosim.attach(spec, f"{side}_wrist", ROBOT) for side in ("left", "right")]
    model = spec.compile()
    data = mujoco.MjData(model)
    alone, own, state = hung(TWO.format(other=""), "left_wrist")
    for _ in range(20):
        for soft in both:
            soft.before(model, data)
        mujoco.mj_step(model, data)
        for soft in both:
            soft.after(model, data)
        alone.step(own, state)
    assert both[0].ledger.algorithmic_mass
    assert both[1].ledger.algorithmic_mass
    assert not data.xfrc_applied.any()
    assert mujoco.get_mjcb_control() is None
    np.testing.assert_allclose(data.qpos[:1], state.qpos, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(both[0].film, alone.film, rtol=0.0, atol=1e-12)


def test_the_film_touches_what_is_in_the_scene() -> None:
    """A soft robot on a carriage comes down on a free box, which bears what the film feels."""
    text = """
    <mujoco><option timestep="0.001"/><worldbody>
      <geom name="floor" type="plane" size="1 1 0.1"/>
      <body name="carriage" pos="0 0 0.13"><joint name="down" type="slide" axis="0 0 -1"/>
        <geom type="box" size="0.05 0.05 0.01" mass="5" contype="0" conaffinity="0"/>
        <site name="tool" euler="180 0 0"/></body>
      <body name="box" pos="0 0 0.05"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="0.5"/></body>
    </worldbody>
    <actuator><position joint="down" kp="5000" kv="100" /></actuator></mujoco>"""
    soft, model, data = hung(text, "tool", overrides={"solver.damping_per_s": 5.0, "start.pressure_Pa": 2e3})
    soft.reset(model, data)
    gap = float(soft.film[:, 2].min()) - 0.1
    touched, taken_J, told_J = 0, 0.0, 0.0
    for tick in range(120):
        data.ctrl[0] = min(gap + 2e-3, 0.001 * tick)
        before = data.body("box").xipos.copy()
        soft.step(model, data)
        assert soft.ledger.momentum_error < 1e-10
        touched += soft.ledger.contacts > 0
        taken_J += float(soft.measure().contact_force_N["box"] @ (data.body("box").xipos - before))
        told_J += soft.ledger.bodies_work_J
    assert abs(taken_J) > 1e-6
    assert told_J == pytest.approx(taken_J, rel=0.05)  # the box turns as well
    force = soft.measure().contact_force_N["box"]
    assert touched > 10
    assert force[2] < -0.1
    assert abs(data.qpos[3] - 0.05) < 5e-3


def test_a_mocap_body_presses_on_the_film_as_a_driven_one_does() -> None:
    """It gives way to no load; a slide that a stiff servo leads the same way gives by little."""
    text = """
    <mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/><worldbody>
      <body name="carriage" pos="0 0 0.5">
        <joint type="slide" axis="0 0 1" stiffness="5000" damping="300"/>
        <geom type="box" size="0.05 0.05 0.01" mass="3" contype="0" conaffinity="0"/>
        <site name="tool" pos="0 0 -0.01" euler="180 0 0"/></body>
      <body name="plate" {led}pos="0 0 0.456">{joint}<geom type="box" size="0.05 0.05 0.01" mass="9"/></body>
    </worldbody>{servo}</mujoco>"""
    slide = {"joint": '<joint name="up" type="slide" axis="0 0 1"/>', "led": ""}
    slide["servo"] = '<actuator><position joint="up" kp="1e6" kv="1e4"/></actuator>'
    forces = []
    for given in ({"joint": "", "led": 'mocap="true" ', "servo": ""}, slide):
        calm = {"solver.damping_per_s": 20.0, "start.pressure_Pa": 3e3}
        soft, model, data = hung(text.format(**given), "tool", overrides=calm)
        for tick in range(300):  # it swings until then, after a ramp of 120
            up = 8e-5 * min(tick, 120)
            if model.nmocap:
                data.mocap_pos[0, 2] = 0.456 + up
            else:
                data.ctrl[0] = up
            soft.step(model, data)
            assert soft.ledger.momentum_error < 1e-10
        forces.append(soft.measure().contact_force_N["plate"][2])
    assert forces[0] < -0.3
    assert forces[0] == pytest.approx(forces[1], rel=0.005)
