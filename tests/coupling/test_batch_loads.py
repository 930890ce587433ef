"""Which loads a batch of ticks takes: a pressure, tensions and gravity, and nothing that it does not know."""

from __future__ import annotations

from dataclasses import dataclass, fields, make_dataclass, replace
from typing import Any

import numpy as np
import pytest

from cosim.coupling.batch import batch
from cosim.coupling.batch.batch import _NOT_TAKEN, _plain
from cosim.soft.body.loads import Loads

PLAIN = Loads(2e4, (1.0, 2.0), (1.0, 0.0, -9.0))


def test_pressure_tensions_and_gravity_are_taken() -> None:
    assert _plain(PLAIN)
    assert _plain(replace(PLAIN, cable_length_m=()))


@pytest.mark.parametrize("name", [field.name for field in _NOT_TAKEN])
def test_nothing_else_is(name: str) -> None:
    for value in (np.zeros((3, 3)), (None, 0.1), object()):
        load: Any = object.__new__(Loads)
        for field in fields(Loads):
            object.__setattr__(load, field.name, value if field.name == name else getattr(PLAIN, field.name))
        assert not _plain(load)


def test_a_load_more_is_not_taken_unheard(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Wind:
        speed: float

    wider = make_dataclass("Wider", [("wind", Wind | None, None)], frozen=True)
    monkeypatch.setattr(batch, "_NOT_TAKEN", [*_NOT_TAKEN, *fields(wider)])
    load: Any = replace(PLAIN)
    object.__setattr__(load, "wind", None)
    assert _plain(load)
    object.__setattr__(load, "wind", Wind(3.0))
    assert not _plain(load)
