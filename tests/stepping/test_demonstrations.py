"""Scenarios that demonstrate something do it: shortened runs, and what must be seen in them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import rotation_from_quaternion, vector_from_rotation
from cosim.build.simulation import build
from cosim.config.loading import load_scenario, to_table
from cosim.results.result import RunResult

TICK_S = 0.004


def shortening(name: str, seconds: dict[str, float]) -> dict[str, Any]:
    """Return the changes that make a scenario short: longer ticks, other durations, no settling.

    Args:
        name: of the scenario.
        seconds: duration of each phase that is kept; the run starts where those before it would have led.
    """
    table = to_table(load_scenario(name))
    start, phases = table["start"], []
    for phase in table["phase"]:
        if phase["name"] in seconds:
            phases.append({**phase, "duration_s": seconds[phase["name"]], "settle_s": 0.0})
        if phases:
            continue
        start["pressure_Pa"] = phase.get("pressure_Pa", start["pressure_Pa"])
        shift = np.array(phase.get("flange_shift_m", np.zeros(3)))
        start["flange"]["position_m"] = (np.array(start["flange"]["position_m"]) + shift).tolist()
    return {"clock.tick_s": TICK_S, "start": start, "phase": phases}


def shortened(name: str, seconds: dict[str, float]) -> RunResult:
    """Run a shortened scenario; see `shortening`."""
    result = cosim.run(name, overrides=shortening(name, seconds), error=False)
    assert result.status == "completed"
    return result


def turns_about_y(name: str, body: str, seconds: dict[str, float]) -> list[float]:
    """Run a shortened scenario; return how far a body has turned [rad] at the end of each phase.

    Summed tick by tick, so that it may be more than one turn.
    """
    simulation = build(load_scenario(name, shortening(name, seconds)))
    place, turned, ends = simulation.stage.body_names.index(body), 0.0, {}
    before = None
    for snapshot in simulation.steps():
        now = rotation_from_quaternion(snapshot.body_quaternion[place])
        turned += 0.0 if before is None else float(vector_from_rotation(now @ before.T)[1])
        before, ends[snapshot.phase] = now, turned
    return list(ends.values())


def at_end_of(result: RunResult, phase: str) -> int:
    """Return the row at the end of a phase."""
    return int(np.flatnonzero(result.phase == result.stage.phase_names.index(phase))[-1])


@pytest.mark.long
def test_the_arm_reaches_around_the_bar() -> None:
    result = shortened("arm_around_bar", {"wind": 1.2, "hook": 0.6})
    bar = load_scenario("arm_around_bar").objects[0]
    near, far = (bar.position_m[0] + side * bar.size_m[0] for side in (-1.0, 1.0))
    assert result.tip_position[0, 0] < near - 0.04
    assert result.tip_position[-1, 0] > far + 0.01
    assert result.tip_direction[-1, 2] > 0.5  # it has come up on the far side
    assert result.contact_force_N.max() > 3.0
    assert result.contact_depth_m.max() < 1e-3


def test_the_corner_of_a_table_does_not_slip_into_the_finger() -> None:
    result = shortened("gripper_on_table_edge", {"press": 0.5, "slide": 0.2})
    pressed, slid = (result.contact_force_N[at_end_of(result, name)] for name in ("press", "slide"))
    assert pressed > 10.0
    assert slid > 10.0
    assert result.contact_depth_m.max() < 1e-3


@pytest.mark.long
def test_the_soft_arm_s_gripper_pulls_wire_off_a_spool() -> None:
    gripped, pulled = turns_about_y("gripper_pulls_wire", "spool", {"grip": 0.35, "pull": 0.45})
    assert (gripped - pulled) * 0.03 > 0.1  # metres of wire; 0.03 m is the radius of its coil


@pytest.mark.long
def test_the_soft_arm_s_gripper_lifts_the_bridge() -> None:
    gripped, lifted = turns_about_y("gripper_lifts_bridge", "bridge", {"grip": 0.4, "lift": 0.6})
    assert abs(gripped) < 0.05  # it lies on the ground until it is taken
    assert lifted < -0.5  # rad, about -y


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "body", "force_N"),
    [
        ("pouch_gripper_lifts_ball", "ball", 2.0),
        ("bellows_gripper_lifts_box", "box", 3.0),
        ("ring_gripper_lifts_bottle", "bottle", 80.0),
    ],
)
def test_a_gripper_from_a_drawing_or_a_mesh_holds_its_object_when_shaken(
    name: str, body: str, force_N: float
) -> None:
    pytest.importorskip("ezdxf", reason="needs the extra pattern")
    shorter = {"phase.shake.duration_s": 1.5, "phase.hold.duration_s": 0.1}
    result = cosim.run(name, overrides=shorter, error=False)
    held = result.body_position[:, result.body(body)]
    place = held - result.flange_position
    closed, end = at_end_of(result, "close"), at_end_of(result, "hold")
    assert result.summary["warnings"] == []
    assert held[end, 2] - held[0, 2] > 0.19
    assert np.linalg.norm(place[closed:] - place[end], axis=1).max() < 2e-3  # it does not slip
    assert result.contact_force_N[end] > force_N


def test_a_pad_presses_on_a_box_that_stays_level_while_the_pad_is_turned() -> None:
    pytest.importorskip("shapely", reason="needs the extra pattern")
    result = shortened("pad_levels_box", {"press": 0.6, "inflate": 0.2, "turn": 0.5})
    box = result.body("box")
    q = result.body_quaternion[:, box]
    assert 2.0 * np.hypot(q[:, 1], q[:, 2]).max() < math.radians(1.0)
    assert np.linalg.norm(result.body_position[:, box] - result.body_position[0, box], axis=1).max() < 2e-3
    ends = [result.contact_force_N[at_end_of(result, name)] for name in ("press", "inflate", "turn")]
    assert ends[0] > 10.0
    assert ends[1] > 1.5 * ends[0]
    assert ends[2] == pytest.approx(ends[1], rel=0.2)


def test_a_conveyor_brings_the_spool_below_the_gripper() -> None:
    seconds = {"bring": 1.0}
    changes = shortening("gripper_sorts_bins", seconds) | {"fidelity": "rigid"}
    result = cosim.run("gripper_sorts_bins", overrides=changes, error=False)
    spool = result.body_position[:, result.stage.body_names.index("spool")]
    np.testing.assert_allclose(spool[-1] - spool[0], [0.0, 0.2, 0.0], atol=3e-4)  # it sinks in by 0.1 mm


def test_an_arm_in_a_bin_presses_on_its_wall() -> None:
    result = shortened("arm_reaches_into_bin", {"bend": 0.3, "stroke": 0.3})
    wall = result.body_contact_force[:, result.stage.body_names.index("cell/near_bin")]
    assert result.contact_force_N[0] == 0.0
    assert 1.0 < wall[-1, 0] < 10.0  # towards +x, as the flange goes
    assert result.summary["max_contact_depth_m"] < 5e-4
