"""What does not change during a run, as values of JSON in the files of its arrays.

What only engines can tell (the film's stress at given nodes) and what is only drawn is not kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import DeviceNames
from cosim.errors import InputError
from cosim.plan.decision import Decision
from cosim.telemetry.snapshot import RunInfo

_NOT_KEPT: Final = ("membrane_stress", "hinge_energy_share", "stiffener_strain", "shapes", "arm", "tip_paths")
_KEPT: Final = tuple(field.name for field in fields(RunInfo) if field.name not in _NOT_KEPT)


def stored_stage(stage: RunInfo) -> dict[str, Any]:
    """Return a stage as values of JSON."""
    return {name: _plain(getattr(stage, name)) for name in _KEPT}


def stage_of(stored: Mapping[str, Any]) -> RunInfo:
    """Return the stage that `stored_stage` was given, without what is not kept.

    Raises:
        InputError: it is none.
    """
    if missing := [name for name in _KEPT if name not in stored]:
        raise InputError(f"what is said of the run lacks {', '.join(missing)}")
    made: dict[str, Any] = {name: _tuples(stored[name]) for name in _KEPT}
    made["soft_triangles"] = np.array(stored["soft_triangles"], np.int64).reshape(-1, 3)
    made["cables"] = tuple(np.array(nodes, np.int64) for nodes in stored["cables"])
    made["gravity"] = np.array(stored["gravity"], np.float64)
    made["modelled"] = tuple(Decision(**entry) for entry in stored["modelled"])
    if stored["devices"] is not None:
        made["devices"] = DeviceNames(**{key: _tuples(value) for key, value in stored["devices"].items()})
    return RunInfo(**made, shapes=(), membrane_stress=_no_stress)


def _no_stress(_positions: Array) -> Array:
    raise InputError(
        "the film's stress is not kept in files; build the run's scenario to compute it: "
        'cosim.Simulation("DIR/scenario.toml").stage.membrane_stress(positions)'
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
