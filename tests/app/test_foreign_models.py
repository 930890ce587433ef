"""Models of others: a soft robot hangs on them and goes a few ticks, or is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import cosim
from cosim.errors import InputError

LIGHT: dict[str, Any] = {"fidelity": "rigid"}
ROBOT = "square_core"
gymnasium = pytest.importorskip("gymnasium")
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
FILES = sorted(ASSETS.glob("*.xml"))


def begin(spec: Any, at: str, overrides: dict[str, Any]) -> tuple[cosim.Attached, Any, Any]:
    """Return a soft robot at rest on a model, with that and its data."""
    soft = cosim.attach(spec, at, ROBOT, overrides=overrides)
    model = spec.compile()
    data = mujoco.MjData(model)
    soft.reset(model, data)
    return soft, model, data


def ticks(soft: cosim.Attached, model: Any, data: Any, count: int = 10) -> None:
    """Take some ticks, in which the exchange balances and all stays finite."""
    for _ in range(count):
        soft.step(model, data)
        assert soft.ledger.momentum_error < 1e-10
    assert np.isfinite(data.qpos).all()
    assert np.isfinite(soft.film).all()


IN_THE_WAY = dict.fromkeys(("hopper", "humanoidstandup", "point", "walker2d", "walker2d_v5"), "floor")
IN_THE_WAY |= {"inverted_pendulum": "rail", "pusher": "object", "pusher_v5": "object"}
"""Models whose last body stands so near to something that the soft robot would begin inside of it."""


@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_models_of_gymnasium_attach_or_are_refused_by_name(path: Path) -> None:
    """Those that step by RK4 are refused, and carry a soft robot with another integrator."""
    spec = mujoco.MjSpec.from_file(str(path))
    last = next(body.name for body in reversed(spec.bodies) if body.name)
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        with pytest.raises(InputError, match="integrator is RK4"):
            cosim.attach(path, last, ROBOT)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if path.stem in IN_THE_WAY:
        with pytest.raises(InputError, match=f"mm deep in '{IN_THE_WAY[path.stem]}'"):
            begin(spec, last, LIGHT)
    ticks(*begin(spec, last, {**LIGHT, "contact.enabled": path.stem not in IN_THE_WAY}))


def body(joint: str, inside: str = "", more: str = "") -> str:
    """Return an MJCF of a body with a joint, what else it holds, and what else there is."""
    return f"""
    <mujoco><option timestep="0.002"/><worldbody>
      <geom type="plane" size="2 2 0.1"/>
      <body name="mount" pos="0 0 1">{joint}<geom type="box" size="0.05 0.05 0.05" mass="1"/>{inside}</body>
      <body name="other" pos="1 0 1"><freejoint/><geom type="sphere" size="0.05" mass="1"/></body>
    </worldbody>{more}</mujoco>"""


WELD = '<equality><weld body1="mount" body2="other"/></equality>'
CONNECT = '<equality><connect body1="mount" body2="other" anchor="0.1 0 0"/></equality>'
TENDON = """<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
    <actuator><position tendon="t" kp="50"/></actuator>"""
HINGE = '<joint name="j" axis="0 1 0" damping="1"/>'
SMALL = {
    "hinge": body(HINGE),
    "slide": body('<joint type="slide" axis="0 0 1" stiffness="1000" damping="20"/>'),
    "ball": body('<joint type="ball" damping="1"/>'),
    "free": body("<freejoint/>"),
    "several joints": body('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>' + HINGE),
    "fixed": body(""),
    "gravity compensated": body("<freejoint/>").replace('name="mount"', 'name="mount" gravcomp="1"'),
    "weld": body("<freejoint/>", more=WELD),
    "connect": body("<freejoint/>", more=CONNECT),
    "keyframe": body(HINGE, more='<keyframe><key name="up" qpos="0.5 1 0 1 1 0 0 0"/></keyframe>'),
    "motor": body(HINGE, more='<actuator><motor joint="j" gear="5"/></actuator>'),
    "muscle of a tendon": body(HINGE, more=TENDON),
    "armature and friction": body('<joint axis="1 0 0" armature="0.1" frictionloss="0.2" range="-1 1"/>'),
    "sensors": body(HINGE, '<site name="s"/>', '<sensor><force site="s"/><jointpos joint="j"/></sensor>'),
    "branches": body(HINGE, '<body><joint axis="1 0 0"/><geom size="0.02" pos="0.2 0 0"/></body>'),
    "energy": body(HINGE, more='<option><flag energy="enable"/></option>'),
}


@pytest.mark.parametrize("name", SMALL)
def test_small_models_carry_a_soft_robot(name: str) -> None:
    """Of each joint and each integrator, with what else a model may have."""
    integrator = ("Euler", "implicit", "implicitfast")[list(SMALL).index(name) % 3]
    spec = mujoco.MjSpec.from_string(SMALL[name].replace("timestep", f'integrator="{integrator}" timestep'))
    ticks(*begin(spec, "mount", LIGHT), 5)


def test_a_mocap_body_leads_the_soft_robot() -> None:
    """Nothing gives way: the flange is where the mocap body is put, and its base with it."""
    text = body("").replace('name="mount"', 'name="mount" mocap="true"')
    spec = mujoco.MjSpec.from_string(text)
    soft, model, data = begin(spec, "mount", LIGHT)
    film = soft.film
    for _ in range(20):
        data.mocap_pos[0, 0] += 1e-3
        soft.step(model, data)
    np.testing.assert_allclose(soft.film - film, np.tile([0.02, 0.0, 0.0], (len(film), 1)), atol=1e-9)


def test_what_a_film_cannot_touch_is_named() -> None:
    """A height field; with contact switched off it does not matter."""
    field = '<asset><hfield name="hills" nrow="4" ncol="4" size="1 1 0.1 0.1"/></asset>'
    text = body(HINGE, more=field).replace(
        'type="plane" size="2 2 0.1"', 'name="hills" type="hfield" hfield="hills"'
    )
    spec = mujoco.MjSpec.from_string(text)
    with pytest.raises(InputError, match="geom 'hills' is of type 'hfield', which a film cannot touch"):
        begin(spec, "mount", LIGHT)
    ticks(*begin(spec, "mount", {**LIGHT, "contact.enabled": False}), 3)


def test_a_keyframe_is_a_new_start() -> None:
    spec = mujoco.MjSpec.from_string(SMALL["keyframe"])
    soft, model, data = begin(spec, "mount", LIGHT)
    ticks(soft, model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    soft.reset(model, data)
    first = soft.tip_position
    ticks(soft, model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    soft.reset(model, data)
    np.testing.assert_array_equal(soft.tip_position, first)
    assert soft.tick == 0
