"""Checks that a plan stays within the range of a section model, before the run. The plan is passed through on
the statics; where a phase accelerates the flange, gravity g is replaced by g - y, with y the equivalent
static acceleration of the arm's swing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.errors import ConvergenceError, OutOfRangeError, ScenarioError
from cosim.plan import ramp, static_plan
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import loads_of
from cosim.plan.decision import SECTION_RANGE, Decision
from cosim.plan.plan import PhasePlan, Plan
from cosim.plan.swing import FlangeAcceleration
from cosim.soft.solve.state import Equilibrium

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm


_PIECES = 20  # load steps of a phase
_SLOW = 0.1  # accelerations below this fraction of gravity are not checked
_PROBE = 0.02  # of gravity, to the side
_RANGE = " out of its section model's range: "
_FIRST_MODE = (
    1.5  # w^2 d / a, d the tip's deflection under an even load a: 1.55 of a beam, 1.45 of a hanging rope
)
_MOVED_BY: Final = (
    "flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target", "tip_path", "cable_tension_N",
    "forces", "pressure_Pa", "release", "clamp",
)  # fmt: skip
_DRIVEN_BY: Final = ("cable_length_m", "cable_shortening_m", "control", "pump_pressure_Pa")


def section_range(
    scenario: Scenario, plan: Plan, soft: SoftRobot, arm: Arm | None, touched: bool
) -> Decision:
    """Return whether the soft arm stays within its model's range, as far as the plan determines its shape.

    Args:
        scenario: checked.
        plan: of the run.
        soft: soft side at its start; its state is changed.
        arm: of Pinocchio; None if the flange does not move.
        touched: whether contact is modelled. It may support the arm, so leaving the range is then reported
            and not refused.

    Raises:
        ScenarioError: the arm leaves the range; `path` names the key.
    """
    try:
        known = _Walk(scenario, plan, soft, arm).through()
    except ScenarioError as error:
        if not touched:
            raise
        reason = f"{error.faults[0][1]}; this check leaves contact out"
        return Decision(SECTION_RANGE, False, reason, error.path)
    return Decision(SECTION_RANGE, True, f"{known} bears the plan's loads and accelerations", "fidelity")


@final
class _Walk:
    """Solves the arm's equilibria through a plan."""

    def __init__(self, scenario: Scenario, plan: Plan, soft: SoftRobot, arm: Arm | None) -> None:
        self._plan, self._soft, self._arm = plan, soft, arm
        self._commanded = bool(scenario.commands)
        self._dynamic = scenario.mode == "dynamic"
        self._gas = ChamberGas(scenario.gas)

    def through(self) -> str:
        """Return text on the part of the plan in which the arm is in its range.

        Raises:
            ScenarioError: it leaves the range.
        """
        here = None
        for planned in self._plan.phases:
            name = planned.phase.name
            if self._commanded or any(getattr(planned.phase, key) for key in _DRIVEN_BY):
                return f"up to phase '{name}', in which devices or commands drive it, the arm"
            try:
                here = self._phase(planned, here or self._start())
            except OutOfRangeError as error:
                raise _refused_phase(planned.phase, error) from error
            except ConvergenceError:
                return f"up to phase '{name}', in which it loses its equilibrium, the arm"
            if self._gas.flows:
                return f"up to the end of phase '{name}', in which gas flows, the arm"
        return "the arm"

    def _start(self) -> Equilibrium:
        plan = self._plan
        try:
            here = static_plan.start_equilibrium(self._soft, plan.start, loads_of(plan.command, plan.gravity))
        except OutOfRangeError as error:
            raise ScenarioError("start", _refusal(f"the arm is{_RANGE}{error.place}")) from error
        self._soft.commit(here)
        return here

    def _phase(self, planned: PhasePlan, here: Equilibrium) -> Equilibrium:
        planned.holding.apply(self._soft, here.world_from_flange)
        self._gas.begin(planned.gas, self._soft)
        self._check_swing(planned, here)
        still = planned.joints.spline is None and planned.begin is planned.end and not self._gas.flows
        for fraction in np.linspace(0.0, 1.0, 1 if still else _PIECES + 1).tolist():
            here = self._at(planned, here, fraction)
            self._soft.commit(here)
        return here

    def _at(
        self, planned: PhasePlan, here: Equilibrium, fraction: float, less: Array | None = None
    ) -> Equilibrium:
        """Return the equilibrium at a fraction of a phase, gravity less an acceleration (3,) [m/s^2]."""
        pose = here.world_from_flange
        if self._arm is not None and planned.joints.spline is not None:
            pose = self._arm.forward(planned.joints.at(ramp.Progress(fraction, 0.0, 0.0)).position)
        command = self._gas.between(planned.begin, planned.end, fraction)
        gravity = np.array(self._plan.gravity)
        x, y, z = (gravity if less is None else gravity - less).tolist()
        return self._soft.follow(here, pose, loads_of(command, (x, y, z)))

    def _check_swing(self, planned: PhasePlan, here: Equilibrium) -> None:
        """Check that the arm does not swing out of its range when the flange accelerates.

        Raises:
            ScenarioError: it does.
        """
        found = FlangeAcceleration.of(self._arm, planned) if self._arm and self._dynamic else None
        size = float(np.linalg.norm(self._plan.gravity))
        if found is None or 2.0 * float(np.linalg.norm(found.largest)) < _SLOW * size:
            return
        here = self._at(planned, here, 0.0)
        fraction, swing = found.swing(self._rate(planned, here, found.largest))
        for part in np.linspace(0.0, fraction, _PIECES + 1).tolist():
            here = self._at(planned, here, part)
        try:
            self._at(planned, here, fraction, swing)
        except OutOfRangeError as error:
            largest = float(np.linalg.norm(found.largest))
            text = f"accelerates the flange by up to {largest:.3g} m/s^2; the arm swings{_RANGE}{error.place}"
            key = f"phase.{planned.phase.name}.duration_s"
            raise ScenarioError(key, _refusal(f"{text}; take longer")) from error
        except ConvergenceError:
            return

    def _rate(self, planned: PhasePlan, here: Equilibrium, along: Array) -> float:
        """Return the rate [rad/s] of the arm's first mode along a direction, from its deflection."""
        probe = _PROBE * 9.81
        moved = self._at(planned, here, 0.0, probe * along / np.linalg.norm(along))
        body = self._soft.body
        shift = body.tip_position(moved.state.positions) - body.tip_position(here.state.positions)
        return float(np.sqrt(_FIRST_MODE * probe / max(float(np.linalg.norm(shift)), 1e-9)))


def _refusal(text: str) -> str:
    return f"{text}; or use fidelity = 'lumped', which has no such range"


def _refused_phase(phase: PhaseTable, error: OutOfRangeError) -> ScenarioError:
    """Return the error of a phase; its path is the key that moves the arm, if there is only one."""
    given = [key.replace("forces", "force") for key in _MOVED_BY if getattr(phase, key)]
    path = ["phase", phase.name, *(given if len(given) == 1 else ())]
    by = f", by {' and '.join(given)}," if len(given) > 1 else ""
    return ScenarioError(".".join(path), _refusal(f"takes the arm{by}{_RANGE}{error.place}"))
