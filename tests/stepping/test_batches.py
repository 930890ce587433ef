"""Steps that are shown together are those that are shown one by one, whatever ends them."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.app.simulation import Simulation
from cosim.config.loading import load_scenario
from cosim.errors import ConvergenceError, InputError
from cosim.stepping import stepped_run
from tests.stepping.snapshots import assert_close

PHASE = {"name": "inflate", "duration_s": 0.18, "increments": 5, "pressure_Pa": 3e3}
WAIT = PHASE | {"name": "wait", "duration_s": 0.02}
CHANGES: dict[str, Any] = {
    "model.published": True,
    "fidelity": "rigid",
    "clock.tick_s": 0.002,
    "phase": [PHASE, WAIT],
}


def simulation(**changes: Any) -> Any:
    return build_simulation(load_scenario("ur5e_hexagon_arm", CHANGES | changes))


def fail_at(run: Any, tick: int, error: BaseException) -> None:
    """Let a run fail in a tick."""
    soft, carrier = run._parts.soft, run._parts.carrier
    advance = soft.advance

    def advance_or_error(*given: Any) -> Any:
        if carrier._coupling.interface.state.ticks + 1 == tick:
            raise error
        return advance(*given)

    soft.advance = advance_or_error


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_batches_are_the_steps_of_one_phase_each(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepped_run, "_SHOWN_S", 1e9)
    monkeypatch.setattr(stepped_run, "_SHOWN", 64)
    batches = list(simulation(mode=mode).batches())
    assert [len(batch) for batch in batches] == ([1, 64, 26, 10] if mode == "dynamic" else [1, 5, 5])
    assert all(len(set(batch.phase.tolist())) == 1 for batch in batches)
    assert_close([s for batch in batches for s in batch], list(simulation(mode=mode).steps()), 0.0)


def test_slow_steps_are_shown_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepped_run, "_SHOWN_S", 0.0)
    assert [len(batch) for batch in simulation().batches(most=7)] == [1] * 7


@pytest.mark.parametrize("error", [ConvergenceError("no", 1.0, 1), ValueError("no"), KeyboardInterrupt()])
def test_what_was_solved_before_a_failure_is_shown(error: BaseException) -> None:
    run = simulation()
    fail_at(run, 5, error)
    batches = run.batches()
    assert [batch.tick.tolist() for batch in islice(batches, 2)] == [[0], [1, 2, 3, 4]]
    assert not run.saves_now  # the next tick has been begun
    with pytest.raises(InputError, match="a later tick than 4 has begun"):
        run.save_state()
    with pytest.raises(type(error)):
        next(batches)


def test_a_step_after_another_is_where_steps_lead() -> None:
    run, other = simulation(), simulation()
    last = [run.advance(count) for count in (1, 3, 60, 1)]
    assert [snapshot.tick for snapshot in last] == [0, 3, 63, 64]
    steps = list(islice(other.steps(), 65))
    assert_close(last, [steps[tick] for tick in (0, 3, 63, 64)], 0.0)


def test_a_failed_step_by_hand_keeps_what_was_solved() -> None:
    by_hand = Simulation(load_scenario("ur5e_hexagon_arm", CHANGES))
    by_hand.step(2)
    fail_at(by_hand._run, 9, ConvergenceError("no", 1.0, 1))
    with pytest.raises(ConvergenceError) as caught:
        by_hand.step(20)
    assert by_hand.snapshot.tick == 8
    result = caught.value.result  # type: ignore[attr-defined]
    np.testing.assert_array_equal(result.tick, np.arange(2, 9))
    whole = list(islice(simulation().steps(), 9))
    np.testing.assert_array_equal(result.tip_position, [snapshot.tip_position for snapshot in whole[2:]])
    assert_close([by_hand.snapshot], [whole[8]], 0.0)
