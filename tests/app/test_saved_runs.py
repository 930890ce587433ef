"""A run that goes on from a saved state equals the one that was never saved, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.base.state import difference
from cosim.base.state_file import load, save
from cosim.config.loading import load_scenario
from cosim.errors import InputError
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.tick_batch import Snapshot

# The fingers start around the roll, so that they soon hold it; three fingers, three points each at most.
GRASP: dict[str, Any] = {
    "clock.tick_s": 0.004,
    "start.flange.position_m": [0.45, 0.0, 0.35],
    "phase": [
        {"name": "inflate", "duration_s": 0.2, "settle_s": 0.04, "pressure_Pa": 40e3},
        {"name": "lower", "duration_s": 0.2, "flange_shift_m": [0.0, 0.0, -0.042]},
        {"name": "close", "duration_s": 0.2, "settle_s": 0.04, "cable_tension_N": [6.0] * 6},
        {"name": "lift", "duration_s": 0.12, "flange_shift_m": [0.0, 0.0, 0.02]},
    ],
}
GRASPED = 160  # tick at which the fingers hold the roll above the table


def simulation(name: str, **overrides: Any) -> SteppedRun:
    """Return the simulation of a scenario with changes, in the paper's lumped model, which is quicker."""
    return build_simulation(load_scenario(name, {"model.published": True, **overrides}))


def same(found: list[Snapshot], expected: list[Snapshot]) -> bool:
    """Whether two runs agree in every bit that a snapshot shows, wall time aside."""

    def bits(snapshot: Snapshot) -> tuple[bytes, ...]:
        parts = (
            snapshot.node_position, snapshot.joint_position, snapshot.joint_target, snapshot.body_position,
            snapshot.body_quaternion, snapshot.wrench.force, snapshot.wrench.torque,
            snapshot.world_from_flange.rotation, snapshot.flange_twist.linear, snapshot.tip_position,
        )  # fmt: skip
        table = snapshot.table
        stored = (array.tobytes() for name, array in table.arrays.items() if name != "tick_wall_s")
        return (*(part.tobytes() for part in parts), *stored, repr(snapshot.volume_m3).encode())

    return [bits(snapshot) for snapshot in found] == [bits(snapshot) for snapshot in expected]


def through_a_file(state: Any, tmp_path: Path) -> Any:
    """Return a state that has been written and read."""
    save(tmp_path / "state.npz", state)
    return load(tmp_path / "state.npz")


def test_a_grasp_continues_bit_identically(tmp_path: Path) -> None:
    """Branched in the middle of it: with friction at work."""
    plain = simulation("gripper_lifts_roll", **GRASP)
    steps = plain.steps()
    held = list(islice(steps, GRASPED + 1))[-1]
    state = plain.save_state()
    assert held.contacts >= 3
    assert state.parts["contact"].planes.friction.max() > 0.1
    rest = list(steps)
    assert rest[-1].body_position[-1, 2] > held.body_position[-1, 2] + 5e-3  # the roll is lifted on
    plain.restore_state(state)
    assert same(list(plain.steps()), rest)
    # a second simulation, and the state through a file
    other = simulation("gripper_lifts_roll", **GRASP)
    other.restore_state(through_a_file(state, tmp_path))
    branch = list(other.steps())
    assert same(branch, rest)
    assert not same(branch[1:], rest[:-1])
    # with looser cables the same grasp goes another way
    phases = [*GRASP["phase"][:3], {**GRASP["phase"][3], "cable_tension_N": [1.0] * 6}]
    looser = simulation("gripper_lifts_roll", **{**GRASP, "phase": phases})
    looser.restore_state(state)
    assert not same(list(islice(looser.steps(), 20)), rest[:20])


INFLATE = {"name": "inflate", "duration_s": 0.2, "increments": 8, "pressure_Pa": 5e3}
LEAK = {"name": "leak", "duration_s": 0.1, "increments": 12, "gas": "sealed", "leak_kg_s_Pa": 2e-8}
PUSH = {
    "name": "push", "duration_s": 0.1, "increments": 6, "clamp": ["tip"], "gas": "prescribed",
    "pressure_Pa": 8e3,
}  # fmt: skip
GIVEN = {key: value for key, value in PUSH.items() if key != "gas"}
TURN = [
    {"name": "inflate", "duration_s": 0.1, "increments": 3, "pressure_Pa": 20e3},
    {
        "name": "turn",
        "duration_s": 0.1,
        "increments": 4,
        "flange_turn": {"axis": [0, 1, 0], "angle_rad": 0.15},
    },
]
BRIEF = {
    "inflate": 0.12, "bang_bang": 0.12, "relax": 0.02, "pi_tension": 0.06, "relax_again": 0.02,
    "pi_length": 0.06,
}  # fmt: skip
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "leaking gas": ("three_unit_inflation", {"mode": "dynamic", "phase": [INFLATE, LEAK, PUSH]}),
    "BDF2": (
        "three_unit_inflation",
        {"mode": "dynamic", "phase": [INFLATE, GIVEN], "solver.integrator": "bdf2"},
    ),
    "films that rub on one another": (
        "three_unit_inflation",
        {
            "mode": "dynamic",
            "contact.self_contact": True,
            "clock.tick_s": 0.004,
            "phase": [{**INFLATE, "duration_s": 0.016}, {**GIVEN, "duration_s": 0.016}],
        },
    ),
    "winch and controllers": (
        "bending_angle_control",
        {f"phase.{name}.duration_s": duration for name, duration in BRIEF.items()}
        | {f"phase.{name}.settle_s": 0.0 for name in ("inflate", "relax", "relax_again")}
        | {"controller.paper.period_s": 0.02},
    ),
    "quasistatic, leaking gas": ("three_unit_inflation", {"phase": [INFLATE, LEAK, PUSH]}),
    "quasistatic, on an arm": ("ur5e_hexagon_arm", {"mode": "quasistatic", "phase": TURN}),
    "dynamic, on an arm": ("ur5e_hexagon_arm", {"clock.tick_s": 0.01, "phase": TURN}),
    "rigid, on an arm": ("ur5e_hexagon_arm", {"clock.tick_s": 0.01, "phase": TURN[1:], "fidelity": "rigid"}),
}


