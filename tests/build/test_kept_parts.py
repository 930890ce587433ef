"""Parts that are taken over: a simulation is the same bit for bit, whatever others have made before it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim import KeptParts, Simulation
from cosim.base.identity import content_name
from cosim.base.kept_parts import name_of
from cosim.build import simulation as building
from cosim.errors import ScenarioError
from cosim.plan import path_clearance
from tests.small_section import ROBOT

LIFT = f"""
schema = 2
title = "A small arm is turned over a block, brought to a target and pumped up"
robot = "ur5e"
soft_robot = {ROBOT}
model.published = true
solver = {{ damping_per_s = 20.0 }}
clock = {{ tick_s = 0.005 }}

[start]
flange = {{ position_m = [0.4, 0.0, 0.15], direction = [0.0, 0.0, -1.0] }}
pressure_Pa = 10e3

[[object]]
name = "block"
shape = "box"
size_m = [0.1, 0.1, 0.1]
position_m = [0.4, 0.0, 0.05]
mass_kg = 0.5

[[phase]]
name = "turn"
duration_s = 0.05
increments = 2
flange_turn = {{ axis = [0.0, 1.0, 0.0], angle_rad = 0.3 }}

[[phase]]
name = "reach"
duration_s = 0.05
increments = 2
tip_target = {{ position_m = [0.40, 0.01, 0.104], reach_with = "flange" }}

