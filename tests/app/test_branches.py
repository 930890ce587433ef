"""A run that goes on from another one's state keeps what that one has decided to model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.errors import InputError
from tests.app.test_resets import GRASP

SCENARIO = f"""{GRASP.partition("[[phase]]")[0].replace("0.05]", "0.2]").replace("mass_kg = 0.5", "")}
[[phase]]
name = "press"
duration_s = 0.5
"""
DOWN = {"phase.press.flange_shift_m": [0.0, 0.0, -0.217]}
TICKS = 4


def simulation(tmp_path: Path, **overrides: Any) -> cosim.Simulation:
    """Return the simulation, some ticks after its start."""
    path = tmp_path / "press.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    found = cosim.Simulation(path, overrides=overrides)
    found.step(TICKS)
    return found


def contact(of: cosim.Simulation) -> Any:
    """Return the decision on contact."""
    return next(decision for decision in of.stage.modelled if decision.what == "contact with the scene")


@pytest.mark.parametrize("scheme", ["staggered", "iterated"])
def test_what_comes_into_reach_is_touched_as_if_it_had_been_modelled_all_along(
    tmp_path: Path, scheme: str
) -> None:
    given = {"coupling.scheme": scheme}
    here = simulation(tmp_path, **given)
    there = simulation(tmp_path, **given, **{"contact.only_in_reach": False})
    assert not contact(here).included
    assert contact(there).included
    lowered, known = here.branch(DOWN), there.branch(DOWN)
    assert contact(lowered).included
    end = lowered.step(lowered.ticks_left)
    assert end.contact_force_N > 1.0
    assert np.array_equal(end.node_position, known.step(known.ticks_left).node_position)


def test_what_is_modelled_stays_so(tmp_path: Path) -> None:
    here = simulation(tmp_path, **DOWN)
    lifted = here.branch({"phase.press.flange_shift_m": [0.0, 0.0, 0.0]})
    assert contact(lifted).included
    assert contact(lifted).reason.startswith("as in the run that it continues from: the film reaches ")
    here.save().write(tmp_path / "saved.npz")
    again = cosim.Simulation(lifted.scenario, start=tmp_path / "saved.npz")
    assert again.stage.modelled == lifted.stage.modelled
    assert np.array_equal(again.step(3).node_position, lifted.step(3).node_position)


@pytest.mark.parametrize(
    ("first", "changes", "message"),
    [
        (DOWN, {"contact.enabled": False}, r"contact\.enabled: .* left out \(switched off\)"),
        ({"contact.enabled": False}, DOWN | {"contact.enabled": True}, r"contact\.enabled is true, .* false"),
        ({}, {"coupling.scheme": "iterated"}, r"coupling\.scheme is 'iterated', .* 'staggered'; .* restart"),
        ({}, {"fidelity": "rigid"}, "fidelity is 'rigid', .* 'lumped'; .* leave fidelity = 'lumped'"),
        ({}, {"mode": "quasistatic"}, "mode is 'quasistatic', .* 'dynamic'"),
    ],
    ids=str,
)
def test_a_state_of_another_kind_is_refused_by_key_and_both_values(
    tmp_path: Path, first: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    here = simulation(tmp_path, **first)
    with pytest.raises(InputError, match=message):
        here.branch(changes)
