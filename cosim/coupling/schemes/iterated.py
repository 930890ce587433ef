"""The iterated exchange: a tick is repeated until the loads that act on the rigid side are the soft side's.

Unknown l: the loads on the flange, and on all bodies that can be touched and can move, at the end of the
tick. One trial, from the start of the tick: MuJoCo steps under l, contacts are found at the new poses, the
soft side steps with the new pose of the flange and answers with the loads g(l). The root of
r(l) = g(l) + u - l, u what the tick before left over (so no impulse is lost), is found by quasi-Newton steps.
They begin with the inverse -(1 + h^2 S W)^-1: S how the soft side's loads answer motion, W the mobility of
flange and bodies. It is kept from tick to tick, and made anew where bodies are touched. No algorithmic mass
is carried: at the root, this is implicit Euler for both sides together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.half_ticks import take_rigid_half
from cosim.coupling.schemes.fixed_point_search import InterfaceSearch, IterationOptions, Trial
from cosim.coupling.schemes.interface import Interface, InterfaceState
from cosim.coupling.schemes.interface_loads import InterfaceLoads
from cosim.coupling.schemes.momentum_balance import six_numbers
from cosim.coupling.schemes.scheme import Coupling
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.reduced.sections.outputs import CENTER, WRENCH
from cosim.soft.body.loads import Loads


@final
@dataclass(frozen=True)
class IteratedState:
    """Where an `IteratedCoupling` is.

    Args:
        interface: what it acts on.
        history: loads (1 + b, 6) about the world's origin of up to two iterated ticks, last first.
        left_over: (1 + b, 6), what has not acted yet, about the world's origin.
        inverse: of the quasi-Newton steps; None before the first.
    """

    interface: InterfaceState
    history: tuple[Annotated[Array, ("b", 6)], ...]
    left_over: Annotated[Array, ("b", 6)]
    inverse: Annotated[Array, ("n", "n")] | None


@final
class IteratedCoupling(Coupling):
    """Repeats each tick until both sides agree on the loads between them.

    Args:
        interface: between the sides.
        options: when they agree.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._options = options or IterationOptions()
        self._vector = InterfaceLoads(interface)
        self._inverse: Array | None = None
        self._history: tuple[Array, ...] = ()
        self._left_over = np.zeros((1 + len(self._vector.bodies), 6))

    def begin_again(self) -> None:
        """Forget what the last ticks were like; another scheme has advanced both sides since."""
        self._history, self._left_over = (), np.zeros_like(self._left_over)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        interface, vector = self.interface, self._vector
        if interface.to_be_weighed:
            interface.update_stability_ratio()
        taken, joints = interface.begin(1), len(servos.position[0])
        carried = CarriedInertia(np.zeros((0, 0)), np.ones(1), np.zeros((1, joints)))

        def rigid_half(wrench: Array) -> None:
            taken.ticks.figures[0, WRENCH:CENTER] = wrench
            if not take_rigid_half(interface.rigid(carried), servos, taken.ticks, 0):
                interface.scene.check()
            interface.scene.stepped(taken.ticks.flange(0))

        vector.begin()
        last, owed = vector.answered(), vector.from_world(self._left_over)
        search = InterfaceSearch(interface, vector, rigid_half, loads[0], self._options, self._inverse)
        found = search.run(self._expected(last) + owed, last, owed)
        acted = vector.flange_wrench(found.load)
        interface.take_reply(taken, found.reply, np.concatenate([acted.force, acted.torque]))
        taken.ticks.momentum_error[0] = self._account(found)
        self._inverse = search.inverse
        self._history = (vector.about_world(found.answered), *self._history[:1])
        if interface.body_mass is not None:
            interface.body_mass.update(carry=False)
            taken.ticks.contact[0, 2] = interface.contact_ratio
        taken.ticks.iterations[0], taken.trials[0] = search.newton_iterations, search.trials
        taken.scheme, taken.interface_residual[0] = "iterated", found.size
        return taken

    def save_state(self) -> IteratedState:
        return IteratedState(self.interface.save_state(), self._history, self._left_over, self._inverse)

    def restore_state(self, state: IteratedState) -> None:
        self.interface.restore_state(state.interface)
        self._history, self._left_over, self._inverse = state.history, state.left_over, state.inverse
        bodies = len(self._vector.bodies)
        if len(state.left_over) != 1 + bodies:  # contact begins: bodies bear nothing yet
            self._history, self._inverse = (), None
            self._left_over = np.zeros((1 + bodies, 6))
            self._left_over[0] = state.left_over[0]

    def _expected(self, last: Array) -> Array:
        """Return loads (n,) that go on as they have come."""
        if len(self._history) < 2:
            return last
        now, before = (self._vector.from_world(loads) for loads in self._history)
        return np.asarray(2.0 * now - before)

    def _account(self, found: Trial) -> float:
        """Take note of what is left over; return the error of momentum."""
        left_over = self._vector.about_world(found.residual)
        due = self._left_over - left_over
        self._left_over = left_over
        bodies = due[1:].sum(axis=0) - self._vector.held_fast()
        return self.interface.handed.plus(six_numbers(due[0]), six_numbers(bodies)).error(*found.received)
