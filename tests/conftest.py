"""Kernels, compiled before the tests; and made-up runs: snapshots of one triangle, without any physics."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import pytest

from cosim.bars import study
from cosim.base.compilation import compile_modules
from cosim.base.kept_parts import KeptParts
from cosim.config.schema.scenario import Scenario
from cosim.soft.beams.beam_rings import StiffenerStrain
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.compiled import all_modules
from tests.ticks import changed, made_tick, read_film

TICKS_PER_PHASE = 5
_find = study.find_bars


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes() -> None:
    """Compile all kernels once, before several processes would each compile those that it needs."""
    compile_modules(all_modules())


def pytest_collection_finish() -> None:
    """Leave what is there before the first test out of every later search for garbage."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Solve no refined mesh for error bars, which takes most of a short run, unless a test asks for them."""
    marked = item.get_closest_marker("error_bars")

    def find(*given: Any, everywhere: bool, parts: KeptParts | None = None) -> RunErrors:
        if marked or everywhere:
            return _find(*given, everywhere=everywhere, parts=parts)
        return RunErrors(reason="left out of this test")

    setattr(study, "find_bars", find)  # noqa: B010 - it is a function for mypy


def made_up_stage(scenario: Scenario) -> RunInfo:
    """Return a stage with the scenario's phases, each of 5 ticks."""
    ticks = TICKS_PER_PHASE * len(scenario.phases)
    return RunInfo(
        scenario=scenario.name,
        title=scenario.title,
        mode=scenario.mode,
        tick_s=scenario.clock.tick_s,
        duration_s=ticks * scenario.clock.tick_s,
        ticks=ticks,
        phase_names=tuple(phase.name for phase in scenario.phases),
        joint_names=tuple(f"joint_{k}" for k in range(6)),
        body_names=("base", "tool"),
        shapes=(),
        soft_triangles=np.array([[0, 1, 2]]),
        cables=(np.array([0, 1]),),
        chamber_names=("chamber",),
        cable_names=("right",),
        soft_weight_N=8.52,
        gravity=np.array(scenario.gravity_m_s2),
        membrane_stress=lambda positions: np.zeros(1),
        report="made up",
        hinge_energy_share=lambda positions: 0.5,
        stiffener_strain=lambda positions: StiffenerStrain(0.01, 0.02),
    )


def made_up_snapshot(tick: int, tick_s: float) -> Snapshot:
    """Return a snapshot whose numbers all grow with the tick."""
    film = read_film(
        np.full((3, 3), float(tick)), np.array([1e-4 * (1.0 + tick)]),
        np.array([0.3, 0.0, 0.5 + 0.001 * tick]), np.array([0.0, 0.0, -1.0]), 0.001 * tick,
    )  # fmt: skip
    values = dict[str, Any](
        tick=tick,
        time_s=tick * tick_s,
        phase=max(tick - 1, 0) // TICKS_PER_PHASE,
        joint_position=np.full(6, 0.1 * tick),
        joint_velocity=np.full(6, 0.1 / tick_s),
        joint_torque=np.full(6, 1.0 * tick),
        joint_target=np.full(6, 0.1 * tick),
        body_position=np.zeros((2, 3)),
        body_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        body_contact_force=np.zeros((2, 3)),
        flange_position=np.array([0.3, 0.0, 0.7]),
        flange_rotation=np.eye(3),
        soft_center=np.array([0.3, 0.0, 0.6]),
        soft_inertia=np.diag([2e-3, 2e-3, 1e-3]),
        chamber_pressure_Pa=np.array([100.0 * tick]),
        cable_tension_N=np.array([1.0 * tick]),
        wrench=np.array([0.0, 0.0, -8.52, 0.1, 0.2, 0.3]),
        rigid_power_W=1.0,
        soft_power_W=-1.0 + 1e-6 * tick,
        residual_N=1e-9 * tick,
        newton_iterations=2,
        stability_ratio=0.01 * tick,
        tick_wall_s=1e-4,
    )
    return made_tick(film, values)


@dataclass
class MadeUpSimulation:
    """Yields made-up snapshots; `at_tick` is called with each tick before it is yielded."""

    stage: RunInfo
    at_tick: Callable[[int], None] = lambda tick: None
    next_tick: int = 0
    saves_now: bool = True

    def steps(self, most: int | None = None) -> Iterator[Snapshot]:
        """Yield tick 0 to the last, or those that are left."""
        for tick in islice(range(self.next_tick, self.stage.ticks + 1), most):
            self.at_tick(tick)
            snapshot = made_up_snapshot(tick, self.stage.tick_s)
            last_phase = tick > self.stage.ticks - TICKS_PER_PHASE
            target = np.array([0.3, 0.0, 0.5]) if last_phase else None
            self.next_tick = tick + 1
            yield snapshot if target is None else changed(snapshot, tip_target=target)

    def batches(self, most: int | None = None) -> Iterator[TickBatch]:
        """Yield the same, each as a batch."""
        return (TickBatch.of([snapshot]) for snapshot in self.steps(most))

    def advance(self, ticks: int) -> Snapshot:
        """Return the snapshot after some ticks."""
        return list(self.steps(ticks))[-1]

    def save_state(self) -> int:
        """Return the next tick."""
        return self.next_tick

    def restore_state(self, state: int) -> None:
        """Go on with a tick."""
        self.next_tick = state


@pytest.fixture
def made_up_build() -> Callable[..., Callable[[Scenario], MadeUpSimulation]]:
    """Return `factory(at_tick)`, which makes a `build` for the driver."""

    def factory(at_tick: Callable[[int], None] = lambda tick: None) -> Callable[[Scenario], MadeUpSimulation]:
        return lambda scenario, **_given: MadeUpSimulation(made_up_stage(scenario), at_tick)

    return factory
