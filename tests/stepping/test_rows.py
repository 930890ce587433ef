"""Ticks of a section model in rows: where kernels take their soft halves, and where Python does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import Options, build_simulation, drive, execute
from cosim.app.simulation import Simulation
from cosim.build import soft_model
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.contact.contact_kernels import follow_touched
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.section_ticks import advance_chain
from cosim.errors import InputError, InstabilityError, OutOfRangeError
from cosim.stepping.scene_carrier import ArmCarrier
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.snapshot import Snapshot
from cosim.telemetry.tick_batch import TickBatch
from tests.small_section import ROBOT, on_a_ur5e, section
from tests.stepping.snapshots import assert_close, kernels_take, python_takes_every_soft_half

SCENARIO = on_a_ur5e(
    20e3,
    """
[[phase]]
name = "turn"
duration_s = 0.06
settle_s = 0.02
pressure_Pa = 25e3
cable_tension_N = [2.0, 0.0]
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }

[[phase]]
name = "hold"
duration_s = 0.03
clamp = ["unit_1.outer"]
cable_tension_N = [0.0, 1.0]
""",
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The scenario's file, while its section model is at hand."""
    file = tmp_path_factory.mktemp("rows") / "three_units.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(file.parent / "cache"))
        patch.setattr(soft_model, "build_model", lambda *_: section().model)
        yield file


def scenario(path: Path, **changes: Any) -> Scenario:
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    return load_scenario(path, overrides)


def together(run: SteppedRun, many: int = 64, most: int | None = None) -> list[Snapshot]:
    """Return ticks of which many were taken together."""
    return [snapshot for batch in run.batches(many, most=most) for snapshot in batch]


def taken_together(run: Any, most: int | None = None) -> list[int]:
    """Return the ticks that the kernel takes."""
    return sorted(kernels_take(run, most)[1])


def one_by_one(wanted: Scenario) -> list[Snapshot]:
    """Return all ticks without the kernel."""
    with python_takes_every_soft_half():
        return list(build_simulation(wanted).steps())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"solver__integrator": "bdf2"},
        {"payload_compensation": False},
        {"gravity_m_s2": [3.0, 0.0, -5.0], "solver__damping_per_s": 1.0},
    ],
    ids=str,
)
def test_rows_are_ticks(path: Path, changes: dict[str, Any]) -> None:
    """Up to rounding: shapes are read off for one tick or for many."""
    wanted = scenario(path, **changes)
    run = build_simulation(wanted)
    rows, ticks = together(run), one_by_one(wanted)
    assert taken_together(build_simulation(wanted)) == list(range(1, run.stage.ticks + 1))
    assert np.ptp([snapshot.tip_position for snapshot in ticks], axis=0).max() > 1e-3
    assert_close(rows, ticks, 1e-9)


BOX = {"name": "box", "shape": "box", "size_m": [0.1, 0.1, 0.05], "position_m": [0.4, 0.0, 0.25]}


@pytest.mark.parametrize("height_m", [0.25, 0.05], ids=["near", "far"])
def test_rows_are_ticks_with_something_near(path: Path, height_m: float) -> None:
    box = BOX | {"position_m": [0.4, 0.0, height_m]}
    wanted = scenario(path, contact__only_in_reach=False, object=[box])
    assert taken_together(build_simulation(wanted), 3) == [1, 2]
    assert_close(together(build_simulation(wanted), most=40), one_by_one(wanted)[:40], 1e-9)


TABLE = {"name": "table", "shape": "box", "size_m": [0.4, 0.4, 0.05], "position_m": [0.4, 0.0, 0.4095]}
PLATE = {"name": "plate", "shape": "box", "size_m": [0.3, 0.3, 0.004], "position_m": [0.4, 0.0, 0.4366]}


@pytest.mark.parametrize(("mass_kg", "copies"), [(None, 1), (0.05, 1), (2.0, 1), (0.1, 3)], ids=str)
def test_rows_are_ticks_in_contact_too(
    path: Path, tmp_path: Path, mass_kg: float | None, copies: int
) -> None:
    """Of what is fixed, gives way, is too heavy for that, and of several chains on one flange."""
    plate = PLATE if mass_kg is None else PLATE | {"mass_kg": mass_kg}
    text = SCENARIO
    if copies > 1:
        where = f"copies = {{ count = {copies}, radius_m = 0.09, tilt_rad = 0.0, height_m = 0.0 }}"
        text = text.replace(ROBOT, ROBOT.replace("{ file", f"{{ {where}, file", 1))
        for pulls in ("2.0, 0.0", "0.0, 1.0"):
            text = text.replace(f"[{pulls}]", f"[{', '.join([pulls] * copies)}]")
        text = text.replace('clamp = ["unit_1.outer"]\n', "")
    (tmp_path / "touching.toml").write_text(text, encoding="utf-8")
    wanted = scenario(tmp_path / "touching.toml", object=[TABLE, plate], solver__damping_per_s=5.0)
    rows, together = kernels_take(build_simulation(wanted))
    ticks = one_by_one(wanted)
    touching = {snapshot.tick for snapshot in ticks if snapshot.ledger.contacts}
    assert touching, "the plate is reached"
    assert len(touching & together) > 0.9 * len(touching)
    assert max(snapshot.ledger.momentum_error for snapshot in rows) < 1e-10
    for found, expected in zip(rows, ticks, strict=True):
        assert found.ledger.contacts == expected.ledger.contacts
        assert found.node_position == pytest.approx(expected.node_position, abs=1e-9)
        assert found.body_position == pytest.approx(expected.body_position, abs=1e-9)
        assert found.body_contact_force == pytest.approx(expected.body_contact_force, abs=1e-5)


