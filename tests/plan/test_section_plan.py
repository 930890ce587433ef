"""A plan that takes a section arm out of its model's range is refused before it runs, by key."""

from __future__ import annotations

import re
from io import StringIO
from typing import Any

import pytest

from cosim.app.preparation import build_simulation
from cosim.cli.running import PlanWarnings
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError
from cosim.plan.decision import SECTION_RANGE, Decision
from cosim.telemetry.run_info import RunInfo

RUSH = {"name": "rush", "duration_s": 0.1, "flange_shift_m": [0.0, 0.25, 0.0]}
PULL = {"name": "pull", "duration_s": 2.0, "cable_tension_N": [60.0, 0.0]}
TABLE = {"name": "table", "shape": "box", "size_m": [0.3, 0.3, 0.02], "position_m": [0.4, 0.0, 0.37]}
PLACE = r"section \d of 4 \(.*\) is .*, its model ends at "
INSTEAD = "fidelity = 'lumped', which has no such range"


def built(scenario: Scenario) -> tuple[RunInfo, Decision]:
    stage = build_simulation(scenario).stage
    (found,) = (decision for decision in stage.modelled if decision.what == SECTION_RANGE)
    return stage, found


@pytest.mark.parametrize(
    ("phase", "key", "text"),
    [
        (RUSH, "duration_s", rf"up to 1\d\d m/s\^2; the arm swings out of .*: {PLACE}.*; take longer; or "),
        (PULL, "cable_tension_N", f"takes the arm out of its section model's range: {PLACE}"),
    ],
)
def test_a_plan_beyond_the_range_is_refused(load: Any, phase: dict[str, Any], key: str, text: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        built(load(phase))
    assert refused.value.path == f"phase.{phase['name']}.{key}"
    assert re.search(text, str(refused.value))
    assert str(refused.value).endswith(INSTEAD)


@pytest.mark.parametrize("phase", [{**RUSH, "duration_s": 2.0}, {**PULL, "cable_tension_N": [1.0, 0.0]}])
def test_a_plan_within_the_range_is_built(load: Any, phase: dict[str, Any]) -> None:
    _, found = built(load(phase))
    assert found.included
    assert found.reason == "the arm bears the plan's loads and accelerations"


def test_what_may_be_held_by_what_it_touches_is_warned_of(load: Any) -> None:
    stage, found = built(load(PULL, object=[TABLE]))
    assert not found.included
    assert found.switch == "phase.pull.cable_tension_N"
    assert found.reason.endswith("; this check leaves contact out")
    said = StringIO()
    PlanWarnings(said).open(stage)
    assert f"warning: {found.line}\n" in said.getvalue()
