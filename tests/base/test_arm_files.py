"""Arms by name and from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.arms import arm_names, find_arm, read_arm
from cosim.errors import InputError

ONE_JOINT = """<robot name="one"><link name="root"/><link name="hand"/><link name="finger"/>
<joint name="swing" type="{kind}"><parent link="root"/><child link="hand"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
<joint name="grip" type="fixed"><parent link="hand"/><child link="finger"/></joint></robot>"""


@pytest.mark.parametrize("name", arm_names())
def test_every_named_arm_is_found(name: str) -> None:
    arm = find_arm(name)
    assert arm.home.shape == (len(arm.joint_names),)
    assert arm.flange_frame in arm.urdf
    assert "package://" not in arm.urdf


def test_only_the_chain_to_the_flange_is_kept() -> None:
    arm = find_arm("panda")
    assert "panda_finger_joint1" in arm.urdf_path.read_text()
    assert "finger" not in arm.urdf
    assert arm.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))


def test_unknown_name_lists_what_exists() -> None:
    with pytest.raises(InputError, match=r"unknown arm 'ur6'; there are panda, ur10, ur3, ur5, ur5e"):
        find_arm("ur6")


def test_home_cannot_be_changed_by_accident() -> None:
    with pytest.raises(ValueError, match="read-only"):
        find_arm("ur5e").home[0] = 1.0


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.urdf does not exist"):
        read_arm(tmp_path / "nothing.urdf", "hand", (0.0,))


@pytest.mark.parametrize(
    ("text", "flange", "home", "message"),
    [
        ("<robot", "hand", (0.0,), "is not XML"),
        (ONE_JOINT.format(kind="revolute"), "foot", (0.0,), "no link 'foot'; there are root, hand, finger"),
        (ONE_JOINT.format(kind="floating"), "hand", (0.0,), "joint 'swing' is 'floating'"),
        (ONE_JOINT.format(kind="revolute"), "hand", (0.0, 0.0), "has 1 joints .* but its home has 2 angles"),
    ],
)
def test_unusable_files_are_refused(
    tmp_path: Path, text: str, flange: str, home: tuple[float, ...], message: str
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_arm(path, flange, home)


def test_missing_mesh_is_named(tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh filename="package://parts/hand.stl"/></geometry></visual>'
    path = tmp_path / "arm.urdf"
    text = ONE_JOINT.format(kind="revolute").replace(
        '<link name="hand"/>', f'<link name="hand">{mesh}</link>'
    )
    path.write_text(text)
    with pytest.raises(InputError, match=r"mesh 'package://parts/hand\.stl' not found \(looked for .*parts"):
        read_arm(path, "hand", (0.0,), package_folders=(tmp_path,))


def test_own_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ONE_JOINT.format(kind="revolute"))
    arm = read_arm(path, "hand", (0.3,))
    assert (arm.name, arm.joint_names) == ("arm", ("swing",))
    np.testing.assert_array_equal(arm.home, [0.3])
    assert "finger" not in arm.urdf
