"""Section models of scenarios: built once, kept, their error reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build import section_models
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.errors import ConvergenceError, ScenarioError
from cosim.reduced.section_model import SectionModel
from cosim.soft.body.body import SoftBody
from cosim.soft.body.places import parents
from tests.small_section import body, on_a_ur5e, section

SCENARIO = on_a_ur5e(
    25e3,
    """
[[phase]]
name = "hang"
duration_s = 0.02
""",
)


def test_the_error_of_a_model_is_told_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    run = cosim.run(path)
    figures = run.summary["section_model"]
    assert 1e-5 < figures["tip_error_m"] < 2e-3
    assert 0.02 < figures["tip_error_m"] / figures["tip_error"] < 0.08  # the arm's length
    assert figures["frames"] == 5  # flange, three rims, tip
    assert figures["samples"] > 100
    assert f"{1e3 * figures['tip_error_m']:.1f} mm" in run.stage.report
    tips, held_out = figures["tip_by_pressure"], figures["held_out"]
    assert max(row["largest_m"] for row in tips) == figures["tip_error_m"]
    assert [row["pressure_Pa"] for row in held_out] == pytest.approx(section().model.spline.pressures(12))
    # with little gas the paper's bare film hardly resists bending, and a fit knows it only roughly
    middle, most = (max(row["bending"][k] for row in held_out if row["pressure_Pa"] > 5e3) for k in (0, 1))
    assert 0.001 < middle < 0.2
    assert middle < most
    assert f"({1e2 * max(row['bending'][1] for row in held_out):.0f} % at" in run.stage.report
    monkeypatch.setattr(
        section_models, "build_model", lambda *_: pytest.fail("the model has been built before")
    )
    assert cosim.run(path).summary["section_model"] == figures
    assert cosim.run(path, overrides={"fidelity": "rigid"}).summary["section_model"] is None


def test_recordings_draw_a_refined_film_on_the_mesh_before_refining(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    coarse, path = body(), tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")

    def build(
        fine: SoftBody, _largest_Pa: float, _films: object, middle: SoftBody | None, *_: object
    ) -> SectionModel:
        nodes = section().model.nodes
        if middle is not None:
            nodes = nodes[:, parents(coarse, middle)].mean(axis=2)[:, parents(middle, fine)].mean(axis=2)
        return replace(section().model, nodes=nodes)

    monkeypatch.setattr(section_models, "build_model", build)
    assert cosim.Simulation(path).stage.drawn is None
    stage = cosim.Simulation(path, overrides={"soft_robot.stack.refine": 2}).stage
    drawn, x = stage.drawn, coarse.positions * (1.0, 1.0, 1.2)
    assert drawn is not None
    np.testing.assert_array_equal(drawn.triangles, coarse.triangles)
    np.testing.assert_array_equal(drawn.stress(x), coarse.principal_stress(x)[:, 0])
    fine = build_soft_body(file_of(load_scenario(path), "its mesh"), load_scenario(path).model, finer=2)
    np.testing.assert_array_equal(stage.soft_triangles, fine.triangles)
    np.testing.assert_allclose(fine.positions[drawn.nodes], coarse.positions, atol=1e-12)
    for mine, cable in zip(drawn.cables, stage.cables, strict=True):
        np.testing.assert_array_equal(drawn.nodes[mine], cable)


def test_a_model_is_kept_for_its_range_of_pressure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    built: list[float] = []

    def build(_body: SoftBody, largest_Pa: float, *_: object) -> SectionModel:
        built.append(largest_Pa)
        spline = section().model.spline._replace(largest_Pa=largest_Pa)
        return replace(section().model, spline=spline)

    monkeypatch.setattr(section_models, "build_model", build)
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    ordinary, high = load_scenario(path), load_scenario(path, {"phase.hang.pressure_Pa": 90e3})
    models = [section_models.section_model(scenario) for scenario in (ordinary, high, ordinary, high)]
    ranges = [model.spline.largest_Pa for model in models]
    assert built == ranges[:2] == ranges[2:]
    # a model for less pressure does not work for more; a range that nobody needs costs accuracy
    assert ranges[0] < 90e3 < ranges[1] < 1.2 * 90e3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"soft_robot": "three_finger_gripper", "phase.hang.pressure_Pa": [1e3, 2e3, 3e3]},
            "phase.hang.pressure_Pa: is not alike for all copies",
        ),
        (
            {"soft_robot": "three_finger_gripper", "phase.hang.gas": {"copy_2": "sealed"}},
            "phase.hang.gas: is sealed; section models of copies need pressures",
        ),
        ({"soft_robot": "arm_with_gripper"}, "soft_robot.attach: has no section model"),
        (
            {"phase.hang.release": ["unit_1.hole"]},
            "phase.hang.release: names 'unit_1.hole'; .* and the tip only; use fidelity = 'lumped'",
        ),
        (
            {"soft_robot.base": ["unit_1.outer"]},
            r"soft_robot.base: is \['unit_1.outer'\]; .* alone; use fidelity = 'lumped'",
        ),
    ],
)
def test_what_a_section_model_leaves_out_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    with pytest.raises(ScenarioError, match=message):
        load_scenario(path, changes)


def test_a_model_that_loses_its_equilibria_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    lost = replace(section().model, tips=section().model.tips * (1.0, float("inf"), 1.0))
    monkeypatch.setattr(section_models, "build_model", lambda *_: lost)
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"'hexagon_arm' is not valid: .* use fidelity = 'lumped'"):
        section_models.section_model(load_scenario(path))


def test_a_model_far_off_its_film_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    off = 0.06 / section().model.tip_error
    far = replace(section().model, tips=section().model.tips * (1.0, off, 1.0))
    monkeypatch.setattr(section_models, "build_model", lambda *_: far)
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"by up to 6% of the length, more than 5%, .*; use fidelity"):
        section_models.section_model(load_scenario(path))


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_cables_are_wound_as_on_the_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)
    path = tmp_path / "three_units.toml"
    wind = "duration_s = 0.1\nincrements = 4\ncable_shortening_m = { right = 0.004 }"
    path.write_text(SCENARIO.replace("duration_s = 0.02", wind), encoding="utf-8")
    found, film = (
        cosim.run(path, overrides={"fidelity": fidelity, "mode": mode}) for fidelity in ("section", "lumped")
    )
    assert film.cable_tension_N[-1, 0] > 0.5
    assert found.cable_tension_N[-1] == pytest.approx(film.cable_tension_N[-1], rel=0.05)
    ways = [run.tip_position[-1] - run.tip_position[0] for run in (found, film)]
    assert ways[0] == pytest.approx(ways[1], abs=0.05 * float(abs(ways[1]).max()))


def test_film_without_smooth_states_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> SectionModel:
        raise ConvergenceError("the stiffener has buckled", 1.0, 25)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lost)
    path = tmp_path / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"no section model of .*the stiffener has buckled") as refused:
        section_models.section_model(load_scenario(path))
    assert refused.value.path == "fidelity"
