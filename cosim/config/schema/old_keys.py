"""Keys of the schema number before, and what they are called now."""

from __future__ import annotations

from typing import Final

SCHEMA: Final = 2
"""Schema number of scenario and robot files."""

RENAMED: Final = {
    "Scenario": {"chamber": "model"},
    "SoftRobotTable": {"chamber": "stack", "frame": "stiffener"},
}
"""By the class of a table: its old keys, and what they are called since this schema number."""

REMEDY: Final = "rewrite the file: cosim upgrade FILE"
