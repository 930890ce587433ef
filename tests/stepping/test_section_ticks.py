"""Ticks of a section model: how many are taken together changes nothing, whatever ends them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import drive, execute
from cosim.app.preparation import build_simulation
from cosim.app.run_follower import Options
from cosim.app.simulation import Simulation
from cosim.build import section_models
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.errors import InputError, InstabilityError, OutOfRangeError
from cosim.stepping.arm_carrier import ArmCarrier
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.small_section import on_a_ur5e, section
from tests.stepping.snapshots import assert_close

SCENARIO = on_a_ur5e(
    20e3,
    """
[[phase]]
name = "turn"
duration_s = 0.06
settle_s = 0.02
pressure_Pa = 25e3
cable_tension_N = [2.0, 0.0]
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }

[[phase]]
name = "hold"
duration_s = 0.03
clamp = ["unit_1.outer"]
cable_tension_N = [0.0, 1.0]
""",
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scenario's file, while its section model is at hand."""
    file = tmp_path_factory.mktemp("ticks") / "three_units.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(file.parent / "cache"))
        patch.setattr(section_models, "build_model", lambda *_: section().model)
        yield file


def scenario(path: Path, **changes: Any) -> Scenario:
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    return load_scenario(path, overrides)


def together(run: SteppedRun, many: int = 64, most: int | None = None) -> list[Snapshot]:
    """Return ticks of which many were taken together."""
    return [snapshot for batch in run.batches(many, most=most) for snapshot in batch]


TABLE = {"name": "table", "shape": "box", "size_m": [0.4, 0.4, 0.05], "position_m": [0.4, 0.0, 0.4095]}
PLATE = {"name": "plate", "shape": "box", "size_m": [0.3, 0.3, 0.004], "position_m": [0.4, 0.0, 0.4366]}


