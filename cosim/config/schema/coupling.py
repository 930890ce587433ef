"""Schema of the exchange between arm and soft robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, final

from annotated_types import Interval

from cosim.config.toml.constraints import Count


@final
@dataclass(frozen=True)
class CouplingTable:
    """How arm, objects and soft robot exchange their loads in the dynamic mode.

    Args:
        scheme: "staggered": one step of each side a tick, loads act one tick later, algorithmic mass rides
            along where the soft robot is heavy for what it acts on; "iterated": a tick is repeated until the
            loads agree; "auto": iterated only where the staggered exchange would need algorithmic mass.
        tolerance: largest difference of the loads over their size, where they agree.
        iterations_max: trials of a tick before the run fails.
    """

    scheme: Literal["staggered", "iterated", "auto"] = "staggered"
    tolerance: Annotated[float, Interval(ge=1e-12, le=1e-3)] = 1e-9
    iterations_max: Count = 30
