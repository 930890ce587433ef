"""Linear models against differences of a run's ticks, and against the frequencies that it reports."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import cosim
from cosim.base.frames import Array
from cosim.base.kept_parts import KeptParts
from cosim.build import section_models
from cosim.errors import InputError
from tests.derivatives import differences, relative_error
from tests.small_section import on_a_ur5e, section

PULLED = {"right": 1.0, "left": 0.6}
PRESSURE_Pa = 25e3
STEPS = {"pressure_Pa": 10.0, "cable_tension_N": 1e-2, "flange_twist": 1e-2}
TICKS = 12
HEAVY = {"soft_robot.mass.node_mass_kg": 0.012, "start.flange.direction": [0.2, 0.0, -1.0]}
AXES = ("vx", "vy", "vz", "wx", "wy", "wz")


@pytest.fixture(autouse=True)
def _small_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)


@cache
def parts() -> KeptParts:
    return KeptParts()


def pulled(folder: Path, **changes: object) -> cosim.Simulation:
    """Return the arm of three units, drawn sideways and pulled by its cables, once it has come to rest."""
    path = folder / "small.toml"
    path.write_text(on_a_ur5e(PRESSURE_Pa, ""), encoding="utf-8")
    overrides = {
        "start.flange.direction": [1.0, 0.0, 0.2],
        "start.cable_tension_N": list(PULLED.values()),
        "solver.damping_per_s": 40.0,
        "solver.dynamic_tolerance_N": 1e-10,
        **changes,
    }
    simulation = cosim.Simulation(path, overrides=overrides, kept=parts())
    simulation.step(1000)
    return simulation


def command(name: str, change: float) -> cosim.Command:
    kind, _, of = name.partition(".")
    if kind == "pressure_Pa":
        return cosim.Command(pressure_Pa={"chamber": PRESSURE_Pa + change})
    if kind == "cable_tension_N":
        return cosim.Command(cable_tension_N={of: PULLED[of] + change})
    return cosim.Command(flange_twist=change * np.eye(6)[AXES.index(of)])


def tips(simulation: cosim.Simulation, name: str, change: float) -> Array:
    """Return the tip (ticks, 3) after a command that begins with the next tick; a twist ends with it."""
    here = simulation.save()
    found = [simulation.step(command(name, change)).tip_position]
    found += [simulation.step().tip_position for _ in range(TICKS - 1)]
    simulation.restore(here)
    return np.array(found)


def answer(model: cosim.LinearModel, name: str) -> Array:
    """Return the same of the linear model, per unit of the command."""
    a, b, c, d = model.held(1, [name])
    x, found = np.zeros(len(a)), []
    for k in range(TICKS):
        u = 1.0 if k == 0 or not name.startswith("flange_twist") else 0.0
        x = a @ x + b[:, 0] * u
        found.append(c @ x + d[:, 0] * u)
    return np.array(found)


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler", "bdf2, heavy"])
def test_the_ticks_of_a_linear_model_are_those_of_the_run(tmp_path: Path, integrator: str) -> None:
    kind, _, heavy = integrator.partition(", ")
    changes = {"solver.integrator": kind} | (HEAVY if heavy else {})
    simulation = pulled(tmp_path, **changes)
    model = cosim.linearise(simulation)
    carried = model.parts["joint_acceleration"].shape[0] > 0  # with algorithmic mass on the joints
    assert carried == bool(heavy)
    assert model.inputs == (
        "pressure_Pa", "cable_tension_N.right", "cable_tension_N.left",
        *(f"flange_twist.{axis}" for axis in AXES),
    )  # fmt: skip
    for name in model.inputs:
        step = STEPS[name.partition(".")[0]]
        run = differences(lambda change: tips(simulation, name, change[0]), np.zeros(1), step)[0]  # noqa: B023
        assert relative_error(answer(model, name), run) < 1e-6, name


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler, lossy"])
def test_the_ticks_of_a_film_with_all_its_motions_are_those_of_the_run(
    tmp_path: Path, integrator: str
) -> None:
    kind, _, lossy = integrator.partition(", ")
    changes = {"soft_robot.film.loss_factor": 0.2} if lossy else {}
    simulation = pulled(tmp_path, fidelity="lumped", **{"solver.integrator": kind}, **changes)
    model = cosim.linearise(simulation, motions=10_000)
    few = cosim.linearise(simulation, motions=20)
    assert len(few.a) < len(model.a) / 4
    for name in model.inputs:
        step = STEPS[name.partition(".")[0]]
        run = differences(lambda change: tips(simulation, name, change[0]), np.zeros(1), step)[0]  # noqa: B023
        assert relative_error(answer(model, name), run) < 1e-6, name
        assert relative_error(answer(few, name), run) < 0.01, name


def test_a_model_of_held_commands_is_that_of_its_ticks_in_a_row(tmp_path: Path) -> None:
    model = cosim.linearise(pulled(tmp_path))
    a, b, c, d = model.held(1, ["flange_twist.vx", "cable_tension_N.left"])
    many_a, many_b, many_c, many_d = model.held(3, ["flange_twist.vx", "cable_tension_N.left"])
    assert many_a == pytest.approx(a @ a @ a, rel=1e-9, abs=1e-9)
    assert many_b == pytest.approx(a @ (a @ b + b) + b, rel=1e-9, abs=1e-9)
    assert (many_c == c).all()
    assert (many_d == d).all()
    with pytest.raises(InputError, match=r"no input 'flange_twist.v'.*flange_twist.vx"):
        model.held(1, ["flange_twist.v"])


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler", "bdf2, lumped"])
def test_its_modes_are_those_that_the_run_reports(tmp_path: Path, integrator: str) -> None:
    integrator, _, fidelity = integrator.partition(", ")
    phase = {"name": "hold", "duration_s": 0.1, "cable_tension_N": list(PULLED.values())}
    changes = {"robot": "none", "phase": [phase], "solver.integrator": integrator}
    changes |= {"fidelity": fidelity} if fidelity else {}
    path = tmp_path / "held.toml"
    path.write_text(on_a_ur5e(PRESSURE_Pa, ""), encoding="utf-8")
    start = {"start.cable_tension_N": list(PULLED.values()), "solver.damping_per_s": 4.0}
    simulation = cosim.Simulation(path, overrides={**changes, **start}, kept=parts())
    simulation.step(simulation.ticks_left)
    footing = simulation.snapshot.stability
    assert footing is not None
    model = cosim.linearise(simulation)
    frequencies, decays, shapes = model.modes(len(footing.frequencies_Hz))
    # the run reports frequencies without losses: |l|, and c / 2 is the decay of all
    assert frequencies == pytest.approx(footing.frequencies_Hz, rel=1e-5 if fidelity else 1e-6)
    assert decays == pytest.approx(2.0, rel=1e-4)
    assert np.abs(shapes).max(axis=(1, 2)) == pytest.approx(1.0)
    assert model.inputs == ("pressure_Pa", "cable_tension_N.right", "cable_tension_N.left")


def test_modes_are_written_as_moving_shapes(tmp_path: Path) -> None:
    phase = {"name": "hold", "duration_s": 0.1}
    path, written = tmp_path / "held.toml", tmp_path / "modes.rrd"
    path.write_text(on_a_ur5e(PRESSURE_Pa, ""), encoding="utf-8")
    simulation = cosim.Simulation(path, overrides={"robot": "none", "phase": [phase], "fidelity": "lumped"})
    simulation.step()
    model = cosim.linearise(simulation)
    model.write_modes(simulation, written, count=2)
    chunks = [chunk.to_record_batch() for chunk in RrdReader(written).stream().to_chunks()]
    films = [
        np.array(film.as_py())
        for chunk in chunks if "Mesh3D:vertex_positions" in chunk.schema.names
        for film in chunk.column("Mesh3D:vertex_positions")
    ]  # fmt: skip
    rest = np.array(simulation.snapshot.node_position)
    moved = np.array(films) - rest
    assert len(moved) == 120
    _, _, shapes = model.modes(2)
    for k, shape in enumerate(shapes):
        own, size = moved[60 * k : 60 * (k + 1)], 0.08 * np.ptp(rest, axis=0).max()
        assert own[0] == pytest.approx(size * shape.real, abs=1e-6)
        assert own[15] == pytest.approx(-own[0], abs=1e-6)  # half a swing later
        assert own[30] == pytest.approx(own[0], abs=1e-6)


CABLES = [f"cable_tension_N.{name}" for name in PULLED]


@pytest.mark.parametrize("fidelity", ["section", "lumped"])
def test_before_the_first_tick_the_model_is_that_of_ticks_to_come(tmp_path: Path, fidelity: str) -> None:
    path = tmp_path / "small.toml"
    path.write_text(on_a_ur5e(PRESSURE_Pa, ""), encoding="utf-8")
    overrides = {"fidelity": fidelity, "start.cable_tension_N": list(PULLED.values())}
    simulation = cosim.Simulation(path, overrides=overrides, kept=parts())
    early = cosim.linearise(simulation, inputs=CABLES)
    assert simulation.snapshot.tick == 0
    simulation.step(3)
    late = cosim.linearise(simulation, inputs=CABLES)
    for model in (early, late):
        assert np.abs(np.linalg.eigvals(model.a)).max() < 1.0
    gains = [
        model.c @ np.linalg.solve(np.eye(len(model.a)) - model.a, model.b) + model.d
        for model in (early, late)
    ]
    # at rest, ticks hardly move what the tangent is taken at
    assert relative_error(*gains) < 1e-3


def test_references_that_no_input_moves_are_left_out(tmp_path: Path) -> None:
    whole = cosim.linearise(pulled(tmp_path))
    for model in (whole, whole.slow(60.0)):
        alone = model.driven_by(CABLES)
        assert len(alone.a) == len(model.a) - 6
        assert alone.parts["joint_position"].shape == (6, len(alone.a))
        assert np.abs(np.linalg.eigvals(alone.a)).max() < 1.0
        ends = []
        for each in (model, alone):
            a, b, c, d = each.held(40, CABLES)
            ends.append(c @ b + d)
            assert len(a) == len(alone.a)
        assert relative_error(*ends) < 1e-9
    assert len(whole.driven_by(["flange_twist.vx"]).a) > len(whole.a) - 6
    with pytest.raises(InputError, match="no input 'cable'"):
        cosim.linearise(pulled(tmp_path), inputs=["cable"])


def test_rigid_bodies_and_statics_have_no_linear_model(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(on_a_ur5e(PRESSURE_Pa, ""), encoding="utf-8")
    for changes in ({"fidelity": "rigid"}, {"coupling.scheme": "iterated"}):
        simulation = cosim.Simulation(path, overrides=changes, kept=parts())
        simulation.step()
        with pytest.raises(InputError, match=r"set (mode|coupling)"):
            cosim.linearise(simulation)


def test_slow_motions_alone_move_the_tip_as_the_whole_model_does(tmp_path: Path) -> None:
    model = cosim.linearise(pulled(tmp_path))
    slow = model.slow(60.0)
    assert len(slow.a) < len(model.a) / 4
    assert slow.modes(3)[0] == pytest.approx(model.modes(3)[0], rel=1e-6)
    for ticks in (40, 400):  # a swing, and at rest
        ends = []
        for each in (model, slow):
            _, b, c, d = each.held(ticks, ["cable_tension_N.right", "flange_twist.vx"])
            ends.append(c @ b + d)
        assert relative_error(*ends) < 2e-3