[[phase]]
name = "pump"
duration_s = 0.05
increments = 2
pressure_Pa = 12e3
"""

CHANGES: tuple[dict[str, Any], ...] = (
    {},
    {"start.pressure_Pa": 11e3},
    {"start.pressure_Pa": 9e3, "phase.pump.pressure_Pa": 9e3},
    {"phase.pump.pressure_Pa": 14e3},
    {"phase.pump.duration_s": 0.04},
    {"phase.turn.ramp": "linear"},
    {"phase.turn.flange_turn.angle_rad": 0.2},
    {"phase.reach.tip_target.position_m": [0.40, 0.005, 0.104]},
    {"start.flange.position_m": [0.41, 0.0, 0.15]},
    {"start.flange.roll_rad": 0.3},
    {"start.cable_tension_N": [1.0, 0.0]},
    {"clock.tick_s": 0.0025},
    {"gravity_m_s2": [0.0, 0.5, -9.7]},
    {"solver.damping_per_s": 10.0},
    {"solver.integrator": "implicit_euler"},
    {"solver.residual_tolerance_N": 1e-7},
    {"soft_robot.mass.node_mass_kg": 4e-4},
    {"soft_robot.film.thickness_m": 1.1e-4},
    {"soft_robot.hinge.stiffness_factor": 1.5},
    {"model.closed": False},
    {"object.block.mass_kg": 0.8},
    {"object.block.position_m": [0.4, 0.1, 0.05], "plan.clearance_m": 0.1},
    {"object.block.friction": 0.3},
    {"arm_base": {"position_m": [0.01, 0.0, 0.0]}},
    {"robot": "ur5"},
    {"payload_compensation": False},
    {"contact.stiffness_N_m3": 2e8},
    {"contact.enabled": False},
    {"contact.self_contact": False},
    {"plan.clearance_m": 0.2},
    {"plan.collision": "off"},
    {"coupling.scheme": "iterated"},
    {"fidelity": "rigid"},
    {"mode": "quasistatic"},
    {"robot": "none", "object": [], "phase": [{"name": "pump", "duration_s": 0.1, "pressure_Pa": 2e4}]},
)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> cosim.Scenario:
    """Return a scenario of 30 ticks with a tip target and an object."""
    path = tmp_path_factory.mktemp("kept") / "lift.toml"
    path.write_text(LIFT, encoding="utf-8")
    return cosim.load_scenario(path)


def seen(simulation: Simulation) -> list[bytes | str]:
    """Return all that a simulation says of itself, and where it is from its state at rest to its end."""
    stage, found = simulation.stage, list[bytes | str]()
    found += [
        stage.report,
        content_name(stage.arm, stage.modelled, [shape.vertices for shape in stage.shapes]),
    ]
    while True:
        here = simulation.snapshot
        arrays = (here.node_position, here.joint_position, here.joint_torque, here.body_position)
        found += [*(array.tobytes() for array in arrays), here.chamber_pressure_Pa.tobytes()]
        if not simulation.ticks_left:
            return found
        simulation.step(min(3, simulation.ticks_left))


@pytest.fixture(scope="module")
def kept(scenario: cosim.Scenario) -> KeptParts:
    """Return what has been kept of the scenario as it is."""
    found = KeptParts()
    Simulation(scenario, kept=found)
    return found


@pytest.mark.parametrize("changes", CHANGES, ids=lambda changes: " ".join(changes) or "none")
def test_a_change_touches_what_it_would_touch_in_a_new_simulation(
    changes: dict[str, Any], scenario: cosim.Scenario, kept: KeptParts
) -> None:
    alone = seen(Simulation(scenario, overrides=changes))
    assert seen(Simulation(scenario, overrides=changes, kept=kept)) == alone


@pytest.mark.parametrize("changes", CHANGES[:4], ids=lambda changes: " ".join(changes) or "none")
def test_where_nothing_changes_everything_is_used_again(
    changes: dict[str, Any], scenario: cosim.Scenario
) -> None:
    kept = KeptParts()
    first = seen(Simulation(scenario, overrides=changes, kept=kept))
    assert seen(Simulation(scenario, overrides=changes, kept=kept)) == first


@pytest.mark.parametrize(
    "changes",
    [
        {"gravity_m_s2": [0.0, 0.5, -9.7]},
        {"soft_robot.mass.node_mass_kg": 4e-4},
        {"clock.tick_s": 0.0025},
        {"object.block.position_m": [0.4, 0.3, 0.1]},
        {"phase.pump.duration_s": 0.04},
    ],
    ids=" ".join,
)
def test_so_it_is_of_a_plan_without_statics(changes: dict[str, Any], scenario: cosim.Scenario) -> None:
    plain = replace(scenario, phases=(scenario.phases[0], scenario.phases[2]))
    held = replace(plain.objects[0], mass_kg=None)  # what cannot move is looked at ahead
    plain, kept = replace(plain, objects=(held,)), KeptParts()
    before = seen(Simulation(plain, kept=kept))
    alone = seen(Simulation(plain, overrides=changes))
    assert seen(Simulation(plain, overrides=changes, kept=kept)) == alone != before


def test_what_a_change_leaves_alone_is_not_made_again(
    scenario: cosim.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved: list[str] = []
    statics = building.solved_phases

    def counted(*given: Any) -> Any:
        solved.append("")
        return statics(*given)

    monkeypatch.setattr(building, "solved_phases", counted)
    simulation = Simulation(scenario, kept=KeptParts())
    for changes, times in (
        ({"object.block.mass_kg": 0.7}, 1),
        ({"clock.tick_s": 0.0025}, 1),
        ({"phase.pump.pressure_Pa": 13e3}, 2),
        ({"phase.pump.pressure_Pa": 13e3, "payload_compensation": False}, 2),
    ):
        simulation.reset(changes=changes)
        assert len(solved) == times


def test_a_plan_on_disk_is_the_one_that_would_be_solved(
    scenario: cosim.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    alone = seen(Simulation(scenario, kept=KeptParts()))
    Simulation(scenario, kept=KeptParts(on_disk=True))
    # the statics, and much smaller, the clearances of the way
    _, file = sorted((tmp_path / "cosim" / "plans").iterdir(), key=lambda path: path.stat().st_size)

    def solve_again(*_given: Any) -> None:
        raise AssertionError("solved again")

    with monkeypatch.context() as patched:
        patched.setattr(building, "solved_phases", solve_again)
        patched.setattr(path_clearance, "path_clearances", solve_again)
        assert seen(Simulation(scenario, kept=KeptParts(on_disk=True))) == alone
        with pytest.raises(AssertionError, match="solved again"):
            Simulation(scenario, overrides={"start.pressure_Pa": 11e3}, kept=KeptParts(on_disk=True))
    whole = file.read_bytes()
    for damaged in (b"", whole[:-7], whole[:5000] + b"?" + whole[5001:], whole.partition(b"\n")[2]):
        file.write_bytes(damaged)
        with pytest.warns(RuntimeWarning, match="its content is computed again"):
            assert seen(Simulation(scenario, kept=KeptParts(on_disk=True))) == alone
        assert file.read_bytes()[:60] == whole[:60]


@pytest.mark.parametrize(
    "changes",
    [
        {"solver.damping_per_s": 15.0},
        {"solver.dynamic_tolerance_N": 1e-3},
        {"solver.integrator": "implicit_euler"},
    ],
    ids=" ".join,
)
def test_a_plan_on_disk_is_that_of_other_steps_in_time_too(
    scenario: cosim.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    Simulation(scenario, kept=KeptParts(on_disk=True))
    files = set((tmp_path / "cosim" / "plans").iterdir())
    alone = seen(Simulation(scenario, overrides=changes, kept=KeptParts()))
    assert seen(Simulation(scenario, overrides=changes, kept=KeptParts(on_disk=True))) == alone
    assert set((tmp_path / "cosim" / "plans").iterdir()) == files


def test_what_cannot_be_made_is_refused_every_time(scenario: cosim.Scenario, kept: KeptParts) -> None:
    beyond = {"phase.reach.tip_target.position_m": [2.0, 0.0, 0.5]}
    for _ in range(2):
        with pytest.raises(ScenarioError, match=r"phase\.reach\.tip_target"):
            Simulation(scenario, overrides=beyond, kept=kept)


def test_another_file_of_a_mesh_is_another_body(tmp_path: Path) -> None:
    film = tmp_path / "film.stl"
    film.write_text("one", encoding="utf-8")
    parts, made = KeptParts(), list[int]()

    def body() -> int:
        made.append(len(made))
        return made[-1]

    from cosim.base.kept_parts import stamps

    first = parts.made("body", name_of(stamps([film])), body)
    assert parts.made("body", name_of(stamps([film])), body) == first
    film.write_text("other", encoding="utf-8")
    assert parts.made("body", name_of(stamps([film])), body) != first
    assert stamps([tmp_path / "absent.stl"])[0][1:] == (-1, -1)


def test_what_cannot_be_named_is_never_taken_for_another() -> None:
    parts = KeptParts()
    assert parts.made("body", name_of(object()), lambda: 1) == 1
    assert parts.made("body", name_of(object()), lambda: 2) == 2


def test_a_few_parts_of_each_kind_are_kept_and_none_is_pickled() -> None:
    parts = KeptParts()
    for k in range(20):
        parts.made("body", str(k), lambda k=k: k)  # type: ignore[misc]
        parts.made("body", "0", lambda: 0)  # taken again and again, it stays
    assert parts.made("body", "0", lambda: -1) == 0
    assert parts.made("body", "1", lambda: -1) == -1
    parts.forget("body", "0")
    assert parts.made("body", "0", lambda: -1) == -1
    assert pickle.loads(pickle.dumps(parts)).made("body", "0", lambda: 5) == 5


def test_a_branch_shares_what_is_kept(scenario: cosim.Scenario) -> None:
    here = Simulation(scenario)
    here.step(4)
    there = here.branch()
    assert np.array_equal(there.step(5).node_position, here.step(5).node_position)
