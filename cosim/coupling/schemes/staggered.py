"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio above a bound), its algorithmic mass A = J^T M_a J rides along on the joints; A
times the acceleration at which the soft side answers as before, the last one with implicit Euler, is given
back as torque. So only a change of the answer meets A: a rigid load moves as one body with the flange.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.

A tick is a row of length one. Kernels take rows, until the flange or bodies are to be weighed, or a soft half
is more than they know: lists of what is near are not valid, a tangent is indefinite, gas is sealed. That
half is left to Python, and the row continues.

What is carried: a small motion xi of the flange takes the film along rigidly, which strains nothing, but the
film lags behind by X = K^-1 c m E xi: K the tangent of the step, E the rigid motions of the nodes m, c the
weight of inertia in the step's scheme. Within the tick the wrench on the flange changes by
-c E^T m (E - X) xi; in a slow motion it ends up changed by -c E^T m E xi, as that of a rigid body. Carried:

    M_a = s_0 (E^T m E - (1 - b) E^T m X),    b = min(1, 1 / r^2),

r the stability ratio, s_0 = c h^2 the first of `answer_weights`. The whole mass, b = 1, leaves slow motions
as they are, but under a soft film that is heavy (r above 1.5, implicit Euler) the motion grows weakly. Under
that of the tick, b = 0, it does not up to r = 10; where the acceleration jumps, a tick's impulse is lost.
Source: the amplification of a chain on a mass, in tests/coupling/test_algorithmic_mass.py.

The automatic exchange is iterated where the staggered one would need an algorithmic mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import RecordStore, address_of, nothing_of
from cosim.coupling.contact.contact_arrays import AHEAD_TICKS, ContactArrays
from cosim.coupling.contact.levers import rigid_motions
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film, film_calls
from cosim.coupling.half_ticks import (
    LISTS_LEFT,
    RIGID_SIDE_WARNS,
    SOFT_HALF_LEFT,
    SOFT_STEP_BEGUN,
    SOFT_STEP_SOLVED,
    RigidSide,
    hand_over,
    keep_rigid_half,
    load_rigid_side,
)
from cosim.coupling.schemes.fine_ticks import FineTicks
from cosim.coupling.schemes.interface import Coupling, Interface, InterfaceState
from cosim.coupling.schemes.iterated import IteratedCoupling, IteratedState, IterationOptions
from cosim.coupling.section_ticks import ChainCommands, ChainMotion, ChainSteps, ChainTables, advance_chain
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.soft_sides.section_arm import ChainShapes, SectionArm
from cosim.coupling.soft_sides.soft_side import SoftSide, expecting_no_change
from cosim.coupling.ticks import CarriedInertia, Servos, Ticks
from cosim.coupling.ticks_taken import TicksTaken
from cosim.reduced.sections.section_energy import TERMS
from cosim.reduced.solve.chain_step import ChainState, ChainStep, solve_chain
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.film_step import FilmSide
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.self_contact import FilmContacts
from cosim.soft.solve.state import BegunStep, SoftState
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
            return 0, SOFT_HALF_LEFT if taken_well else RIGID_SIDE_WARNS
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


def soft_halves(interface: Interface) -> SoftHalves:
    """Return what takes the ticks of an interface in a row."""
    soft = interface.soft.rowing
    alone = interface.contact is None and interface.scene.steps_itself
    if isinstance(soft, SectionArm) and alone and not soft.stepper.losses_follow_shape:
        return _SectionHalves(interface)
    if isinstance(soft, SoftArm) and soft.steps_alone and soft.stepper.quick.sides.knows_body:
        return _FilmHalves(interface)
    return SoftHalves(interface)


