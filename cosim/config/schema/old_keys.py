"""Keys of the schema number before, and what they are called now."""

from __future__ import annotations

from typing import Final

SCHEMA: Final = 2
"""Schema number of scenario and robot files."""

_WRINKLING: Final = 'is no more; drop it: film.law = "wrinkling" makes a coarse mesh answer like the film'

RENAMED: Final = {
    "Scenario": {"chamber": "model"},
    "SoftRobotTable": {"chamber": "stack", "frame": "stiffener"},
}
"""By the class of a table: its old keys, and what they are called since this schema number."""

GONE: Final = {
    "FilmTable": {"compressive_fraction": _WRINKLING},
    "SoftRobotTable": {"calibration": _WRINKLING},
    "ModelTable": {"calibrated": _WRINKLING},
}
"""By the class of a table: keys that there are no more, and what to do."""

REMEDY: Final = "rewrite the file: cosim upgrade FILE"
