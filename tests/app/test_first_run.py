"""Kernels are compiled for their own types of arguments alone, and `cosim warm-up` compiles all of them."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import cosim
from cosim.build import first_kernels
from cosim.cli.screen import logged_to
from tests.base.forked_python import run_forked
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
    path = folder / "press.toml"
    path.write_text(PRESS, encoding="utf-8")
    cosim.run(path, overrides={"object": [], "contact.only_in_reach": False})  # only the arm is there
    assert_own_arguments()
    assert compiled()["cosim.coupling.contact.contact_kernels.sum_contact_loads"] == 0
    force = cosim.run(path, out=folder / "press", recording=True).contact_force_N
    assert force.max() > 0.0
    assert_own_arguments()
    cosim.run(path, overrides={"mode": "quasistatic"})
    assert_own_arguments()
    curled = cosim.run("gripper_closes_on_itself", overrides=CURL).summary
    assert curled["max_self_contact_force_N"] > 1.0
    assert_own_arguments()
    together = *first_kernels.FILM, *first_kernels.IN_MOTION, *first_kernels.FRAMES, *first_kernels.FILMS_MEET
    assert [kernel.__name__ for kernel in together if not kernel.signatures] == []


def assert_own_arguments() -> None:
    # arrays that cannot be written to are of another type than those that can
    assert {name: count for name, count in compiled().items() if count > 1} == {}


def test_kernels_are_compiled_for_their_arguments(tmp_path: Path) -> None:
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


def test_a_first_run_compiles_long_kernels_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, asked = tmp_path / "press.toml", list[str]()
    path.write_text(PRESS, encoding="utf-8")
    monkeypatch.setattr(first_kernels, "is_ready", lambda kernel: False)
    monkeypatch.setattr(
        first_kernels, "compile_kernels", lambda kernels: asked.extend(kernel.__name__ for kernel in kernels)
    )
    cosim.Simulation(cosim.load_scenario(path))
    assert {"add_membranes", "substitute_singly", "add_beam_rings", "fill_over", "points_near"} <= {*asked}
    asked.clear()
    cosim.Simulation(cosim.load_scenario(path, {"contact.self_contact": False}))
    assert "add_membranes" in asked
    assert "fill_over" not in asked


def test_every_kernel_is_one_that_is_compiled_by_warming_up() -> None:
    code = (
        "from cosim.base import compilation; from cosim.app import preparation\n"
        "def say(kernels): print(*(f'{each.__module__}.{each.__name__}' for each in kernels))\n"
        "compilation.compile_kernels = say; preparation.warm_up()"
    )
    done = run_forked(code, ROOT)
    assert done.returncode == 0, done.stderr
    all_modules()
    assert set(done.stdout.split()) == set(compiled())


def test_log_messages_are_shown_with_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []
    log = logging.getLogger("cosim")
    with logged_to(told.append):
        log.warning("Compiling.")
        log.error("no room")
    assert told == ["Compiling."]
    assert capsys.readouterr().err == "no room\n"
