"""Soft robots that carry others on their tips: files, names, refusals, and a first run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.build.options import fidelity_body
from cosim.build.simulation import build
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario, load_soft_robot, scenario_text
from cosim.config.schema.settings import ModelTable
from cosim.errors import ScenarioError
from cosim.plan.film_reach import film_reach

ARM = "arm_with_gripper"
FINGERS = ("gripper/copy_1", "gripper/copy_2", "gripper/copy_3")


def scenario_with(**changes: Any) -> Any:
    return load_scenario(
        "hexagon_arm_bending", {"model.published": True, "soft_robot": ARM, "phase": [SHORT], **changes}
    )


SHORT: dict[str, Any] = {"name": "inflate", "duration_s": 0.02, "pressure_Pa": {"arm": 2e3, "gripper": 1e3}}


def test_names_in_the_schema_are_those_of_the_body() -> None:
    robot = load_soft_robot(ARM)
    body = build_soft_body(robot, ModelTable(published=True))
    assert robot.chamber_names() == ("arm", *FINGERS)
    assert tuple(part.name for part in body.chambers) == robot.chamber_names()
    assert set(body.rings) == set(robot.ring_names())
    names = robot.cable_names()
    assert len(names) == len(body.cables) == 8
    assert names[:3] == ("right", "left", "gripper/corner_0")
    assert names[-1] == "gripper/copy_3/corner_1"
    assert robot.sides_of("gripper/copy_2/tip") == 4
    assert robot.sides_of("unit_3.outer") == 6


def test_cables_of_fingers_run_along_the_side_that_faces_the_axis() -> None:
    body = build_soft_body(load_soft_robot(ARM), ModelTable(published=True))
    for k, cable in enumerate(body.cables[2:]):
        finger = body.rings[f"gripper/copy_{1 + k // 2}/unit_1.outer"]
        radius = np.linalg.norm(body.positions[:, :2], axis=1)
        assert radius[cable.nodes[0]] < radius[finger].mean()


def test_the_plate_holds_the_fingers_while_chambers_fill() -> None:
    simulation = build(scenario_with(mode="dynamic"))
    *_, last = simulation.steps()
    np.testing.assert_allclose(last.chamber_pressure_Pa, [2e3, 1e3, 1e3, 1e3], rtol=1e-12)
    body = simulation._parts.soft.body
    nodes = body.plates[0].rings[0]
    spans = [
        np.linalg.norm(x[nodes][:, None] - x[nodes][None], axis=2)
        for x in (body.positions, last.node_position)
    ]
    assert np.abs(spans[1] - spans[0]).max() < 1e-4


def test_the_resolved_scenario_loads_again_to_the_same(tmp_path: Path) -> None:
    scenario = scenario_with()
    path = tmp_path / "again.toml"
    path.write_text(scenario_text(scenario), encoding="utf-8")
    assert load_scenario(path) == scenario


def test_a_refined_model_refines_what_is_carried_too() -> None:
    counts = []
    for fidelity in ("lumped", "refined"):
        counts.append(len(fidelity_body(scenario_with(fidelity=fidelity)).triangles))
    assert counts[1] == 4 * counts[0]


def test_tensions_by_name_group_and_pattern() -> None:
    def at(name: str, **keys: Any) -> dict[str, Any]:
        return {"name": name, "duration_s": 0.1, **keys}

    phases = [
        at("close", cable_tension_N={"gripper": 1.0, "right": 2.0}),
        at("hold"),
        at("open", cable_tension_N={"gripper/copy_*/corner_1": 0.0, "left": 3.0}),
    ]
    scenario = scenario_with(phase=phases, **{"start.cable_tension_N": {"left": 0.5}})
    assert scenario.start.cable_tension_N == (0.0, 0.5) + (0.0,) * 6
    close, hold, opened = (phase.cable_tension_N for phase in scenario.phases)
    assert close == (2.0, 0.5) + (1.0,) * 6
    assert hold is None
    assert opened == (2.0, 3.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0)


def test_wrong_tables_of_tensions_are_refused() -> None:
    def refusal(*phases: dict[str, Any]) -> str:
        with pytest.raises(ScenarioError) as caught:
            scenario_with(
                phase=[{"name": f"p{k}", "duration_s": 0.1, **keys} for k, keys in enumerate(phases)]
            )
        return str(caught.value)

    assert refusal({"cable_tension_N": {"rigt": 1.0}}).startswith(
        "phase.p0.cable_tension_N.rigt: no cable 'rigt'"
    )
    assert refusal({"cable_tension_N": {"right": -1.0}}).startswith("phase.p0.cable_tension_N.right: -1")
    reach = {"tip_target": {"height_m": 0.1, "reach_with": "cables"}}
    assert "omits left" in refusal(reach, {"cable_tension_N": {"right": 1.0, "gripper": 1.0}})


def test_the_reach_goes_on_beyond_the_plate() -> None:
    bodies = (
        build_soft_body(load_soft_robot(name), ModelTable(published=True)) for name in ("hexagon_arm", ARM)
    )
    arm, whole = (film_reach(body, 0.0) for body in bodies)
    assert arm < whole < np.inf


REFUSED: dict[str, tuple[str, Any, str, str]] = {
    "film": ("robot.film.thickness_m", 1e-3, "robot.film", "must not"),
    "barrier": ("robot.hinge.fold_barrier_rad", 0.1, "robot.hinge.fold_barrier_rad", "0.1"),
    "corner": ("robot.cable.corner_0.corner", 4, "robot.cable.corner_0.corner", "0 to 3"),
    "key": ("plate.mass_g", 30.0, "plate.mass_g", "mass_kg"),
    "height": ("height_m", -0.1, "height_m", "at least 0"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_attachments_are_refused_by_the_key(case: str) -> None:
    key, value, path, word = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        scenario_with(**{f"soft_robot.attach.gripper.{key}": value})
    assert caught.value.path == f"soft_robot.attach.gripper.{path}"
    assert word in str(caught.value)


def test_a_carrier_has_one_tip() -> None:
    with pytest.raises(ScenarioError, match="single tip"):
        scenario_with(**{"soft_robot.copies": {"count": 2, "radius_m": 0.1}})


def test_an_attachment_s_file_must_exist(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('file = "hexagon_arm"\nattach = [{name = "a", robot = "gripper_fingr"}]\n', "utf-8")
    with pytest.raises(ScenarioError, match=r"soft_robot\.attach\.a\.robot.*gripper_finger"):
        load_soft_robot(path)