def test_bodies_are_weighed_again_while_rows_press_harder_on_them(tmp_path: Path) -> None:
    turn = "flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }"
    text = SCENARIO.replace(turn, "flange_shift_m = [0.0, 0.0, -0.012]").replace("0.06\n", "0.3\n")
    (tmp_path / "lowered.toml").write_text(text, encoding="utf-8")
    objects = [TABLE, PLATE | {"mass_kg": 0.05}]
    wanted = scenario(tmp_path / "lowered.toml", object=objects, solver__damping_per_s=5.0)
    rows, together = kernels_take(build_simulation(wanted))
    ratios = [snapshot.ledger.contact_ratio for snapshot in rows if snapshot.ledger.contacts]
    assert len(together) > 0.9 * len(rows)
    assert ratios[-1] > 5.0 * min(ratio for ratio in ratios if ratio)  # contacts have become stiffer


def test_contacts_follow_a_body_by_its_share_of_the_way(path: Path) -> None:
    """Share and way are at its centre of mass; with the body go all that ties contacts to it."""
    wanted = scenario(path, object=[TABLE, PLATE | {"mass_kg": 0.05}], solver__damping_per_s=5.0)
    run: Any = build_simulation(wanted)
    plate, last = run.stage.body_names.index("plate"), together(run, most=40)[-1]
    exchange, x = run._parts.carrier._coupling.interface.contact, np.ascontiguousarray(last.node_position)
    before, arrays = exchange.find(run._parts.soft.state, run.stage.tick_s), exchange.arrays
    mine, center = before.body == plate, arrays.bodies.centers[plate].copy()
    assert mine.any()
    share, way = np.linspace(-0.3, 0.9, 36).reshape(6, 6), np.arange(1.0, 7.0) * 1e-4
    met, lead = arrays.met[plate], arrays.bodies.leads.lead[plate].copy()
    met[:3], met[3:6] = way[:3] - np.cross(way[3:], center), way[3:]
    arrays.yields[plate] = share
    follow_touched(exchange.at, x)
    exchange.forget()
    gone = share @ way
    points = np.einsum("ka,kar->kr", before.weights, x[before.nodes])
    shift = (gone[:3] + np.cross(gone[3:], points - center)) * mine[:, None]
    assert exchange.planes.anchor - before.anchor == pytest.approx(shift, abs=1e-12)
    rises = np.einsum("kr,kr->k", before.normal, shift)
    assert exchange.planes.offset - before.offset == pytest.approx(rises, abs=1e-12)
    assert arrays.bodies.centers[plate] - center == pytest.approx(gone[:3], abs=1e-12)
    led = arrays.bodies.leads.lead[plate] - lead
    assert led[:3] + np.cross(led[3:], center) == pytest.approx(gone[:3], abs=1e-12)
    assert led[3:] == pytest.approx(gone[3:], abs=1e-12)


def test_kernels_take_ticks_in_which_a_light_body_goes_far(path: Path, tmp_path: Path) -> None:
    """As Python would, though the film's own tolerance is too coarse to know where the plate goes."""
    (tmp_path / "long.toml").write_text(SCENARIO, encoding="utf-8")
    objects, long = [TABLE, PLATE | {"mass_kg": 0.05}], 0.01
    given: dict[str, Any] = {
        "solver__damping_per_s": 5.0,
        "solver__dynamic_tolerance_N": 5e-3,
        "clock__tick_s": long,
    }
    wanted = scenario(tmp_path / "long.toml", object=objects, **given)
    rows, together = kernels_take(build_simulation(wanted))
    ticks = one_by_one(wanted)
    touching = {snapshot.tick for snapshot in ticks if snapshot.ledger.contacts}
    assert len(touching & together) > 0.8 * len(touching)
    for found, expected in zip(rows, ticks, strict=True):
        assert found.body_position == pytest.approx(expected.body_position, abs=2e-5)


