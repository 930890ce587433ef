"""`Simulation.reset`: what comes after it is what comes after the start of a new simulation, bit for bit."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.errors import InputError

GRASP = """
schema = 2
title = "An inflated core is lowered onto a block that can slide"
robot = "ur5e"
soft_robot = "square_core"
model.published = true
solver = { damping_per_s = 20.0 }
clock = { tick_s = 0.005 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 10e3

[[object]]
name = "block"
shape = "box"
size_m = [0.1, 0.1, 0.1]
position_m = [0.4, 0.0, 0.05]
mass_kg = 0.5

[[phase]]
name = "press"
duration_s = 0.02
flange_shift_m = [0.0, 0.0, -0.004]

[[phase]]
name = "pump"
duration_s = 0.03
pressure_Pa = 12e3
"""
HEIGHT = {"start.flange.position_m": [0.4, 0.0, 0.141]}  # so low that the core touches the block
HEAVY, FIRM = {"object.block.mass_kg": 0.7}, {"phase.pump.pressure_Pa": 14e3}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> cosim.Scenario:
    """Return a scenario of 10 ticks with contact."""
    path = tmp_path_factory.mktemp("grasp") / "grasp.toml"
    path.write_text(GRASP, encoding="utf-8")
    return cosim.load_scenario(path, HEIGHT)


def end_of(simulation: cosim.Simulation) -> tuple[np.ndarray[Any, Any], ...]:
    """Return what a simulation shows at its end."""
    last = simulation.step(simulation.ticks_left)
    return last.node_position, last.joint_position, last.joint_torque, last.body_position


def alike(one: tuple[np.ndarray[Any, Any], ...], other: tuple[np.ndarray[Any, Any], ...]) -> bool:
    """Return whether two ends are the same to the bit."""
    return all(np.array_equal(here, there) for here, there in zip(one, other, strict=True))


def test_a_reset_simulation_repeats_a_new_one(scenario: cosim.Scenario) -> None:
    here = cosim.Simulation(scenario)
    fresh = end_of(here)
    assert here.snapshot.contact_force_N > 0.1
    for _ in range(2):
        assert here.reset().tick == 0
        assert alike(end_of(here), fresh)


def test_changes_hold_until_the_next_reset(scenario: cosim.Scenario) -> None:
    here, ends = cosim.Simulation(scenario), []
    for changes in (HEAVY, FIRM, HEAVY | FIRM, None):
        here.reset(changes=changes)
        ends.append(end_of(here))
        assert alike(ends[-1], end_of(cosim.Simulation(scenario, overrides=changes)))
    assert not any(alike(ends[-1], end) for end in ends[:-1])
    assert here.scenario is scenario or here.scenario == scenario


def test_from_a_saved_state_it_continues_as_a_branch_does(scenario: cosim.Scenario, tmp_path: Path) -> None:
    here = cosim.Simulation(scenario)
    here.step(6)
    saved = here.save()
    saved.write(tmp_path / "six.npz")
    plain, firm = end_of(here.branch()), end_of(here.branch(FIRM))
    end_of(here)
    for start in (saved, tmp_path / "six.npz"):
        assert here.reset(start).tick == 6
        assert alike(end_of(here), plain)
        assert here.reset(start, FIRM).tick == 6
        assert alike(end_of(here), firm)


def test_it_returns_to_where_it_was_made_to_begin(scenario: cosim.Scenario) -> None:
    first = cosim.Simulation(scenario)
    first.step(3)
    here = cosim.Simulation(scenario, start=first.save())
    assert (here.snapshot.tick, here.step(2).tick) == (3, 5)
    assert here.reset().tick == 3
    assert here.reset(changes=FIRM).tick == 3


def test_what_is_refused_leaves_it_where_it_was(scenario: cosim.Scenario, tmp_path: Path) -> None:
    here = cosim.Simulation(scenario)
    here.step(4)
    with pytest.raises(InputError, match=r"object\.block\.mass_kg"):
        here.reset(changes={"object.block.mass_kg": -1.0})
    with pytest.raises(InputError, match=r"missing\.npz"):
        here.reset(tmp_path / "missing.npz")
    assert here.snapshot.tick == 4
    other = cosim.Simulation(scenario)
    other.step(4)
    assert alike(end_of(here), end_of(other))


def test_a_pickled_one_is_reset_as_it_would_have_been(scenario: cosim.Scenario) -> None:
    here = cosim.Simulation(scenario)
    fresh = end_of(here)
    here.reset(changes=FIRM)
    here.step(2)
    there = pickle.loads(pickle.dumps(here))
    assert there.snapshot.tick == 2
    assert alike(end_of(there), end_of(here))
    assert there.reset().tick == 0
    assert alike(end_of(there), fresh)
