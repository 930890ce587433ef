"""Base class of carriers that are part of a MuJoCo scene."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from cosim.base.frames import Array, Pose, Twist, Wrench
from cosim.base.state_checks import check_state
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve.state import Obstacles
from cosim.stepping.carrier import Carrier


class SceneCarrier(Carrier):
    """Carries the flange by a scene, which exchanges loads with the soft side.

    Args:
        scene: rigid side.
        soft: soft side.
        contact: law of the soft robot's contact with the scene; None for no contact.
    """

    def __init__(self, scene: CoupledScene, soft: SoftRobot, contact: ContactLaw | None) -> None:
        self._coupled, self._soft, self._contact_law = scene, soft, contact
        self._coupling: Coupling | None = None

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
        return ContactExchange(query, scene.bodies, self._soft.contact_surface(), law).find_static

    def begins_in(self, points: Array) -> str:
        return "" if self._contact_law is None else self._coupled.begins_in(points)

    def couple(self, wrench: Wrench) -> None:
        self._coupling = self._exchanging(wrench, self._contact())

    def _contact(self) -> ContactExchange | None:
        """Return the exchange of contact loads; None without contact."""
        scene, soft, law = self._coupled, self._soft, self._contact_law
        if law is None:
            return None
        return ContactExchange(scene.contact_query(), scene.bodies, soft.contact_surface(), law)

    @abstractmethod
    def _exchanging(self, wrench: Wrench, contact: ContactExchange | None) -> Coupling:
        """Return the scheme of the exchange, with the soft side's wrench on the flange at its start."""

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        assert self._coupling is not None, "couple() comes before advance()"
        return self._coupling.advance(servos, loads)

    def parts(self) -> dict[str, Any]:
        return {"scene": self._coupled, **({} if self._coupling is None else self._coupling.parts())}

    def completed(self, states: Mapping[str, Any]) -> dict[str, Any]:
        if "exchange" not in states:
            return dict(states)
        if self._coupling is None:
            check_state(states["scene"], self._coupled.state, place="state.scene")
            self._coupled.state = states["scene"]
            self.couple(Wrench())
        assert self._coupling is not None, "couple() has just made it"
        return self._coupling.interface.completed(states)
