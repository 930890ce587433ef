"""Ticks of a lumped film that are taken together, in one kernel, are those that are taken one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import build_simulation
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.schemes import soft_halves
from cosim.soft.solve.newton import NewtonSolver
from cosim.telemetry.snapshot import Snapshot
from tests.stepping.snapshots import assert_close, kernels_take, python_takes_every_soft_half

TICKS = 120
SCENARIO = """
schema = 2
title = "Two units with printed frames on a UR5e, above a block"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2, mesh = "drawn" }, cable = [
  { name = "right", corner = 0, units = [1, 2], capstan_factor = 0.8 }] }
fidelity = "lumped"
clock = { tick_s = 0.002 }
solver = { damping_per_s = 5.0 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 2e3

[[object]]
name = "block"
shape = "box"
size_m = [0.3, 0.3, 0.1]
position_m = [0.4, 0.0, 0.4175]

[[phase]]
name = "turn"
duration_s = 0.1
settle_s = 0.02
pressure_Pa = 2.5e3
cable_tension_N = [0.5]
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }

[[phase]]
name = "lower"
duration_s = 0.1
settle_s = 0.02
flange_shift_m = [0.0, 0.0, -0.02]
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("rows") / "two_units.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    return file


def scenario(path: Path, **changes: Any) -> Scenario:
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    return load_scenario(path, overrides)


def one_by_one(wanted: Scenario) -> list[Snapshot]:
    """Return all ticks without the kernel."""
    with python_takes_every_soft_half():
        return list(build_simulation(wanted).steps())


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_rows_are_ticks_in_contact_too(path: Path, integrator: str) -> None:
    """Up to rounding: the torque of a payload is summed in another order."""
    # films of the graded mesh press on one another as well and ask for other patterns: see below for those
    changes = {"solver__integrator": integrator, "contact__self_contact": False}
    wanted = scenario(path, solver__damping_per_s=5.0, **changes)
    rows, together = kernels_take(build_simulation(wanted))
    ticks = one_by_one(wanted)
    touching = {snapshot.tick for snapshot in ticks if snapshot.ledger.contacts}
    assert touching, "the block is reached"
    before = set(range(1, min(touching)))
    for some in (before, touching):
        assert len(some & together) > 0.6 * len(some)
    assert np.ptp([snapshot.tip_position for snapshot in ticks], axis=0).max() > 5e-3
    # a step ends anywhere within its tolerance: where a kept factor just serves, or just does not
    assert_close(rows[: min(touching)], ticks[: min(touching)], 2e-6)
    found, expected = rows[-1].ledger.contact_force_N, ticks[-1].ledger.contact_force_N
    assert found == pytest.approx(expected, rel=1e-3)


LOOSE = """
[[object]]
name = "plate"
shape = "box"
size_m = [0.12, 0.12, 0.004]
position_m = [0.4, 0.0, 0.4698]
mass_kg = 2.0
"""


