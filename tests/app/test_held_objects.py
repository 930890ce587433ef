"""Objects that a soft robot on a palm holds: the wrench on its flange, the summary, the robot's program."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.app.payload import payload_rows
from cosim.base.frames import Array, rotations_from_quaternions
from cosim.build.arms import find_arm
from cosim.cli.main import main
from cosim.errors import InputError
from cosim.kinematics.arm import Arm
from cosim.results.result import RunResult
from cosim.telemetry.texts.closing_lines import closing_lines
from tests.trays import DOWN, PALM_KG, SCENARIO, TRAY_KG

GRAVITY = 9.81
PRESSED = """
schema = 2
title = "A soft arm on a palm presses a box on the floor, and leaves it there"
robot = "ur5e"
soft_robot.file = "square_core"
model.published = true
clock.tick_s = 0.004

[start]
flange = { position_m = [0.4, 0.0, 0.2], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 20e3

[[object]]
name = "box"
shape = "box"
size_m = [0.1, 0.1, 0.15]
position_m = [0.4, 0.0, 0.075]
mass_kg = 0.5

[[phase]]
name = "press"
duration_s = 0.2
pressure_Pa = 20e3
flange_shift_m = [0.0, 0.0, -0.008]

[[phase]]
name = "leave"
duration_s = 0.2
flange_shift_m = [0.0, 0.0, 0.02]
"""
LEFT_BEHIND = """
schema = 2
title = "A soft arm moves away from under a slippery box"
robot = "ur5e"
soft_robot.file = "square_core"
model.published = true
clock.tick_s = 0.004

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, 1.0] }
pressure_Pa = 20e3

[[object]]
name = "box"
shape = "box"
size_m = [0.06, 0.06, 0.02]
position_m = [0.4, 0.0, 0.5549]
mass_kg = 0.05
friction = 0.02

[[phase]]
name = "wait"
duration_s = 0.16
pressure_Pa = 20e3

