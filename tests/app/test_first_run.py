"""What a first run waits for comes before its loop, and is told: no kernel is compiled within it."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import cosim
from cosim.app import driver
from cosim.build.kernel_modules import common_modules, contact_modules, kernel_modules
from cosim.config.loading import load_scenario
from cosim.recording import colours
from cosim.rigid.scene import step_loads
from tests.compiled import all_modules

ROOT = Path(__file__).resolve().parents[2]
PRESS = """
schema = 2
title = "A framed unit is pressed on a block"
robot = "ur5e"
start = { flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] } }
object = [{ name = "block", shape = "box", size_m = [0.2, 0.2, 0.1], position_m = [0.4, 0.0, 0.442] }]
phase = [{ name = "press", duration_s = 0.04, pressure_Pa = 5e3, increments = 4 }]
[soft_robot]
file = "hexagon_arm"
stack.units = 1
cable = []
stiffener = { kind = "beam", width_m = 3e-3, height_m = 3e-3, young_modulus_Pa = 2e9 }
"""
CURL = {
    "model.published": True,
    "phase.inflate.increments": 2,
    "phase.close.increments": 4,
    "phase.close.cable_tension_N": [2.5] * 6,
}
"""Just enough for the fingers to meet, in four increments: in two of 4 N they snap, which takes 50 s."""


def compiled() -> dict[str, int]:
    """Return how many times each kernel that is loaded has been compiled, or taken from the cache."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("cosim.")]
    kernels = [kernel for module in modules for kernel in kernels_of(module)]
    return {f"{kernel.__module__}.{kernel.__name__}": len(kernel.signatures) for kernel in kernels}


def kernels_of(module: ModuleType) -> list[Any]:
    """Return the kernels that a module holds."""
    return [value for value in vars(module).values() if getattr(value, "fixed_signature", None) is not None]


def check_runs(folder: Path) -> None:
    """Run scenarios in this process, which is new, and check the kernels after each."""
    before: dict[str, int] = {}
    drive = driver.drive

    def watched(*arguments: Any) -> Any:
        before.update(compiled())
        return drive(*arguments)

    driver.drive = watched
    path = folder / "press.toml"
    path.write_text(PRESS, encoding="utf-8")
    cosim.run(path, overrides={"object": [], "contact.only_in_reach": False})  # only the arm is there
    assert_nothing_came(before)
    assert compiled()["cosim.coupling.contact.contact_kernels.conclude"] == 0
    force = cosim.run(path, out=folder / "press", recording=True).contact_force_N
    assert force.max() > 0.0
    assert_nothing_came(before)
    cosim.run(path, overrides={"mode": "quasistatic"})
    assert_nothing_came(before)
    curled = cosim.run("gripper_closes_on_itself", overrides=CURL).summary
    assert curled["max_self_contact_force_N"] > 1.0
    assert_nothing_came(before)


def assert_nothing_came(before: dict[str, int]) -> None:
    now = compiled()
    assert {name: count for name, count in now.items() if count != before[name]} == {}
    # arrays that cannot be written to are of another type than those that can
    assert {name: count for name, count in now.items() if count > 1} == {}


def test_every_kernel_is_one_that_some_run_compiles_beforehand() -> None:
    all_modules()
    arm = load_scenario("ur5e_hexagon_arm")
    lumped = replace(arm, fidelity="lumped", contact=replace(arm.contact, self_contact=True))
    others = replace(lumped, fidelity="section"), replace(lumped, model=replace(lumped.model, closed=False))
    cables = tuple(replace(cable, losses="directed") for cable in arm.soft_robot.cables)
    others += (replace(lumped, soft_robot=replace(arm.soft_robot, cables=cables)),)
    lossy = replace(arm.soft_robot, film=replace(arm.soft_robot.film, loss_factor=0.05))
    stiff = replace(arm.soft_robot, stiffener=replace(arm.soft_robot.stiffener, kind="stiff"))
    others += replace(lumped, soft_robot=lossy), replace(lumped, fidelity="refined")
    apart = replace(lumped, contact=replace(arm.contact, self_contact=False))
    others += replace(lumped, soft_robot=stiff), apart
    some = (*kernel_modules(lumped), *(module for other in others for module in kernel_modules(other)))
    named: list[str] = []
    for module in (*common_modules(), *some, *contact_modules(), step_loads, colours):
        own = (value for value in kernels_of(module) if value.__module__ == module.__name__)
        named += [f"{value.__module__}.{value.__name__}" for value in own]
    assert set(compiled()) == set(named)


def test_no_kernel_is_compiled_in_the_loop_or_for_other_arguments_than_its_own(tmp_path: Path) -> None:
    code = "import sys, pathlib, tests.app.test_first_run as t; t.check_runs(pathlib.Path(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("start", [cosim.run, cosim.Simulation])
def test_python_is_told_what_takes_long(
    start: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
) -> None:
    told: list[str] = []

    def slow(announce: Callable[[str], None], more: Iterable[ModuleType]) -> None:
        told.extend(module.__name__ for module in more)
        announce("Compiling.")
        raise KeyboardInterrupt

    monkeypatch.setattr(driver, "compile_kernels", slow)
    with pytest.raises(KeyboardInterrupt):
        start("ur5e_hexagon_arm", overrides={"contact.self_contact": True})
    assert "cosim.soft.contact.self_contact_search" in told
    assert [(record.name, record.levelno) for record in caplog.records] == [("cosim", logging.WARNING)]
