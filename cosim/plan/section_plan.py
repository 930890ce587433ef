"""Whether a plan stays within the range of a section model, before anything runs.

How far a soft arm swings that is carried along a path: as one oscillator that is shaken at its foot.

The plan is walked through on the statics; where a phase accelerates the flange, gravity is replaced by g - y,
with y what the arm's swing comes to (`swing`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ConvergenceError, OutOfRangeError, ScenarioError
from cosim.plan import motion, planning
from cosim.plan.decision import SECTION_RANGE, Decision
from cosim.plan.plan import ChamberGas, PhasePlan, Plan, loads_of
from cosim.soft.solve.state import Equilibrium

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm


_SAMPLES = 41  # of a phase, at least
_TAIL_MAX = 2000  # samples after it


@final
@dataclass(frozen=True)
class FlangeAcceleration:
    """Accelerations of the flange's origin, and the arm's rest after them.

    Args:
        fractions: (k,) progress of the phase.
        values: (k, 3) [m/s^2], world.
        step_s: between them.
    """

    fractions: Array
    values: Array
    step_s: float

    @classmethod
    def of(cls, arm: Arm, planned: PhasePlan) -> FlangeAcceleration | None:
        """Return those of a phase; None where the flange rests, or leaps, which has none."""
        phase, path = planned.phase, planned.joints
        if path.spline is None or phase.ramp == "step":
            return None
        count = max(_SAMPLES, 2 * len(path.spline.x))
        step_s = phase.duration_s / (count - 1)
        # a sample before and one after: a linear ramp leaps from rest to its speed
        ways = [motion.progress(phase.ramp, k * step_s, phase.duration_s) for k in range(-1, count + 1)]
        x = np.array([arm.forward(path.at(way).position).translation for way in ways])
        fractions = np.array([way.value for way in ways[1:-1]])
        return cls(fractions, np.diff(x, n=2, axis=0) / step_s**2, step_s)

    @property
    def largest(self) -> Array:
        """(3,) [m/s^2], where it is largest."""
        return np.asarray(self.values[int(np.argmax(np.linalg.norm(self.values, axis=1)))])

    def swing(self, rate_rad_s: float) -> tuple[float, Array]:
        """Return when an undamped oscillator is farthest, and what lasting acceleration does that.

        y'' = w^2 (a - y), exact for an acceleration a that is even between samples. Slow motions give y = a,
        a sudden acceleration that lasts up to y = 2 a, a short one less than a.

        Args:
            rate_rad_s: w.

        Returns:
            Progress of the phase; acceleration y (3,) [m/s^2] of its foot.
        """
        tail = min(_TAIL_MAX, math.ceil(2.0 * math.pi / (rate_rad_s * self.step_s)))
        angle = rate_rad_s * self.step_s
        cosine, sine = math.cos(angle), math.sin(angle)
        y, rate = np.zeros(3), np.zeros(3)  # rate: y' / w
        farthest, place = y, 0
        for k, a in enumerate([*self.values, *np.zeros((tail, 3))]):
            y, rate = a + cosine * (y - a) + sine * rate, cosine * rate - sine * (y - a)
            if y @ y > farthest @ farthest:
                farthest, place = y, k
        return float(self.fractions[min(place, len(self.fractions) - 1)]), farthest


_PIECES = 20  # of a phase
_SLOW = 0.1  # share of gravity below which an acceleration bends no arm out of its range
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


def section_range(scenario: Scenario, plan: Plan, soft: SoftSide, arm: Arm | None, touched: bool) -> Decision:
    """Return whether the soft arm stays within its model's range, as far as the plan knows where it is.

    Args:
        scenario: checked.
        plan: of the run.
        soft: at its start; its state is used up.
        arm: kinematics; None where the flange stands still.
        touched: whether contact is modelled, which may hold the arm: what is found is then said, not refused.

    Raises:
        ScenarioError: it leaves the range; `path` names the key that takes it there.
    """
    try:
        known = _Walk(scenario, plan, soft, arm).through()
    except ScenarioError as error:
        if not touched:
            raise
        return Decision(SECTION_RANGE, False, f"{error.faults[0][1]}; contact is not in this", error.path)
    return Decision(SECTION_RANGE, True, f"{known} bears the plan's loads and accelerations", "fidelity")


@final
class _Walk:
    """Follows the arm's equilibrium through a plan."""

    def __init__(self, scenario: Scenario, plan: Plan, soft: SoftSide, arm: Arm | None) -> None:
        self._plan, self._soft, self._arm = plan, soft, arm
        self._commanded = bool(scenario.commands)
        self._dynamic = scenario.mode == "dynamic"
        self._gas = ChamberGas(scenario.gas)

    def through(self) -> str:
        """Return how far the plan knows where the arm will be; it stays in its range there."""
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
            here = planning.start_equilibrium(self._soft, plan.start, loads_of(plan.command, plan.gravity))
        except OutOfRangeError as error:
            raise ScenarioError("start", _refusal(f"the arm is{_RANGE}{error.place}")) from error
        self._soft.settle(here)
        return here

    def _phase(self, planned: PhasePlan, here: Equilibrium) -> Equilibrium:
        planned.holding.apply(self._soft, here.world_from_flange)
        self._gas.begin(planned.gas, self._soft)
        self._check_swing(planned, here)
        still = planned.joints.spline is None and planned.begin is planned.end and not self._gas.flows
        for fraction in np.linspace(0.0, 1.0, 1 if still else _PIECES + 1).tolist():
            here = self._at(planned, here, fraction)
            self._soft.settle(here)
        return here

    def _at(
        self, planned: PhasePlan, here: Equilibrium, fraction: float, less: Array | None = None
    ) -> Equilibrium:
        """Return the equilibrium at a fraction of a phase, gravity less an acceleration (3,) [m/s^2]."""
        pose = here.world_from_flange
        if self._arm is not None and planned.joints.spline is not None:
            pose = self._arm.forward(planned.joints.at(motion.Progress(fraction, 0.0, 0.0)).position)
        command = self._gas.between(planned.begin, planned.end, fraction)
        gravity = np.array(self._plan.gravity)
        x, y, z = (gravity if less is None else gravity - less).tolist()
        return self._soft.follow(here, pose, loads_of(command, (x, y, z)))

    def _check_swing(self, planned: PhasePlan, here: Equilibrium) -> None:
        """Raise where the flange's motion makes the arm swing out of its range.

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
    return f"{text}; or take fidelity = 'lumped', which knows what lies beyond"


def _refused_phase(phase: PhaseTable, error: OutOfRangeError) -> ScenarioError:
    """Return the refusal of a phase: by the one key that moves the arm, or by all of them."""
    given = [key.replace("forces", "force") for key in _MOVED_BY if getattr(phase, key)]
    path = ["phase", phase.name, *(given if len(given) == 1 else ())]
    by = f", by {' and '.join(given)}," if len(given) > 1 else ""
    return ScenarioError(".".join(path), _refusal(f"takes the arm{by}{_RANGE}{error.place}"))
