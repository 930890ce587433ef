"""A view of a user's own follows a run to its end, however that comes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app import preparation
from tests.pages import page
from tests.recording import tip_speed
from tests.recording.tip_speed import TipSpeed

CHANGES = {"model.published": True, "clock.tick_s": 0.01}


@pytest.mark.parametrize("failing", [False, True])
def test_a_view_records_what_the_run_returns(
    failing: bool,
    made_up_build: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    read: Callable[[Path], Any],
) -> None:
    def at_tick(tick: int) -> None:
        if failing and tick == 9:
            raise ZeroDivisionError("of a controller")

    monkeypatch.setattr(preparation, "build_simulation", made_up_build(at_tick))
    view = TipSpeed(str(tmp_path / "tip.rrd"))
    try:
        result = cosim.run("ur5e_hexagon_arm", overrides=CHANGES, observers=[view])
    except ZeroDivisionError as error:
        result = vars(error)["result"]
    assert (len(result.time_s) < 10) == failing
    recorded = read(tmp_path / "tip.rrd").by_time("/tip/speed_m_s", "Scalars:scalars")
    assert list(recorded) == [round(1e9 * time) for time in result.time_s[1:]]
    way = np.linalg.norm(np.diff(result.tip_position, axis=0), axis=1)
    np.testing.assert_allclose(
        np.ravel(list(recorded.values())), way / np.diff(result.time_s), rtol=1e-9, atol=1e-12
    )


def test_the_page_on_extending_shows_the_file() -> None:
    file = Path(tip_speed.__file__ or "").read_text(encoding="utf-8")
    assert f"```python\n{file}```" in page("extending")
