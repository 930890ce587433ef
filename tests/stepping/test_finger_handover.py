"""Fingers that hand over to their film while they hold an object: it is neither dropped nor kicked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import takewhile
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import build_simulation
from cosim.build import soft_model
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.coupling.soft_sides.handover import BridgeEnd, Handover
from cosim.reduced.fitting import Effort
from cosim.reduced.section_model import SectionModel
from cosim.reduced.sections.section_energy import BENT
from cosim.stepping.parts import film_law
from cosim.telemetry.snapshot import Snapshot
from tests.small_section import kept_model

CHANGES = {
    "fidelity": "section",
    "model.handover": True,
    "start.pressure_Pa": 5e3,
    "phase.inflate.duration_s": 0.3,  # so fast that they leave their range, and come back
    "phase.lower.duration_s": 0.6,
    "phase.lift.duration_s": 0.6,
}
FADED = 50  # ticks


@cache
def model() -> SectionModel:
    """Return a rough model of a finger of the shipped gripper."""
    scenario = load_scenario("gripper_lifts_roll", CHANGES)
    robot: Any = scenario.soft_robot
    body = build_soft_body(replace(robot, copies=None, palm=None), scenario.model)
    law = film_law(scenario)
    assert law is not None
    films = replace(law, friction=0.0, throughout=True)
    return kept_model(body, 45e3, films, Effort(levels=6, samples=8, intervals=4), folds=True)


@cache
def lifted(share: float, until: str) -> tuple[list[Snapshot], np.ndarray, np.ndarray]:
    """Return a run to the end of a phase, with a share of the range of bending, and of it the roll.

    Returns:
        Ticks; place (n, 3) [m] of the roll in the flange's frame, and force (n, 3) [N] of the film on it.
    """
    energy = model().energy.copy()
    energy[:, :, BENT] *= share**2
    rough = replace(model(), energy=energy, tips=np.zeros((0, 3)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soft_model, "kept", lambda *_: rough)
        run = build_simulation(load_scenario("gripper_lifts_roll", CHANGES))
    names, roll = run.stage.phase_names, run.stage.body_names.index("roll")
    last = names.index(until)
    shots = list(takewhile(lambda shot: shot.phase <= last, ticks(run, last)))
    place = [shot.world_from_flange.inverse().apply(shot.body_position[roll]) for shot in shots]
    return shots, np.array(place), np.array([shot.body_contact_force[roll] for shot in shots])


def ticks(run: Any, last: int) -> Iterator[Snapshot]:
    for batch in run.batches():
        yield from batch
        if batch.phase[-1] > last:
            return


def changes_of(shots: list[Snapshot]) -> list[Handover]:
    return [each for shot in shots for each in shot.handovers if isinstance(each, Handover)]


def test_what_fingers_hold_is_neither_dropped_nor_kicked_as_the_film_takes_over() -> None:
    shots, place, force = lifted(0.9, "lift")
    whole, expected, pressed = lifted(1.5, "lift")
    early, back, change = changes_of(shots)
    assert [each.to for each in (early, back, change)] == ["film", "section", "film"]
    assert "is stretched by" in early.why
    assert back.touched_gap_N == 0.0
    assert [each.to for each in changes_of(whole)] == ["film", "section"]  # bends never take it out of range
    at = slice(change.tick, change.tick + 2 * FADED)
    assert shots[change.tick - 1].phase == shots[0].phase + 2  # it closes
    assert np.linalg.norm(force[change.tick - 1]) > 5.0
    assert change.tip_jump_m < 5e-4
    assert change.wrench_gap < 0.03
    assert change.touched_gap_N < 0.05 * np.linalg.norm(force[change.tick - 1])
    assert np.linalg.norm(place[at] - expected[at], axis=1).max() < 1e-4
    assert np.linalg.norm(force[at] - pressed[at], axis=1).max() < 0.1 * np.linalg.norm(pressed[at][-1])
    (first, *_) = force[at] - pressed[at]
    assert np.linalg.norm(first) < 0.05 * np.linalg.norm(pressed[at][0])
    closed = next(k for k, shot in enumerate(shots) if shot.phase == shots[-1].phase)
    assert shots[-1].body_position[-1][2] > 0.19 + shots[0].body_position[-1][2]
    assert np.linalg.norm(place[-1] - place[closed]) < 2e-3


def test_bridging_forces_of_fingers_fade() -> None:
    shots, _, _ = lifted(0.9, "lift")
    ends = [(shot.tick, each) for shot in shots for each in shot.handovers if isinstance(each, BridgeEnd)]
    assert len(ends) == len(changes_of(shots))
    assert abs(ends[-1][1].work_J) < 0.05


def test_what_fingers_press_on_a_palm_does_not_hop_as_it_is_lifted() -> None:
    shots, place, force = lifted(1.5, "lift")
    lift = [shot.phase == shots[-1].phase for shot in shots]
    assert np.linalg.norm(force[lift], axis=1).min() > 5.0
    # a palm as hard for what just touches it: 1.1 N and 0.16 mm in a tick
    assert np.abs(np.diff(force[lift], axis=0)).max() < 0.05
    assert np.abs(np.diff(place[lift], axis=0)).max() < 5e-5
