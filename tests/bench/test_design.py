"""Designs of a robot: slopes against differences, answers that are known, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.bench.design import DesignTask, design, design_lines, solve_choice
from cosim.bench.design_problem import DesignProblem
from cosim.bench.page import write_designs
from cosim.config.benches import DesignStudyTable, load_design_study
from cosim.config.loading import load_soft_robot
from cosim.errors import InputError, ScenarioError
from tests.derivatives import differences, relative_error

STUDY = """
scenario = "bending_angle"
evaluations = 20
[set]
model.published = false
contact.self_contact = false
soft_robot.stiffener.rest_on_one_another = false
soft_robot.stack.mesh = "drawn"
soft_robot.film.law = "edge_strain"
[[parameter]]
key = "soft_robot.stiffener.width_m"
low = 2e-3
high = 6e-3
[[parameter]]
key = "pull"
low = 0.05
high = 3.0
start = 1.0
[[case]]
name = "straight"
loads.pressure_Pa = 8e3
[[case]]
name = "bent"
loads = { pressure_Pa = 8e3, "cable_tension_N.corner_0" = "pull", "cable_tension_N.corner_1" = "pull" }
[goal]
quantity = "cable_tension_N.corner_0"
case = "bent"
"""
LENGTH = """
[[limit]]
quantity = "length_m"
case = "bent"
minus = "straight"
at_most = {bound}
"""
WIDTH = """
[[limit]]
quantity = "mass_kg"
equal = {bound}
"""
LIGHT = """
soft_robot.film.density_kg_m3 = 1400.0
soft_robot.mass.node_mass_kg = 0.0
soft_robot.stiffener.density_kg_m3 = 1270.0
"""


POUCH = """
schema = 2
name = "pouch"
source = "own drawing"
base = ["base"]
known.assumed = ["body", "film", "group", "hinge", "stiffener"]
film.law = "edge_strain"
film.young_modulus_Pa = 0.5e9
film.poisson_ratio = 0.3
film.thickness_m = 0.06e-3
film.density_kg_m3 = 950.0
hinge.rule = "shell"
[body]
kind = "pattern"
outline_m = [[-0.015, 0.0], [0.015, 0.0], [0.012, 0.08], [-0.012, 0.08]]
edge = "sealed"
port_m = [0.0, 0.02]
mesh_m = 0.0063
[[body.set]]
name = "base"
box_m = [[-1.0, -0.001], [1.0, 0.005]]
[[body.set]]
name = "tip"
box_m = [[-1.0, 0.079], [1.0, 0.081]]
[[group]]
name = "back"
film.law = "edge_strain"
film.young_modulus_Pa = 3e9
film.poisson_ratio = 0.35
film.thickness_m = 0.4e-3
film.density_kg_m3 = 1390.0
"""
OUTLINE = """
scenario = "pouch_finger_bends"
starts = 3
[set]
soft_robot = "{robot}"
contact.self_contact = false
[[parameter]]
key = "soft_robot.body.outline_m.2.1"
also = ["-soft_robot.body.outline_m.1.1"]
low = 0.008
high = 0.03
[[parameter]]
key = "gas"
low = 2e3
high = 15e3
start = 5e3
[[case]]
name = "bent"
loads.pressure_Pa = "gas"
[goal]
quantity = "bending_angle_rad"
sense = "most"
[[limit]]
quantity = "volume_m3.chamber"
at_most = 1e-5
"""


def study(folder: Path, text: str) -> DesignStudyTable:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_design_study(path)


def test_slopes_of_goal_and_limits_are_those_of_their_values(tmp_path: Path) -> None:
    text = STUDY.replace("[[parameter]]", LIGHT + "[[parameter]]", 1)
    problem = DesignProblem(study(tmp_path, text + LENGTH.format(bound=0.0) + WIDTH.format(bound=0.01)))
    here = np.array([0.4, 0.5])
    found = differences(problem.reached, here, 1e-3).T
    problem.reached(here)
    exact = problem.slopes(here)
    for row, by_differences in zip(exact, found, strict=True):
        assert relative_error(row, by_differences) < 1e-5


def outline(folder: Path) -> DesignStudyTable:
    (folder / "pouch.toml").write_text(POUCH, encoding="utf-8")
    return study(folder, OUTLINE.format(robot=folder / "pouch.toml"))


def test_slopes_by_the_width_of_an_outline_are_those_of_the_drawn_pouch(tmp_path: Path) -> None:
    problem = DesignProblem(outline(tmp_path))
    found = differences(problem.reached, problem.start, 2e-3).T
    problem.reached(problem.start)
    angle, volume = zip(problem.slopes(problem.start), found, strict=True)
    assert relative_error(*volume) < 1e-5
    assert relative_error(*angle) < 2e-3  # what solutions of a soft pouch resolve


def test_further_starts_are_random_within_the_bounds_and_seeded(tmp_path: Path) -> None:
    limited = replace(outline(tmp_path), evaluations=2)
    ranked = design(limited, verify=False)
    assert sorted(found.choice for found in ranked) == ["start 1", "start 2", "start 3"]
    starts = {found.choice: found.start.values for found in ranked}
    assert starts["start 1"] == pytest.approx([0.015, 5e3])
    assert all((limited.parameter[0].low < values[0] < 0.03) for values in starts.values())
    assert not np.allclose(starts["start 2"], starts["start 3"])
    again, other = (
        solve_choice(DesignTask(replace(limited, seed=seed), begin=1, verify=False)) for seed in (0, 1)
    )
    assert np.array_equal(again.start.values, starts["start 2"])
    assert not np.array_equal(other.start.values, starts["start 2"])


def test_the_least_tension_is_the_one_that_the_limit_needs(tmp_path: Path) -> None:
    text = STUDY.replace("[[parameter]]", LIGHT + "[[parameter]]", 1)
    probe = DesignProblem(study(tmp_path, text + LENGTH.format(bound=0.0) + WIDTH.format(bound=0.01)))
    wanted = np.array([3e-3, 0.25])
    _, shorter, mass = probe.solved(wanted).tolist()
    limited = study(tmp_path, text + LENGTH.format(bound=shorter) + WIDTH.format(bound=mass))
    found = solve_choice(DesignTask(limited, verify=False))
    assert found.feasible
    assert found.evaluations <= 20
    assert found.found.values == pytest.approx(wanted, rel=5e-3)


def test_choices_are_ranked_and_the_best_robot_can_be_loaded(tmp_path: Path) -> None:
    choices = "".join(
        f'[[choice]]\nname = "{name}"\nset = {{ "soft_robot.film.thickness_m" = {thickness} }}\n'
        for name, thickness in (("thick", 0.3e-3), ("thin", 0.1e-3))
    )
    ranked = design(study(tmp_path, STUDY + LENGTH.format(bound=-5e-4) + choices), verify=False)
    assert {found.choice for found in ranked} == {"thick", "thin"}
    assert [found.feasible for found in ranked] == [True, True]
    goals = [found.found.reached[0] for found in ranked]
    assert goals == sorted(goals)
    page, robot = write_designs(ranked, tmp_path / "out", "study.toml")
    assert all(line.partition(":")[0] in page.read_text() for line in design_lines(ranked[0]))
    read = load_soft_robot(robot)
    assert read.stiffener.width_m == pytest.approx(ranked[0].found.values[0], rel=1e-9)
    assert "stiffener.width_m" in read.known.assumed


def test_wrong_studies_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"cable_tension_N.corner_0: case.*bend.*bent"):
        study(tmp_path, STUDY.replace('case = "bent"', 'case = "bend"'))
    with pytest.raises(ScenarioError, match="needs one of at_least, at_most and equal"):
        study(tmp_path, STUDY + LENGTH.format(bound=0.0) + "at_least = 1.0\n")
    with pytest.raises(InputError, match=r"(pul|pull): is (no parameter|a parameter that no load names)"):
        DesignProblem(study(tmp_path, STUDY.replace('= "pull" }', '= "pul" }').replace('"pull",', '"pul",')))
    with pytest.raises(InputError, match="tip_position_m: means several numbers"):
        DesignProblem(study(tmp_path, STUDY.replace('cable_tension_N.corner_0"\nc', 'tip_position_m"\nc')))
