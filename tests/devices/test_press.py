"""A controller of the flange presses with a set force: a soft body from arrays, on an arm, on a table."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import cosim
from tests.devices import press
from tests.devices.press import Press
from tests.pages import page
from tests.soft.own_tube import tube

TEXT = page("extending")
(SCENARIO,) = re.findall(r"```toml\n(schema = 2\ntitle = \"a soft robot is pressed.*?)```", TEXT, re.DOTALL)
TUBE = {"start.pressure_Pa": 5e3, "start.flange.position_m": [0.5, 0.0, 0.607], "phase.press.duration_s": 1.2}


@pytest.mark.parametrize("force_N", [1.0, 2.0])
def test_a_given_body_on_an_arm_presses_with_the_set_force(tmp_path: Path, force_N: float) -> None:
    file, given = tmp_path / "press.toml", tube()
    file.write_text(SCENARIO.replace('soft_robot = "square_core"\n', ""), encoding="utf-8")
    result = cosim.run(file, overrides=TUBE, controllers={"press": Press("table", force_N)}, body=given)
    felt = -result.body_contact_force[:, result.body("table"), 2]
    assert felt[0] == 0.0
    assert felt[-1] == pytest.approx(force_N, rel=0.01)
    assert felt.max() < 1.2 * force_N  # it comes down slowly enough not to hit
    # what the table does not carry hangs on the flange
    weight = 9.81 * given.body.mass_kg
    assert result.flange_force[-1, 2] == pytest.approx(force_N - weight, abs=0.02 * force_N)
    assert np.abs(np.diff(result.flange_position[-25:, 2])).max() < 2e-5  # it rests


def test_the_page_on_extending_shows_the_file() -> None:
    file = Path(press.__file__ or "").read_text(encoding="utf-8")
    assert f"```python\n{file}```" in TEXT
