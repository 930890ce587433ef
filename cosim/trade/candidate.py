"""One candidate of a trade."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, final

Group: TypeAlias = Literal["time", "model"]


@final
@dataclass(frozen=True)
class Candidate:
    """One way to run the scenario.

    Args:
        name: for the table.
        group: "time": candidates differ in fidelity and in how time is stepped; "model": in what is modelled.
        changes: overrides of the scenario, by key path.
        reference: whether the others of its group are measured against it: of several, against the first that
            runs to its end.
        family: what it has in common with others of one colour in the plot.
        base: whether it is the scenario's own model, from which its group's switches start.
        decision: what of `modelled` in summary.json it decides otherwise; empty for none.
        commanded: whether tensions and flange poses for the tip's targets are those of the scenario's own
            model; otherwise they are planned anew, as `cosim run` does.
    """

    name: str
    group: Group
    changes: Mapping[str, Any] = field(hash=False)
    reference: bool = False
    family: str = ""
    base: bool = False
    decision: str = ""
    commanded: bool = False

    @property
    def words(self) -> str:
        """The changes as words of the command line, without the durations."""
        shown = {key: value for key, value in self.changes.items() if not key.startswith("phase.")}
        return " ".join(f"--set {key}={value}" for key, value in shown.items())
