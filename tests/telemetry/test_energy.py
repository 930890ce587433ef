"""The energy balance of a run in time closes, and names what the integrator takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.app.shown_state import check_shown
from cosim.base.names import LOST, TERMS
from cosim.base.names import PUT_IN as ALL_PUT_IN
from cosim.recording.plots import plots_of

SCENARIO = """
schema = 2
title = "Two units that a jerk of the flange shakes while a cable pulls"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [
  { name = "right", corner = 0, units = [1, 2], capstan_factor = 0.8 }] }
fidelity = "lumped"
clock = { tick_s = 0.002 }
solver = { damping_per_s = 5.0, air_drag_per_s = 2.0 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 2e3

[[phase]]
name = "jerk"
duration_s = 0.08
settle_s = 0.08
pressure_Pa = 4e3
cable_tension_N = [1.0]
flange_shift_m = [0.02, 0.0, 0.0]
"""
BLOCK = """
[[object]]
name = "block"
shape = "box"
size_m = [0.1, 0.1, 0.04]
position_m = [{0}, {1}, {2}]
"""
PUT_IN = ("gas_J", "cables_J", "flange_J", "gravity_J")


def last_phase(tmp_path: Path, text: str = SCENARIO, **changes: Any) -> dict[str, Any]:
    file = tmp_path / "jerk.toml"
    file.write_text(text, encoding="utf-8")
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    found: dict[str, Any] = cosim.run(file, overrides=overrides).summary["phases"][-1]
    return found


def balance(tmp_path: Path, text: str = SCENARIO, **changes: Any) -> dict[str, float]:
    found: dict[str, float] = last_phase(tmp_path, text, **changes)["energy"]
    return found


def test_the_balance_closes_with_what_the_integrator_takes(tmp_path: Path) -> None:
    found = {name: balance(tmp_path, solver__integrator=name) for name in ("implicit_euler", "bdf2")}
    for energy in found.values():
        put_in = sum(abs(energy[name]) for name in PUT_IN)
        assert abs(energy["rest_J"]) < 0.01 * put_in
        assert min(energy[name] for name in ("damping_J", "air_drag_J", "elastic_J")) > 0.0
        # losses of one way: what the film gains in length by its pressure is given back by the cable
        assert energy["eyelets_J"] != 0.0
    euler, bdf2 = found["implicit_euler"], found["bdf2"]
    # first order in the tick, second: of a swing of some hertz a multiple
    assert euler["numerical_J"] > 5.0 * abs(bdf2["numerical_J"])
    # what the integrator takes is no part of what is left over
    assert abs(euler["rest_J"]) < 0.02 * euler["numerical_J"]


def test_what_touches_and_eyelets_that_know_their_way_are_no_part_of_the_rest(tmp_path: Path) -> None:
    x, y, z = last_phase(tmp_path)["tip_position_m"]
    text = SCENARIO.replace("[0.02, 0.0, 0.0]", "[0.005, 0.0, -0.01]")
    text = text.replace("capstan_factor = 0.8", 'capstan_factor = 0.8, losses = "directed"')
    text += BLOCK.format(x, y, z - 0.02 - 0.004)  # its top is 4 mm below the tip, which comes down by 10 mm
    # a half more where damping has velocities for displacements: in a hit they jump from tick to tick.
    # The rest falls with the tick; film that presses on itself or on the flange's face has a part in it
    energy = balance(tmp_path, text, solver__integrator="bdf2", clock__tick_s=0.001)
    put_in = sum(abs(energy[name]) for name in PUT_IN)
    assert abs(energy["contacts_J"]) > 0.03 * put_in
    assert energy["eyelets_J"] > 0.0  # against the way that the cable slides
    assert abs(energy["rest_J"]) < 0.007 * put_in


def released(tmp_path: Path, losses: str) -> dict[str, Any]:
    """Return the summary of a run that pulls the cable, and then lets it go."""
    text = SCENARIO.replace("capstan_factor = 0.8", f'capstan_factor = 0.8, losses = "{losses}"')
    text = text.replace("flange_shift_m = [0.02, 0.0, 0.0]", "") + RELEASE
    file = tmp_path / "release.toml"
    file.write_text(text, encoding="utf-8")
    found: dict[str, Any] = cosim.run(file, error=False).summary
    return found


RELEASE = """
[[phase]]
name = "release"
duration_s = 0.08
settle_s = 0.04
cable_tension_N = [0.0]
"""


def test_energy_that_losses_of_one_way_make_is_named(tmp_path: Path) -> None:
    summary = released(tmp_path, "one_way")
    pull, release = (phase["energy"] for phase in summary["phases"])
    made = release["eyelets_made_J"] - pull["eyelets_made_J"]
    # all that eyelets take as the cable is let go, less what they lose as it swings once
    given_back = pull["eyelets_J"] - release["eyelets_J"]
    assert 0.0 < given_back < made < 1.5 * given_back
    (warning,) = (text for text in summary["warnings"] if "eyelets make" in text)
    assert warning.startswith("phase 'release': eyelets make ")
    left = [row["what"] for row in summary["modelled"] if not row["included"]]
    assert "direction of cable losses" in left


def test_directed_losses_make_no_energy(tmp_path: Path) -> None:
    summary = released(tmp_path, "directed")
    assert summary["phases"][-1]["energy"]["eyelets_made_J"] == 0.0
    assert not any("eyelets make" in text for text in summary["warnings"])
    assert "direction of cable losses" not in [row["what"] for row in summary["modelled"]]


DROPPED = """
schema = 2
title = "A block falls by 50 mm on two upright units"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [] }
solver = { integrator = "bdf2" }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, 1.0] }
pressure_Pa = 30e3

