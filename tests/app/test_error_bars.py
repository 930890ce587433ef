"""A run says how far its figures may be off: by its mesh, its ticks and what its solver leaves.

The same run on the mesh refined once gives the difference that the bar of the mesh is a multiple of: of 1.2
to 3.5, whatever the calibration has found. The two are solved apart: from another shape, with another clamp.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.bars import study
from cosim.bars.calibration import DRAWN, GRADED, bounded, bounded_tension
from cosim.bars.finer_mesh import FinerMesh, Pair
from cosim.base.kept_parts import KeptParts
from cosim.build import section_models
from cosim.build.soft_model import SoftModel
from cosim.cli.main import main
from cosim.config.loading import load_scenario, scenario_text
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.soft.body.loads import Loads
from tests.small_section import FRAMED, framed_section, on_a_ur5e

SADDLE = Path(__file__).parents[1] / "cases" / "saddle" / "pouch_on_ur5e.toml"
pytestmark = pytest.mark.error_bars
LEAST, MOST = 1.2, 3.5
FIGURES = ("tip_m", "sag_m", "length_m", "volume_m3", "cable_tension_N", "peak_strain")
LENGTHS = {"tip_m": "tip_position_m", "sag_m": "sag_m", "volume_m3": "volume_m3"}
ARM = """
schema = 2
title = "Three square units lean over and are lifted"
robot = "none"
soft_robot = "square_core_cables"
mode = "quasistatic"
[start]
flange = { position_m = [0.0, 0.0, 0.5], direction = [0.3, 0.0, -1.0] }
[[phase]]
name = "inflate"
duration_s = 0.5
increments = 2
pressure_Pa = 10e3
"""
LIFT = """
[[phase]]
name = "lift"
duration_s = 0.5
increments = 2
tip_target = { height_m = 0.472, reach_with = "cables" }
"""


PUSHED = """
[[phase.force]]
rings = ["unit_3.outer"]
corners = [1, 2]
total_N = [0.0, 0.5, 0.0]
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    return path


def phases(scenario: str | Path, error: bool | None = True, **overrides: Any) -> list[dict[str, Any]]:
    """Return the figures of each phase of a run."""
    found: list[dict[str, Any]] = cosim.run(scenario, overrides=overrides, error=error).summary["phases"]
    return found


def assert_bars_hold(run: list[dict[str, Any]], refined: list[dict[str, Any]]) -> None:
    """Compare the bars of a run's phases with the same run on the refined mesh."""
    for coarse, fine in zip(run, refined, strict=True):
        bars = coarse["error"]
        assert bars["reason"] is None
        away = {
            key: float(np.linalg.norm(np.subtract(coarse[figure], fine[figure])))
            for key, figure in LENGTHS.items()
        }
        assert LEAST * away["tip_m"] < bars["tip_m"] < MOST * away["tip_m"]
        # bare film has many shapes: two runs differ by 0.8 to 1.3 times what the states at rest do
        assert bars["volume_m3"] == pytest.approx(GRADED.factors["volume_m3"] * away["volume_m3"], rel=0.35)
        # sag is off by at least a share of what the tip is
        assert LEAST * away["sag_m"] < bars["sag_m"] < MOST * away["tip_m"]
        assert bars["peak_strain"] is None or bars["peak_strain"] > 0.0


def test_the_bar_of_the_mesh_is_a_multiple_of_what_refining_it_changes(arm: Path) -> None:
    assert_bars_hold(phases(arm), phases(arm, error=False, fidelity="refined"))


def test_a_state_of_the_refined_mesh_is_followed_from_an_earlier_one() -> None:
    model = SoftModel(load_scenario("three_unit_inflation"), KeptParts())
    side = model.side()
    assert isinstance(side, FilmRobot)
    mesh, flange = FinerMesh(side.body, model.refined(1)), side.full_state.flange
    less, more = (
        side.start(flange, Loads((pressure_Pa,), (), (0.0, 0.0, 0.0))) for pressure_Pa in (200.0, 2e3)
    )
    clamp = mesh.clamp(side.clamp)
    followed = mesh.followed(clamp, more, mesh.at_rest(clamp, less))
    spent, near = mesh.iterations, mesh.at_rest(clamp, more)
    assert mesh.iterations == spent + near.iterations
    assert followed.loads.pressure_Pa == (2e3,)
    ends = [mesh.side.body.tip_position(found.state.positions) for found in (followed, near)]
    assert ends[0] == pytest.approx(ends[1], abs=2e-4)


