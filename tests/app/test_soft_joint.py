"""A soft joint between two bodies of anybody's model: loads on both, momentum, saved states, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.errors import InputError
from tests.app.test_attach import EXACT, ROBOT

HUNG = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="arm" pos="0 0 1"><joint name="up" type="slide" axis="0 0 1"/>
    <geom type="box" size="0.05 0.05 0.05" mass="3"/>
    <site name="wrist" pos="0 0 -0.05" euler="180 0 0"/></body>
  <body name="tool" pos="0 0 0.925">{joint}<geom type="sphere" size="0.02" mass="{mass}"/></body>
</worldbody><actuator><position joint="up" kp="20000" kv="400"/></actuator></mujoco>"""
FREE = """
<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
  <body name="base"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="2"/></body>
  <body name="tool" pos="0 0 0.01"><freejoint/><geom type="box" size="0.02 0.02 0.02" mass="{mass}"/></body>
</worldbody></mujoco>"""
CALM: dict[str, Any] = {"solver.damping_per_s": 20.0, "start.pressure_Pa": 3e3}


def joined(text: str, at: str | tuple[str, str], **given: Any) -> tuple[cosim.Attached, Any, Any]:
    """Return a soft robot between two bodies, with its compiled model and data."""
    spec = mujoco.MjSpec.from_string(text)
    soft = cosim.attach(spec, at, ROBOT, **given)
    model = spec.compile()
    return soft, model, mujoco.MjData(model)


def hung(mass: float = 0.2, joint: str = "<freejoint/>") -> tuple[cosim.Attached, Any, Any]:
    """Return a tool that hangs on an arm by a soft robot."""
    soft, model, data = joined(HUNG.format(mass=mass, joint=joint), ("wrist", "tool"), overrides=CALM)
    soft.reset(model, data)
    return soft, model, data


def test_a_tool_hangs_on_the_film_and_the_film_on_the_arm() -> None:
    """Each load is that below it; the tool moves by its own, and goes with the tip ring."""
    mass = 0.2
    soft, model, data = hung(mass)
    gap, h, first = data.body("tool").xpos - soft.tip_position, soft.tick_s, model.body("tool").dofadr[0]
    soft.step(model, data, 300)
    load, speed, weight = soft.far_wrench.force, data.qvel[first : first + 3].copy(), 9.81 * mass
    soft.step(model, data)
    moved = mass * (data.qvel[first : first + 3] - speed) / h + [0.0, 0.0, weight]
    np.testing.assert_allclose(load, moved, rtol=0.0, atol=1e-9)
    loads = []
    for _ in range(100):
        soft.step(model, data)
        loads.append((soft.far_wrench.force[2], soft.wrench.force[2]))
    below = weight + 9.81 * soft.node_mass_kg.sum()
    np.testing.assert_allclose(np.mean(loads, axis=0), [weight, -below], rtol=0.02)
    np.testing.assert_allclose(data.body("tool").xpos - soft.tip_position, gap, rtol=0.0, atol=1e-4)
    assert soft.ledger.momentum_error < 1e-10


def test_a_twisted_tool_is_turned_back_by_the_film() -> None:
    """The torque on the tool is against its turn."""
    soft, model, data = hung(0.2, '<joint axis="0 0 1" damping="0.01"/>')
    data.qpos[-1] = 0.1
    soft.step(model, data)
    back = soft.far_wrench.torque[2]
    assert back < -1e-3
    soft.step(model, data, 200)
    assert abs(data.qpos[-1]) < 0.05


@pytest.mark.parametrize("mass", [1.0, 0.1])
def test_momentum_of_two_bodies_and_the_film_is_conserved(mass: float) -> None:
    """A heavy body is met where it is, a light one gives way within the film's step."""
    soft, model, data = joined(FREE.format(mass=mass), ("base", "tool"), overrides=EXACT)
    soft.reset(model, data)
    h, node_mass, film = soft.tick_s, soft.node_mass_kg, soft.film
    data.qvel[:3] = 0.05, -0.02, 0.03
    soft.pressure_Pa = 3e3
    momentum: list[Array] = []
    for _ in range(20):
        before = film
        soft.step(model, data)
        film = soft.film
        total = 2.0 * data.qvel[:3] + mass * data.qvel[6:9] + node_mass @ (film - before) / h
        momentum.append(total + h * (soft.wrench.force + soft.far_wrench.force))
        assert soft.ledger.momentum_error < 1e-10
    assert np.abs(data.qvel[6:9]).max() > 0.1  # the inflated film has pushed the tool away
    np.testing.assert_allclose(momentum, [momentum[0]] * 20, rtol=0.0, atol=1e-10 * 0.1)