def test_sealed_gas_goes_tick_by_tick(path: Path) -> None:
    wanted = scenario(path, phase__hold__gas="sealed", contact__enabled=False)
    rows, ticks = together(build_simulation(wanted)), one_by_one(wanted)
    assert {rows[tick].phase for tick in taken_together(build_simulation(wanted))} == {0}
    assert rows[-1].pressure_Pa != 25e3
    assert_close(rows, ticks, 1e-9)


def test_commanded_cables_go_tick_by_tick(path: Path, tmp_path: Path) -> None:
    text = SCENARIO.replace("cable_tension_N = [0.0, 1.0]", "cable_shortening_m = { cable_1 = 1e-3 }")
    names = load_scenario(path).soft_robot.cable_names()
    (tmp_path / "short.toml").write_text(text.replace("cable_1", names[0]), encoding="utf-8")
    wanted = scenario(tmp_path / "short.toml")
    assert taken_together(build_simulation(wanted), 50) == list(range(1, 41))  # of the phase before


def test_devices_act_tick_by_tick(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    devices = run._parts.commands._actuation
    devices._modelled = True  # as with a controller of tensions, which leaves the loads plain
    devices.report = lambda *_: None
    assert [len(run._some(64)) for _ in range(4)] == [1, 1, 1, 1]


def test_rows_know_what_is_mounted(path: Path, tmp_path: Path) -> None:
    palm = "palm = { radius_m = 0.05, thickness_m = 0.02, mass_kg = 0.7 }"
    text = SCENARIO.replace(ROBOT, ROBOT.replace("{ file", f"{{ {palm}, file", 1))
    (tmp_path / "palm.toml").write_text(text, encoding="utf-8")
    wanted = scenario(tmp_path / "palm.toml")
    rows, ticks = together(build_simulation(wanted)), one_by_one(wanted)
    assert taken_together(build_simulation(wanted))
    assert_close(rows, ticks, 1e-9)


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_rows_carry_algorithmic_mass(path: Path, integrator: str) -> None:
    wanted = scenario(path, clock__tick_s=0.0005, solver__integrator=integrator)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cosim.stepping.scene_carrier.StaggeredCoupling", _always_carrying)
        rows, ticks = together(build_simulation(wanted)), one_by_one(wanted)
    assert set(advance_chain.signatures) == {advance_chain.fixed_signature.args}  # compiled for no others
    assert all(snapshot.ledger.algorithmic_mass for snapshot in rows[1:])
    assert_close(rows, ticks, 1e-9)


def _always_carrying(interface: Any) -> Any:
    return StaggeredCoupling(interface, ratio_bound=0.0)


@pytest.mark.parametrize(("ahead", "integrator"), [(1, "bdf2"), (7, "bdf2"), (7, "implicit_euler")])
def test_how_many_ticks_go_in_a_row_changes_no_bit(path: Path, ahead: int, integrator: str) -> None:
    wanted = scenario(path, solver__integrator=integrator)
    few, many = together(build_simulation(wanted), ahead), together(build_simulation(wanted))
    assert_close(few, many, 0.0)


def test_a_soft_step_that_is_left_is_finished(path: Path) -> None:
    """A jump of the pressure in long ticks: free flight leaves the range of the model."""
    jump = {"phase__turn__ramp": "step", "phase__turn__pressure_Pa": 40e3}
    # by BDF2, which takes next to nothing of the swing, it leaves the range for good
    wanted = scenario(path, clock__tick_s=0.005, solver__integrator="implicit_euler", **jump)
    rows, ticks = together(build_simulation(wanted)), one_by_one(wanted)
    left = set(range(1, len(rows))) - set(taken_together(build_simulation(wanted)))
    assert 1 < len(left) < len(rows) - 1
    assert_close(rows, ticks, 1e-9)


def test_nothing_is_saved_ahead_of_what_is_shown(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    batches = run.batches(8)
    assert [len(batch) for batch in islice(batches, 2)] == [1, 8]
    assert run.saves_now
    run._error = InstabilityError("of tick 9")
    with pytest.raises(InputError, match="a later tick than 8 has been begun"):
        run.save_state()
    run._error = None
    saved = run.save_state()
    rest = [snapshot for batch in batches for snapshot in batch]
    run.restore_state(saved)
    assert_close(together(run, 3), rest, 0.0)


def test_a_run_stopped_within_a_phase_goes_on_bit_for_bit(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted, seen = scenario(path), []
    monkeypatch.setattr(SteppedRun.batches, "__defaults__", (4, None))

    def stop() -> str | None:
        seen.append(None)
        return "enough" if len(seen) == 4 else None

    whole = execute(wanted, build_simulation, Options(tmp_path / "whole"), 0.0)
    stopped = execute(wanted, build_simulation, Options(tmp_path / "part", stop=stop), 0.0)
    assert (stopped.summary["status"], stopped.summary["ticks"]) == ("interrupted", 12)
    resumed = execute(wanted, build_simulation, Options(tmp_path / "part", resume=True), 0.0)
    assert resumed.summary["resumed_at_ticks"] == [12]
    assert resumed.summary["phases"] == whole.summary["phases"]


def test_a_rigid_side_that_blows_up_is_named(path: Path) -> None:
    run: Any = build_simulation(scenario(path))
    shown: list[int] = []

    def observe(batch: TickBatch) -> None:
        shown.extend(batch.tick.tolist())
        if shown[-1] == 8:
            run._parts.carrier._scene._data.qvel[0] = np.nan

    ending = drive(run.batches(8), observe, lambda: None)
    assert isinstance(ending.error, InstabilityError)
    assert shown == list(range(9))


def test_the_flange_sensor_shows_the_last_tick(path: Path) -> None:
    """Its axes are those at the beginning of the tick."""
    wanted = scenario(path)
    row: Any = build_simulation(wanted)
    together(row, most=21)
    with python_takes_every_soft_half():
        ticks: Any = build_simulation(wanted)
        list(ticks.steps(21))
    found, expected = (run._parts.carrier._scene.flange.measured for run in (row, ticks))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_ticks_before_a_rigid_side_that_blows_up_are_shown(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of a row; what is saved is the state before that tick."""
    servos = ArmCarrier.servos

    def wrong(self: ArmCarrier, *given: Any) -> Any:
        found = servos(self, *given)
        if len(found.torque) > 20:
            found.torque[20, 0] = np.nan
        return found

    wanted = scenario(path)
    with monkeypatch.context() as patch:
        patch.setattr(ArmCarrier, "servos", wrong)
        failed = execute(wanted, build_simulation, Options(tmp_path), 0.0)
    assert isinstance(failed.error, InstabilityError)
    assert failed.summary["ticks"] == 20
    resumed = execute(wanted, build_simulation, Options(tmp_path, resume=True), 0.0)
    assert resumed.summary["resumed_at_ticks"] == [20]
    assert resumed.summary["status"] == "completed"


def test_a_soft_step_without_solution_leaves_the_state_before_it(path: Path, tmp_path: Path) -> None:
    sudden = {
        "phase__hold__ramp": "step",
        "phase__hold__cable_tension_N": [0.0, 15.0],
    }  # at rest it bears them
    wanted = scenario(path, clock__tick_s=0.01, **sudden)
    failed = execute(wanted, build_simulation, Options(tmp_path), 0.0)
    assert isinstance(failed.error, OutOfRangeError)
    assert failed.summary["ticks"] >= 8  # all of the first phase
    assert re.match(
        r"OutOfRangeError: phase 'hold', tick \d+ \(0\.\d+ s\), 25 kPa, cable left at \S+ N: even in steps "
        r"of 0\.312 ms: the section model ends here: section \d of \d \(.*\) is \w+ by .*, its model ends ",
        failed.summary["reason"],
    ), failed.summary["reason"]
    again = execute(wanted, build_simulation, Options(tmp_path, resume=True), 0.0)
    assert again.summary["resumed_at_ticks"] == [failed.summary["ticks"]]
    assert again.summary["ticks"] == failed.summary["ticks"]
    assert again.summary["reason"] == failed.summary["reason"]


def test_as_many_states_are_yielded_as_asked_for(path: Path) -> None:
    run = build_simulation(scenario(path))
    first = together(run, most=5)
    assert [snapshot.tick for snapshot in first] == list(range(5))
    assert run.saves_now  # none was taken beyond
    assert [snapshot.tick for snapshot in together(run, 3, 4)] == [5, 6, 7, 8]
    assert run.saves_now
    assert len(together(run)) == run.stage.ticks - 8


def test_stepping_by_hand_is_running(path: Path) -> None:
    wanted = scenario(path)
    whole, simulation = together(build_simulation(wanted)), Simulation(wanted)
    for ticks in (1, 20, 1, 30):
        simulation.step(ticks)
        assert_close([simulation.snapshot], [whole[simulation.snapshot.tick]], 0.0)


def test_an_interrupted_step_leaves_what_was_before(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(scenario(path))
    expected = Simulation(scenario(path)).step(30)
    simulation.step(4)
    taken = StaggeredCoupling.advance

    def interrupted(self: StaggeredCoupling, *given: Any) -> Any:
        taken(self, *given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(StaggeredCoupling, "advance", interrupted)
        with pytest.raises(KeyboardInterrupt):
            simulation.step(26)
    assert simulation.snapshot.tick == 4
    assert_close([simulation.step(26)], [expected], 0.0)
