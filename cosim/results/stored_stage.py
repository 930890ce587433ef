"""The description of a run as values of JSON, without functions of the engines and data for drawing."""

from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import DeviceNames, SensorNames
from cosim.errors import InputError
from cosim.plan.decision import Decision
from cosim.telemetry.camera_image import CameraInfo
from cosim.telemetry.run_info import ObjectInfo, RunInfo

_NOT_STORED: Final = (
    "membrane_stress", "hinge_energy_share", "stiffener_strain", "shapes", "arm", "tip_paths", "decay",
    "energy", "tip_measured_by", "tip_directions", "stored_m", "frames_length", "drawn",
    "lengths_s", "rounded",
)  # fmt: skip
_STORED: Final = tuple(field.name for field in fields(RunInfo) if field.name not in _NOT_STORED)


def stored_stage(stage: RunInfo) -> dict[str, Any]:
    """Return a stage as values of JSON."""
    return {name: _plain(getattr(stage, name)) for name in _STORED}


def stage_of(stored: Mapping[str, Any]) -> RunInfo:
    """Return the stage with values of `stored_stage`, without the fields that are not stored.

    Raises:
        InputError: a field is missing.
    """
    if missing := [name for name in _STORED if name not in stored]:
        raise InputError(f"the description of the run lacks {', '.join(missing)}")
    made: dict[str, Any] = {name: _tuples(stored[name]) for name in _STORED}
    made["soft_triangles"] = np.array(stored["soft_triangles"], np.int64).reshape(-1, 3)
    made["cables"] = tuple(np.array(nodes, np.int64) for nodes in stored["cables"])
    made["gravity"] = np.array(stored["gravity"], np.float64)
    made["modelled"] = tuple(Decision(**entry) for entry in stored["modelled"])
    for name, kind in (("sensors", SensorNames), ("objects", ObjectInfo), ("cameras", CameraInfo)):
        made[name] = tuple(kind(**_with_tuples(entry)) for entry in stored[name])
    if stored["devices"] is not None:
        made["devices"] = DeviceNames(**_with_tuples(stored["devices"]))
    return RunInfo(**made, shapes=(), membrane_stress=_no_stress)


def _no_stress(_positions: Array) -> Array:
    raise InputError(
        "the film's stress is not in the files; build the run's scenario to compute it: "
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


def _with_tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _tuples(value) for key, value in entry.items()}


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