def test_a_difference_that_folds_films_is_not_added() -> None:
    model = SoftModel(load_scenario("three_unit_inflation"), KeptParts())
    side = model.side()
    assert isinstance(side, FilmRobot)
    mesh = FinerMesh(side.body, model.refined(1))
    rest = side.start(side.full_state.flange, Loads((2e3,), (), (0.0, 0.0, 0.0)))
    clamp = mesh.clamp(side.clamp)
    found = mesh.at_rest(clamp, rest)
    spent, x = mesh.iterations, found.state.positions
    folded = x + np.random.default_rng(1).uniform(-0.02, 0.02, x.shape)
    before = Pair(rest, replace(found, state=replace(found.state, positions=folded)), clamp)
    again = mesh.at_rest(clamp, rest, before)
    assert mesh.iterations - spent <= spent
    assert again.state.positions == pytest.approx(x, abs=1e-6)


@pytest.mark.long
def test_tensions_for_a_target_are_found_again_on_the_refined_mesh(arm: Path) -> None:
    # of one cable there is one tension
    one = '{ name = "one", corner = 1, units = [1, 3], capstan_factor = 0.86 }'
    arm_of_three = f'{{ file = "hexagon_arm_five", stack.units = 3, cable = [{one}] }}'
    alone = ARM.replace('"square_core_cables"', arm_of_three)
    sideways = (alone + LIFT).replace("[0.3, 0.0, -1.0]", "[1.0, 0.0, 0.0]").replace("0.472", "0.501")
    arm.write_text(sideways, encoding="utf-8")
    coarse, fine = phases(arm)[-1], phases(arm, error=False, fidelity="refined")[-1]
    away = float(np.abs(np.subtract(coarse["cable_tension_N"], fine["cable_tension_N"])).max())
    # two meshes may agree by chance: a tension is off by at least a tenth of itself
    away = max(away, 0.1 * max(coarse["cable_tension_N"]))
    assert LEAST * away < coarse["error"]["cable_tension_N"] < MOST * away


def test_figures_are_off_by_no_less_than_tip_and_volume_ask_for() -> None:
    away = {"tip_m": 1e-3, "sag_m": 0.0, "length_m": 3e-3, "volume_m3": 4e-6}
    here = {"length_m": 0.1, "volume_m3": 1e-4}  # 4 % of the gas, of the length 4 mm
    assert bounded(away, here, GRADED) == pytest.approx(away | {"tip_m": 2e-3, "sag_m": 2e-3})
    assert bounded(away, here | {"volume_m3": 0.0}, GRADED) == pytest.approx(away | {"sag_m": 0.5e-3})
    # fingers' mesh lacks volume, which hardly moves their tips
    assert bounded(away, here, DRAWN) == pytest.approx(away | {"sag_m": 0.5e-3})
    # of a tension 0.1, of what the tips ask for 0.5: root of the sum of squares
    assert bounded_tension(1.2, 0.04, 0.06) == pytest.approx(0.13)
    assert bounded_tension(0.0, 0.3, 0.8) == pytest.approx(0.5)


@pytest.mark.long
def test_forces_on_rings_are_those_of_the_run_on_the_refined_mesh(arm: Path) -> None:
    arm.write_text(ARM + PUSHED, encoding="utf-8")
    assert_bars_hold(phases(arm), phases(arm, error=False, fidelity="refined"))


def test_a_force_on_a_ring_is_divided_evenly_on_the_refined_mesh() -> None:
    model = SoftModel(load_scenario("three_unit_inflation"), KeptParts())
    side = model.side()
    assert isinstance(side, FilmRobot)
    mesh, ring = FinerMesh(side.body, model.refined(1)), side.body.rings["unit_3.outer"]
    force = np.zeros((side.body.nodes, 3))
    force[ring, 1] = 0.06 / len(ring)
    rest = side.start(side.full_state.flange, Loads((2e3,), (), (0.0, 0.0, 0.0), force))
    found = mesh.at_rest(mesh.clamp(side.clamp), rest).loads.nodal_force
    assert found is not None
    finer_ring = mesh.side.body.rings["unit_3.outer"]
    assert len(finer_ring) > len(ring)
    assert found[finer_ring, 1] == pytest.approx(0.06 / len(finer_ring))
    assert found.sum(axis=0) == pytest.approx([0.0, 0.06, 0.0])


