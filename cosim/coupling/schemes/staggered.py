"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio r above a bound), a share of its algorithmic mass A = J^T M_a J rides along on the
joints. What it takes at the expected acceleration is given back as torque (see `algorithmic_mass`).
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.

A tick is a row of length one. Kernels take rows, until the flange or bodies are to be weighed, or a soft half
is more than they know: lists of what is near are not valid, a tangent is indefinite, gas is sealed. That
half is left to Python, and the row continues.

The automatic exchange is iterated where the staggered one would need an algorithmic mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import RecordStore
from cosim.coupling.half_ticks import (
    RIGID_SIDE_WARNS,
    SOFT_HALF_LEFT,
    SOFT_STEP_BEGUN,
    SOFT_STEP_SOLVED,
    RigidSide,
    load_rigid_side,
)
from cosim.coupling.open_ticks import OpenTicks
from cosim.coupling.schemes.algorithmic_mass import algorithmic_mass, riding_along
from cosim.coupling.schemes.fine_ticks import FineTicks
from cosim.coupling.schemes.interface import Coupling, Interface, InterfaceState
from cosim.coupling.schemes.iterated import IteratedCoupling, IteratedState, IterationOptions
from cosim.coupling.schemes.soft_halves import FilmHalves, OpenRow, soft_halves
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.soft.body.loads import Loads

