"""Which loads a batch of ticks takes: a pressure, tensions and gravity, and nothing that it does not know."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from cosim.soft.body.loads import PLAIN, Loads, is_plain
from tests.soft.wind import Windy

GIVEN = Loads((2e4,), (1.0, 2.0), (1.0, 0.0, -9.0))
NOT_TAKEN = [field.name for field in fields(Loads) if field.name not in PLAIN]


def test_pressure_tensions_and_gravity_are_taken() -> None:
    assert is_plain(GIVEN)
    assert is_plain(replace(GIVEN, cable_length_m=()))


@pytest.mark.parametrize("name", NOT_TAKEN)
def test_nothing_else_is(name: str) -> None:
    for value in (np.zeros((3, 3)), (None, 0.1), object()):
        load: Any = object.__new__(Loads)
        for field in fields(Loads):
            object.__setattr__(load, field.name, value if field.name == name else getattr(GIVEN, field.name))
        assert not is_plain(load)


def test_a_load_more_is_not_taken_unheard() -> None:
    assert is_plain(Windy((2e4,)))
    assert not is_plain(Windy((2e4,), wind_m_s=3.0))
