"""`cosim.run` on a made-up simulation."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app import api, preparation
from cosim.errors import ConvergenceError, InstabilityError

REFERENCE = "ur5e_hexagon_arm"
TICKS = 25


def test_run_returns_one_row_per_snapshot(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())
    monkeypatch.chdir(tmp_path)
    result = cosim.run(REFERENCE, overrides={"clock.tick_s": 0.01, "recording.frames_per_s": 50})
    assert result.status == "completed"
    assert result.directory is None
    assert list(tmp_path.iterdir()) == []
    assert result.tick.tolist() == list(range(TICKS + 1))
    assert result.time_s == pytest.approx(0.01 * np.arange(TICKS + 1))
    assert result.joint_position.shape == (TICKS + 1, 6)
    assert result.cable_tension_N.shape == (TICKS + 1, 1)
    assert result.flange_force[:, 2] == pytest.approx(-8.52)
    # 50 frames per second at ticks of 10 ms: every second tick
    assert result.frame_time_s == pytest.approx(0.02 * np.arange(13))
    assert result.node_position.shape == (13, 3, 3)
    assert (
        result.joint_torque.shape == result.joint_velocity.shape == (TICKS + 1, len(result.stage.joint_names))
    )
    assert result.body_contact_force.shape == result.body_position.shape == (TICKS + 1, 2, 3)
    assert repr(result).splitlines() == [
        "RunResult of ur5e_hexagon_arm, dynamic, completed: 25 of 25 ticks, 0.25 of 0.25 s",
        "26 rows of 42 arrays, 13 frames of the film, 5 phases, 6 joints, 2 bodies, 1 chambers, 1 cables",
    ]
    assert result.node_position[:, 0, 0].tolist() == list(range(0, TICKS + 1, 2))


def test_run_writes_files_on_request(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())
    result = cosim.run(REFERENCE, out=tmp_path / "a")
    assert result.directory == tmp_path / "a"
    written = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    assert written == result.summary
    assert not (tmp_path / "a" / "recording.rrd").exists()


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (ConvergenceError("stalled", 1.0, 3), ConvergenceError),
        (KeyboardInterrupt(), cosim.RunInterrupted),
        (ZeroDivisionError("of a controller"), ZeroDivisionError),
    ],
    ids=str,
)
def test_run_raises_what_ended_it_and_keeps_files_and_arrays(
    error: BaseException,
    raised: type[BaseException],
    made_up_build: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    def at_tick(tick: int) -> None:
        if tick == 4:
            raise error

    monkeypatch.setattr(preparation, "build_simulation", made_up_build(at_tick))
    with pytest.raises(raised) as caught:
        cosim.run(REFERENCE, out=tmp_path / "a")
    assert isinstance(caught.value, type(error))
    result: Any = vars(caught.value)["result"]
    assert result.tick.tolist() == list(range(4))
    assert result.flange_force.shape == (4, 3)
    assert result.directory == tmp_path / "a"
    written = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    assert written["status"] == ("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
    assert written["ticks"] == 3
    assert written == result.summary


@pytest.mark.parametrize("error", [InstabilityError("not finite"), ZeroDivisionError("of the bars")], ids=str)
def test_files_are_completed_though_error_bars_fail(
    error: Exception, made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def find(_scenario: object, _ends: object) -> None:
        raise error

    monkeypatch.setattr(preparation, "build_simulation", made_up_build(lambda _tick: None))
    monkeypatch.setattr(api, "bars_finder", lambda *_: find)
    unexpected = not isinstance(error, InstabilityError)
    with pytest.raises(ZeroDivisionError) if unexpected else nullcontext():
        cosim.run(REFERENCE, out=tmp_path / "a", error=True)
    written = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    assert written["status"] == "completed"
    reason = "they could not be computed"
    assert written["error"]["reason"] == (reason if unexpected else f"{reason}: not finite")


def test_a_run_that_fails_at_its_start_has_no_rows(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_tick(_tick: int) -> None:
        raise ConvergenceError("stalled", 1.0, 3)

    monkeypatch.setattr(preparation, "build_simulation", made_up_build(at_tick))
    with pytest.raises(ConvergenceError) as caught:
        cosim.run(REFERENCE)
    result = caught.value.result
    assert result is not None
    assert (result.status, len(result.tick), result.summary["ticks"]) == ("failed", 0, 0)
    assert repr(result).startswith("RunResult of ur5e_hexagon_arm, dynamic, failed: 0 of 25 ticks, 0 of ")