[[object]]
name = "block"
shape = "box"
size_m = [0.04, 0.04, 0.04]
position_m = [0.4, 0.0, 0.9]
mass_kg = 0.1

[[phase]]
name = "drop"
duration_s = 0.24
"""


def test_ticks_in_pieces_close_the_balance_and_a_block_bounces_as_in_short_ticks(tmp_path: Path) -> None:
    file = tmp_path / "drop.toml"
    file.write_text(DROPPED, encoding="utf-8")
    top = float(cosim.Simulation(file).snapshot.node_position[:, 2].max())
    place = [0.4, 0.0, top + 0.02 + 0.05]
    restitution, found = [], []
    for tick_s in (2e-3, 2.5e-4):
        changes = {"object.block.position_m": place, "clock.tick_s": tick_s}
        run = cosim.run(file, overrides=changes, error=False)
        speed = np.diff(run.body_position[:, run.stage.body_names.index("block"), 2]) / tick_s
        restitution.append(float(speed.max() / -speed.min()))
        found.append(run)
    energy = found[0].summary["phases"][-1]["energy"]
    put_in = sum(abs(energy[name]) for name in PUT_IN)
    # 67 mJ of 80 where accelerations were taken over whole ticks
    assert abs(energy["rest_J"]) < 0.005 * put_in
    # 0.67 and 0.79 with two steps of MuJoCo in 2 ms
    assert restitution[0] == pytest.approx(restitution[1], rel=0.1)
    # one tick at a time, as a loop of someone else takes them, pieces are known as well
    simulation = cosim.Simulation(file, overrides={"object.block.position_m": place})
    snapshot = next(each for _ in range(60) if (each := simulation.step()).table.substeps)
    (pieces,) = snapshot.table.substeps.values()
    assert len(pieces.positions) == 4
    np.testing.assert_array_equal(pieces.positions[-1], snapshot.node_position)
    assert not pieces.positions.flags.writeable
    check_shown(snapshot.kept(), simulation.stage)  # as a resumed run does with the last one


LOSSY: dict[str, Any] = {"solver__integrator": "bdf2", "soft_robot__film__loss_factor": 0.05}


def test_the_balance_counts_what_materials_lose(tmp_path: Path) -> None:
    plain = last_phase(tmp_path, **(LOSSY | {"soft_robot__film__loss_factor": 0.0}))
    found = last_phase(tmp_path, **LOSSY)
    energy = found["energy"]
    put_in = sum(abs(energy[name]) for name in PUT_IN)
    assert plain["energy"]["material_damping_J"] == 0.0
    assert energy["material_damping_J"] > 0.05 * put_in
    assert abs(energy["rest_J"]) < 0.01 * put_in
    # every mode is told what its materials take, more of those that swing faster
    decays = [row["declared_decay_per_s"] for row in found["modes"]]
    assert [row["declared_decay_per_s"] for row in plain["modes"]] == pytest.approx([3.5] * 4)
    assert min(decays) > 2.0 * 3.5
    assert decays[3] > 2.0 * decays[0]


@pytest.mark.parametrize(
    ("changes", "switch"),
    [
        ({"fidelity": "rigid"}, "fidelity"),
        ({"mode": "quasistatic"}, "mode"),
        ({}, "soft_robot.film.loss_factor"),
    ],
)
def test_a_run_says_whether_it_knows_losses_of_materials(
    tmp_path: Path, changes: dict[str, Any], switch: str
) -> None:
    file = tmp_path / "jerk.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    overrides: dict[str, Any] = {"soft_robot.film.loss_factor": 0.05, **changes}
    rows = cosim.Simulation(file, overrides=overrides).stage.modelled
    (row,) = [row for row in rows if row.what == "losses of the film's material"]
    assert (row.included, row.switch) == (not changes, switch)


def test_statics_and_other_models_have_no_balance(tmp_path: Path) -> None:
    assert balance(tmp_path, fidelity="rigid") is None


def test_the_balance_is_in_the_arrays_and_adds_up_at_every_tick_that_has_it_whole(tmp_path: Path) -> None:
    file = tmp_path / "jerk.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    result = cosim.run(file, out=tmp_path / "out")
    energy = dict(zip(TERMS, result.energy_J.T, strict=True))
    at_end = result.summary["phases"][-1]["energy"]
    whole = np.flatnonzero(~np.isnan(energy["rest_J"]))
    assert result.time_s[whole].tolist() == pytest.approx([0.0, 0.1])
    for name, column in energy.items():
        if name in ("elastic_J", "rest_J"):
            assert np.isnan(np.delete(column, whole)).all()
        else:
            assert column[-1] == pytest.approx(at_end[name], rel=1e-12)
    put_in, lost = (sum(energy[name] for name in names) for names in (ALL_PUT_IN, LOST))
    left = put_in - lost - energy["elastic_J"] - energy["kinetic_J"]
    assert left[whole] == pytest.approx(energy["rest_J"][whole], abs=1e-12)
    # what is written is what is read
    read = cosim.load_run(tmp_path / "out")
    np.testing.assert_array_equal(read.energy_J, result.energy_J)


def test_a_recording_shows_every_term_of_the_balance(tmp_path: Path) -> None:
    file = tmp_path / "jerk.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    simulation = cosim.Simulation(file)
    plots = [plot for plot in plots_of(simulation.stage, 6) if plot.tab == "Energy"]
    shown = [name for plot in plots for name in plot.series]
    assert sorted(shown) == sorted(name.removesuffix("_J").replace("_", " ") for name in TERMS)
    assert [
        plot for plot in plots_of(replace(simulation.stage, energy=None), 6) if plot.tab == "Energy"
    ] == []
