"""A section model touches what the film would: a table pressed and rubbed, a puck pushed, both modes."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build import section_models
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from tests.small_section import ROBOT, section

START = f"""
schema = 2
title = "Three units on a UR5e"
robot = "ur5e"
soft_robot = {ROBOT}
model.published = true
solver = {{ damping_per_s = 5.0 }}
clock = {{ tick_s = 0.004 }}
contact = {{ stiffness_N_m3 = 1e8, smoothing_m = 3e-4, stick_m = 3e-4 }}

[start]
flange = {{ position_m = [0.45, 0.0, 0.3], direction = [0.0, 0.0, -1.0] }}
pressure_Pa = 25e3
"""
TABLE = """
[[object]]
name = "table"
shape = "box"
size_m = [0.4, 0.4, 0.1]
position_m = [0.45, 0.0, 0.186]

[[phase]]
name = "press"
duration_s = 0.2
settle_s = 0.2
increments = 8
flange_shift_m = [0.0, 0.0, -0.008]

[[phase]]
name = "rub"
duration_s = 0.2
increments = 8
flange_shift_m = [0.01, 0.0, 0.0]
"""
PUCK = """
[[object]]
name = "table"
shape = "box"
size_m = [0.6, 0.6, 0.1]
position_m = [0.45, 0.0, 0.15]
friction = 0.3                  # it slides, and does not topple

[[object]]
name = "puck"
shape = "box"
size_m = [0.04, 0.1, 0.06]
position_m = [0.525, 0.0, 0.2301]
mass_kg = 0.2
friction = 0.3

[[phase]]
name = "push"
duration_s = 0.4
flange_shift_m = [0.04, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("section_contact")


@pytest.fixture(autouse=True)
def kept(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)


@cache
def run(folder: Path, scene: str, fidelity: str, mode: str) -> cosim.RunResult:
    """Return the run of a scene."""
    return cosim.run(scene_file(folder, scene), overrides={"fidelity": fidelity, "mode": mode})


def scene_file(folder: Path, scene: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(START + scene, encoding="utf-8")
    return path


def of_phase(result: cosim.RunResult, name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(phase for phase in result.summary["phases"] if phase["name"] == name)
    return found


@pytest.mark.parametrize("mode", [pytest.param("dynamic", marks=pytest.mark.long), "quasistatic"])
def test_a_table_is_pressed_as_by_the_film(folder: Path, mode: str) -> None:
    found, film = (run(folder, TABLE, fidelity, mode) for fidelity in ("section", "lumped"))
    pressed = film.contact_force_N.max()
    assert pressed > 9.0
    # the film gives way between its rims, frames do not
    assert np.abs(found.contact_force_N - film.contact_force_N).max() < 0.05 * pressed
    assert np.abs(found.tip_position - film.tip_position).max() < 5e-4
    assert found.contact_depth_m.max() == pytest.approx(film.contact_depth_m.max(), rel=0.1)


@pytest.mark.long
def test_friction_pulls_as_on_the_film(folder: Path) -> None:
    pulls = [
        of_phase(run(folder, TABLE, fidelity, "dynamic"), "rub")["flange_wrench"]["force_N"][0]
        for fidelity in ("section", "lumped")
    ]
    assert pulls[1] < -4.0
    assert pulls[0] == pytest.approx(pulls[1], rel=0.1)


@pytest.mark.parametrize("scheme", ["staggered", pytest.param("iterated", marks=pytest.mark.long)])
def test_a_puck_is_pushed_as_by_the_film(folder: Path, scheme: str) -> None:
    ways = []
    for fidelity in ("section", "lumped"):
        changes = {"fidelity": fidelity, "coupling.scheme": scheme}
        simulation = build(load_scenario(scene_file(folder, PUCK), changes))
        steps = list(simulation.steps())
        assert max(step.momentum_error for step in steps) < 1e-10
        assert max(step.interface_residual for step in steps) <= 1e-9
        puck = simulation.stage.body_names.index("puck")
        ways.append(steps[-1].body_position[puck] - steps[0].body_position[puck])
    assert ways[1][0] > 0.01
    assert ways[0] == pytest.approx(ways[1], abs=0.1 * ways[1][0])
