"""Saved states on disk: everything comes back bit for bit, and nothing else can be made of a file."""

from __future__ import annotations

import enum
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.base.state_file import STATE_SCHEMA, load, load_header, save
from cosim.errors import InputError
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.soft.elements.gas import SealedGas


class Valve(enum.Enum):
    """A kind of value that a device may hold."""

    OPEN = "lets gas through"
    SHUT = "does not"


@dataclass(frozen=True)
class Device:
    """A state of two levels, as a plug-in may define one."""

    reading: Array
    last: Any
    valve: Valve = Valve.SHUT
    name: str = ""


@dataclass
class Open:
    """Can change, so it is no state."""

    value: float


def around(state: Any, tmp_path: Path) -> Any:
    """Return a state that has been written and read."""
    save(tmp_path / "a.npz", state)
    return load(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "value",
    [None, True, 7, 2**70, -0.1, 1e-320, float("inf"), "µ \n", (), (1, (2.5, None)), [1, "a"], {"a": (1,)}],
)
def test_plain_values_come_back(value: Any, tmp_path: Path) -> None:
    again = around(value, tmp_path)
    assert again == value
    assert type(again) is type(value)


@pytest.mark.parametrize("value", [np.float64(0.1), np.int64(3), np.bool_(True)])
def test_numbers_of_numpy_come_back_as_numbers(value: Any, tmp_path: Path) -> None:
    assert around((value,), tmp_path) == (value,)


def test_nan_comes_back(tmp_path: Path) -> None:
    assert np.isnan(around(float("nan"), tmp_path))


@pytest.mark.parametrize(
    "array",
    [
        np.array([0.1, np.nan, -0.0, 5e-324]),
        np.zeros((0, 3)),
        np.array(2.5),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(4, dtype=np.int32),
        np.array([[True, False]]),
    ],
)
def test_arrays_come_back_bit_for_bit(array: Any, tmp_path: Path) -> None:
    again = around(array, tmp_path)
    assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert again.flags.f_contiguous == array.flags.f_contiguous


def test_classes_come_back_nested(tmp_path: Path) -> None:
    pose = Pose(rotation_from_vector(np.array([0.1, 0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    state = Device(np.arange(3.0), (pose, SealedGas(2e5, 1e-3)), Valve.OPEN, "pump")
    again = around(state, tmp_path)
    assert isinstance(again, Device)
    assert (again.valve, again.name) == (Valve.OPEN, "pump")
    assert again.last[0].rotation.tobytes() == pose.rotation.tobytes()
    assert again.last[1] == state.last[1]


def test_named_tuples_come_back_as_they_are(tmp_path: Path) -> None:
    again = around((PressureSpline(4e4, 6), (1.0, 2)), tmp_path)
    assert again == (PressureSpline(4e4, 6), (1.0, 2))
    assert type(again[0]) is PressureSpline
    assert type(again[1]) is tuple


def test_an_array_that_is_shared_is_written_once(tmp_path: Path) -> None:
    shared = np.arange(5000.0)
    again = around((shared, Device(shared, None), shared + 1.0), tmp_path)
    assert again[0] is again[1].reading
    assert (tmp_path / "a.npz").stat().st_size < 2.2 * shared.nbytes


def test_the_header_can_be_read_alone(tmp_path: Path) -> None:
    save(tmp_path / "a.npz", None, {"tick": 3})
    assert load_header(tmp_path / "a.npz") == {"tick": 3}


@pytest.mark.parametrize(
    ("value", "place"),
    [
        (Device(np.zeros(1), Open(1.0)), "state.last is a Open"),
        ((1, {"a": object()}), r"state\[1\].a is a object"),
        ({1.5: 2}, "state is a dict"),
        (Device(np.array([None]), None), "state.reading is an array of objects"),
    ],
)
def test_what_cannot_be_saved_is_named(value: Any, place: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=place):
        save(tmp_path / "a.npz", value)
    assert not list(tmp_path.iterdir())


def test_a_class_within_a_function_cannot_be_saved(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Hidden:
        value: float

    with pytest.raises(TypeError, match="top level"):
        save(tmp_path / "a.npz", Hidden(1.0))


def forged(state: Any, path: Path, schema: int = STATE_SCHEMA) -> Path:
    """Write an archive by hand."""
    text = json.dumps({"schema": schema, "header": {}, "state": state}).encode()
    np.savez(path, structure=np.frombuffer(text, np.uint8))
    return path


@pytest.mark.parametrize(
    "name", ["os:system", "pathlib:Path", "no.such:Thing", f"{__name__}:Open", "builtins:eval", ":", "this:d"]
)
def test_a_file_makes_frozen_dataclasses_of_loaded_modules_only(name: str, tmp_path: Path) -> None:
    path = forged({"class": name, "fields": {}}, tmp_path / "a.npz")
    with pytest.raises(InputError, match="does not know"):
        load(path)


def test_a_class_that_has_changed_is_refused(tmp_path: Path) -> None:
    path = forged({"class": f"{__name__}:Device", "fields": {"reading": 1, "lost": 2}}, tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"another version.*lost"):
        load(path)
    path = forged({"class": f"{__name__}:Device", "fields": {}}, tmp_path / "b.npz")
    with pytest.raises(InputError, match=r"another version: 'other fields: last, name, reading, valve'"):
        load(path)


def test_another_schema_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"schema 99; this cosim reads {STATE_SCHEMA}"):
        load(forged(None, tmp_path / "a.npz", schema=99))


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "whole.npz", np.arange(1000.0))
    torn = tmp_path / "torn.npz"
    torn.write_bytes((tmp_path / "whole.npz").read_bytes()[:-300])
    text = tmp_path / "text.npz"
    text.write_text("no", encoding="utf-8")
    objects = tmp_path / "objects.npz"
    np.savez(objects, structure=np.array([{"a": 1}], dtype=object))
    alone = tmp_path / "alone.npy"
    np.save(alone, np.zeros(3))
    for path in (torn, text, objects, alone, tmp_path / "missing.npz"):
        with pytest.raises(InputError, match="no saved state"):
            load(path)