def test_rings_that_are_held_later_are_held_where_the_refined_mesh_has_them() -> None:
    counts = {f"phase.{name}.increments": 4 for name in ("start", "inflate", "load", "pull")}
    name = "bending_angle_tip_load"
    run, refined = phases(name, **counts), phases(name, error=False, fidelity="refined", **counts)
    assert_bars_hold(run[1:], refined[1:])  # hardly inflated, the bare film has many shapes


@pytest.mark.parametrize(
    "robot", ["three_finger_gripper", pytest.param("arm_with_gripper", marks=pytest.mark.long)]
)
def test_copies_and_what_is_carried_are_refined_as_well(arm: Path, robot: str) -> None:
    given = {"soft_robot": robot, "phase.inflate.pressure_Pa": 2e3, "phase.inflate.increments": 1}
    assert phases(arm, **given)[-1]["error"]["tip_m"] > 0.0


def test_long_ticks_are_reported(arm: Path) -> None:
    swing = {"mode": "dynamic", "phase.inflate.duration_s": 0.2, "phase.inflate.pressure_Pa": 5e3}
    found = [phases(arm, **swing, **{"clock.tick_s": tick_s})[-1] for tick_s in (0.01, 0.00125)]
    away = float(np.linalg.norm(np.subtract(found[0]["tip_position_m"], found[1]["tip_position_m"])))
    long, short = (each["error"]["of_tick"]["tip_m"] for each in found)
    assert away > 1e-5
    assert 0.5 * away < long < 10.0 * away
    assert short < 0.6 * long


APART: dict[str, Any] = {
    "contact.self_contact": False, "soft_robot.stiffener.rest_on_one_another": False,
}  # fmt: skip
"""Nothing touches: what swings is linear, and statics are cheap."""
PULL = """
[[phase]]
name = "pull"
duration_s = 0.3
cable_tension_N = [0.5, 0.0]
"""


@pytest.mark.parametrize("tick_s", [0.01, 0.005])
def test_the_bar_of_long_ticks_covers_what_a_quarter_of_them_changes(arm: Path, tick_s: float) -> None:
    # what the ticks have lost of the swings is more than what still swings
    arm.write_text(ARM.replace("increments = 2\n", "") + PULL, encoding="utf-8")
    swing = {**APART, "mode": "dynamic", "solver.integrator": "bdf2", "phase.inflate.duration_s": 0.3}
    run = phases(arm, **swing, **{"clock.tick_s": tick_s})
    finer = phases(arm, error=False, **swing, **{"clock.tick_s": tick_s / 4.0})
    for long, short in zip(run, finer, strict=True):
        away = float(np.linalg.norm(np.subtract(long["tip_position_m"], short["tip_position_m"])))
        assert 1e-4 < away < long["error"]["of_tick"]["tip_m"] < 15.0 * away


def test_what_the_solver_leaves_counts_by_its_tolerance(arm: Path) -> None:
    close, loose = (
        phases(arm, **{"solver.residual_tolerance_N": given})[-1]["error"]["of_solver"]["tip_m"]
        for given in (1e-6, 1e-4)
    )
    # both tangents are of nearly the same shape
    assert loose == pytest.approx(100.0 * close, rel=0.01)


@pytest.mark.parametrize(("overrides", "why"), [({"fidelity": "rigid"}, "the shape is frozen")])
def test_models_without_a_refined_mesh_say_so(arm: Path, overrides: dict[str, Any], why: str) -> None:
    summary = cosim.run(arm, overrides=overrides, error=True).summary
    assert summary["error"]["reason"].startswith(why)
    assert [phase["error"] for phase in summary["phases"]] == [None]


