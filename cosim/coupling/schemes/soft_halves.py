"""Ticks in a row whose soft halves kernels take or leave to Python: what sides share, film, section model.

A row may stay open while somebody else steps the scene: both sides follow once it is closed.
It is the row that kernels take where the scene steps itself, so it has the same bits: what Python does about
a row is done when something of it is read, when it is full, or when a soft half is more than kernels know.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, IntArray, Wrench
from cosim.base.kernel_types import nothing_of
from cosim.base.kernels import RecordStore, address_of
from cosim.coupling import half_ticks, open_ticks, section_ticks
from cosim.coupling.contact.contact_arrays import AHEAD_TICKS, ContactArrays, no_contact
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film, film_calls
from cosim.coupling.half_ticks import ALL_DONE, LISTS_LEFT, SOFT_HALF_LEFT, SOFT_STEP_SOLVED, RigidSide
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.section_ticks import ChainCommands, ChainFilm, ChainMotion, ChainSteps, ChainTables
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.soft_sides.section_arm import ChainShapes, SectionArm
from cosim.coupling.ticks import Servos, Ticks, TicksTaken
from cosim.reduced.sections import assembly, section_energy
from cosim.reduced.sections.section_strains import COLUMNS
from cosim.reduced.solve.chain_step import ChainState, ChainStep, solve_chain
from cosim.reduced.solve.newton import nothing_touched
from cosim.soft.body.loads import Loads
from cosim.soft.solve import film_step, self_contact
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.state import BegunStep, SoftState, StepScheme
from cosim.soft.solve.time_step import LARGE_TURN_RAD


class SoftHalves:
    """Takes ticks in a row: of this one, the soft halves are left to Python.

    Args:
        interface: between the sides.
    """

    fast_m_s: float = np.inf
    most: int = 64
    """Ticks in a row: fine meshes are large."""

    def __init__(self, interface: Interface) -> None:
        self.interface = interface
        self._plain: Any = None
        self._motion: Any = None
        self._first = 0

    @final
    def take(
        self, rigid: RigidSide, servos: Servos, loads: Sequence[Loads], taken: TicksTaken
    ) -> tuple[int, int]:
        """Take ticks, or the rigid half of one; return how many are done, and how that ended.

        Args:
            rigid: side.
            servos: what they are asked for in n ticks.
            loads: on the soft body at their ends.
            taken: to be filled from its next row on.
        """
        first = taken.done
        ticks = taken.ticks.from_on(first)
        if self._plain is None or not self._ready:
            taken_well = self.interface.rigid_half(rigid, servos, ticks, 0)
            return 0, SOFT_HALF_LEFT if taken_well else half_ticks.RIGID_SIDE_WARNS
        if self._motion is None:
            self._motion, self._first = self._room(len(taken.trials) - first), first
        commands = self._plain.some(first, first + len(loads))
        motion = self._motion.from_on(first - self._first)
        done, ending = self._row(rigid, servos, loads, commands, ticks, motion)
        taken.pressure_Pa[first : first + done] = commands.pressure.reshape(len(loads), -1)[:done]
        return done, ending

    @final
    def begin(self, loads: Sequence[Loads]) -> None:
        """Begin ticks in a row, with all loads of theirs."""
        plain = all(load.plain for load in {id(load): load for load in loads}.values())
        self._plain = self._commands(loads) if plain else None

    @property
    def plain(self) -> bool:
        """Whether kernels know such soft halves."""
        return self._plain is not None

    @final
    def end(self, taken: TicksTaken) -> None:
        """Show the shapes of ticks that kernels have taken: what follows begins again."""
        if self._motion is not None:
            done = taken.done - self._first
            if done:
                taken.parts.append(self._shapes(self._motion, taken.pressure_Pa[self._first : taken.done]))
            self._motion = None

    @property
    def _ready(self) -> bool:
        """Whether the next tick may be taken by a kernel."""
        return False

    def _commands(self, loads: Sequence[Loads]) -> Any:
        """Return what the soft side is asked for by plain loads."""

    def _room(self, count: int) -> Any:
        """Return rows of the soft side for n ticks, with what is there before the first of them."""

    def _row(
        self, rigid: RigidSide, servos: Servos, loads: Sequence[Loads], commands: Any, ticks: Ticks, way: Any
    ) -> tuple[int, int]:
        """Take ticks in one call; return how many are done, and how that ended."""
        raise NotImplementedError

    def _shapes(self, way: Any, pressure_Pa: Any) -> Sequence[Any]:
        """Return the shapes of ticks at pressures (done, chambers)."""
        raise NotImplementedError


_FAR_S, _ROOM_M, _FREE_ROOM_M = 0.05, 0.15, 1.0
"""So long a chain meets nothing that is farther than its reach and this: the flange goes at less than 3 m/s,
what can move freely comes on at less than 20 m/s.
"""


@final
class SectionHalves(SoftHalves):
    """Of a section model.

    Args:
        interface: between the sides.
    """

    most = 512  # more cost no less each

    @property
    def _soft(self) -> SectionArm:
        soft = self.interface.soft
        assert isinstance(soft, SectionArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return True

    def _is_far(self, contact: ContactExchange) -> bool:
        """Return whether the chain is far from all that it might touch in a row."""
        if contact.arrays.bodies.loaded.any() or contact.planes is not None:
            return False
        query, origin = contact.query, self.interface.scene.flange_pose.translation
        reach, bodies = self._soft.reach_m + _FREE_ROOM_M, contact.bodies
        away = bodies.mass_centers[contact.arrays.movable] - origin
        if ((away * away).sum(axis=1) < reach * reach).any():
            return False  # found without a search
        query.update()
        hits = query.distances(origin[None], reach, query.near(origin, origin, reach))
        free = bodies.movable(query.body[hits.shape])
        return not (free | (hits.distance < self._soft.reach_m + _ROOM_M)).any()

    @cached_property
    def _no_film(self) -> ChainFilm:
        nothing: ChainFilm = nothing_of(ChainFilm)
        return nothing._replace(contact=self._store.address(no_contact()))

    @cached_property
    def _store(self) -> RecordStore:
        return RecordStore(ContactArrays)

    @cached_property
    def _film_room(self) -> ChainFilm:
        """Room for the film, but for contacts."""
        section = self._soft.section
        nodes, (first, rows, _) = len(section.frames.before), nothing_touched()
        return ChainFilm(
            0, 0.0, np.zeros(1), section.frames.before, np.empty((nodes, 2, 4)), section.node_table,
            np.empty((2, nodes, 3)), np.empty((nodes, 3)), first, rows,
        )  # fmt: skip

    def _film(self) -> ChainFilm:
        """Return the film as it is, and its room for what it may touch; that of no film where all is far."""
        contact, last = self.interface.contact, self._soft.last
        if contact is None or self._is_far(contact):
            return self._no_film
        film, room = self._film_room, len(contact.arrays.touched.pressing)
        film.pressure[0] = pressure = last.pressure_Pa
        film.weights[:] = self._soft.section.node_weights(pressure)
        if room > len(film.first):
            film = film._replace(first=np.empty(room, np.int64), rows=np.empty((room, COLUMNS)))
            self.__dict__["_film_room"] = film
        return film._replace(contact=contact.at, rest_m=contact.rest_reach_m)

    def _commands(self, loads: Sequence[Loads]) -> ChainCommands:
        distinct, section = {id(load): load for load in loads}, self._soft.section
        known = {key: section.pressure(load) for key, load in distinct.items()}
        pressure = np.array([known[id(load)] for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        first, weights = np.empty(len(loads), np.int64), np.empty((len(loads), section_energy.TERMS))
        spline, terms = section.model.spline, None
        for k, value in enumerate(pressure.tolist()):
            if terms is None or value != pressure[k - 1]:
                terms = spline.terms(value)
            first[k], weights[k] = terms.first, terms.weights[0]
        return ChainCommands(pressure, first, weights, self._soft.stepper.segment_tensions(tension))

    def _room(self, count: int) -> ChainMotion:
        chain = self._soft.last.chain
        frames = len(chain.frames)
        rows = ChainMotion(np.empty((count + 2, 2, frames, 4, 3)), np.empty((count, frames, 6)))
        rows.motion[0] = chain.motion if chain.earlier is None else chain.earlier
        rows.motion[1] = chain.motion
        return rows

    def _shapes(self, way: ChainMotion, pressure_Pa: Any) -> ChainShapes:
        return ChainShapes(way.motion[2 : len(pressure_Pa) + 2, 0], pressure_Pa[:, 0])

    def _row(
        self,
        rigid: RigidSide,
        servos: Servos,
        loads: Sequence[Loads],
        commands: ChainCommands,
        ticks: Ticks,
        way: ChainMotion,
    ) -> tuple[int, int]:
        done, ending = self._some((rigid, servos, loads, commands, ticks, way), begun=False)
        more = done + 1
        while ending == LISTS_LEFT and more:  # with new lists kernels take this tick as well, and go on
            contact = self.interface.contact
            assert contact is not None, "there are lists"
            contact.find(self._soft.state, self.interface.scene.tick_s)
            n = len(loads)
            rest = servos.some(done, n), loads[done:], commands.some(done, n)
            given = rigid, *rest, ticks.from_on(done), way.from_on(done)
            more, ending = self._some(given, begun=True)
            done += more
        return done, SOFT_HALF_LEFT if ending == LISTS_LEFT else ending

    def _some(
        self,
        asked: tuple[RigidSide, Servos, Sequence[Loads], ChainCommands, Ticks, ChainMotion],
        *,
        begun: bool,
    ) -> tuple[int, int]:
        """Take ticks with the lists that there are; `begun`: after the rigid half of the first."""
        rigid, servos, loads, commands, ticks, way = asked
        soft, stepper, tick_s = self._soft, self._soft.stepper, self.interface.scene.tick_s
        options, begin = stepper.options, soft.last.chain
        two_steps, earlier = options.integrator == "bdf2", begin.earlier is not None
        film, scheme = self._film(), stepper.scheme(tick_s)
        if self.interface.light is not None:
            scheme = scheme._replace(tolerance_N=self.interface.light.closely_N(scheme.tolerance_N))
        if film is self._no_film and self.interface.contact is not None:
            servos = servos.some(0, max(1, round(_FAR_S / tick_s)))
        steps = ChainSteps(
            stepper.side(soft.clamp, loads[0], begin.frames), ChainTables(*stepper.tables),
            address_of(solve_chain), address_of(half_ticks.hand_over), scheme, film,
            two_steps, earlier, stepper.tangent.serves(soft.clamp, tick_s, two_steps and earlier), begun,
        )  # fmt: skip
        done, ending, kept = section_ticks.advance_chain(rigid, servos, commands, steps, ticks, way)
        last = done if ending in (SOFT_HALF_LEFT, LISTS_LEFT) else done - 1  # of which a soft step was tried
        stepper.tangent.keep(kept, soft.clamp, tick_s, two_steps and (earlier or last > 0))
        if done:
            motion, figures = way.motion[done : done + 2].copy(), ticks.figures[done].copy()
            step = ChainStep(
                ChainState(motion[1], motion[0]), way.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
                int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]),
                float(commands.pressure[done - 1]),
            )  # fmt: skip
            soft.go_to(step, ticks.flange(done), loads[done - 1])
        # what was computed for a pressure is kept with it
        stepper.side(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending


@final
class FilmHalves(SoftHalves):
    """Of a lumped film.

    Args:
        interface: between the sides.
    """

    @property
    def soft(self) -> SoftArm:
        """What is stepped."""
        soft = self.interface.soft
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
        return film_calls(None)

    @cached_property
    def _nothing(self) -> ContactArrays:
        return no_contact()

    @cached_property
    def _no_films(self) -> self_contact.FilmContacts:
        nothing: self_contact.FilmContacts = nothing_of(self_contact.FilmContacts)
        return nothing

    @cached_property
    def _contact_store(self) -> RecordStore:
        return RecordStore(ContactArrays)

    @cached_property
    def _films_store(self) -> RecordStore:
        return RecordStore(self_contact.FilmContacts)

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

    def begin_row(self) -> tuple[tuple[film_step.FilmSide, StepScheme], FilmSteps]:
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
        begun: tuple[film_step.FilmSide, StepScheme],
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
        if ending in (half_ticks.SOFT_STEP_BEGUN, SOFT_STEP_SOLVED):
            end = way.x[done + 2].copy(), way.velocity[done + 2].copy(), way.memory[done + 1].copy()
            spent = int(ticks.iterations[done]), float(ticks.residual[done])
            quick.begun = BegunStep(soft.state, *end, *spent, ending == SOFT_STEP_SOLVED)
        return done, ending

    def ends_row(self, steps: FilmSteps) -> bool:
        """Return whether a row with such steps ends after a tick: something is weighed, or films let go."""
        contact, films = self.interface.contact, self.soft.films
        released = steps.whole and films is not None and not films.contacts.counts[self_contact.REMEMBERED]
        return released or (contact is not None and contact.asks_for_weighing)

    def _steps(self, side: film_step.FilmSide, pressed: bool) -> FilmSteps:
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
        soft.go_to(state, float(ticks.residual[done - 1]), drive)


def soft_halves(interface: Interface) -> SoftHalves:
    """Return what takes the ticks of an interface in a row."""
    soft = interface.soft
    if isinstance(soft, SectionArm) and interface.scene.steps_itself and not soft.stepper.losses_follow_shape:
        return SectionHalves(interface)
    if isinstance(soft, SoftArm) and soft.stepper.quick.sides.knows_body:
        return FilmHalves(interface)
    return SoftHalves(interface)


_NO_SERVOS = Servos.knowing_no_payload(*[np.zeros((1, 0))] * 3)


@final
class OpenRow:
    """Ticks of a film in a row, of which one may be in progress.

    Args:
        halves: which would take them in one call.
        taken: room for them.
        rigid: side, until the flange is weighed again.
        most: ticks until then, for which there is room.
        store: of earlier rows, in which little changes.
    """

    def __init__(
        self, halves: FilmHalves, taken: TicksTaken, rigid: RigidSide, most: int, store: RecordStore
    ) -> None:
        self.taken, self.rigid, self._halves, self._store = taken, rigid, halves, store
        self.done, self.in_tick, self._ending = 0, False, ALL_DONE
        self._most = most
        self._begun, steps = halves.begin_row()
        self._loads: Loads | None = None
        rows = halves.commands_room(most), steps, taken.ticks, halves.room(most)
        ticks = open_ticks.OpenTicks(rigid, _NO_SERVOS, *rows)
        self._ticks, self._at, self._call = ticks, store.address(ticks), address_of(advance_film)

    @property
    def full(self) -> bool:
        """Whether it takes no more: there is no room, or something is to be weighed."""
        return self.done >= self._most or self._halves.ends_row(self._ticks.steps)

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return assembly.supplied_wrench(self.taken.ticks.figures[self.done].copy())

    @property
    def positions(self) -> Array:
        """(n, 3) [m], a view of the nodes at the end of the last tick."""
        return self._ticks.way.x[self.done + 1]

    def load(self) -> None:
        """Begin a tick."""
        open_ticks.load_open_tick(self._at, self.done)
        self.in_tick = True

    def end(self, loads: Loads) -> bool:
        """End a tick under loads at its end; return whether kernels have taken it.

        Otherwise its rigid half has been read, and the row is to be closed.
        """
        k, row = self.done, self._ticks
        self.in_tick = False
        if not loads.plain:
            half_ticks.read_rigid_half(self.rigid, _NO_SERVOS, row.ticks, k)
            self._ending = SOFT_HALF_LEFT
            return False
        if loads is not self._loads:
            commands, chambers = row.commands, row.commands.pressure.shape[1]
            commands.pressure[k:] = loads.pressures(chambers)
            commands.tension[k:], commands.gravity[k:] = loads.cable_tension_N, loads.gravity
        self._ending = open_ticks.end_open_tick(self._at, self._call, k)
        if self._ending == LISTS_LEFT:
            self._with(self._halves.with_new_lists(row.steps, row.way.x[k + 1], row.way.velocity[k + 1]))
            self._ending = open_ticks.end_open_tick(self._at, self._call, k)
            self._most = k + 1
        if self._ending != ALL_DONE:
            return False
        self._loads, self.done = loads, k + 1
        return True

    def _with(self, steps: FilmSteps) -> None:
        self._ticks = self._ticks._replace(steps=steps)
        self._at = self._store.address(self._ticks)

    def close(self) -> None:
        """Let the soft side go to where the ticks have led it."""
        ending = SOFT_HALF_LEFT if self._ending == LISTS_LEFT else self._ending
        row = self._ticks
        self._halves.end_row(self._begun, row.way, row.ticks, self._loads, (self.done, ending))
