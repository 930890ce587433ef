"""A scenario as an FMU, run by another program's FMI master: the run itself, or what inputs make of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.cli.main import main

pytest.importorskip("pythonfmu", reason="needs pythonfmu")
fmpy = pytest.importorskip("fmpy", reason="needs fmpy")
SHORT: dict[str, Any] = {
    "soft_robot": "square_core", "start.cable_tension_N": [], "clock.tick_s": 0.004,
    "solver.damping_per_s": 2.0, "contact.enabled": False,
    "phase": [{"name": "fill", "duration_s": 0.2, "pressure_Pa": 5e3}],
}  # fmt: skip
STEP_S = 0.04


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an FMU of a short scenario."""
    from cosim.app.fmu import write_fmu

    path = tmp_path_factory.mktemp("fmu") / "filled.fmu"
    write_fmu("ur5e_hexagon_arm", path, SHORT)
    return path


def simulated(file: Path, **given: Any) -> Any:
    """Return what the FMI master has seen after each communication step."""
    return fmpy.simulate_fmu(str(file), stop_time=0.2, step_size=STEP_S, output_interval=STEP_S, **given)


def test_an_fmu_without_commands_is_the_run(file: Path) -> None:
    seen, simulation = simulated(file), cosim.Simulation("ur5e_hexagon_arm", overrides=SHORT)
    assert seen["time"].tolist() == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16, 0.2])
    for k in range(len(seen)):
        here = simulation.step(10) if k else simulation.snapshot
        tip = [seen[f"tip_position.{axis}"][k] for axis in "xyz"]
        np.testing.assert_allclose(tip, here.tip_position, rtol=0.0, atol=1e-9)
        force = [seen[f"flange_force.{axis}"][k] for axis in "xyz"]
        np.testing.assert_allclose(force, here.wrench.force, rtol=0.0, atol=1e-9)
        joints = [seen[f"joint_position.{name}"][k] for name in simulation.stage.joint_names]
        np.testing.assert_allclose(joints, here.joint_position, rtol=0.0, atol=1e-9)


def test_inputs_are_commands_reached_within_a_step(file: Path) -> None:
    """An input equal to its start value commands nothing; what differs does, with the joints left alone."""
    simulation = cosim.Simulation("ur5e_hexagon_arm", overrides=SHORT)
    (chamber,), joint = simulation.stage.chamber_names, simulation.stage.joint_names[0]
    start = simulation.snapshot.joint_position
    there = start + np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
    kind = [("time", float), (f"pressure_Pa.{chamber}", float), (f"joint_target.{joint}", float)]
    rows = [(0.0, 0.0, start[0]), (0.08, 0.0, start[0]), (0.08, 2e3, start[0]), (0.12, 2e3, start[0])]
    rows += [(0.12, 2e3, there[0]), (0.2, 2e3, there[0])]
    seen = simulated(file, input=np.array(rows, kind))
    simulation.step(20)
    simulation.step(cosim.Command(pressure_Pa={chamber: 2e3}), ticks=10)
    simulation.step(cosim.Command(pressure_Pa={chamber: 2e3}, joint_position=there), ticks=10)
    here = simulation.step(10)
    assert seen[f"chamber_pressure_Pa.{chamber}"][-1] == 2e3
    tip = [seen[f"tip_position.{axis}"][-1] for axis in "xyz"]
    np.testing.assert_allclose(tip, here.tip_position, rtol=0.0, atol=1e-9)


def test_steps_that_are_no_ticks_and_other_names_are_refused(
    file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(Exception, match="fmi2DoStep"):
        fmpy.simulate_fmu(str(file), stop_time=0.1, step_size=0.005, output_interval=0.005)
    assert main(["export-fmu", "ur5e_hexagon_arm", str(tmp_path / "an arm.fmu")]) == 2
    assert main(["export-fmu", "ur5e_hexagon_arm", str(tmp_path / "a.fmu"), "--set", "mode=quasistatic"]) == 2
    words = capfd.readouterr().err
    assert "must be a name of letters" in words
    assert "mode is 'quasistatic'" in words