_NOTHING_GIVEN_BACK: Final = np.zeros(2)


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (2, joints) [rad/s^2], accelerations while it was carried.
        fine: how many ticks from the next one on are fine ones at least.
    """

    interface: InterfaceState
    added: Array
    past: Array
    fine: int


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
        self._added = np.zeros((joints, joints))
        self._past = np.zeros((2, joints))
        self._carries = False
        self._rowing, self._halves = interface.soft.rowing, soft_halves(interface)
        self._fine = FineTicks(interface)
        self._halves.fast_m_s = self._fine.fast_m_s
        self._begun: tuple[TicksTaken, RigidSide] | None = None
        self._open: OpenRow | None = None

    def begin(self, *, opening: bool = True) -> None:
        """Load the rigid side for a tick whose rigid half somebody else takes; then comes `advance`.

        Args:
            opening: whether it may be in a row that stays open, see `open_row`.
        """
        row, halves = self._open, self._halves
        if row is None:
            opens = opening and isinstance(halves, FilmHalves) and halves.ready and not self._fine.left
            taken = self._ready(halves.most if opens else 1)
            rigid = self._weighed(taken)
            if isinstance(halves, FilmHalves) and opens:
                # a first step looks back over one only
                most = 1 if halves.soft.state.earlier is None else self.interface.ticks_to_weighing
                most = min(len(taken.trials), most)
                row = self._open = OpenRow(halves, taken, rigid, most, self._open_store)
            else:
                load_rigid_side(rigid, taken.ticks, 0)
                self._begun = taken, rigid
        if row is not None:
            row.load()

    @cached_property
    def _open_store(self) -> RecordStore:
        return RecordStore(OpenTicks)

    @property
    def open_row(self) -> OpenRow | None:
        """Ticks whose rigid halves somebody else has taken, which the soft side has not followed yet."""
        return self._open

    def follow(self) -> None:
        """Let both sides be where an open row is; one tick of it that is in progress goes on by itself."""
        row, self._open = self._open, None
        if row is None:
            return
        row.close()
        if row.done:
            self.interface.follow(row.taken, row.done)
            self._fine.look(row.taken)
        if row.in_tick:
            taken = self.interface.begin(1)
            taken.algorithmic_mass[:] = self._carries
            self._begun = taken, row.rigid

    def _advance_open(self, row: OpenRow, loads: Loads) -> TicksTaken:
        """Take the soft half of the tick in progress of an open row."""
        interface, taken = self.interface, row.taken
        if row.end(loads):
            if row.full:
                self.follow()
            return taken
        self.follow()
        interface.scene.stepped(taken.ticks.flange(taken.done))
        interface.take_reply(taken, interface.advance_soft(loads))
        self._fine.look(taken)
        return taken

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        if self._open is not None:
            return self._advance_open(self._open, loads[0])
        taken = self._ready(len(loads)) if self._begun is None else self._begun[0]
        count = len(taken.trials)
        self._halves.begin(loads[:count])
        try:
            goes_on = True
            while goes_on and taken.done < count:
                goes_on = self._go_on(taken, servos.some(taken.done, count), loads[taken.done : count])
        except BaseException as error:  # whatever it is, what has been taken is to be shown first
            if not taken.done:
                raise
            taken.error = error
        self._halves.end(taken)
        return taken

    def _ready(self, count: int) -> TicksTaken:
        """Get ready for up to so many ticks; return room for them."""
        interface = self.interface
        interface.scene.check()
        most = 1 if self._fine.left else interface.begin_ticks()  # one model takes fine ticks
        if interface.soft.rowing is not self._rowing:  # another model steps from here on
            self._rowing, self._halves = interface.soft.rowing, soft_halves(interface)
            self._halves.fast_m_s = self._fine.fast_m_s
        return interface.begin(min(count, self._halves.most, most))

    def _weighed(self, taken: TicksTaken) -> RigidSide:
        """Weigh the flange where that is due; return the rigid side until it is due again."""
        interface = self.interface
        if interface.to_be_weighed:
            self._update_stability_ratio()
        taken.algorithmic_mass[taken.done : taken.done + interface.ticks_to_weighing] = self._carries
        joints = len(self._added) if self._carries else 0
        carried = CarriedInertia(self._added[:joints, :joints].copy(), self._given_back, self._past)
        return interface.rigid(carried)

    def _go_on(self, taken: TicksTaken, servos: Servos, loads: Sequence[Loads]) -> bool:
        """Take ticks until flange or bodies are to be weighed again, or Python has taken a soft half.

        Returns:
            Whether the row goes on: not after one that kernels might have taken, so shapes stay of one kind,
            nor where another model steps.
        """
        interface, (begun, self._begun) = self.interface, (self._begun, None)
        rigid = self._weighed(taken) if begun is None else begun[1]
        most = interface.ticks_to_weighing
        if self._fine.left:
            self._halves.end(taken)
            self._fine.take(rigid, servos.some(0, 1), loads[0], taken)
            return not self._halves.plain
        done, ending = self._halves.take(rigid, servos.some(0, most), loads[:most], taken)
        if done:
            interface.follow(taken, done)
        if ending == RIGID_SIDE_WARNS:
            interface.scene.check()
        if ending not in (SOFT_HALF_LEFT, SOFT_STEP_BEGUN, SOFT_STEP_SOLVED):
            self._fine.look(taken)
            return True
        self._halves.end(taken)
        interface.scene.stepped(taken.ticks.flange(taken.done))
        interface.take_reply(taken, interface.advance_soft(loads[done]))
        self._fine.look(taken)
        return not self._halves.plain and interface.soft.rowing is self._rowing

    def carried(self) -> CarriedInertia:
        """Return a copy of what rides on the joints."""
        added = self._added if self._carries else np.zeros((0, 0))
        return CarriedInertia(added.copy(), self._given_back, self._past.copy())

    @property
    def _given_back(self) -> Array:
        if not self._carries:
            return _NOTHING_GIVEN_BACK
        return riding_along(self.interface.soft.answer_weights, self.interface.ratio)[1]

    @property
    def fine(self) -> FineTicks:
        """What takes ticks in pieces."""
        return self._fine

    def save_state(self) -> StaggeredState:
        self.follow()
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy(), self._fine.left)

    def restore_state(self, state: StaggeredState) -> None:
        self._begun = self._open = None
        self._fine.restore(state.fine)
        self.interface.restore_state(state.interface)
        self._added, self._carries = state.added, bool(state.added.any())
        self._past[:] = state.past

    def _update_stability_ratio(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        interface, scene = self.interface, self.interface.scene
        interface.update_stability_ratio()
        carries, added = interface.ratio > self._ratio_bound, np.zeros_like(self._added)
        if carries:
            contact = None if interface.contact is None else interface.contact.planes
            origin, jacobian = scene.flange_pose.translation, scene.flange.jacobian()
            mass = algorithmic_mass(interface.soft, origin, interface.ratio, contact, scene.tick_s)
            share, _ = riding_along(interface.soft.answer_weights, interface.ratio)
            added = share * (jacobian.T @ mass @ jacobian)
        if carries or self._carries:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not self._carries:
            self._past[:] = scene.joint_acceleration
        if self._carries and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._added, self._carries = added, carries


_FLANGE_RATIO_BOUND = 0.5  # of the stability ratio, above which ticks are iterated


@final
@dataclass(frozen=True)
class AutomaticState:
    """Where an `AutomaticCoupling` is.

    Args:
        iterated: its iterated scheme; the staggered one carries no mass.
        iterates: whether the last tick was iterated.
        fine: how many ticks from the next one on are fine ones at least, if they are staggered.
    """

    iterated: IteratedState
    iterates: bool
    fine: int


@final
class AutomaticCoupling(Coupling):
    """Decides before every tick, by the stability ratio of the flange.

    Args:
        interface: between the sides.
        options: when the iterated scheme's loads agree.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._staggered = StaggeredCoupling(interface, np.inf)
        self._iterated = IteratedCoupling(interface, options)
        self._iterates = False

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        interface = self.interface
        if interface.to_be_weighed:
            interface.update_stability_ratio()
        iterates = interface.ratio > _FLANGE_RATIO_BOUND
        if iterates and not self._iterates:
            self._iterated.begin_again()
            self._staggered.fine.stop()
        self._iterates = iterates
        return (self._iterated if iterates else self._staggered).advance(servos.some(0, 1), loads[:1])

    def save_state(self) -> AutomaticState:
        return AutomaticState(self._iterated.save_state(), self._iterates, self._staggered.fine.left)

    def restore_state(self, state: AutomaticState) -> None:
        self._staggered.fine.restore(state.fine)
        self._iterated.restore_state(state.iterated)
        self._iterates = state.iterates
