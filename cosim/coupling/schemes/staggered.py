"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick, the wrench of the last tick acts on the flange while MuJoCo steps. The soft robot then takes one
implicit step with the flange's new pose and returns the next wrench. If the soft robot is heavy for the
flange (stability ratio r above a bound), the joints carry a fraction of its algorithmic mass A = J^T M_a J,
and a torque cancels its inertia at the expected acceleration (`algorithmic_mass`). Contacts with the scene
are found between the two steps, and act on bodies one tick later.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.schemes.algorithmic_mass import CarriedInertia, algorithmic_mass, carried_fraction
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.substepping import Substepping
from cosim.coupling.schemes.tick import begin_tick, end_tick, tick
from cosim.coupling.ticks import ServoCommand, ServoCommands, TickLog
from cosim.errors import InstabilityError
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.loads import Loads

_TICKS_MAX: Final = 64  # in one call


@final
@dataclass(frozen=True)
class StaggeredState:
    """State of a `StaggeredCoupling`.

    Args:
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (2, joints) [rad/s^2], accelerations while it was carried.
    """

    added: Array
    past: Array


@final
class StaggeredCoupling(Coupling):
    """Advances arm and soft robot by one step each, in turn.

    Args:
        interface: between them.
        ratio_bound: stability ratio above which the joints carry algorithmic mass.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5) -> None:
        super().__init__(interface)
        self._ratio_bound = ratio_bound
        joints = len(interface.scene.joint_acceleration)
        self._carry(np.zeros((joints, joints)), np.zeros((2, joints)))
        self._substepping = Substepping(interface)
        self._begun_log: TickLog | None = None

    def begin(self) -> None:
        """Load the arm for a tick whose rigid step another loop takes; `advance` then ends the tick."""
        self._begun_log = self._new_log(1)
        self._update_when_due()
        begin_tick(self.interface, self._carried)

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        begun_log, self._begun_log = self._begun_log, None
        log = self._new_log(len(loads)) if begun_log is None else begun_log
        try:
            for k in range(len(log.trials)):
                self._step_tick(servos.row(k), loads[k], log, begun=begun_log is not None)
        except BaseException as error:  # of any kind: the ticks before it are shown first
            self._advise(error)
            if not log.done:
                raise
            log.error = error
        return log

    def _step_tick(self, servos: ServoCommand, loads: Loads, log: TickLog, *, begun: bool) -> None:
        """Take one tick of the clock; if it has `begun`, another loop has taken the rigid step."""
        interface = self.interface
        if not begun:
            self._update_when_due()
        log.algorithmic_mass[log.done] = self._carried.acts
        with interface.soft.work:
            if self._substepping.state:
                self._substepping.step_tick(self._carried, servos, loads, log)
                return
            if begun:
                interface.read_rigid(log)
                end_tick(interface, loads, log)
            else:
                tick(interface, self._carried, servos, loads, log)
        self._substepping.update()

    def _advise(self, error: BaseException) -> None:
        """Add the remedy to an instability of a soft robot that is heavy for the arm."""
        ratio, scene = self.interface.ratio, self.interface.scene
        repeatable = isinstance(scene, RigidScene)  # scenes stepped by other loops cannot repeat a tick
        if repeatable and ratio > self._ratio_bound and isinstance(error, InstabilityError):
            error.args = (
                f"{error} The soft robot is heavy for the arm (stability ratio {ratio:.2g}): set "
                "coupling.scheme = 'iterated'.",
            )

    def _new_log(self, count: int) -> TickLog:
        """Return an empty log for up to `count` ticks, after checking the scene."""
        self.interface.scene.check()
        return self.interface.new_log(min(count, _TICKS_MAX))

    def _update_when_due(self) -> None:
        if self.interface.ratio_is_due:
            self._update_stability_ratio()

    def carried(self) -> CarriedInertia:
        """Return a copy of the inertia that the joints carry."""
        return replace(self._carried, past=self._carried.past.copy())

    @property
    def substepping(self) -> Substepping:
        """Divides ticks into substeps where bodies move fast."""
        return self._substepping

    @property
    def state(self) -> StaggeredState:
        """The inertia that the joints carry; restore the interface before it."""
        return StaggeredState(self._carried.inertia, self._carried.past.copy())

    @state.setter
    def state(self, state: StaggeredState) -> None:
        self._begun_log = None
        self._carry(state.added, state.past.copy())

    def parts(self) -> dict[str, Any]:
        return {"substeps": self._substepping, **super().parts()}

    def _carry(self, inertia: Array, past: Array) -> None:
        acts, interface = bool(inertia.any()), self.interface
        _, weights = carried_fraction(interface.soft.reaction_weights, interface.ratio)
        self._carried = CarriedInertia(inertia, weights, past, acts)

    def _update_stability_ratio(self) -> None:
        """Update the stability ratio and the carried algorithmic mass."""
        interface, scene, before = self.interface, self.interface.scene, self._carried
        interface.update_stability_ratio()
        carries, added, past = interface.ratio > self._ratio_bound, np.zeros_like(before.inertia), before.past
        if carries:
            contact = None if interface.contact is None else interface.contact.planes
            origin, jacobian = scene.flange_pose.translation, scene.flange.jacobian()
            mass = algorithmic_mass(interface.soft, origin, interface.ratio, contact, scene.tick_s)
            fraction, _ = carried_fraction(interface.soft.reaction_weights, interface.ratio)
            added = fraction * (jacobian.T @ mass @ jacobian)
        if carries or before.acts:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not before.acts:
            past[:] = scene.joint_acceleration
        if before.acts and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._carry(added, past)