def test_a_phase_that_branches_has_no_bar() -> None:
    given = {"mode": "quasistatic", "robot": "none", "phase.inflate.increments": 4}
    last = phases(SADDLE, **given)[-1]["error"]
    assert last["reason"] == "the soft robot branches in it, and figures jump there"
    assert [last[key] for key in FIGURES] == [None] * len(FIGURES)


def test_it_costs_no_more_than_its_share_unless_it_is_asked_for(
    arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm.write_text(ARM + LIFT, encoding="utf-8")
    monkeypatch.setattr(study, "FRACTION", 1e3)
    assert all(phase["error"]["reason"] is None for phase in phases(arm, error=None, **APART))
    monkeypatch.setattr(study, "FRACTION", 0.0)  # whatever a run takes, two phases take more
    summary = cosim.run(arm, overrides=APART).summary
    assert summary["phases"][0]["error"] is None
    assert summary["phases"][1]["error"]["reason"] is None
    assert "quarter of the run" in summary["error"]["reason"]
    monkeypatch.setattr(study, "LEAST_s", 0.0)
    short = cosim.run(arm, overrides=APART).summary
    assert [phase["error"] for phase in short["phases"]] == [None, None]
    assert "--error" in short["error"]["reason"]


@pytest.mark.parametrize("given", [True, False])
def test_the_command_line_says_it_or_leaves_it_out(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], given: bool
) -> None:
    out = tmp_path / "run"
    words = ["run", str(arm), "--out", str(out), "--no-recording", "--error" if given else "--no-error"]
    assert main(words) == 0
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("error:"))
    error = json.loads((out / "summary.json").read_text("utf-8"))["phases"][0]["error"]
    if given:
        assert line.startswith(f"error:     tip {1e3 * error['tip_m']:.2g} mm ('inflate'), sag ")
    else:
        assert error is None
        assert line == "error:     not computed: not requested"


BENT = """
[[phase]]
name = "turn"
duration_s = 0.4
increments = 4
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.6 }
[[phase]]
name = "hold"
duration_s = 0.4
increments = 4
clamp = ["unit_1.outer"]
cable_tension_N = [1.0, 0.0]
"""


def test_a_section_model_is_compared_with_its_film_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: framed_section().model)
    path = tmp_path / "bent.toml"
    path.write_text(on_a_ur5e(25e3, BENT, FRAMED, published=False), encoding="utf-8")
    rows, film = (phases(path, fidelity=model, mode="quasistatic") for model in ("section", "lumped"))
    for row, lumped, rel in zip(rows, film, (1e-3, 2.0), strict=True):
        assert row["error"]["reason"] is None
        apart = np.linalg.norm(np.subtract(row["tip_position_m"], lumped["tip_position_m"]))
        of_section = row["error"]["of_section"]["tip_m"]
        # the ring that is held at last is held as the chain draws it, not as the film has it
        assert of_section == pytest.approx(float(apart), rel=rel)
        assert 5e-5 < of_section < row["error"]["tip_m"]
    most = framed_section().body.nodes
    too_dear = f"with a film of {most} nodes it takes 10 s and longer; --error computes it nevertheless"
    for nodes, reason in ((most, None), (most - 1, too_dear)):
        monkeypatch.setattr(study, "FILM_NODES_MAX", nodes)
        unasked = cosim.run(path, overrides={"fidelity": "section", "mode": "quasistatic"})
        assert unasked.summary["error"]["reason"] == reason


def test_a_bar_above_a_quarter_of_its_figure_is_a_warning_with_its_cause() -> None:
    run = cosim.run("three_unit_inflation", error=True).summary
    (text,) = (text for text in run["warnings"] if "'inflate'" in text)
    last = run["phases"][-1]
    assert last["error"]["length_m"] > 0.25 * last["length_m"]
    assert "volume by " in text
    assert text.endswith("the mesh is coarse: fidelity = 'refined' divides every triangle into four")


SWING: dict[str, Any] = {**APART, "mode": "dynamic", "clock.tick_s": 0.01, "phase.inflate.duration_s": 0.2}


