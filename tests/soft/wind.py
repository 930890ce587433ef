"""Loads and commands with a field more than those of the package: what a field added to these would meet."""

from __future__ import annotations

from dataclasses import dataclass

from cosim.plan.commands import SoftCommand
from cosim.soft.body.loads import Loads


@dataclass(frozen=True)
class Windy(Loads):  # type: ignore[misc]  # final: no other code makes more of it
    """Loads, and wind."""

    wind_m_s: float = 0.0


@dataclass(frozen=True, eq=False)
class WindyCommand(SoftCommand):  # type: ignore[misc]  # as above
    """A command, and wind."""

    wind_m_s: float = 0.0