@pytest.mark.parametrize("inside", [True, False], ids=["tangents in kernels", "and elsewhere"])
@pytest.mark.parametrize("loose", [False, True], ids=["fixed", "a loose plate on it"])
def test_rows_are_ticks_bit_for_bit_from_the_same_rigid_halves(
    path: Path, loose: bool, inside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether a tick goes in a row, is left in the middle of its soft step, or before it, leaves no trace."""
    if loose:
        path = path.with_name("loose.toml")
        path.write_text(SCENARIO + LOOSE, encoding="utf-8")
    if not inside:
        none = property(lambda solver: lambda film: solver._no_tangents)
        monkeypatch.setattr(NewtonSolver, "_tangents", none)
    # a step that the kernel has tried before it is left, as the plate gives way otherwise, may have made
    # another tangent: by BDF2 the step that Python takes then ends elsewhere, by 2e-14 m
    wanted = scenario(path, **({"solver__integrator": "implicit_euler"} if loose else {}))
    rows, together = kernels_take(build_simulation(wanted))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soft_halves, "LARGE_TURN_RAD", -1.0)  # every flange turns further in a tick
        ticks, alone = kernels_take(build_simulation(wanted))
    assert not alone
    touching = {snapshot.tick for snapshot in ticks if snapshot.ledger.contacts}
    # a tick whose tangent is made elsewhere is left: both kinds are to be among them
    assert len(touching & together) > (0.5 if inside else 0.3) * len(touching)
    if not inside:
        assert touching - together, "some are left in the middle"
    assert_close(rows, ticks, 0.0)
    if loose:
        assert max(snapshot.ledger.contact_ratio for snapshot in ticks) > 0.0
        assert np.abs(ticks[-1].body_contact_force[-1]).max() > 0.1


LOSSY: dict[str, Any] = {"soft_robot__film__loss_factor": 0.05, "solver__integrator": "bdf2"}


def test_rows_know_losses_of_materials(path: Path) -> None:
    wanted = scenario(path, **LOSSY)
    rows, together = kernels_take(build_simulation(wanted))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soft_halves, "LARGE_TURN_RAD", -1.0)  # every flange turns further in a tick
        ticks, alone = kernels_take(build_simulation(wanted))
    plain, plain_together = kernels_take(build_simulation(scenario(path, solver__integrator="bdf2")))
    assert not alone
    assert len(together) > 0.9 * len(plain_together)
    assert_close(rows, ticks, 0.0)
    apart = [
        np.abs(one.tip_position - other.tip_position).max() for one, other in zip(rows, plain, strict=True)
    ]
    assert max(apart) > 1e-5


@pytest.mark.parametrize(("most", "changes"), [(38, {}), (70, {}), (83, {}), (70, LOSSY)])
def test_a_run_that_is_restored_goes_on_as_it_would_have(
    path: Path, most: int, changes: dict[str, Any]
) -> None:
    run: Any = build_simulation(scenario(path, **changes))
    list(run.batches(most=most))
    saved = run.save_state()
    first = [snapshot for batch in run.batches(7) for snapshot in batch]
    again: Any = build_simulation(scenario(path, **changes))
    again.restore_state(saved)
    assert_close([snapshot for batch in again.batches(64) for snapshot in batch], first, 0.0)


def test_a_tick_that_the_kernel_leaves_is_finished(path: Path) -> None:
    """The first tick of a run has no factorisation; a flange that turns far needs another start."""
    run: Any = build_simulation(scenario(path))
    _, together = kernels_take(run)
    assert 1 not in together
    assert {3, 4, 5} <= together


CURL: dict[str, Any] = {
    "contact__self_contact": True,
    "soft_robot__stack__units": 3,
    "soft_robot__stiffener__width_m": 3e-3,  # films of softer frames are lost and found in most ticks
    "soft_robot__stiffener__height_m": 3e-3,
    "soft_robot__stiffener__young_modulus_Pa": 2e9,
    "soft_robot__cable": [{"name": "right", "corner": 0, "units": [1, 3], "capstan_factor": 1.0}],
    "phase__turn__cable_tension_N": [20.0],
    "phase__turn__pressure_Pa": 3e3,
    "phase__lower__flange_shift_m": [0.0, 0.0, 0.0],
}


@pytest.mark.parametrize("asked", [True, "auto"])
def test_ticks_in_which_films_touch_one_another_go_in_rows(path: Path, asked: Any) -> None:
    """A tick that is left in the middle, for a tangent or new lists, is finished as it began."""
    wanted = scenario(path, **{**CURL, "contact__self_contact": asked})
    rows, together = kernels_take(build_simulation(wanted))
    touching = {snapshot.tick for snapshot in rows if snapshot.ledger.self_contacts}
    assert len(touching) > 0.5 * len(rows)
    assert len(touching & together) > 0.8 * len(touching)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soft_halves, "LARGE_TURN_RAD", -1.0)  # every flange turns further in a tick
        ticks, alone = kernels_take(build_simulation(wanted))
    assert not alone
    assert max(snapshot.ledger.self_contact_force_N for snapshot in ticks) > 1.0
    assert_close(rows, ticks, 0.0)


def test_contact_is_modelled_from_where_films_come_to_press(path: Path) -> None:
    """Until then a run is that without contact, to the last bit; then that with contact throughout."""
    auto, never, always = (
        list(build_simulation(scenario(path, **{**CURL, "contact__self_contact": asked})).steps())
        for asked in ("auto", False, True)
    )
    first = next(k for k, snapshot in enumerate(auto) if snapshot.ledger.self_contacts)
    assert first > 10
    assert_close(auto[:first], never[:first], 0.0)
    assert not np.array_equal(auto[first].node_position, never[first].node_position)
    for one, other in zip(auto, always, strict=True):
        np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=0.0, atol=1e-4)
    assert np.abs(auto[-1].tip_position - never[-1].tip_position).max() > 1e-4


def test_ticks_that_are_solved_closely_take_few_iterations(path: Path) -> None:
    """Rings of beams that end their search as in ordinary ticks leave 2e-6 N, which no iteration removes."""
    changes = {"solver__dynamic_tolerance_N": 1e-7, "solver__dynamic_newton_iterations": 50}
    iterations = [s.ledger.newton_iterations for s in build_simulation(scenario(path, **changes)).steps()]
    assert max(iterations) < 20  # 50 and more where they are at the bound
    assert float(np.mean(iterations)) < 6.0
