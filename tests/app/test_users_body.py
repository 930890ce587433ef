"""`cosim.run(body=...)`: a soft body from arrays in place of a scenario's soft robot."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.build.given_body import NamedBody
from cosim.build.soft_body import build_soft_body
from cosim.cli.main import EXIT_INPUT, main
from cosim.errors import MeshError, ScenarioError
from cosim.results.result import RunResult
from cosim.results.result_builder import ResultBuilder
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.body.places import center_line_length, center_rings
from cosim.soft.elements.hinge import Hinges
from cosim.telemetry.tick_batch import TickBatch
from tests.pages import page
from tests.soft import own_tube
from tests.soft.own_tube import LENGTH_M, tube

SCENARIO = """\
schema = 2
title = "a tube of my own, inflated and bent"
robot = "none"

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "inflate"
duration_s = 0.1
settle_s = 0.0
pressure_Pa = 5e3

[[phase]]
name = "bend"
duration_s = 0.1
settle_s = 0.0
cable_tension_N = { side = 2.0 }
"""
SHORT = {
    "phase": [{"name": "inflate", "duration_s": 0.02, "settle_s": 0.0, "increments": 4, "pressure_Pa": 20e3}],
    "clock.tick_s": 2e-3,
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "tube.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_an_open_tube_is_inflated_and_bends_towards_its_cable(file: Path, mode: str) -> None:
    out = file.parent / "out"
    result = cosim.run(file, overrides={"mode": mode}, body=tube(), out=out, recording=True)
    assert result.summary["status"] == "completed"
    assert (out / "recording.rrd").stat().st_size > 0
    inflated = result.tip_position[result.phase == result.phase[1]][-1]
    bent = result.tip_position[-1]
    assert abs(inflated[0]) < 1e-5
    assert 1e-3 < bent[0] < 1e-2
    assert abs(bent[2] - (0.5 - LENGTH_M)) < 0.02 * LENGTH_M


def test_its_cuff_is_of_thicker_film(file: Path) -> None:
    body = tube().body
    cuff, wall = body.membranes
    assert cuff.film.thickness_m == 2.0 * wall.film.thickness_m
    result = cosim.run(file, overrides={"phase.bend.cable_tension_N": [0.0]}, body=body)
    assert result.summary["status"] == "completed"
    drawn, rows = body.positions[cuff.triangles].mean(axis=1)[:, 2], 12
    assert (drawn < LENGTH_M / rows).all()


def test_the_page_on_extending_shows_body_and_scenario() -> None:
    text = Path(own_tube.__file__ or "").read_text(encoding="utf-8")
    shown = page("extending")
    assert f"```python\n{text}```" in shown
    assert f"```toml\n{SCENARIO}```" in shown


def columns(result: RunResult) -> dict[str, Array]:
    assert len(result.arrays) > 20
    return {key: value for key, value in result.arrays.items() if key != "tick_wall_s"}


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_an_arm_from_arrays_is_bit_identical_to_that_of_its_file(mode: str) -> None:
    changes = {**SHORT, "mode": mode, "start.cable_tension_N": [1.0, 2.0]}
    scenario = cosim.load_scenario("ur5e_hexagon_arm", changes)
    robot = scenario.soft_robot
    body = build_soft_body(robot, scenario.model)  # type: ignore[arg-type]
    given = NamedBody(body, robot.name, robot.cable_names())
    own = cosim.run(scenario)
    foreign = cosim.run("ur5e_hexagon_arm", overrides=changes, body=given)
    np.testing.assert_equal(columns(foreign), columns(own))
    modelled = [run.summary["modelled"] for run in (foreign, own)]
    switches = [
        next(entry for entry in found if entry["what"] == "hinges").pop("switch") for found in modelled
    ]
    assert switches == ["body", "soft_robot.hinge.stiffness_factor"]
    for found in modelled:
        next(entry for entry in found if entry["what"] == "direction of cable losses").pop("switch")
    assert modelled[0] == modelled[1]


def test_it_is_stepped_branched_and_pickled(file: Path) -> None:
    here = cosim.Simulation(file, body=tube())
    here.step(5)
    here.save().write(saved := file.parent / "saved.npz")
    same = (pickle.loads(pickle.dumps(here)), cosim.Simulation(file, body=tube(), start=saved))
    branch = here.branch({"phase.inflate.pressure_Pa": 4e3})
    for other in (here, *same, branch):
        other.step(20)
    for again in same:
        np.testing.assert_array_equal(again.snapshot.node_position, here.snapshot.node_position)
    assert not np.array_equal(branch.snapshot.node_position, here.snapshot.node_position)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fidelity": "section"}, "fidelity: 'section' needs a stack of units"),
        ({"fidelity": "refined"}, "fidelity: 'refined' needs a geometry that can be drawn finer"),
        ({"model.all_hinges": False}, r"model\.all_hinges: is false"),
        ({"model.published": True}, r"model\.published: is true"),
        ({"model.closed": False}, r"model\.closed: is false; .*closed = True"),
        ({"soft_robot.film.thickness_m": 1e-4}, r"soft_robot\.film\.thickness_m: cannot be set"),
        ({"soft_robot": "hexagon_arm"}, "soft_robot: cannot be set"),
        (
            {"phase.bend.cable_tension_N": {"left": 1.0}},
            r"phase\.bend\.cable_tension_N\.left: no cable 'left'",
        ),
        ({"phase.bend.cable_tension_N": [1.0, 2.0]}, "has 2 entries; there are 1 cables: side"),
        ({"phase.bend.clamp": ["end"]}, r"phase\.bend\.clamp: no ring 'end'. There are: base, tip, middle"),
        ({"phase.bend.release": ["middle"]}, r"phase\.bend\.release: 'middle' is not held; held are: base"),
        ({"phase.bend.pressure_Pa": {"left": 1e3}}, r"phase\.bend\.pressure_Pa\.left: no chamber 'left'"),
        (
            {"phase.bend.support": [{"rings": ["middle"], "axes": "x", "corners": [0]}]},
            r"phase\.bend\.support\.1\.corners: are of stacks of units",
        ),
    ],
)
def test_what_only_a_file_can_tell_is_refused(file: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        cosim.run(file, overrides=changes, body=tube())


def test_groups_of_nodes_are_held_and_loaded_by_name(file: Path) -> None:
    force = [{"rings": ["tip"], "total_N": [0.1, 0.0, 0.0]}]
    changes: dict[str, Any] = {"mode": "quasistatic", "phase.bend.cable_tension_N": [0.0]}
    loose = cosim.run(file, overrides={**changes, "phase.bend.force": force}, body=tube())
    held = cosim.run(
        file, overrides={**changes, "phase.bend.force": force, "phase.bend.clamp": ["middle"]}, body=tube()
    )
    assert 0.0 < held.tip_position[-1, 0] < 0.5 * loose.tip_position[-1, 0]


def test_all_faults_are_reported_with_a_body(file: Path) -> None:
    with pytest.raises(ScenarioError) as told:
        cosim.load_scenario(file, {"clock.tick_s": -1.0, "phase.bend.pressure_Pa": "much"}, tube().table())
    assert {path for path, _ in told.value.faults} == {"clock.tick_s", "phase.bend.pressure_Pa"}
    with pytest.raises(ScenarioError) as told:
        cosim.load_scenario(file, {"phase.bend.clamp": ["end"], "robot": "ur6e"}, tube().table())
    assert {path for path, _ in told.value.faults} == {"phase.bend.clamp", "robot"}
    assert "no ring 'end'" in str(told.value)


def test_its_files_go_on_only_with_the_body(file: Path) -> None:
    out = file.parent / "out"
    result = cosim.run(file, body=tube(), out=out)
    written = out / "scenario.toml"
    for run in (cosim.run, cosim.Simulation, cosim.load_scenario):
        with pytest.raises(
            ScenarioError, match="soft_robot: 'tube' was given as arrays, which are in no file"
        ):
            run(written)
    np.testing.assert_equal(columns(cosim.run(written, body=tube())), columns(result))
    with pytest.raises(ScenarioError, match="soft_robot: 'tube' was given as arrays"):
        cosim.run(cosim.load_scenario(file, body=tube().table()))


def test_an_interrupted_run_continues_from_python_alone(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, out, seen = cosim.run(file, body=tube()), file.parent / "out", []

    def interrupted(_builder: ResultBuilder, batch: TickBatch) -> None:
        if seen and seen[-1].tick[-1] > 0:  # the checkpoint holds what was seen before
            raise RuntimeError("enough")
        seen.append(batch)

    with monkeypatch.context() as patch:
        patch.setattr(ResultBuilder, "observe", interrupted)
        with pytest.raises(RuntimeError, match="enough"):
            cosim.run(file, body=tube(), out=out)
    assert main(["run", "--resume", str(out)]) == EXIT_INPUT
    assert "soft_robot: 'tube' was given as arrays" in capsys.readouterr().err
    here = cosim.Simulation(out / "scenario.toml", body=tube(), start=out / "checkpoint.npz")
    assert 0 < here.ticks_left < 100
    here.step(here.ticks_left)
    np.testing.assert_array_equal(here.snapshot.tip_position, whole.tip_position[-1])


def test_copies_stand_side_by_side_with_gases_of_their_own(file: Path) -> None:
    three = NamedBody(copies(tube().body, around_axis(3, 0.1, 0.0)), "tubes")
    assert three.table().chambers == ("copy_1", "copy_2", "copy_3")
    changes = {"phase.bend.cable_tension_N": {"cable_2": 2.0}, "phase.inflate.pressure_Pa": {"copy_1": 5e3}}
    result = cosim.run(file, overrides=changes, body=three)
    assert result.summary["status"] == "completed"
    length = center_line_length(center_rings(three.body), three.body.positions)
    assert length == pytest.approx(LENGTH_M, rel=1e-12)


def test_another_body_has_another_content() -> None:
    given = tube()
    stiffer = replace(given.body.hinges, stiffness=2.0 * given.body.hinges.stiffness)
    other = NamedBody(given.body.with_other(Hinges, stiffer), "tube", ("side",))
    assert tube().table() == given.table()
    assert replace(other.table(), arrays=given.table().arrays) == given.table()
    assert other.table().arrays != given.table().arrays


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": np.zeros(0, np.int64)}, "has no base"),
        ({"tip": np.array([1, 2])}, "the tip has 2 nodes"),
        ({"node_mass": np.zeros(156)}, "node 0 has a mass of 0 kg"),
        ({"positions": np.zeros((156, 3))}, "triangle 0 .* is degenerate"),
    ],
)
def test_bodies_that_cannot_be_simulated_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        NamedBody(replace(tube().body, **changes))


def test_names_must_be_names_and_as_many_as_cables() -> None:
    body = tube().body
    assert NamedBody(body).cable_names == ("cable_1",)
    for names in (("a", "b"), ("a", "a")):
        with pytest.raises(MeshError, match="1 names that differ are needed"):
            NamedBody(body, "tube", names)
    with pytest.raises(ScenarioError, match=r"body\.cables\.1: .*a letter followed by"):
        NamedBody(body, "tube", ("my cable",))


def test_its_centre_line_leads_from_base_to_tip() -> None:
    body = tube().body
    assert center_line_length(center_rings(body), body.positions) == pytest.approx(LENGTH_M, rel=1e-12)
    fewer = replace(body, tip=body.tip[:8])  # the base has 12 nodes
    rings = center_rings(fewer)
    np.testing.assert_allclose(
        fewer.positions[rings].mean(axis=1),
        [body.positions[body.base].mean(axis=0), fewer.tip_position(body.positions)],
        atol=1e-15,
    )
