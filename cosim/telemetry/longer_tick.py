"""The longest tick that a run would do with, by its error bars: that of second order grows with the square of
the tick.
"""

from collections.abc import Sequence
from typing import Any, Final

from cosim.plan.whole_ticks import are_whole

MOST_OF_MESH: Final = 0.05
"""Largest error of the tip by ticks, over that by the mesh."""
LONGEST_S: Final = 0.01
"""Longest tick for which error bars were compared with errors, see docs/run_error.md."""
_ROUNDING: Final = 1e-6


def longer_tick_s(
    phases: Sequence[dict[str, Any]], tick_s: float, lengths_s: Sequence[float]
) -> float | None:
    """Return a multiple n of the tick with n^2 times its error far below that of the mesh; None without one.

    Phases and all given durations last whole numbers of such ticks.

    Args:
        phases: of a summary, with their `error`.
        tick_s: of the run [s].
        lengths_s: durations that ticks should divide [s], see `whole_ticks.lengths_s`.
    """
    bars = [phase["error"] for phase in phases if phase["error"] is not None]
    if any(row["reason"] or not row.get("of_tick") for row in bars):
        return None
    shares = [row["of_tick"]["tip_m"] / max(row["of_mesh"]["tip_m"], 1e-300) for row in bars]
    ends = [phase["end_s"] / tick_s for phase in phases]
    for n in range(int(LONGEST_S / tick_s + _ROUNDING), 1, -1):
        whole = all(abs(end / n - round(end / n)) < _ROUNDING * end for end in ends)
        whole = whole and are_whole(lengths_s, n * tick_s)
        if shares and whole and n * n * max(shares) <= MOST_OF_MESH:
            return n * tick_s
    return None
