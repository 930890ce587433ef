"""The figures of a run as a flat row: the numbers of its summary by name, those of its last phase without a
prefix.
"""

from collections.abc import Mapping
from typing import Any, Final

PHASES: Final = "phases"
"""Prefix of the names of every phase's figures."""
_OF_THE_CLOCK: Final = frozenset({"startup_s", "wall_s", "command_s", "compiling_s", "real_time_factor"})
"""Figures that differ between runs of the same design."""
_SKIPPED: Final = frozenset(
    {"schema", "phases", "arm", "modelled", "expected_error", "warnings", "resumed_at_ticks"}
)
_XYZ: Final = ("x", "y", "z")
_VECTORS: Final[dict[str, tuple[str, ...]]] = {
    "flange_position_m": _XYZ, "tip_position_m": _XYZ, "tip_direction": _XYZ, "tip_target_m": _XYZ,
    "force_N": _XYZ, "torque_Nm": _XYZ, "flange_quaternion": ("w", *_XYZ),
}  # fmt: skip
"""Lists whose entries have names; the entries of other lists are counted from 1."""


def figures_of(summary: Mapping[str, Any]) -> dict[str, float | int | bool]:
    """Return the numbers of a summary that do not depend on wall time.

    Args:
        summary: as in summary.json.

    Returns:
        by key: of the run; of its last phase; and of every phase, as phases.NAME.KEY. Vectors have a key for
        each component, such as tip_position_m.z; other values are left out.
    """
    phases = summary["phases"]
    run = {key: value for key, value in summary.items() if key not in _OF_THE_CLOCK | _SKIPPED}
    tables = [run, *phases[-1:], {PHASES: {phase["name"]: phase for phase in phases}}]
    figures: dict[str, float | int | bool] = {}
    for table in tables:
        _gather(figures, table, "")
    return figures


def _gather(figures: dict[str, float | int | bool], value: Any, path: str) -> None:
    if isinstance(value, int | float):
        figures.setdefault(path, value)
    elif isinstance(value, list):
        names = _VECTORS.get(path.rpartition(".")[2], tuple(map(str, range(1, len(value) + 1))))
        value = dict(zip(names, value, strict=True))
    if isinstance(value, Mapping):
        for key, item in value.items():
            _gather(figures, item, f"{path}.{key}" if path else key)
