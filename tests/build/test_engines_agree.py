"""An arm that both engines read differently is refused by the name of a joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.arm_file import ArmFile
from cosim.build.arms import find_arm
from cosim.build.engine_agreement import check_engines_agree
from cosim.build.scene_objects import palm_mass, palm_object
from cosim.config.schema.soft_robot import PalmTable
from cosim.errors import InputError
from cosim.kinematics.arm import Arm, Payload
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

UR5E = find_arm("ur5e")
SCENE = RigidScene(SceneDescription(UR5E))


def changed(before: str, after: str) -> ArmFile:
    """Return the UR5e with another number in its file."""
    assert UR5E.urdf.count(before) >= 1
    return replace(UR5E, urdf=UR5E.urdf.replace(before, after))


# A difference that the bounds, 1e-9 and 1e-6, must see.
@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("-0.3922", "-0.3922001", "joint 'wrist_1_joint'.*: the flange 8"),
        ('value="0.365"', 'value="0.3651"', "joint '.*'.*: the mass matrix"),
        ('lower="-3.14', 'lower="-3.13', "joint 'elbow_joint'.*: lower limits -3.14"),
        ('effort="28', 'effort="29', "joint 'wrist_1_joint'.*: torque limits 28"),
        ('value="8.058"', 'value="8.059"', "joint 'shoulder_lift_joint'.*: the mass matrix"),
    ],
)
def test_a_difference_is_told_by_the_joint(before: str, after: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        check_engines_agree(SCENE, Arm(changed(before, after)), UR5E.armature)


def test_armature_counts_on_both_sides() -> None:
    other = UR5E.armature.copy()
    other[2] += 1e-4
    with pytest.raises(InputError, match="joint 'elbow_joint', or its links, differently: the mass matrix"):
        check_engines_agree(SCENE, Arm(UR5E), other)


def test_gravity_of_another_direction_is_told() -> None:
    with pytest.raises(InputError, match="the torque against gravity"):
        check_engines_agree(SCENE, Arm(UR5E, gravity=(0.0, 1e-3, -9.81)), UR5E.armature)


def test_what_is_mounted_counts_and_nothing_moves() -> None:
    palm = PalmTable(radius_m=0.05, thickness_m=0.01, mass_kg=0.4)
    mass = palm_mass(palm)
    scene = RigidScene(SceneDescription(UR5E, mounted=(palm_object(palm),)))
    before = scene.state.integration
    check_engines_agree(scene, Arm(UR5E), UR5E.armature, Payload(mass.mass_kg, mass.center, mass.inertia))
    np.testing.assert_array_equal(scene.state.integration, before)
    with pytest.raises(InputError, match="the mass matrix"):
        check_engines_agree(scene, Arm(UR5E), UR5E.armature)
