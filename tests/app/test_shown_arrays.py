"""Arrays that are handed out: who writes to them changes no run, no saved state, no branch and no start."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import cosim
import cosim.gym
from cosim import Batch, Command, Controller, Measurement, Simulation
from cosim.app.run_follower import Observer
from cosim.build import section_models
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch
from tests.app.test_live_commands import ARM, SEALED, held, standing
from tests.app.test_users_body import SCENARIO
from tests.devices import device_parts
from tests.fuzz.arrays import arrays_of, state_content, write_to_all
from tests.small_section import on_a_ur5e
from tests.small_section import section as small_section
from tests.soft.own_tube import tube


def film(folder: Path) -> Simulation:
    here = held(folder, device_parts.WINCH, SEALED)
    here.step(Command(cable_length_m={"corner_0": 0.03}), ticks=2)
    return here


def arm(_: Path) -> Simulation:
    return standing()


def section(folder: Path) -> Simulation:
    path = folder / "arm.toml"
    path.write_text(on_a_ur5e(25e3, ""), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        patch.setattr(section_models, "build_model", lambda *_: small_section().model)
        return Simulation(path, overrides={**ARM, "fidelity": "section"})


def touching(_: Path) -> Simulation:
    quick = {"model.published": True, "phase.inflate.duration_s": 0.02}
    return Simulation("gripper_lifts_roll", overrides=quick)


def ahead(here: Simulation, path: Path) -> Any:
    """Return the state that a simulation comes to in a few ticks, from where it is and back there."""
    saved = here.save()
    here.step(2)
    found = state_content(here.save(), path)
    here.restore(saved)
    return found


@pytest.mark.parametrize("made", [film, arm, section, touching])
def test_writing_to_what_is_shown_changes_nothing(made: Callable[[Path], Simulation], tmp_path: Path) -> None:
    here, file = made(tmp_path), tmp_path / "state.npz"
    saved, branch = here.save(), here.branch()
    expected = ahead(here, file)
    for shown in (here, here.measure(), saved, branch, here.step(1)):
        write_to_all(shown)
    branch.step(2)
    assert state_content(branch.save(), file) == expected
    here.restore(saved)
    assert ahead(here, file) == expected
    write_to_all(here)  # what is shown after it was restored is what was saved
    here.reset(saved)
    write_to_all(here)
    assert ahead(here, file) == expected
    write_to_all(here.reset())
    first = ahead(here, file)
    here.step(1)
    here.reset()
    assert ahead(here, file) == first


def test_the_walk_finds_what_is_shown(tmp_path: Path) -> None:
    here = film(tmp_path)
    found = {place.removeprefix("here.") for place, _ in arrays_of(here, "here")}
    names = ("node_position", "tip_position", "joint_position", "devices.unstretched_m")
    assert here.snapshot.devices is not None
    assert {f"snapshot.{name}" for name in names} <= found
    assert {"stage.gravity", "stage.soft_triangles"} <= found


def test_what_was_shown_stays_as_it_was(tmp_path: Path) -> None:
    for here in (film(tmp_path), standing()):
        shown = [here.snapshot, here.measure(), here.save()]
        before = [(place, array.tobytes()) for place, array in arrays_of(shown, "")]
        here.step(3)
        assert [(place, array.tobytes()) for place, array in arrays_of(shown, "")] == before


def test_a_state_from_elsewhere_is_not_changed_either(tmp_path: Path) -> None:
    here, file = film(tmp_path), tmp_path / "state.npz"
    expected = ahead(here, file)
    here.save().write(tmp_path / "kept.npz")
    sent = pickle.loads(pickle.dumps(here.save()))
    for _ in range(2):
        here.restore(sent)
        write_to_all((here, sent))
        assert ahead(here, file) == expected
    here.restore(tmp_path / "kept.npz")
    write_to_all(here)
    assert ahead(here, file) == expected
    moved = pickle.loads(pickle.dumps(here))
    write_to_all(moved)
    assert ahead(moved, file) == expected


class Scribbler(Observer):
    """Writes to all that it is shown."""

    def open(self, stage: RunInfo) -> None:
        write_to_all(stage)

    def observe(self, batch: TickBatch) -> None:
        write_to_all((batch, batch.snapshot(-1)))

    def close(self) -> None:
        pass


class ScribblingController(Controller[int]):
    """Writes to all that it sees."""

    def start(self, seen: Measurement) -> int:
        write_to_all(seen)
        return 0

    def act(self, state: int, seen: Measurement) -> tuple[int, Command]:
        write_to_all(seen)
        return state + 1, Command()


class QuietController(ScribblingController):
    def start(self, seen: Measurement) -> int:
        return 0

    def act(self, state: int, seen: Measurement) -> tuple[int, Command]:
        return state + 1, Command()


def test_observers_and_controllers_cannot_change_a_run(tmp_path: Path) -> None:
    phase = '[[phase]]\nname = "inflate"\nduration_s = 0.04\npressure_Pa = 20e3\ncontrol = ["mine"]\n'
    parts = (device_parts.PYTHON.replace("0.1", "0.004"), phase)
    scenario = device_parts.scenario(tmp_path, *parts)
    quiet = cosim.run(scenario, controllers={"mine": QuietController()})
    loud = cosim.run(scenario, controllers={"mine": ScribblingController()}, observers=[Scribbler()])
    arm: Any = {"phase": [{"name": "hang", "duration_s": 0.05}], "fidelity": "rigid"}
    alone, seen = (cosim.run("ur5e_hexagon_arm", overrides=arm, observers=by) for by in ((), [Scribbler()]))
    for expected, found in ((quiet, loud), (alone, seen)):
        for name in ("tip_position", "joint_position", "joint_target", "cable_tension_N", "node_position"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes(), name


def test_a_users_body_is_copied(tmp_path: Path) -> None:
    (tmp_path / "tube.toml").write_text(SCENARIO, encoding="utf-8")
    body, changes, file = tube(), {"solver.damping_per_s": 10.0}, tmp_path / "state.npz"
    here = Simulation(tmp_path / "tube.toml", body=body)
    here.reset(changes=changes)
    expected = ahead(here, file)
    write_to_all(body)
    here.reset(changes=changes)
    assert ahead(here, file) == expected


def test_runs_of_a_batch_and_environments_go_on_as_they_would(tmp_path: Path) -> None:
    scenario = device_parts.scenario(tmp_path)
    with Batch(scenario, 1, overrides={"start.pressure_Pa": 20e3}) as batch:
        batch.step(ticks=1)
        (saved,) = batch.save()
        assert saved is not None
        (expected,) = batch.step(ticks=2)
        batch.reset(start=saved)
        write_to_all((batch, batch.measure(), saved))
        (found,) = batch.step(ticks=2)
    assert expected is not None
    assert found is not None
    assert found.tip_position.tobytes() == expected.tip_position.tobytes()
    environment: Any = gymnasium.make("cosim/TipReach-v0", fidelity="rigid").unwrapped
    action, seen = np.full(6, 0.5, np.float32), []
    for write in (repr, write_to_all):
        write((environment.reset(seed=1), environment.measured, environment.save(), environment))
        write(environment.step(action))
        seen.append(environment.step(action))
    assert repr(seen[0]) == repr(seen[1])
    assert seen[0][0]["observation"].tobytes() == seen[1][0]["observation"].tobytes()


@pytest.mark.parametrize("figure", ["membrane_stress", "hinge_energy_share", "stiffener_strain"])
def test_figures_of_a_stage_take_what_a_snapshot_shows(figure: str, tmp_path: Path) -> None:
    here = held(tmp_path)
    found = getattr(here.stage, figure)
    shown, copied = (found(x) for x in (here.snapshot.node_position, here.snapshot.node_position.copy()))
    np.testing.assert_array_equal(shown, copied)
