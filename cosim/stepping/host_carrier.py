"""A site or body of a user's MuJoCo scene as the carrier of a soft robot."""

from collections.abc import Mapping, Sequence
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.plan.joint_path import JointReference
from cosim.rigid.scene import host_scene
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.stepping.scene_carrier import SceneCarrier

_NO_SERVOS: Final = ServoCommands.without_payload(*[np.zeros((1, 0))] * 3)


@final
class HostCarrier(SceneCarrier):
    """A site or body of a user's scene, which the user steps: `begin`, the steps of a tick, then `end`.

    Args:
        scene: rigid side.
        soft: soft side.
        contact: law of the soft robot's contact with the scene; None for no contact.
    """

    def __init__(self, scene: host_scene.HostScene, soft: SoftRobot, contact: ContactLaw | None) -> None:
        super().__init__(scene, soft, contact)
        self._scene = scene

    @property
    def report(self) -> Mapping[str, str]:
        return {"Arm": "a scene that the user steps"}

    def _exchanging(self, wrench: Wrench, contact: ContactExchange | None) -> StaggeredCoupling:
        return StaggeredCoupling(Interface(self._coupled, self._soft, wrench, contact))

    def _contact(self) -> ContactExchange | None:
        scene, soft, far = self._scene, self._soft, self._scene.far_body
        if far is None:
            return super()._contact()
        query = scene.nothing_touched() if self._contact_law is None else scene.contact_query()
        glued = soft.body.tip, far
        exchange = ContactExchange(query, scene.bodies, soft.contact_surface(), self._contact_law, glued)
        exchange.glue_nodes(soft.state.positions)
        return exchange

    @property
    def far_wrench(self) -> Wrench:
        """Wrench of the soft robot on the body at its tip, at the named site or body, world axes."""
        far, touched = self._scene.far_body, self.touched
        rows = np.flatnonzero(touched.bodies == far)
        if far is None or not len(rows):
            return Wrench()
        load = Wrench(touched.force[rows[0]], touched.torque[rows[0]])
        return load.moved(self._scene.far_position)

    def servos(self, references: JointReference) -> ServoCommands:
        return _NO_SERVOS

    @property
    def _staggered(self) -> StaggeredCoupling:
        assert isinstance(self._coupling, StaggeredCoupling), "couple() comes before"
        return self._coupling

    @property
    def positions(self) -> Array:
        """(n, 3) [m], of the film's nodes; a view."""
        return self._soft.state.positions

    def begin(self) -> None:
        """Begin a tick, with the soft robot's loads on the scene."""
        self._staggered.begin()
        self._scene.begin_tick()

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        self._scene.end_tick()
        with self._scene.lent():
            return super().advance(servos, loads)

    def end(self, loads: Loads) -> TickLog:
        """End a tick: step the soft robot with the flange's new pose, under the loads at the end of the tick.

        Raises:
            ConvergenceError: the soft step has no solution.
        """
        return self.advance(_NO_SERVOS, [loads])
