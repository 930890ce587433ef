"""Keys of the previous schema number with their new names, and keys that were removed with the remedy."""

from typing import Final

SCHEMA: Final = 2
"""Schema number of scenario and robot files."""

_WRINKLING: Final = 'was removed; delete it: film.law = "wrinkling" gives a coarse mesh the film\'s stiffness'
_AUTO: Final = "was removed; delete it: cosim trade SCENARIO --tolerance or --budget proposes settings"
_HANDOVER: Final = "was removed; delete it: beyond the range of a section model use fidelity = 'lumped'"

RENAMED: Final = {
    "Scenario": {"chamber": "model"},
    "SoftRobotTable": {"chamber": "stack", "frame": "stiffener"},
}
"""Class of a table -> its old keys with their names since this schema number."""

GONE: Final = {
    "FilmTable": {"compressive_fraction": _WRINKLING},
    "SoftRobotTable": {"calibration": _WRINKLING},
    "Scenario": {"auto": _AUTO},
    "ModelTable": {"calibrated": _WRINKLING, "handover": _HANDOVER},
    "SolverTable": {
        "substep_error_m": "was removed; delete it, and shorten clock.tick_s if a tick's error is too large",
        "newton_iterations_max": "was removed; delete it: search_iterations_max bounds a search",
    },
}
"""Class of a table -> its removed keys, each with the message that says what to do."""

DROPPED: Final = {("model", "handover"), *(("solver", key) for key in GONE["SolverTable"])}
"""Keys of scenarios that upgrading drops."""

REMEDY: Final = "rewrite the file: cosim upgrade FILE"
