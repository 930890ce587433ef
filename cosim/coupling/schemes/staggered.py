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
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import RecordStore, nothing_of
from cosim.coupling.contact.contact_arrays import AHEAD_TICKS, ContactArrays
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film, film_calls
from cosim.coupling.half_ticks import (
    LISTS_LEFT,
    RIGID_SIDE_WARNS,
    SOFT_HALF_LEFT,
    SOFT_STEP_BEGUN,
    SOFT_STEP_SOLVED,
    RigidSide,
    keep_rigid_half,
    load_rigid_side,
)
from cosim.coupling.open_ticks import OpenTicks
from cosim.coupling.schemes.algorithmic_mass import algorithmic_mass, riding_along
from cosim.coupling.schemes.fine_ticks import FineTicks
from cosim.coupling.schemes.interface import Coupling, Interface, InterfaceState
from cosim.coupling.schemes.iterated import IteratedCoupling, IteratedState, IterationOptions
from cosim.coupling.schemes.open_row import OpenRow
from cosim.coupling.schemes.soft_halves import SectionHalves, SoftHalves
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.soft_sides.section_arm import SectionArm
from cosim.coupling.ticks import CarriedInertia, Servos, Ticks
from cosim.coupling.ticks_taken import TicksTaken
from cosim.soft.body.loads import Loads
from cosim.soft.solve.film_step import FilmSide
from cosim.soft.solve.self_contact import REMEMBERED, FilmContacts
from cosim.soft.solve.state import BegunStep, SoftState, StepScheme
from cosim.soft.solve.time_step import LARGE_TURN_RAD


def soft_halves(interface: Interface) -> SoftHalves:
    """Return what takes the ticks of an interface in a row."""
    soft = interface.soft.rowing
    alone = interface.contact is None and interface.scene.steps_itself
    if isinstance(soft, SectionArm) and alone and not soft.stepper.losses_follow_shape:
        return SectionHalves(interface)
    if isinstance(soft, SoftArm) and soft.steps_alone and soft.stepper.quick.sides.knows_body:
        return FilmHalves(interface)
    return SoftHalves(interface)