def test_a_saved_soft_joint_repeats_its_ticks_to_the_bit(tmp_path: Path) -> None:
    """From memory, and from a file in a new pair that has been glued elsewhere."""
    soft, model, data = hung()

    def walk(soft: cosim.Attached, model: Any, data: Any) -> bytes:
        for tick in range(6):
            data.ctrl[:] = 0.002 * tick
            soft.step(model, data)
        return b"".join(part.tobytes() for part in (data.qpos, data.qvel, soft.film, soft.far_wrench.force))

    walk(soft, model, data)
    saved = soft.save()
    saved.write(tmp_path / "here.npz")
    first = walk(soft, model, data)
    soft.restore(saved)
    assert walk(soft, model, data) == first
    text = HUNG.format(mass=0.2, joint="<freejoint/>")
    other, model, data = joined(text, ("wrist", "tool"), overrides=CALM)
    data.qpos[-7] += 2e-3
    other.reset(model, data)
    other.restore(tmp_path / "here.npz")
    assert walk(other, model, data) == first
    alone, model, data = joined(text, "wrist", overrides={"contact.enabled": False})
    alone.reset(model, data)
    with pytest.raises(InputError, match=r"glued by \d+ nodes, this one by 0"):
        alone.restore(saved)


REFUSED: dict[str, tuple[Any, dict[str, Any], str]] = {
    "no such body": (("wrist", "hand"), {}, "at is 'hand'.*bodies: arm, tool"),
    "goes with the mount": (("wrist", "arm"), {}, "'arm' is rigidly connected to the mount"),
    "three": (("wrist", "tool", "arm"), {}, "at is .*; give the name of a site or body, or two names"),
    "number": (3, {}, "at is 3; give the name of a site or body, or two names"),
    "rigid": (("wrist", "tool"), {"fidelity": "rigid"}, "fidelity is 'rigid'; a soft joint"),
    "section": (("wrist", "tool"), {"fidelity": "section"}, "fidelity is 'section'; a soft joint"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_soft_joint_cannot_be_is_refused_by_name(name: str) -> None:
    at, overrides, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        joined(HUNG.format(mass=0.2, joint="<freejoint/>"), at, overrides=overrides)


def test_a_body_far_from_the_tip_is_refused_with_the_tips_position() -> None:
    soft, model, data = joined(HUNG.format(mass=0.2, joint="<freejoint/>"), ("wrist", "tool"), overrides=CALM)
    data.qpos[-7] = 0.5
    with pytest.raises(InputError, match=r"'tool' is 0\.5\d* m from the soft robot's tip at"):
        soft.reset(model, data)


def test_the_film_touches_its_second_body_at_the_glue_alone() -> None:
    """The tool's ball is in the film and neither pushes it away nor is refused at the start."""
    soft, model, data = hung()
    soft.step(model, data, 5)
    assert soft.ledger.contacts == 0


LINKS = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="upper" pos="0 0 1"><geom type="box" size="0.05 0.05 0.05" mass="3"/>
    <site name="above" pos="0 0 -0.05" euler="180 0 0"/>
    <body name="lower" pos="0 0 -0.06"><joint axis="0 1 0" damping="0.01"/>
      <geom type="capsule" fromto="0 0 -0.03 0.1 0 -0.03" size="0.01" mass="0.3"/>
      <site name="below" pos="0 0 -0.012"/></body></body>
</worldbody></mujoco>"""


def test_film_between_two_links_of_one_arm_holds_their_hinge_back() -> None:
    """The second link is in the tree that carries the first end; it falls less far than it does alone."""
    soft, model, data = joined(LINKS, ("above", "below"), overrides=CALM)
    soft.step(model, data, 300)
    alone = mujoco.MjData(model)
    mujoco.mj_step(model, alone, 300)
    assert 0.05 < data.qpos[0] < 0.95 * alone.qpos[0]
    assert soft.ledger.momentum_error < 1e-10


@pytest.mark.parametrize("led", ["", 'mocap="true" '])
def test_a_second_body_that_cannot_move_bears_the_film(led: str) -> None:
    text = HUNG.format(mass=0.2, joint="").replace('<body name="tool" ', f'<body name="tool" {led}')
    soft, model, data = joined(text, ("wrist", "tool"), overrides=CALM)
    data.ctrl[0] = 5e-3  # the arm pulls up
    soft.step(model, data, 100)
    assert soft.far_wrench.force[2] > 1.0
    assert soft.wrench.force[2] < -1.0
    assert soft.ledger.momentum_error < 1e-10
