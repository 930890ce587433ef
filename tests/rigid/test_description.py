"""Scene descriptions refuse what cannot be built and say why."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Wrench
from cosim.build.arms import find_arm
from cosim.errors import ConvergenceError, InputError, SceneError
from cosim.rigid.build.description import SceneDescription, SceneObject, ServoGains
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")


def test_object_named_like_a_link_is_refused() -> None:
    with pytest.raises(InputError, match=r"MuJoCo refuses it: .*repeated name 'forearm_link'"):
        RigidScene(SceneDescription(ARM, objects=(SceneObject("forearm_link", "sphere", (0.1,)),)))


def stiffness(scene: RigidScene) -> Array:
    """Return the torque per angle (joints,) [N m/rad] with which the servos pull from where they are."""
    scene.set_control(scene.joint_position + 1e-3)
    scene.step()
    # they damp by the speed at the end of the step
    return 1e3 * (scene.servo_torque + scene.servo_damping * scene.joint_velocity)


def test_gains_of_the_ur5e_are_the_usual_ones() -> None:
    scene = RigidScene(SceneDescription(ARM))
    np.testing.assert_allclose(stiffness(scene), [2000, 2000, 2000, 500, 500, 500])
    np.testing.assert_allclose(scene.servo_damping, [400, 400, 400, 100, 100, 100])


def test_gains_can_be_chosen() -> None:
    gains = ServoGains(np.arange(1.0, 7.0), np.arange(2.0, 8.0))
    scene = RigidScene(SceneDescription(ARM, gains=gains))
    np.testing.assert_allclose(stiffness(scene), gains.stiffness)
    np.testing.assert_allclose(scene.servo_damping, gains.damping)


def test_an_arm_without_torque_limits_is_not_held_back() -> None:
    unlimited = replace(ARM, urdf=re.sub(r'effort="\d+"', 'effort="0"', ARM.urdf))
    scene = RigidScene(SceneDescription(unlimited))
    assert np.all(np.isinf(scene.effort_limit))
    settled = scene.static_configuration(ARM.home, wrench=Wrench(np.array([0.0, 0.0, -300.0]), np.zeros(3)))
    assert np.max(np.abs(settled - ARM.home)) > 0.05


@pytest.mark.parametrize("force_N", [300.0, 1e5], ids=["balanced", "no rest found"])
def test_load_beyond_the_arms_torque_is_named(force_N: float) -> None:
    scene = RigidScene(SceneDescription(ARM))
    with pytest.raises(ConvergenceError, match=r"holding this load takes .* N m at joint .*which can give"):
        scene.static_configuration(ARM.home, wrench=Wrench(np.array([0.0, 0.0, -force_N]), np.zeros(3)))


def test_an_object_whose_inertia_is_no_number_is_named() -> None:
    """Each of its values is finite; what MuJoCo works out from them is not."""
    objects = [
        SceneObject(name, "box", (1e3, 1e3, 1e3), mass_kg=mass) for name, mass in (("a", 1.0), ("b", 1e306))
    ]
    with pytest.raises(
        SceneError, match=r"body 'b': inertia is inf inf inf; every number must be finite"
    ) as caught:
        RigidScene(SceneDescription(ARM, objects=tuple(objects)))
    assert caught.value.body == "b"


def test_gains_are_those_of_the_arms_file_or_grow_with_its_efforts() -> None:
    """37.5 N m is the torque whose servo has 500 N m/rad; a sliding joint gives its force at 20 mm."""
    efforts = np.array([150.0, 37.5, 28.0, 0.0, 28.0, 28.0])
    assert list(ServoGains.of(ARM, efforts).stiffness) == [2000.0, 500.0, 500.0, 500.0, 500.0, 500.0]
    assert list(ServoGains.of(ARM, efforts).damping[:2]) == [400.0, 100.0]
    sliding = replace(
        ARM,
        urdf=ARM.urdf.replace(
            '"shoulder_pan_joint" type="revolute"', '"shoulder_pan_joint" type="prismatic"'
        ),
    )
    assert list(ServoGains.of(sliding, 10.0 * efforts).stiffness[:2]) == [75e3, 5000.0]
    assert ServoGains.of(sliding, efforts).stiffness[0] == 50e3
    own = replace(ARM, servo_stiffness=np.full(6, 7.0), servo_damping=np.full(6, 3.0))
    scene = RigidScene(SceneDescription(own))
    np.testing.assert_array_equal(scene.servo_damping, 3.0)
    rotors = replace(ARM, armature=np.arange(1.0, 7.0))
    np.testing.assert_array_equal(RigidScene(SceneDescription(rotors)).armature, np.arange(1.0, 7.0))