@final
class FilmHalves(SoftHalves):
    """Of a lumped film.

    Args:
        interface: between the sides.
    """

    @property
    def soft(self) -> SoftArm:
        """What is stepped."""
        soft = self.interface.soft.rowing
        assert isinstance(soft, SoftArm), "soft_halves() has asked"
        return soft

    @property
    def ready(self) -> bool:
        """Whether the next tick may be taken by a kernel."""
        return self.soft.stepper.quick.sides.knows_factor

    @property
    def _ready(self) -> bool:
        return self.ready

    def _commands(self, loads: Sequence[Loads]) -> FilmCommands:
        chambers = len(self.soft.body.gas_chambers)
        pressure = np.array([load.pressures(chambers) for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        return FilmCommands(pressure, tension, np.array([load.gravity for load in loads]))

    def commands_room(self, count: int) -> FilmCommands:
        """Return room for what n ticks are asked for."""
        body = self.soft.body
        return FilmCommands(*(np.zeros((count, n)) for n in (len(body.gas_chambers), len(body.cables), 3)))

    @cached_property
    def _calls(self) -> IntArray:
        return film_calls(self.interface.rigid_half)

    @cached_property
    def _soft_calls(self) -> IntArray:
        """The same for a tick whose rigid half has been taken."""
        return film_calls(keep_rigid_half)

    @cached_property
    def _nothing(self) -> ContactArrays:
        nothing: ContactArrays = nothing_of(ContactArrays)
        return nothing._replace(counts=np.zeros(7, np.int64))

    @cached_property
    def _no_films(self) -> FilmContacts:
        nothing: FilmContacts = nothing_of(FilmContacts)
        return nothing

    @cached_property
    def _contact_store(self) -> RecordStore:
        return RecordStore(ContactArrays)

    @cached_property
    def _films_store(self) -> RecordStore:
        return RecordStore(FilmContacts)

    def _room(self, count: int) -> FilmMotion:
        return self.room(count)

    def room(self, count: int) -> FilmMotion:
        """Return rows for n ticks, with what is there before the first of them."""
        state = self.soft.state
        x, velocity = (np.empty((count + 2, *state.positions.shape)) for _ in range(2))
        memory = np.empty((count + 1, len(state.memory)))
        x[0], velocity[0] = state.earlier or (state.positions, state.velocities)
        x[1], velocity[1], memory[0] = state.positions, state.velocities, state.memory
        return FilmMotion(x, velocity, memory)

    def _shapes(self, way: FilmMotion, pressure_Pa: Any) -> Sequence[Any]:
        return list(way.x[2 : len(pressure_Pa) + 2])

    def _row(
        self,
        rigid: RigidSide,
        servos: Servos,
        loads: Sequence[Loads],
        commands: FilmCommands,
        ticks: Ticks,
        way: FilmMotion,
    ) -> tuple[int, int]:
        if self.soft.state.earlier is None:  # a first step looks back over one only
            servos, commands = servos.some(0, 1), commands.some(0, 1)
        begun, steps = self.begin_row()
        done, ending = advance_film(rigid, servos, commands, steps, ticks, way)
        if ending == LISTS_LEFT:  # with new lists the kernel takes this tick as well, after its rigid half
            steps = self.with_new_lists(steps, way.x[done + 1], way.velocity[done + 1])
            one = servos.some(done, done + 1), commands.some(done, done + 1), steps
            more, ending = advance_film(rigid, *one, ticks.from_on(done), way.from_on(done))
            done, ending = done + more, SOFT_HALF_LEFT if ending == LISTS_LEFT else ending
        return self.end_row(begun, way, ticks, loads[done - 1] if done else None, (done, ending))

    def begin_row(self) -> tuple[tuple[FilmSide, StepScheme], FilmSteps]:
        """Return what ticks in a row step, by which scheme, and what they have in common."""
        soft, sides, tick_s = self.soft, self.soft.stepper.quick.sides, self.interface.scene.tick_s
        scheme, pressed = soft.stepper.scheme_of(soft.state, tick_s), soft.state.touching is not None
        side = sides.of(scheme, tick_s, pressed=pressed)
        assert side is not None, "of a body and a factorisation that it knows"
        if soft.films is not None:
            soft.films.remember(soft.state.touching)
        return (side, scheme), self._steps(side, pressed)

    def end_row(
        self,
        begun: tuple[FilmSide, StepScheme],
        way: FilmMotion,
        ticks: Ticks,
        loads: Loads | None,
        ended: tuple[int, int],
    ) -> tuple[int, int]:
        """Let the soft side go to where a row has ended; `loads` are those of its last tick that is done."""
        soft, quick, (done, ending) = self.soft, self.soft.stepper.quick, ended
        quick.sides.take_over(*begun)
        if loads is not None:
            self._went(way, ticks, done, loads)
        if soft.films is not None:
            soft.films.overlook(soft.state)
        if ending in (SOFT_STEP_BEGUN, SOFT_STEP_SOLVED):
            end = way.x[done + 2].copy(), way.velocity[done + 2].copy(), way.memory[done + 1].copy()
            spent = int(ticks.iterations[done]), float(ticks.residual[done])
            quick.begun = BegunStep(soft.state, *end, *spent, ending == SOFT_STEP_SOLVED)
        return done, ending

    def ends_row(self, steps: FilmSteps) -> bool:
        """Return whether a row with such steps ends after a tick: something is weighed, or films let go."""
        contact, films = self.interface.contact, self.soft.films
        released = steps.whole and films is not None and not films.contacts.counts[REMEMBERED]
        return released or (contact is not None and contact.asks_for_weighing)

    def _steps(self, side: FilmSide, pressed: bool) -> FilmSteps:
        """Return what the steps of a row have in common; `pressed`: films press on one another before it."""
        soft, contact, films = self.soft, self.interface.contact, self.soft.films
        quick, tick_s = soft.stepper.quick, self.interface.scene.tick_s
        return FilmSteps(
            quick.sides.address(side), quick.begins(lenient=True), quick.begins(lenient=False),
            0.0 if contact is None else contact.rest_reach_m, 0.0 if films is None else films.rest_m,
            AHEAD_TICKS * tick_s, self._calls, soft.body.node_mass.reshape(-1, 1, 1), LARGE_TURN_RAD,
            self._contact_store.address(self._nothing) if contact is None else contact.at,
            self._films_store.address(self._no_films) if films is None else films.at,
            self.fast_m_s, pressed and quick.sides.has_parts,
        )  # fmt: skip

    def with_new_lists(self, steps: FilmSteps, x: Array, velocity: Array) -> FilmSteps:
        """Return the same for a tick from x and velocity (n, 3) whose rigid half has been taken."""
        contact, films, tick_s = self.interface.contact, self.soft.films, self.interface.scene.tick_s
        if contact is not None:
            contact.find(SoftState(x, velocity, self.soft.state.memory), tick_s)
            steps = steps._replace(contact=contact.at)
        if films is not None:
            films.renew(x, velocity, tick_s)
            steps = steps._replace(films=films.at)
        return steps._replace(calls=self._soft_calls)

    def _went(self, way: FilmMotion, ticks: Ticks, done: int, loads: Loads) -> None:
        """Let the soft side go to where ticks have led it; `loads` are those of the last one."""
        soft, films = self.soft, self.soft.films
        x, velocity = way.x[done : done + 2].copy(), way.velocity[done : done + 2].copy()
        touching = None if films is None else films.remembered
        state = SoftState(x[1], velocity[1], way.memory[done].copy(), (x[0], velocity[0]), touching)
        drive = ticks.flange(done), loads
        soft.go_to(state, float(ticks.residual[done - 1]), ticks.flange(done - 1), drive)


_NOTHING_GIVEN_BACK: Final = np.zeros(2)


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (2, joints) [rad/s^2], accelerations while it was carried.
        fine: whether the next tick is a fine one.
    """

    interface: InterfaceState
    added: Array
    past: Array
    fine: bool


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

    def begin(self) -> None:
        """Load the rigid side for a tick whose rigid half somebody else takes; then comes `advance`."""
        row, halves = self._open, self._halves
        if row is None:
            opens = isinstance(halves, FilmHalves) and halves.ready and not self._fine.on
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
        most = interface.begin_ticks()
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
        if self._fine.on:
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
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy(), self._fine.on)

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
        fine: whether the next tick is a fine one, if it is staggered.
    """

    iterated: IteratedState
    iterates: bool
    fine: bool


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
        return AutomaticState(self._iterated.save_state(), self._iterates, self._staggered.fine.on)

    def restore_state(self, state: AutomaticState) -> None:
        self._staggered.fine.restore(state.fine)
        self._iterated.restore_state(state.iterated)
        self._iterates = state.iterates