class Stops:
    """An observer that interrupts a run in its second phase."""

    def open(self, stage: cosim.Observer) -> None:
        """Do nothing."""

    def observe(self, batch: Any) -> None:
        """Interrupt once the second phase has begun."""
        if batch.phase[0]:
            raise KeyboardInterrupt

    def close(self) -> None:
        """Do nothing."""


def of_figures(bars: dict[str, Any]) -> dict[str, float]:
    """Return the bars that are known."""
    return {key: bars[key] for key in FIGURES if bars[key] is not None}


def test_a_finished_run_has_the_same_bars_in_memory_and_on_disk(arm: Path, tmp_path: Path) -> None:
    arm.write_text(ARM.replace("increments = 2\n", "") + PULL, encoding="utf-8")
    asked = cosim.run(arm, overrides=SWING, error=True).summary
    run = cosim.run(arm, overrides=SWING, error=False, out=tmp_path / "run")
    assert [phase["error"] for phase in run.summary["phases"]] == [None, None]
    for found in (run, tmp_path / "run", cosim.load_run(tmp_path / "run")):
        bars = cosim.error_bars(found)
        assert bars.reason is None
        for k, phase in enumerate(asked["phases"]):
            assert bars.phases[k]["of_tick"]["tip_m"] > 0.0
            assert of_figures(bars.phases[k]) == pytest.approx(of_figures(phase["error"]), rel=1e-6)


def test_a_resumed_run_has_bars_of_the_phases_before(arm: Path, tmp_path: Path) -> None:
    arm.write_text(ARM.replace("increments = 2\n", "") + PULL, encoding="utf-8")
    long = SWING | {"phase.pull.duration_s": 3.0}  # of several batches
    whole, out = cosim.run(arm, overrides=long, error=False), tmp_path / "run"
    with pytest.raises(cosim.RunInterrupted):
        cosim.run(arm, overrides=long, error=False, out=out, observers=[Stops()])
    assert main(["run", "--resume", str(out), "--no-error", "--quiet"]) == 0
    bars, wanted = cosim.error_bars(out).phases, cosim.error_bars(whole).phases
    assert [bars[k]["tip_m"] for k in (0, 1)] == pytest.approx([wanted[k]["tip_m"] for k in (0, 1)], rel=1e-6)
    assert bars[1]["of_tick"]["tip_m"] == pytest.approx(wanted[1]["of_tick"]["tip_m"], rel=1e-6)


def test_the_command_prints_the_bars_of_a_run(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    cosim.run(arm, error=False, out=out)
    assert main(["errors", str(out)]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    bars = cosim.error_bars(out).phases[0]
    assert line.startswith(f"inflate  tip {1e3 * bars['tip_m']:.2g} mm, sag ")
    assert f"tip by mesh {1e3 * bars['of_mesh']['tip_m']:.2g} mm, tip by solver " in line


def test_a_run_without_phase_ends_is_refused_in_one_line(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    cosim.run(arm, error=False, out=out)
    ends = out / "phase_ends.npz"
    ends.write_bytes(ends.read_bytes()[:-100])
    assert main(["errors", str(out)]) == 2
    ends.unlink()
    assert main(["errors", str(out)]) == 2
    damaged, absent = capsys.readouterr().err.splitlines()
    assert damaged.startswith(f"cosim: error: {ends}: is no saved state that can be read")
    assert absent.endswith(f"run it again: cosim run {out / 'scenario.toml'}")


def test_phase_ends_of_another_soft_robot_are_refused(arm: Path, tmp_path: Path) -> None:
    cosim.run(arm, error=False, out=tmp_path / "run")
    path = tmp_path / "run" / "scenario.toml"
    path.write_text(scenario_text(load_scenario(arm, {"soft_robot": "hexagon_arm"})), encoding="utf-8")
    with pytest.raises(cosim.InputError, match="nodes"):
        cosim.error_bars(tmp_path / "run")


def test_a_search_ends_once_its_time_is_spent(arm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spent = iter(range(10**6))
    monkeypatch.setattr(study.Budget, "spent_s", property(lambda _budget: next(spent)))
    found = cosim.run(arm).summary
    (phase,) = found["phases"]
    assert phase["error"]["reason"] == "it would cost more than the run; --error computes it nevertheless"
    assert found["error"]["iterations"] < 10