[[phase]]
name = "away"
duration_s = 0.4
flange_shift_m = [0.0, 0.25, 0.0]
"""


@pytest.fixture(scope="module")
def lifted(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """Return the run that lifts a tray off its posts, holds it, and puts it down."""
    folder = tmp_path_factory.mktemp("tray")
    (folder / "tray.toml").write_text(SCENARIO + DOWN, encoding="utf-8")
    return cosim.run(folder / "tray.toml", error=False, out=folder / "run")


def below(result: RunResult, held: bool) -> float:
    """Return the weight of all below the flange."""
    return GRAVITY * (result.stage.soft_mass_kg + PALM_KG + TRAY_KG * held)


def at_rest(result: RunResult, phase: str) -> Array:
    """Return the last rows of a phase."""
    return np.flatnonzero(result.phase == result.stage.phase_names.index(phase))[-10:]


def test_the_wrench_at_rest_is_the_weight_below_the_flange(lifted: RunResult) -> None:
    for phase, held in (("hold", True), ("lower", False)):
        force = lifted.flange_force[at_rest(lifted, phase)]
        weight = below(lifted, held)
        # the servos still creep by 1e-3 of gravity
        np.testing.assert_allclose(force, np.tile([0.0, 0.0, -weight], (10, 1)), atol=0.005 * weight)
    assert lifted.contact_force_N[at_rest(lifted, "hold")].min() > 0.3 * TRAY_KG * GRAVITY
    assert lifted.palm_contacts[at_rest(lifted, "hold")].min() > 0
    assert lifted.flange_force[0, 2] == pytest.approx(-below(lifted, held=False), rel=1e-6)


def test_the_reported_wrench_is_that_which_the_arm_carries(lifted: RunResult) -> None:
    arm, row = Arm(find_arm("ur5e")), at_rest(lifted, "hold")[-1]
    q = lifted.joint_position[row]
    load = np.concatenate([lifted.flange_force[row], lifted.flange_torque[row]])
    asked = arm.gravity_torque(q) - arm.jacobian(q).T @ load
    np.testing.assert_allclose(lifted.joint_torque[row], asked, atol=0.02)  # N m, of 20


def test_the_wrench_in_motion_changes_the_momentum(lifted: RunResult) -> None:
    rows = np.flatnonzero(lifted.time_s < 0.12)  # nothing is touched before
    assert not lifted.contacts[rows].any()
    time_s = lifted.time_s[rows]
    speed = np.gradient(lifted.flange_position[:, 2], lifted.time_s)[rows]
    mass = below(lifted, held=False) / GRAVITY
    impulse = float(np.trapezoid(-lifted.flange_force[rows, 2] - mass * GRAVITY, time_s))
    gained = mass * (speed[-1] - speed[0])
    assert gained > 0.05  # N s; the film's own swing is the rest
    assert impulse == pytest.approx(gained, rel=0.03)


def test_the_summary_says_what_was_held_and_how_hard(lifted: RunResult) -> None:
    (tray,) = lifted.summary["objects"]
    (span,) = tray["held"]
    raised = lifted.body_position[:, lifted.body("tray"), 2] - lifted.body_position[0, lifted.body("tray"), 2]
    off = lifted.time_s[raised > 2e-4]
    assert span["since_s"] == pytest.approx(off[0], abs=0.03)
    assert span["until_s"] == pytest.approx(off[-1], abs=0.03)
    assert tray["moved_m"] < 5e-4
    assert tray["tilted_rad"] < 1e-3
    assert tray["dropped_s"] == []
    assert tray["max_squeeze_N"] == pytest.approx(lifted.contact_force_N.max(), rel=0.05)
    # friction is in the force on it, not in the sum of normal forces
    assert 0.0 < tray["max_contact_force_N"] < 1.01 * tray["max_squeeze_N"]
    assert lifted.summary["warnings"] == []
    lines = [line for line in closing_lines(lifted.summary, Path("runs/tray"), []) if "object:" in line]
    assert len(lines) == 1
    assert re.search(r"'tray' \(0.3 kg\): moved by 0\.\d+ mm, .*held from 0.1\d* s to 0.7\d* s", lines[0])


def test_the_payload_is_that_of_the_parts_with_and_without_what_is_held(lifted: RunResult) -> None:
    found = cosim.payload_torque(lifted)
    ((parts, holding),) = found.holding
    assert [part.name for part in parts] == ["tray"]
    soft = lifted.stage.soft_mass_kg
    # the plate has 0.2352 l, the four legs 3.3 ml each, 19.5 mm lower
    plate, legs = 0.14 * 0.28 * 0.006, 4 * 0.01 * 0.01 * 0.033
    lower = np.array([0.0, 0.0, 0.0195 * legs / (plate + legs)])
    for figures, phase, tray_kg in ((found.fixed, "lower", 0.0), (holding, "hold", TRAY_KG)):
        row = at_rest(lifted, phase)[-1]
        flange = rotations_from_quaternions(lifted.flange_quaternion[[row]])[0]
        tray = lifted.body_position[row, lifted.body("tray")] - lower - lifted.flange_position[row]
        moment = soft * (lifted.soft_center[row] - lifted.flange_position[row]) + tray_kg * tray
        mass = soft + PALM_KG + tray_kg
        centre = (moment @ flange + PALM_KG * np.array([0.0, 0.0, 0.005])) / mass
        assert figures[0] == pytest.approx(mass, rel=0.02)
        assert np.linalg.norm(figures[1:4] - centre) < 0.02 * np.linalg.norm(centre)
    masses = payload_rows(lifted)[:, 0]
    assert set(np.round(masses, 9).tolist()) == set(np.round([found.fixed[0], holding[0]], 9).tolist())
    text = repr(found)
    assert "with 'tray' (0.3 kg) from 0.1" in text
    assert np.sqrt(np.mean(found.by_fixed[at_rest(lifted, "hold")] ** 2)) < 0.01  # N m


def test_a_wrench_that_the_parts_do_not_explain_is_refused(lifted: RunResult) -> None:
    force = lifted.flange_force + np.array([0.0, 0.0, -9.0])
    odd = replace(lifted, arrays={**lifted.arrays, "flange_force": force})
    with pytest.raises(InputError, match=r"would put the payload's centre of gravity \d+ mm from that of"):
        cosim.payload_torque(odd)


def test_the_robots_program_sets_both_payloads_when_the_tray_comes_and_goes(
    lifted: RunResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "way.script"
    assert main(["export-path", str(lifted.directory), str(script), "--rate", "250"]) == 0
    lines = script.read_text(encoding="utf-8").splitlines()
    served, masses, notes = 0, [], {}
    for line in lines:
        served += line.startswith("  servoj")
        if line.startswith("  #"):
            notes[served] = line
        if line.startswith("  set_target_payload"):
            call = ast.literal_eval(line.strip().removeprefix("set_target_payload"))
            masses.append((served, call[0], call[3]))
    (span,) = lifted.summary["objects"][0]["held"]
    taken, left = (round(250 * span[key]) for key in ("since_s", "until_s"))
    assert list(notes) == [taken, left]
    assert "takes 'tray', 0.3 kg" in notes[taken]
    assert "lets go of 'tray', 0.3 kg" in notes[left]
    bare, full = below(lifted, held=False) / GRAVITY, below(lifted, held=True) / GRAVITY
    for row, mass, _ in masses:
        assert mass == pytest.approx(full if taken <= row < left else bare, rel=1e-5)
    assert {(taken, 0.0), (left, 0.0)} <= {(row, within_s) for row, _, within_s in masses}
    shown = capsys.readouterr().out
    assert "payload: empty: 0.679 kg" in shown
    assert "payload: with 'tray' (0.3 kg) from 0.1" in shown


def test_what_is_pressed_and_not_lifted_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "pressed.toml").write_text(PRESSED, encoding="utf-8")
    palm = {"soft_robot.palm": {"radius_m": 0.05, "thickness_m": 0.01, "mass_kg": 0.1}}
    with_palm = cosim.run(tmp_path / "pressed.toml", error=False, overrides=palm)
    (text,) = with_palm.summary["warnings"]
    assert text.startswith("phase 'leave' lifts the flange by 20 mm, and no object is held at its end: 'box'")
    (box,) = with_palm.summary["objects"]
    assert box["held"] == []
    assert box["max_squeeze_N"] > 0.1
    # one film without a palm is no gripper
    assert cosim.run(tmp_path / "pressed.toml", error=False).summary["warnings"] == []


def test_what_falls_off_was_dropped(tmp_path: Path) -> None:
    (tmp_path / "away.toml").write_text(LEFT_BEHIND, encoding="utf-8")
    (box,) = cosim.run(tmp_path / "away.toml", error=False).summary["objects"]
    (span,) = box["held"]
    (dropped_s,) = box["dropped_s"]
    assert span["since_s"] < 0.05
    assert 0.16 < span["until_s"] < 0.56
    assert dropped_s == pytest.approx(span["until_s"], abs=0.1)
    assert box["moved_m"] > 0.01
