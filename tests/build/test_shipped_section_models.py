"""Section models that come with cosim: of today's robots, used without a build, near their films."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.build import section_models
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.config.schema.scenario import Scenario
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState


def shipped(name: str, changes: dict[str, object] | None = None) -> Scenario:
    """Return a scenario with a section model."""
    return load_scenario(name, {"fidelity": "section", **(changes or {})})


def test_all_files_are_those_of_today_s_robots_and_options() -> None:
    """Otherwise run `python benchmarks/section_models.py`."""
    wanted = {section_models.shipped_path(shipped(name)) for name in section_models.SHIPPED}
    assert set(section_models.FOLDER.iterdir()) == wanted


@pytest.mark.parametrize("name", section_models.SHIPPED)
def test_they_are_used_without_a_build(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(section_models, "build_model", lambda *_: pytest.fail("it comes with cosim"))
    assert section_models.section_model(shipped(name)).tip_error < 0.005


@pytest.mark.parametrize(
    "changes",
    [
        {"soft_robot.film.young_modulus_Pa": 1e9},
        {"soft_robot.stiffener.side_ratio": 0.99},
        {"contact.self_contact": False},
        {"model.all_hinges": False},
    ],
)
def test_another_robot_or_option_has_another_name(changes: dict[str, object]) -> None:
    name = section_models.SHIPPED[0]
    assert not section_models.shipped_path(shipped(name, changes)).exists()


@pytest.mark.parametrize("name", section_models.SHIPPED)
def test_they_bend_as_today_s_film_does(name: str) -> None:
    scenario = shipped(name)
    body = build_soft_body(file_of(scenario, "its mesh"), scenario.model)
    clamp, slack = Clamp.of_base(body), (0.0,) * len(body.cables)
    solver = EquilibriumSolver(
        NewtonSolver(FilmPotential(body), clamp.mask(body.nodes)), clamp, NewtonOptions()
    )
    begin = solver.solve(SoftState.drawn(body, Pose()), Pose(), Loads((1e3,), slack))
    film = solver.follow(begin, Pose(), Loads((25e3,), (0.4, *slack[1:]), (3.0, 0.0, 9.0)))
    chain = ChainSolver(SectionBody(body, section_models.section_model(scenario)))
    frames = chain.section.frames.fit(film.state.positions, Pose())
    found = chain.solve(frames, np.arange(len(frames)) > 0, film.loads, 1e-6, 60)
    length = np.linalg.norm(frames[-1, 0])
    assert np.linalg.norm(found.frames[-1, 0] - frames[-1, 0]) < 0.01 * length
    straight = chain.section.straight(25e3)
    assert np.linalg.norm(frames[-1, 0] - straight[-1, 0]) > 0.1 * length
