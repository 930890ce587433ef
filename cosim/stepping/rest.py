"""The state at rest before the first phase, found once for all runs that begin alike."""

from __future__ import annotations

from typing import Any, Final

from cosim.base.frames import Pose
from cosim.base.kept_parts import KeptParts, name_of
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.plan.paths.phase_drafts import start_equilibrium
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

_MOST: Final = 4  # a state holds a factorisation, which of a fine mesh takes tens of megabytes


def brought_to_rest(
    kept: KeptParts, model_name: str, soft: SoftSide, flange: Pose, loads: Loads
) -> Equilibrium:
    """Bring a soft side to its equilibrium before the first phase, and return that.

    Args:
        kept: parts that may serve again.
        model_name: of all that the soft side is made of.
        soft: new.
        flange: where it is.
        loads: that act.

    Raises:
        ConvergenceError: there is none near the drawn shape.
    """

    def hung() -> tuple[Equilibrium | None, Any]:
        with soft.searching("start"):
            found = soft.hang(flange, loads.gravity)
        return found, None if found is None else soft.save_state()

    def settled() -> tuple[Equilibrium, Any]:
        # hung up without pressure and tension it is the same for all of them
        begin, state = kept.made("hung up", name_of(model_name, flange, loads.gravity), hung, _MOST)
        if state is not None:
            soft.restore_state(state)
        found = start_equilibrium(soft, flange, loads, begin)
        soft.settle(found)
        return found, soft.save_state()

    found, state = kept.made("state at rest", name_of(model_name, flange, loads), settled, _MOST)
    # that of a side which has just found it changes nothing
    soft.restore_state(state)
    return found
