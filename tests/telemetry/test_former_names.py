"""Former names forward to the new ones for one release, with a warning."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Pose, Wrench
from cosim.devices.controller import RobotState
from cosim.telemetry import run_info, snapshot
from tests.conftest import made_up_snapshot


def test_run_info_is_forwarded_from_its_former_module() -> None:
    with pytest.warns(DeprecationWarning, match=r"import RunInfo from cosim\.telemetry\.run_info"):
        assert snapshot.RunInfo is run_info.RunInfo
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = snapshot.Nothing


def test_the_former_name_of_stability_warns() -> None:
    with pytest.warns(DeprecationWarning, match="is Snapshot.stability now"):
        assert made_up_snapshot(1, 0.01).footing is None


def test_the_former_names_of_the_robot_s_state_warn() -> None:
    joints = np.zeros(6)
    state = RobotState(
        time_s=0.0, flange=Pose(), flange_twist=np.zeros(6), flange_wrench=Wrench(),
        flange_jacobian=np.zeros((6, 6)), joint_position=joints, joint_velocity=joints, joint_torque=joints,
        contact_force_N={}, body_pose={},
    )  # fmt: skip
    with pytest.warns(DeprecationWarning, match=r"is RobotState\.flange_wrench now"):
        assert state.wrench is state.flange_wrench
    with pytest.warns(DeprecationWarning, match=r"is RobotState\.contact_force_N now"):
        assert state.contact_force is state.contact_force_N
