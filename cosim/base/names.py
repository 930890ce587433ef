"""Names that files and results give to parts without a name of their own."""

from __future__ import annotations

from typing import Final

ONLY_CHAMBER: Final = "chamber"
"""Name of the chamber of a body that has only one."""
