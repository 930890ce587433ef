"""Keys of the schema number before, and what they are called now."""

from typing import Final

SCHEMA: Final = 2
"""Schema number of scenario and robot files."""

_WRINKLING: Final = 'is no more; drop it: film.law = "wrinkling" makes a coarse mesh answer like the film'

_AUTO: Final = "is no more; drop it: cosim trade SCENARIO --tolerance or --budget says what to set"
_HANDOVER: Final = "is no more; drop it: where a section model ends, fidelity = 'lumped' goes on"

RENAMED: Final = {
    "Scenario": {"chamber": "model"},
    "SoftRobotTable": {"chamber": "stack", "frame": "stiffener"},
}
"""By the class of a table: its old keys, and what they are called since this schema number."""

GONE: Final = {
    "FilmTable": {"compressive_fraction": _WRINKLING},
    "SoftRobotTable": {"calibration": _WRINKLING},
    "Scenario": {"auto": _AUTO},
    "ModelTable": {"calibrated": _WRINKLING, "handover": _HANDOVER},
    "SolverTable": {
        "substep_error_m": "is no more; drop it, and shorten clock.tick_s where a tick's error is too large",
        "newton_iterations_max": "is no more; drop it: search_iterations_max bounds a search",
    },
}
"""By the class of a table: keys that there are no more, and what to do."""

DROPPED: Final = {("model", "handover"), *(("solver", key) for key in GONE["SolverTable"])}
"""Keys of scenarios that upgrading drops."""

REMEDY: Final = "rewrite the file: cosim upgrade FILE"
