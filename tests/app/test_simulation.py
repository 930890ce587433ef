"""`cosim.Simulation`: stepped by hand, saved, restored, branched."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Pose
from cosim.base.state_file import save
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import ConvergenceError, InputError, OutputError, ScenarioError

SHORT: dict[str, Any] = {
    "phase": [{"name": "inflate", "duration_s": 0.2, "increments": 8, "pressure_Pa": 5e3}]
}


def simulation(**options: Any) -> cosim.Simulation:
    """Return a simulation of 8 increments."""
    return cosim.Simulation("three_unit_inflation", overrides=SHORT, **options)


def test_it_starts_at_rest_and_ends_with_the_scenario() -> None:
    here = simulation()
    assert (here.snapshot.tick, here.ticks_left) == (0, 8)
    assert here.step(3).tick == 3
    assert here.step().tick == here.snapshot.tick == 4
    assert here.step(4).tick == 8
    assert here.ticks_left == 0
    assert here.step(0).tick == 8
    result = cosim.run("three_unit_inflation", overrides=SHORT)
    assert np.array_equal(here.snapshot.tip_position, result.tip_position[-1])


@pytest.mark.parametrize("ticks", [9, -1])
def test_more_than_the_scenario_holds_is_refused(ticks: int) -> None:
    here = simulation()
    with pytest.raises(InputError, match=f"{ticks} ticks were asked for; the scenario has 8 left"):
        here.step(ticks)
    assert here.snapshot.tick == 0


def test_it_returns_to_what_was_saved(tmp_path: Path) -> None:
    here = simulation()
    here.step(3)
    saved = here.save()
    end = here.step(5)
    here.restore(saved)
    assert here.snapshot is saved.snapshot
    assert np.array_equal(here.step(5).node_position, end.node_position)
    saved.write(tmp_path / "three.npz")
    with pytest.raises(OutputError, match=r"three.npz: cannot be written: No such file"):
        saved.write(tmp_path / "nowhere" / "three.npz")
    other = simulation(start=tmp_path / "three.npz")
    assert other.snapshot.tick == 3
    assert np.array_equal(other.step(5).node_position, end.node_position)


def test_a_branch_is_independent() -> None:
    here = simulation()
    here.step(3)
    softer = here.branch({"phase.inflate.pressure_Pa": 4e3})
    same = here.branch()
    assert softer.snapshot.tick == same.snapshot.tick == 3
    softer.step(5)
    assert softer.snapshot.pressure_Pa == 4e3
    end = here.step(5)
    assert end.pressure_Pa == 5e3
    assert np.array_equal(same.step(5).node_position, end.node_position)


def test_after_a_failure_it_is_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    here = simulation()
    here.step(3)
    other = here.branch()

    def fail(*_: Any) -> None:
        raise ConvergenceError("no", 1.0, 1)

    with monkeypatch.context() as patch:
        patch.setattr(FilmRobot, "solve", fail)
        patch.setattr(FilmRobot, "follow", fail)
        with pytest.raises(ConvergenceError) as caught:
            here.step(2)
    assert caught.value.result is not None
    assert caught.value.result.tick.tolist() == [3]
    assert here.snapshot.tick == 3
    assert np.array_equal(here.step(5).node_position, other.step(5).node_position)


def test_a_file_that_holds_no_simulation_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "pose.npz", Pose())
    with pytest.raises(InputError, match="holds a Pose, not the state of a simulation"):
        simulation(start=tmp_path / "pose.npz")
    with pytest.raises(InputError, match="no saved state"):
        simulation(start=tmp_path / "missing.npz")


def test_what_was_solved_before_a_failure_is_in_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    here, solved = simulation(), []
    here.step(2)
    given = FilmRobot.solve

    def fail(self: FilmRobot, *args: Any) -> Any:
        solved.append(None)
        if len(solved) == 4:
            raise ZeroDivisionError("whoever raised it")
        return given(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(FilmRobot, "solve", fail)
        with pytest.raises(ZeroDivisionError) as caught:
            here.step(6)
    result: Any = vars(caught.value)["result"]
    assert result.tick.tolist() == [2, 3, 4, 5]
    assert (result.status, result.summary["reason"]) == ("failed", "ZeroDivisionError: whoever raised it")
    assert np.array_equal(result.tip_position[-1], here.snapshot.tip_position)
    assert here.step(3).tick == 8


def test_a_pickled_simulation_continues_bit_identically() -> None:
    here = simulation()
    here.step(3)
    other = pickle.loads(pickle.dumps(here))
    assert other.snapshot.tick == 3
    assert np.array_equal(here.step(5).node_position, other.step(5).node_position)
    saved = pickle.loads(pickle.dumps(here.save()))
    assert np.array_equal(saved.snapshot.node_position, here.snapshot.node_position)


def test_results_and_errors_can_be_pickled() -> None:
    result = cosim.run("three_unit_inflation", overrides=SHORT)
    error = ConvergenceError("no", 2.0, 3)
    error.result = result
    error.add_note("where")
    found = pickle.loads(pickle.dumps(error))
    assert type(found) is ConvergenceError
    assert (str(found), found.residual_N, found.__notes__) == ("no", 2.0, ["where"])
    assert found.result.arrays.keys() == result.arrays.keys()
    for name, array in result.arrays.items():
        np.testing.assert_array_equal(found.result.arrays[name], array)
    assert found.result.summary == result.summary
    here, there = (one.stage.membrane_stress(result.node_position[-1]) for one in (result, found.result))
    np.testing.assert_array_equal(here, there)
    other = pickle.loads(pickle.dumps(ScenarioError("clock.tick_s", "is 0")))
    assert (str(other), other.path) == ("clock.tick_s: is 0", "clock.tick_s")


def test_what_python_shows_of_them_is_short() -> None:
    here = simulation()
    here.step(3)
    shown = [here, here.save(), here.snapshot, here.stage]
    for text in map(repr, shown):
        assert len(text) < 400
        assert text.count("\n") <= 1
    assert repr(here) == "Simulation of three_unit_inflation, quasistatic: tick 3 of 8, 0.075 s"
    assert repr(here.save()) == "SavedState after tick 3, at 0.075 s"
    assert repr(here.snapshot).startswith("Snapshot of tick 3, 0.075 s, phase 0: 0 joints")


def test_a_refused_state_of_another_simulation_leaves_no_trace() -> None:
    rigid: dict[str, Any] = {"model.published": True, "fidelity": "rigid", "phase": []}
    here = cosim.Simulation("ur5e_hexagon_arm", overrides=rigid)
    other = cosim.Simulation("ur5e_hexagon_arm", overrides={**rigid, "robot": "none"}).save()
    here.step(2)
    expected = here.branch().step(2).joint_torque
    with pytest.raises(InputError, match="here it has"):
        here.restore(other)
    assert here.step(2).joint_torque.tobytes() == expected.tobytes()
