"""A MuJoCo scene that carries the flange: what arms and scenes of others have in common as carriers."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from cosim.base.frames import Array, IntArray, Pose, Twist, Wrench
from cosim.base.state_check import KnownStates, check_indices, check_state
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.schemes.interface import Coupling
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.coupling.ticks import Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve.state import Obstacles
from cosim.stepping.carrier import Carrier


class SceneCarrier(Carrier):
    """Carries the flange by a scene that the soft side exchanges loads with.

    Args:
        scene: rigid side.
        soft: soft side.
        contact: law of the soft robot's contact with the scene; None for no contact.
    """

    def __init__(self, scene: CoupledScene, soft: SoftSide, contact: ContactLaw | None) -> None:
        self._coupled, self._soft, self._contact_law = scene, soft, contact
        self._coupling: Coupling | None = None
        self._known = KnownStates()

    @property
    def flange_pose(self) -> Pose:
        return self._coupled.flange_pose

    @property
    def flange_twist(self) -> Twist:
        return self._coupled.flange_twist

    @property
    def wrench(self) -> Wrench:
        return Wrench() if self._coupling is None else self._coupling.wrench

    @property
    def body_names(self) -> tuple[str, ...]:
        return self._coupled.body_names

    def body_poses(self) -> tuple[Array, Array]:
        return self._coupled.body_poses()

    @property
    def touched(self) -> ContactReport:
        return NOTHING_TOUCHED if self._coupling is None else self._coupling.interface.touched

    def obstacles(self) -> Obstacles | None:
        scene, law = self._coupled, self._contact_law
        if law is None:
            return None
        query = scene.contact_query(fixed_only=True)
        return ContactExchange(query, scene.bodies, self._soft.contact_surface(), law).still

    def begins_in(self, points: Array) -> str:
        return "" if self._contact_law is None else self._coupled.begins_in(points)

    def couple(self, wrench: Wrench) -> None:
        self._coupling = self._exchanging(wrench, self._contact())

    def _contact(self) -> ContactExchange | None:
        """Return the exchange of what the film touches; None where that is nothing."""
        scene, soft, law = self._coupled, self._soft, self._contact_law
        if law is None:
            return None
        return ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface(), law)

    @abstractmethod
    def _exchanging(self, wrench: Wrench, contact: ContactExchange | None) -> Coupling:
        """Return the scheme of the exchange, with what the soft side exerts on the flange at its start."""

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        assert self._coupling is not None, "couple() comes before advance()"
        return self._coupling.advance(servos, loads)

    def _restore_exchange(self, state: Any, coupling: Any, loaded: IntArray) -> None:
        """Return scene and exchange to a saved state.

        Args:
            state: of the carrier; its `scene` is that of the scene.
            coupling: of the exchange; None: there was none.
            loaded: (k,) bodies that bear loads of contact.
        """
        check_indices(loaded, len(self._coupled.body_names), "bodies")
        self._coupled.restore_state(state.scene)
        if coupling is None:
            self._coupling = None
            return
        if self._coupling is None:
            self.couple(Wrench())
        assert self._coupling is not None, "couple() has just made it"
        if state not in self._known:
            check_state(coupling, self._coupling.save_state(), place="state.carrier.coupling")
        self._coupling.restore_state(coupling)
        self._known.add(state)