@final
class _FilmHalves(SoftHalves):
    """Of a lumped film.

    Args:
        interface: between the sides.
    """

    @property
    def _soft(self) -> SoftArm:
        soft = self.interface.soft.rowing
        assert isinstance(soft, SoftArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return self._soft.stepper.quick.sides.knows_factor

    def _commands(self, loads: Sequence[Loads]) -> FilmCommands:
        chambers = len(self._soft.body.gas_chambers)
        pressure = np.array([load.pressures(chambers) for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        return FilmCommands(pressure, tension, np.array([load.gravity for load in loads]))

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
        state = self._soft.state
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
        soft, quick, tick_s = self._soft, self._soft.stepper.quick, self.interface.scene.tick_s
        if soft.state.earlier is None:  # a first step looks back over one only
            servos, commands = servos.some(0, 1), commands.some(0, 1)
        scheme, pressed = soft.stepper.scheme_of(soft.state, tick_s), soft.state.touching is not None
        side = quick.sides.of(scheme, tick_s, pressed=pressed)
        assert side is not None, "of a body and a factorisation that it knows"
        if soft.films is not None:
            soft.films.remember(soft.state.touching)
        steps = self._steps(side, pressed)
        done, ending = advance_film(rigid, servos, commands, steps, ticks, way)
        if ending == LISTS_LEFT:  # with new lists the kernel takes this tick as well, after its rigid half
            steps = self._with_new_lists(steps, way.x[done + 1], way.velocity[done + 1])
            one = servos.some(done, done + 1), commands.some(done, done + 1), steps
            more, ending = advance_film(rigid, *one, ticks.from_on(done), way.from_on(done))
            done, ending = done + more, SOFT_HALF_LEFT if ending == LISTS_LEFT else ending
        quick.sides.take_over(side, scheme)
        if done:
            self._went(way, ticks, done, loads[done - 1])
        if soft.films is not None:
            soft.films.overlook(soft.state)
        if ending in (SOFT_STEP_BEGUN, SOFT_STEP_SOLVED):
            end = way.x[done + 2].copy(), way.velocity[done + 2].copy(), way.memory[done + 1].copy()
            spent = int(ticks.iterations[done]), float(ticks.residual[done])
            quick.begun = BegunStep(soft.state, *end, *spent, ending == SOFT_STEP_SOLVED)
        return done, ending

    def _steps(self, side: FilmSide, pressed: bool) -> FilmSteps:
        """Return what the steps of a row have in common; `pressed`: films press on one another before it."""
        soft, contact, films = self._soft, self.interface.contact, self._soft.films
        quick, tick_s = soft.stepper.quick, self.interface.scene.tick_s
        return FilmSteps(
            quick.sides.address(side), quick.begins(lenient=True), quick.begins(lenient=False),
            0.0 if contact is None else contact.rest_reach_m, 0.0 if films is None else films.rest_m,
            AHEAD_TICKS * tick_s, self._calls, soft.body.node_mass.reshape(-1, 1, 1), LARGE_TURN_RAD,
            self._contact_store.address(self._nothing) if contact is None else contact.at,
            self._films_store.address(self._no_films) if films is None else films.at,
            self.fast_m_s, pressed and quick.sides.has_parts,
        )  # fmt: skip

    def _with_new_lists(self, steps: FilmSteps, x: Array, velocity: Array) -> FilmSteps:
        """Return the same for a tick from x and velocity (n, 3) whose rigid half has been taken."""
        contact, films, tick_s = self.interface.contact, self._soft.films, self.interface.scene.tick_s
        if contact is not None:
            contact.find(SoftState(x, velocity, self._soft.state.memory), tick_s)
            steps = steps._replace(contact=contact.at)
        if films is not None:
            films.renew(x, velocity, tick_s)
            steps = steps._replace(films=films.at)
        return steps._replace(calls=self._soft_calls)

    def _went(self, way: FilmMotion, ticks: Ticks, done: int, loads: Loads) -> None:
        """Let the soft side go to where ticks have led it; `loads` are those of the last one."""
        soft, films = self._soft, self._soft.films
        x, velocity = way.x[done : done + 2].copy(), way.velocity[done : done + 2].copy()
        touching = None if films is None else films.remembered
        state = SoftState(x[1], velocity[1], way.memory[done].copy(), (x[0], velocity[0]), touching)
        drive = ticks.flange(done), loads
        soft.go_to(state, float(ticks.residual[done - 1]), ticks.flange(done - 1), drive)


@final
class _SectionHalves(SoftHalves):
    """Of a section model that touches nothing.

    Args:
        interface: between the sides.
    """

    most = 512  # more cost no less each

    @property
    def _soft(self) -> SectionArm:
        soft = self.interface.soft.rowing
        assert isinstance(soft, SectionArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return True

    def _commands(self, loads: Sequence[Loads]) -> ChainCommands:
        pressure = np.array([self._soft.section.pressure(load) for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        first, weights = np.empty(len(loads), np.int64), np.empty((len(loads), TERMS))
        spline, terms = self._soft.section.model.spline, None
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
        soft, stepper, tick_s = self._soft, self._soft.stepper, self.interface.scene.tick_s
        options, begin = stepper.options, soft.last.chain
        two_steps, earlier = options.integrator == "bdf2", begin.earlier is not None
        steps = ChainSteps(
            stepper.side(soft.clamp, loads[0], begin.frames), ChainTables(*stepper.tables),
            address_of(solve_chain), address_of(hand_over), stepper.scheme(tick_s),
            two_steps, earlier, stepper.tangent.serves(soft.clamp, tick_s, two_steps and earlier),
        )  # fmt: skip
        done, ending, kept = advance_chain(rigid, servos, commands, steps, ticks, way)
        last = done if ending == SOFT_HALF_LEFT else done - 1  # of which the soft step was tried
        stepper.tangent.keep(kept, soft.clamp, tick_s, two_steps and (earlier or last > 0))
        if done:
            motion, figures = way.motion[done : done + 2].copy(), ticks.figures[done].copy()
            step = ChainStep(
                ChainState(motion[1], motion[0]), way.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
                int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]),
                soft.section.pressure(loads[done - 1]),
            )  # fmt: skip
            soft.go_to(step, ticks.flange(done), loads[done - 1])
        # what was computed for a pressure is kept with it
        stepper.side(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending


def rigid_share(ratio: float) -> float:
    """Return b, how much of what the film lags behind within a tick is carried all the same.

    Args:
        ratio: r, stability ratio of the flange.
    """
    return 1.0 if ratio <= 1.0 else 1.0 / ratio**2


def algorithmic_mass(
    soft: SoftSide, origin: Array, ratio: float, contact: ContactPlanes | None, step_s: float
) -> Array:
    """Return M_a (6, 6), linear then angular, about a point, world axes.

    Args:
        soft: after its step.
        origin: (3,) [m], of the flange.
        ratio: r, stability ratio of the flange.
        contact: with the body; None for none.
        step_s: h [s].
    """
    mass = soft.mass_properties().spatial(origin)
    lacking = 1.0 - rigid_share(ratio)
    if lacking > 0.0:
        rigid = rigid_motions(soft.state.positions, origin)
        momentum = np.ascontiguousarray((soft.body.node_mass[:, None, None] * rigid).transpose(2, 0, 1))
        lagging = soft.response(soft.inertia_weight(step_s) * momentum, contact, step_s)
        if lagging is not None:  # the tangent is not indefinite
            behind = lacking * np.einsum("inr,jnr->ij", momentum, lagging)
            mass -= 0.5 * (behind + behind.T)
    return np.asarray(soft.answer_weights[0] * mass)


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (k, joints) [rad/s^2], accelerations while it was carried.
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
        self._weights = expecting_no_change(interface.soft.answer_weights)
        self._past = np.zeros((len(self._weights), joints))
        self._carries = False
        self._rowing, self._halves = interface.soft.rowing, soft_halves(interface)
        self._fine = FineTicks(interface)
        self._halves.fast_m_s = self._fine.fast_m_s
        self._begun: tuple[TicksTaken, RigidSide] | None = None

    def begin(self) -> None:
        """Load the rigid side for a tick whose rigid half somebody else takes; then comes `advance`."""
        taken = self._ready(1)
        rigid = self._weighed(taken)
        load_rigid_side(rigid, taken.ticks, 0)
        self._begun = taken, rigid

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
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
        carried = CarriedInertia(self._added[:joints, :joints].copy(), self._weights, self._past)
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
        return CarriedInertia(added.copy(), self._weights, self._past.copy())

    @property
    def fine(self) -> FineTicks:
        """What takes ticks in pieces."""
        return self._fine

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy(), self._fine.on)

    def restore_state(self, state: StaggeredState) -> None:
        self._begun = None
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
            added = jacobian.T @ mass @ jacobian
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
