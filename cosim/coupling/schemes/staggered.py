"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio r above a bound), a share of its algorithmic mass A = J^T M_a J rides along on the
joints. What it takes at the expected acceleration is given back as torque.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.
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
    """Where a `StaggeredCoupling` is.

    Args:
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (2, joints) [rad/s^2], accelerations while it was carried.
    """

    added: Array
    past: Array


@final
class StaggeredCoupling(Coupling):
    """Advances by one step of each side, in turn.

    Args:
        interface: between the sides.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5) -> None:
        super().__init__(interface)
        self._ratio_bound = ratio_bound
        joints = len(interface.scene.joint_acceleration)
        self._carry(np.zeros((joints, joints)), np.zeros((2, joints)))
        self._fine = Substepping(interface)
        self._begun: TickLog | None = None

    def begin(self) -> None:
        """Load the rigid side for a tick whose rigid step somebody else takes; then comes `advance`."""
        self._begun = self._room(1)
        self._update_when_due()
        begin_tick(self.interface, self._carried)

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        begun, self._begun = self._begun, None
        taken = self._room(len(loads)) if begun is None else begun
        try:
            for k in range(len(taken.trials)):
                self._take(servos.row(k), loads[k], taken, begun=begun is not None)
        except BaseException as error:  # whatever it is, the ticks before it are to be shown first
            self._advise(error)
            if not taken.done:
                raise
            taken.error = error
        return taken

    def _take(self, servos: ServoCommand, loads: Loads, taken: TickLog, *, begun: bool) -> None:
        """Take one tick of the clock; of one that has `begun`, somebody else has taken the rigid step."""
        interface = self.interface
        if not begun:
            self._update_when_due()
        taken.algorithmic_mass[taken.done] = self._carried.acts
        with interface.soft.work:
            if self._fine.state:
                self._fine.take(self._carried, servos, loads, taken)
                return
            if begun:
                interface.read_rigid(taken)
                end_tick(interface, loads, taken)
            else:
                tick(interface, self._carried, servos, loads, taken)
        self._fine.look()

    def _advise(self, error: BaseException) -> None:
        """Add to an instability the scheme that helps where the soft robot is heavy for the arm."""
        ratio, scene = self.interface.ratio, self.interface.scene
        own = isinstance(scene, RigidScene)  # scenes that cosim does not step alone cannot repeat a tick
        if own and ratio > self._ratio_bound and isinstance(error, InstabilityError):
            error.args = (
                f"{error} The soft robot is heavy for the arm (stability ratio {ratio:.2g}): set "
                "coupling.scheme = 'iterated'.",
            )

    def _room(self, count: int) -> TickLog:
        """Return room for some of so many ticks, with the state before the first of them."""
        self.interface.scene.check()
        return self.interface.room(min(count, _TICKS_MAX))

    def _update_when_due(self) -> None:
        if self.interface.ratio_is_due:
            self._update_stability_ratio()

    def carried(self) -> CarriedInertia:
        """Return a copy of what rides on the joints."""
        return replace(self._carried, past=self._carried.past.copy())

    @property
    def substepping(self) -> Substepping:
        """What takes ticks in pieces."""
        return self._fine

    @property
    def state(self) -> StaggeredState:
        """What the joints carry; the interface is restored before it."""
        return StaggeredState(self._carried.inertia, self._carried.past.copy())

    @state.setter
    def state(self, state: StaggeredState) -> None:
        self._begun = None
        self._carry(state.added, state.past.copy())

    def parts(self) -> dict[str, Any]:
        return {"substeps": self._fine, **super().parts()}

    def _carry(self, inertia: Array, past: Array) -> None:
        acts, interface = bool(inertia.any()), self.interface
        _, weights = carried_fraction(interface.soft.reaction_weights, interface.ratio)
        self._carried = CarriedInertia(inertia, weights, past, acts)

    def _update_stability_ratio(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        interface, scene, before = self.interface, self.interface.scene, self._carried
        interface.update_stability_ratio()
        carries, added, past = interface.ratio > self._ratio_bound, np.zeros_like(before.inertia), before.past
        if carries:
            contact = None if interface.contact is None else interface.contact.planes
            origin, jacobian = scene.flange_pose.translation, scene.flange.jacobian()
            mass = algorithmic_mass(interface.soft, origin, interface.ratio, contact, scene.tick_s)
            share, _ = carried_fraction(interface.soft.reaction_weights, interface.ratio)
            added = share * (jacobian.T @ mass @ jacobian)
        if carries or before.acts:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not before.acts:
            past[:] = scene.joint_acceleration
        if before.acts and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._carry(added, past)
