"""The state at rest of a soft side before the first phase."""

from typing import Any, Final

from cosim.base.frames import Pose
from cosim.base.kept_parts import KeptParts, name_of
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.plan import static_plan
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

_MOST_STATES: Final = 4
"""States to keep; each has a factorisation, which takes tens of megabytes for a fine mesh."""


def brought_to_rest(
    kept: KeptParts, model_name: str, soft: SoftRobot, flange: Pose, loads: Loads
) -> Equilibrium:
    """Bring a soft side to its equilibrium before the first phase, and return it.

    Args:
        kept: parts that may be used again.
        model_name: identity of the soft side's model.
        soft: new soft side.
        flange: its pose.
        loads: on the soft side.

    Raises:
        ConvergenceError: none was found near the drawn shape.
    """

    def hung() -> tuple[Equilibrium | None, Any]:
        with soft.searching("start"):
            found = soft.hang(flange, loads.gravity)
        return found, None if found is None else soft.full_state

    def at_rest() -> tuple[Equilibrium, Any]:
        # the start without pressure and tension is the same for all pressures and tensions
        begin, state = kept.made("hung up", name_of(model_name, flange, loads.gravity), hung, _MOST_STATES)
        if state is not None:
            soft.full_state = state
        found = static_plan.start_equilibrium(soft, flange, loads, begin)
        soft.commit(found)
        return found, soft.full_state

    found, state = kept.made("state at rest", name_of(model_name, flange, loads), at_rest, _MOST_STATES)
    soft.full_state = state  # unchanged if it was just found
    return found
