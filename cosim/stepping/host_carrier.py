"""A scene of somebody else as the carrier of the flange: the soft robot follows whoever steps it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.coupling.ticks import Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.errors import InputError
from cosim.plan.motion import JointReference
from cosim.rigid.scene.host_scene import HostScene, HostState
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.stepping.scene_carrier import SceneCarrier


@final
@dataclass(frozen=True)
class HostCarrierState:
    """Where somebody's scene is.

    Args:
        scene: rigid side.
        coupling: exchange with the soft side.
        glued: (k, 3) [m], where glued nodes are tied, in their body's frame.
    """

    scene: HostState
    coupling: Any
    glued: Annotated[Array, ("k", 3)]


_NO_SERVOS: Final = Servos.knowing_no_payload(*[np.zeros((1, 0))] * 3)


@final
class HostCarrier(SceneCarrier):
    """A site or body of somebody's scene, which steps that: `begin`, the steps of a tick, then `advance`.

    Args:
        scene: rigid side.
        soft: soft side.
        contact: law of the soft robot's contact with the scene; None for no contact.
    """

    def __init__(self, scene: HostScene, soft: SoftSide, contact: ContactLaw | None) -> None:
        super().__init__(scene, soft, contact)
        self._scene = scene
        self._last: TicksTaken | None = None

    @property
    def report(self) -> Mapping[str, str]:
        return {"Arm": "a scene that somebody else steps"}

    def _exchanging(self, wrench: Wrench, contact: ContactExchange | None) -> StaggeredCoupling:
        return StaggeredCoupling(Interface(self._coupled, self._soft, wrench, contact))

    def _contact(self) -> ContactExchange | None:
        scene, soft, far = self._scene, self._soft, self._scene.far_body
        if far is None:
            return super()._contact()
        query = scene.nothing_touched() if self._contact_law is None else scene.contact_query()
        glued = soft.body.tip, far
        found = ContactExchange(query, scene.bodies, soft.contact_surface(), self._contact_law, glued)
        found.glue(soft.state.positions)
        return found

    @property
    def _glued(self) -> Array:
        contact = self._staggered.interface.contact
        return np.zeros((0, 3)) if contact is None else contact.arrays.glue.place

    @property
    def far_wrench(self) -> Wrench:
        """What the soft robot exerts on what its tip is glued to, at that site or body, world axes."""
        far, touched = self._scene.far_body, self.touched
        place = np.flatnonzero(touched.bodies == far)
        if far is None or not len(place):
            return Wrench()
        load = Wrench(touched.force[place[0]], touched.torque[place[0]])
        return load.moved(self._scene.far_position)

    def set_configuration(self, joints: Array) -> None:
        pass

    def track(self, reference: Array) -> None:
        pass

    def servos(self, references: JointReference) -> Servos:
        return _NO_SERVOS

    @property
    def _staggered(self) -> StaggeredCoupling:
        assert isinstance(self._coupling, StaggeredCoupling), "couple() comes before"
        return self._coupling

    @property
    def wrench(self) -> Wrench:
        row = self._staggered.open_row
        return super().wrench if row is None else row.wrench

    @property
    def positions(self) -> Array:
        """(n, 3) [m], of the film's nodes; a view."""
        row = self._staggered.open_row
        return self._soft.state.positions if row is None else row.positions

    def begin(self) -> None:
        """Begin a tick: what acts through it is on the rigid side's arrays."""
        self._staggered.begin()
        self._scene.begin_tick()

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        self._scene.end_tick()
        with self._scene.lent():
            return super().advance(servos, loads)

    def end(self, loads: Loads) -> None:
        """End a tick: the soft robot moves to where the flange has come, under loads at the end of the tick.

        Raises:
            ConvergenceError: the soft step has no solution.
        """
        self._last = self.advance(_NO_SERVOS, [loads])

    def follow(self) -> None:
        """Let everything readable be where the last tick has ended; ticks in a row leave that for later."""
        if self._staggered.open_row is not None:
            with self._scene.lent():
                self._staggered.follow()

    def last_entry(self) -> LedgerEntry:
        """Return what was exchanged in the last tick."""
        assert self._last is not None, "end() comes before"
        self.follow()
        return self._last.last_entry()

    def save_state(self) -> HostCarrierState:
        self.follow()
        assert self._coupling is not None, "couple() comes before"
        saved = HostCarrierState(self._scene.save_state(), self._coupling.save_state(), self._glued.copy())
        self._known.add(saved)
        return saved

    def restore_state(self, state: object) -> None:
        if not isinstance(state, HostCarrierState):
            raise InputError("the saved state is not of a soft robot in somebody's scene")
        if state.glued.shape != self._glued.shape:
            raise InputError(
                f"the saved soft robot is glued by {len(state.glued)} nodes, this one by {len(self._glued)}"
            )
        self._restore_exchange(state, state.coupling, state.scene.loaded)
        self._glued[:] = state.glued
