"""What is no command is refused by its key, and what fails keeps the arrays until then."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim import Command
from cosim.errors import ConvergenceError, InputError
from tests.app.test_live_commands import HELD, held, standing

ROW = r"must be 6 numbers in a row, shape \(6,\)"
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"pressure_Pa": 5.0}, r"step: pressure_Pa is 5\.0; give numbers by name"),
    ({"pressure_Pa": None}, "step: pressure_Pa is None; give numbers by name"),
    ({"pressure_Pa": {"chamber": "5"}}, "step: pressure_Pa of 'chamber' is '5'; must be a number"),
    ({"pressure_Pa": {"chamber": None}}, "step: pressure_Pa of 'chamber' is None; must be a number"),
    ({"pressure_Pa": {"chamber": True}}, "step: pressure_Pa of 'chamber' is True; must be a number"),
    ({"pressure_Pa": {"chamber": [5.0]}}, r"step: pressure_Pa of 'chamber' is \[5\.0\]; must be a number"),
    ({"pressure_Pa": {"chamber": 10**400}}, "step: pressure_Pa of 'chamber' is beyond the largest number"),
    ({"gas_kg": [1e-3]}, "step: gas_kg is .*; give numbers by name"),
    ({"pump_pressure_Pa": {3: 1.0}}, "step: pump_pressure_Pa of 3; there are: none"),
    ({"cable_tension_N": ("right", 1.0)}, "step: cable_tension_N is .*; give numbers by name"),
    ({"cable_tension_N": {"right": 1j}}, "step: cable_tension_N of 'right' is 1j; must be a number"),
    ({"cable_length_m": "0.1"}, "step: cable_length_m is '0.1'; give numbers by name"),
    ({"cable_length_m": {"right": 0.0}}, "step: cable_length_m of 'right' is 0; must be above 0"),
    ({"flange_twist": 0.1}, rf"step: flange_twist is 0\.1; {ROW}"),
    ({"flange_twist": "100000"}, rf"step: flange_twist is '100000'; {ROW}"),
    ({"flange_twist": [0.1, None, 0.0, 0.0, 0.0, 0.0]}, r"step: flange_twist\[1\] is None; must be a number"),
    ({"joint_position": np.zeros((6, 1))}, rf"step: joint_position is .*; {ROW}"),
    ({"joint_velocity": np.zeros(6)}, "joint_velocity, which is that at joint_position; give both"),
    ({"joint_position": {"a": 1.0}}, rf"step: joint_position is .*; {ROW}"),
    ({"flange": [0.4, 0.0, 0.5]}, r"step: flange is \[0\.4, 0\.0, 0\.5\]; give a cosim\.Pose"),
    ({"flange": cosim.Pose(np.zeros((3, 3)))}, r"step: flange\.rotation is no rotation"),
    ({"flange": cosim.Pose(-np.eye(3))}, "its rows must be a right-handed triad"),
]


@pytest.mark.parametrize(("given", "message"), WRONG)
def test_what_is_no_command_is_refused_by_its_key(given: dict[str, Any], message: str) -> None:
    here = ARMS.setdefault("one", standing())
    before = here.snapshot
    with pytest.raises(InputError, match=message) as caught:
        here.step(Command(**given), ticks=2)
    assert len(str(caught.value).splitlines()) == 1
    assert here.snapshot is before


ARMS: dict[str, cosim.Simulation] = {}
"""One for all refusals: none of them changes it."""


@pytest.mark.parametrize(
    ("command", "ticks", "message"),
    [
        ("x", 1, "step: command is 'x'; give a cosim.Command, or a number of ticks alone"),
        (True, 1, "step: command is True; give a cosim.Command"),
        (1.5, 1, r"step: command is 1\.5; give a cosim.Command"),
        ([Command()], 1, "step: command is .*; give a cosim.Command"),
        ({"pressure_Pa": {}}, 1, "step: command is .*; give a cosim.Command"),
        (Command, 1, "step: command is .*; give a cosim.Command"),
        (5, 3, "step: command is 5; give a cosim.Command, or a number of ticks alone"),
        (None, 1.5, r"step: ticks is 1\.5; must be a whole number"),
        (None, "2", "step: ticks is '2'; must be a whole number"),
        (None, True, "step: ticks is True; must be a whole number"),
        (None, None, "step: ticks is None; must be a whole number"),
        (Command(), np.zeros(2), "step: ticks is .*; must be a whole number"),
        (Command(), 0, "0 ticks were asked for"),
        (None, -1, "-1 ticks were asked for"),
    ],
)
def test_a_step_takes_a_command_and_whole_ticks(command: Any, ticks: Any, message: str) -> None:
    here = ARMS.setdefault("one", standing())
    before = here.snapshot
    with pytest.raises(InputError, match=message):
        here.step(command, ticks=ticks)
    assert here.snapshot is before
    here.step(np.int64(1))
    assert here.snapshot.tick == before.tick + 1


BURST = """
[[phase]]
name = "burst"
duration_s = 0.04
ramp = "step"
pressure_Pa = 1e12
"""


def test_a_step_that_fails_after_a_length_is_commanded_gives_the_arrays_until_then(tmp_path: Path) -> None:
    here = held(tmp_path, HELD, BURST)
    before = here.measure().cable_unstretched_m["corner_0"]
    for ticks in (15, 1):  # the second one from the tick before that which fails
        with pytest.raises(ConvergenceError, match="phase 'burst', tick 11") as caught:
            here.step(Command(cable_length_m={"corner_0": before - 1e-3}), ticks=ticks)
        assert here.snapshot.tick == 10
    result = caught.value.result
    assert result.tick.tolist() == [10]
    here.reset()
    here.step(1)
    with pytest.raises(ConvergenceError) as caught:
        here.step(Command(cable_length_m={"corner_0": before - 1e-3}), ticks=15)
    result = caught.value.result
    assert result.tick.tolist() == list(range(1, 11))
    # nobody looked at lengths before one was commanded
    assert np.isnan(result.cable_length_m[0]).all()
    assert np.isfinite(result.cable_length_m[1:]).all()
    np.testing.assert_allclose(result.cable_unstretched_m[-1, 0], before - 1e-3 * 9 / 15, atol=1e-9)
