"""Which loads a batch of ticks takes: a pressure, tensions and gravity, and nothing that it does not know."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from cosim.coupling.batch.batch import _TAKEN, _plain
from cosim.soft.body.loads import Loads
from tests.soft.wind import Windy

PLAIN = Loads((2e4,), (1.0, 2.0), (1.0, 0.0, -9.0))
NOT_TAKEN = [field.name for field in fields(Loads) if field.name not in _TAKEN]


def test_pressure_tensions_and_gravity_are_taken() -> None:
    assert _plain(PLAIN)
    assert _plain(replace(PLAIN, cable_length_m=()))


@pytest.mark.parametrize("name", NOT_TAKEN)
def test_nothing_else_is(name: str) -> None:
    for value in (np.zeros((3, 3)), (None, 0.1), object()):
        load: Any = object.__new__(Loads)
        for field in fields(Loads):
            object.__setattr__(load, field.name, value if field.name == name else getattr(PLAIN, field.name))
        assert not _plain(load)


def test_a_load_more_is_not_taken_unheard() -> None:
    assert _plain(Windy((2e4,)))
    assert not _plain(Windy((2e4,), wind_m_s=3.0))