def test_devices_act_tick_by_tick(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    devices = run._parts.commands._actuation
    devices._modelled = True  # as with a controller of tensions, which leaves the loads plain
    devices.report = lambda *_: None
    assert [len(run._some(64)) for _ in range(4)] == [1, 1, 1, 1]


@pytest.mark.parametrize(("ahead", "integrator"), [(1, "bdf2"), (7, "bdf2"), (7, "implicit_euler")])
def test_how_many_ticks_a_call_takes_changes_no_bit(path: Path, ahead: int, integrator: str) -> None:
    wanted = scenario(path, solver__integrator=integrator)
    few, many = together(build_simulation(wanted), ahead), together(build_simulation(wanted))
    assert_close(few, many, 0.0)


def test_nothing_is_saved_ahead_of_what_is_shown(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    batches = run.batches(8)
    assert [len(batch) for batch in islice(batches, 2)] == [1, 8]
    assert run.saves_now
    run._error = InstabilityError("of tick 9")
    with pytest.raises(InputError, match="a later tick than 8 has begun"):
        run.save_state()
    run._error = None
    saved = run.save_state()
    rest = [snapshot for batch in batches for snapshot in batch]
    run.restore_state(saved)
    assert_close(together(run, 3), rest, 0.0)


def test_a_run_stopped_within_a_phase_continues_bit_identically(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted, seen = scenario(path), []
    monkeypatch.setattr(SteppedRun.batches, "__defaults__", (4, None))

    def stop() -> str | None:
        seen.append(None)
        return "enough" if len(seen) == 4 else None

    whole = execute(wanted, build_simulation, Options(tmp_path / "whole"), 0.0)
    stopped = execute(wanted, build_simulation, Options(tmp_path / "part", stop=stop), 0.0)
    assert (stopped.summary["status"], stopped.summary["ticks"]) == ("interrupted", 12)
    resumed = execute(wanted, build_simulation, Options(tmp_path / "part", resume=True), 0.0)
    assert resumed.summary["resumed_at_ticks"] == [12]
    assert resumed.summary["phases"] == whole.summary["phases"]


def test_a_rigid_side_that_blows_up_is_named(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    shown: list[int] = []

    def observe(batch: TickBatch) -> None:
        shown.extend(batch.tick.tolist())
        if shown[-1] == 8:
            run._parts.carrier._scene._data.qvel[0] = np.nan

    ending = drive(run.batches(8), observe, lambda: None)
    assert isinstance(ending.error, InstabilityError)
    assert shown == list(range(9))


def test_ticks_before_a_rigid_side_that_blows_up_are_shown(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of a call; what is saved is the state before that tick."""
    servos = ArmCarrier.servos

    def wrong(self: ArmCarrier, *given: Any) -> Any:
        found = servos(self, *given)
        if len(found.torque) > 20:
            found.torque[20, 0] = np.nan
        return found

    wanted = scenario(path)
    with monkeypatch.context() as patch:
        patch.setattr(ArmCarrier, "servos", wrong)
        failed = execute(wanted, build_simulation, Options(tmp_path), 0.0)
    assert isinstance(failed.error, InstabilityError)
    assert failed.summary["ticks"] == 20
    resumed = execute(wanted, build_simulation, Options(tmp_path, resume=True), 0.0)
    assert resumed.summary["resumed_at_ticks"] == [20]
    assert resumed.summary["status"] == "completed"


def test_a_soft_step_without_solution_leaves_the_state_before_it(path: Path, tmp_path: Path) -> None:
    sudden = {
        "phase__hold__ramp": "step",
        "phase__hold__cable_tension_N": [0.0, 15.0],
    }  # at rest it bears them
    wanted = scenario(path, clock__tick_s=0.01, **sudden)
    failed = execute(wanted, build_simulation, Options(tmp_path), 0.0)
    assert isinstance(failed.error, OutOfRangeError)
    assert failed.summary["ticks"] >= 8  # all of the first phase
    assert re.match(
        r"OutOfRangeError: phase 'hold', tick \d+ \(0\.\d+ s\), 25 kPa, cable left at \S+ N: even in steps "
        r"of 0\.312 ms: the section model ends here: section \d of \d \(.*\) is \w+ by .*, its model ends ",
        failed.summary["reason"],
    ), failed.summary["reason"]
    again = execute(wanted, build_simulation, Options(tmp_path, resume=True), 0.0)
    assert again.summary["resumed_at_ticks"] == [failed.summary["ticks"]]
    assert again.summary["ticks"] == failed.summary["ticks"]
    assert again.summary["reason"] == failed.summary["reason"]


def test_as_many_states_are_yielded_as_asked_for(path: Path) -> None:
    run = build_simulation(scenario(path))
    first = together(run, most=5)
    assert [snapshot.tick for snapshot in first] == list(range(5))
    assert run.saves_now  # none was taken beyond
    assert [snapshot.tick for snapshot in together(run, 3, 4)] == [5, 6, 7, 8]
    assert run.saves_now
    assert len(together(run)) == run.stage.ticks - 8


def test_stepping_by_hand_is_running(path: Path) -> None:
    wanted = scenario(path)
    whole, simulation = together(build_simulation(wanted)), Simulation(wanted)
    for ticks in (1, 20, 1, 30):
        simulation.step(ticks)
        assert_close([simulation.snapshot], [whole[simulation.snapshot.tick]], 0.0)


def test_an_interrupted_step_leaves_what_was_before(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(scenario(path))
    expected = Simulation(scenario(path)).step(30)
    simulation.step(4)
    taken = StaggeredCoupling.advance

    def interrupted(self: StaggeredCoupling, *given: Any) -> Any:
        taken(self, *given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(StaggeredCoupling, "advance", interrupted)
        with pytest.raises(KeyboardInterrupt):
            simulation.step(26)
    assert simulation.snapshot.tick == 4
    assert_close([simulation.step(26)], [expected], 0.0)