@pytest.mark.parametrize("name", RUNS)
def test_every_kind_of_run_continues_bit_identically(name: str, tmp_path: Path) -> None:
    scenario, overrides = RUNS[name]
    whole = simulation(scenario, **overrides)
    plain, end = list(whole.steps()), whole.save_state()
    saved = simulation(scenario, **overrides)
    states, found = [], []
    for snapshot in saved.steps():
        found.append(snapshot)
        states.append(saved.save_state())
    assert same(found, plain)  # saving has no effect
    # also from the first and last step of a phase, where it begins anew
    first = next((snapshot.tick for snapshot in plain if snapshot.phase == 1), 2)
    for tick in (first - 1, (first + len(plain)) // 2):
        saved.restore_state(states[tick])
        assert same(list(saved.steps()), plain[tick + 1 :])
    for tick in (0, first):
        other = simulation(scenario, **overrides)
        other.restore_state(through_a_file(states[tick], tmp_path))
        assert same(list(other.steps()), plain[tick + 1 :])
        assert difference(other.save_state(), end) is None
    saved.restore_state(states[-1])
    assert difference(saved.save_state(), end) is None
    assert list(saved.steps()) == []


def test_open_ends_in_statics_do_not_see_that_they_are_saved() -> None:
    ends = []
    for saved in (True, False):
        run = simulation("paper_figure_9")
        for _ in range(13):
            last = run.advance(1)
            if saved:
                run.save_state()
        ends.append(last)
    assert same(ends[:1], ends[1:])


def test_the_gas_is_part_of_the_state() -> None:
    scenario, overrides = RUNS["quasistatic, leaking gas"]
    run = simulation(scenario, **overrides)
    steps = run.steps()
    assert [snapshot.phase for snapshot in islice(steps, 14)][-1] == 1
    state = run.save_state()
    expected = list(islice(steps, 3))
    before = state.parts["gas"]
    (gas,) = before.sealed
    spoiled = replace(before, sealed=(gas.with_mass(0.99 * gas.mass_kg),))
    run.restore_state(replace(state, parts={**state.parts, "gas": spoiled}))
    assert not same(list(islice(run.steps(), 3)), expected)


def test_restoring_between_two_steps_moves_the_same_iterator() -> None:
    run = simulation("three_unit_inflation", phase=[INFLATE])
    steps = run.steps()
    list(islice(steps, 3))
    state = run.save_state()
    expected = list(islice(steps, 2))
    run.restore_state(state)
    assert same(list(islice(steps, 2)), expected)


UNFIT: dict[str, tuple[str, dict[str, Any], str]] = {
    "mode": ("three_unit_inflation", {"mode": "dynamic"}, "mode is 'dynamic', .* 'quasistatic'"),
    "plan": ("three_unit_inflation", {"phase": [{**INFLATE, "increments": 2}]}, "5 of phase 1; here .* 2"),
    "body": ("ten_unit_extension", {}, r"soft.positions has shape .88, 3., not .284, 3."),
}


@pytest.mark.parametrize("what", UNFIT)
def test_a_state_that_does_not_fit_is_refused(what: str) -> None:
    name, overrides, text = UNFIT[what]
    run = simulation("three_unit_inflation", phase=[INFLATE])
    list(islice(run.steps(), 6))
    with pytest.raises(InputError, match=text):
        simulation(name, **{"phase": [INFLATE], **overrides}).restore_state(run.save_state())


def test_a_state_of_a_scene_with_other_objects_is_refused() -> None:
    overrides = {"phase": TURN, "clock.tick_s": 0.01}
    run = simulation("ur5e_hexagon_arm", **overrides)
    list(islice(run.steps(), 2))
    ball = {
        "name": "ball",
        "shape": "sphere",
        "size_m": [0.02],
        "position_m": [1.0, 1.0, 0.02],
        "mass_kg": 0.1,
    }
    with pytest.raises(InputError, match=r"state.scene.integration has shape \(115,\), here"):
        simulation("ur5e_hexagon_arm", **overrides, object=[ball]).restore_state(run.save_state())


def test_nothing_can_be_saved_before_the_state_at_rest() -> None:
    with pytest.raises(InputError, match="state at rest"):
        simulation("three_unit_inflation", phase=[INFLATE]).save_state()


def test_states_hold_arrays_whose_layout_a_file_keeps(tmp_path: Path) -> None:
    """Other strides could mean other roundings in the sums over them."""
    run = simulation("ur5e_hexagon_arm", **{"clock.tick_s": 0.01, "phase": TURN})
    list(islice(run.steps(), 4))
    state = run.save_state()
    again = through_a_file(state, tmp_path)
    for before, after in zip(arrays_in(state), arrays_in(again), strict=True):
        assert (before.shape, before.dtype) == (after.shape, after.dtype)
        assert before.strides == after.strides or not before.size


def arrays_in(value: Any) -> list[np.ndarray[Any, Any]]:
    """Return all arrays in a state, in order."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple):
        return [array for item in value for array in arrays_in(item)]
    if hasattr(value, "__dataclass_fields__"):
        return [array for name in value.__dataclass_fields__ for array in arrays_in(getattr(value, name))]
    return []
