"""Whether an arm has as many joints as a scenario asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.kinematics.arm import Arm

_FEWEST: Final = 4


def check_joints(scenario: Scenario, arm: Arm) -> None:
    """Check that an arm can do what a scenario asks for.

    With less than 6 joints the flange follows places and directions of its z axis, and rolls as it comes.
    What depends on the roll before the plan is made cannot be asked for.

    Raises:
        ScenarioError: it has less than 4 joints, or does not follow rolls and is to reach a tip target.
    """
    if arm.joint_count < _FEWEST:
        raise ScenarioError(
            "robot",
            f"arm {arm.name!r} has {arm.joint_count} joints ({', '.join(arm.joint_names)}); at least "
            f"{_FEWEST} are needed for places and directions of the flange, 6 for its roll as well",
        )
    for phase in scenario.phases:
        if arm.free_roll and phase.tip_key is not None:
            raise ScenarioError(
                f"phase.{phase.name}.{phase.tip_key}",
                f"arm {arm.name!r} has {arm.joint_count} joints, so its flange rolls as it comes; tip "
                "targets and paths need an arm of 6 joints or more",
            )
