"""Loads on the way to others."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas
from tests.soft.wind import Windy

RAMPED = {"pressure_Pa", "cable_tension_N", "gravity", "nodal_force", "gas", "cable_length_m"}


def test_what_is_not_ramped_is_that_of_the_end() -> None:
    begin, end = Loads((1e3,), (1.0,)), Loads((3e3,), (2.0,), (1.0, 0.0, 0.0), gas=(SealedGas(2e5, 1e-4),))
    others = [field.name for field in fields(Loads) if field.name not in RAMPED]
    marks: dict[str, Any] = {name: object() for name in others}
    for name, mark in marks.items():
        object.__setattr__(end, name, mark)
    between = begin.interpolated(end, 0.5)
    assert {name: getattr(between, name) for name in others} == marks
    assert (between.pressure_Pa, between.cable_tension_N, between.gravity[0]) == ((2e3,), (1.5,), 0.5)
    assert between.gas is end.gas
    assert {"contact", "self_contact", "extra"} <= set(others)


def test_a_load_more_is_that_of_the_end() -> None:
    between = Windy((1e3,)).interpolated(Windy((3e3,), wind_m_s=3.0), 0.5)
    assert between == Windy((2e3,), wind_m_s=3.0)
