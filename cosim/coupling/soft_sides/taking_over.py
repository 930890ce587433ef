"""How the film begins where a chain of frames is, and a chain where the film is: shape, speed, forces.

The model that takes over repeats the last tick, from where the other began it: so it has two states to step
on from, and both can be compared at its end. What a two-step integrator looks back to before that follows
from its formula: with s = 2 h / 3 and base a_n = x_n - s v_n = (4 x_n-1 - x_n-2) / 3,

    x_n-2 = 4 x_n-1 - 3 a_n,    v_n-2 = 2 (x_n-1 - x_n-2) / h - v_n-1.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose, Wrench
from cosim.coupling.soft_sides import lumped_arm, section_arm
from cosim.coupling.soft_sides.handover import MOST_BRIDGED, fade_steps
from cosim.coupling.soft_sides.held_rings import Bridge, HeldRings, borne, flange_of, on_rings
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide
from cosim.errors import ConvergenceError
from cosim.reduced.section_model import carried
from cosim.reduced.sections.assembly import supplied_wrench
from cosim.reduced.solve.chain_step import ChainState
from cosim.reduced.solve.clamp import FrameClamp, film_clamp, rates_from_nodes, upright
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import Equilibrium, SoftState

_NEAR_ITERATIONS: Final = 600  # in which the film comes to rest near a chain
_G_m_s2: Final = 9.81


@final
@dataclass(frozen=True)
class LoadsLeft:
    """Loads in which a model was left: with the bridging forces that acted on it, and without.

    Args:
        whole: with them.
        own: without.
    """

    whole: Loads
    own: Loads

    @property
    def untouched(self) -> "LoadsLeft":
        """The same with nothing that is touched."""
        return LoadsLeft(replace(self.whole, contact=None), replace(self.own, contact=None))

    def with_borne(self, wrench: Wrench, positions: Array, flange: Pose) -> Wrench:
        """Return a wrench on the flange with what that bears of the bridging forces on nodes (n, 3) [m]."""
        whole, own = self.whole.nodal_force, self.own.nodal_force
        if self.whole is self.own or whole is None:
            return wrench
        return together(wrench, borne(whole if own is None else whole - own, positions, flange))


@final
@dataclass(frozen=True)
class Jumps:
    """By how much two models differ at the end of a tick that both have taken; see `Handover`."""

    tip_m: float
    force_N: float
    wrench: float
    kinetic_J: float = 0.0
    pressure_Pa: float = 0.0
    touched_N: float = 0.0


NO_JUMPS: Final = Jumps(0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class Past:
    """Frames and their rates one and two steps before a chain.

    Args:
        motion: (2, f, 4, 3), one step before.
        earlier: (2, f, 4, 3), two steps before.
    """

    motion: Array
    earlier: Array

    @classmethod
    def of(cls, now: ChainState, step_s: float) -> "Past":
        """Return those of a chain after a step of some length [s]; of a first step: as if it moved evenly."""
        x, v = now.motion
        one = np.array((upright(x - step_s * v), v)) if now.earlier is None else now.earlier
        base = x - 2.0 * step_s / 3.0 * v
        two = upright(4.0 * one[0] - 3.0 * base)
        return cls(one, np.array((two, 2.0 * (one[0] - two) / step_s - one[1])))


def together(one: Wrench, other: Wrench) -> Wrench:
    """Return the sum of two wrenches at one point."""
    return Wrench(one.force + other.force, one.torque + other.torque)


def without(found: Equilibrium, loads: Loads, bridge: Bridge, step: int = 0) -> tuple[Equilibrium, Bridge]:
    """Return an equilibrium without bridging forces among its loads, and the bridge, which the flange bears.

    Args:
        found: with them.
        loads: without them.
        bridge: at the end of a step.
        step: which.
    """
    more = bridge.on_flange(found.state.positions, found.world_from_flange, step)
    given = replace(found.loads, nodal_force=loads.nodal_force)
    return replace(found, loads=given, wrench=together(found.wrench, more)), bridge


def with_force(loads: Loads, force: Array | None) -> Loads:
    """Return loads with further dead forces (n, 3) [N], world axes; None for none."""
    if force is None:
        return loads
    given = loads.nodal_force
    return replace(loads, nodal_force=force if given is None else given + force)


@final
class TakingOver:
    """Lets the film begin where a chain is, and the other way round.

    Args:
        chain: one model.
        film: the other, of the same body.
    """

    def __init__(self, chain: section_arm.SectionArm, film: lumped_arm.SoftArm) -> None:
        self._chain, self._film = chain, film
        self._layout, self._section = chain.section.frames, chain.section
        self._rings = HeldRings(film.body, film.films, film.in_shape, self._section)
        self._two_steps = film.dynamics.integrator == "bdf2"

    def _hold_film(self, clamp: FrameClamp, shape: Array, flange: Pose) -> None:
        """Hold the film as frames are held, where a shape (n, 3) [m] has their rings."""
        wanted = film_clamp(self._section, clamp, shape, flange)
        if not np.array_equal(wanted.nodes, self._film.clamp.nodes):
            self._film.hold(wanted)

    def _to_film(self, frames: Array, acting: LoadsLeft, pressure_Pa: float) -> tuple[SoftState, Array]:
        """Return the film at rest with rings held at frames, and B (n, 3) [N], world axes."""
        film, chain = self._film, self._chain
        held = self._rings.at_rest(frames, None, acting.own, pressure_Pa)
        self._hold_film(chain.clamp, held.state.positions, flange_of(frames))
        resisted = chain.resisting(frames, acting.whole, pressure_Pa)
        force = held.force - on_rings(self._layout, frames, resisted, chain.clamp.free, len(held.force))
        force[film.clamp.nodes] = 0.0
        return held.state, force

    def _to_chain(self, frames: Array, shape: SoftState, acting: LoadsLeft, pressure_Pa: float) -> Array:
        """Return -B (n, 3) [N], world axes, of a film near a shape."""
        held, chain = self._rings.at_rest(frames, shape, acting.whole, pressure_Pa), self._chain
        resisted = chain.resisting(frames, acting.own, pressure_Pa)
        force = on_rings(self._layout, frames, resisted, chain.clamp.free, len(held.force)) - held.force
        force[self._film.clamp.nodes] = 0.0
        return np.asarray(force)

    def film_holds(
        self, acting: LoadsLeft, flange: Pose, planes: ContactPlanes, step_s: float
    ) -> tuple[Bridge, Jumps, Array]:
        """Let the film hold what the chain holds, and be where the last tick of the chain has ended.

        A film is dented by what it holds, a chain is not. So the rings close in until contacts press as the
        chain's: the film is at rest under the forces of the springs that hold it untouched, its contacts,
        and the opposite of the chain's, spread over the rings.

        Args:
            acting: loads at the end of the tick, contacts not counted.
            flange: its pose at the end of the coming tick.
            planes: that may be touched in that.
            step_s: length of a tick.

        Returns:
            The bridge, the jumps, and how far (n, 3) [m] the untouched film lies off the chain's.

        Raises:
            ConvergenceError: the film does not come to rest with its rings where the chain has them.
        """
        chain, last = self._chain, self._chain.last
        here, pressure, own = chain.save_state().flange, last.pressure_Pa, acting.untouched.own
        ahead = flange @ here.inverse()
        frames = carried(last.frames, ahead)
        drawn = self._section.positions(frames, pressure)
        state, force = self._to_film(frames, acting.untouched, pressure)
        off = state.positions - drawn
        bridge, tied = Bridge(force @ flange.rotation, np.zeros(6), fade_steps(step_s)), planes.carried(off)
        pressed = LoadsLeft(replace(acting.whole, contact=planes), replace(own, contact=tied))
        state, wrench = self._closed_in(frames, state, force, pressed)
        x = state.positions
        if wrench is not None:
            wrench = together(wrench, bridge.on_flange(x, flange, 0))
        left = acting.with_borne(supplied_wrench(last.figures), chain.state.positions, here)
        left = Wrench(ahead.rotation @ left.force, ahead.rotation @ left.torque)
        bridge, jumps = self._closed(bridge, (self._tips(drawn), left), (self._tips(x), wrench), flange)
        gap = planes.force_on_bodies(drawn) - tied.force_on_bodies(x)
        self._film_goes_on(replace(state, positions=ahead.inverse().apply(x)), here, own, step_s)
        return bridge, replace(jumps, touched_N=float(np.linalg.norm(gap, axis=1).max())), off

    def _closed_in(
        self, frames: Array, untouched: SoftState, force: Array, pressed: LoadsLeft
    ) -> tuple[SoftState, Wrench | None]:
        """Return the film at rest where it presses as the chain at frames, and its wrench on the flange.

        Where it does not come to rest, it is held where the chain is; its wrench is then not known.

        Args:
            frames: (f, 4, 3).
            untouched: film, held there.
            force: (n, 3) [N], B.
            pressed: loads with contacts: of the chain, and of the film.
        """
        film, free, flange = self._film, self._chain.clamp.free, flange_of(frames)
        pressure = self._chain.last.pressure_Pa
        held = self._rings.at_rest(frames, untouched, pressed.own, pressure).state
        resisted = self._chain.resisting(frames, pressed.whole, pressure)
        answered = on_rings(self._layout, frames, resisted, free, len(force))
        answered[film.clamp.nodes] = 0.0
        try:
            found = film.solve(held, flange, with_force(pressed.own, force + answered))
        except ConvergenceError:
            return held, None
        return found.state, found.wrench

    def _film_goes_on(self, state: SoftState, flange: Pose, loads: Loads, step_s: float) -> None:
        """Put the film where the chain is, in a shape near its own, with the chain's speed.

        Args:
            state: at rest.
            flange: pose of the flange.
            loads: that act.
            step_s: length of a tick.
        """
        section, last = self._section, self._chain.last
        x, (before, rates) = state.positions, Past.of(last.chain, step_s).motion
        velocity = section.positions(last.chain.rates, last.pressure_Pa)
        earlier = None
        if self._two_steps:
            x_before = self._layout.carried(x, last.frames, before)
            earlier = x_before, section.positions(rates, last.pressure_Pa)
        begin = replace(state, velocities=velocity, earlier=earlier)
        self._film.go_to(begin, 0.0, flange_of(before), (flange, loads))

    def film_steps(self, acting: LoadsLeft, step_s: float) -> tuple[Bridge, Jumps]:
        """Let the film take the last tick of the chain, and be where that ends.

        What is touched has not dented the film yet: a hit is over before it would rest there.

        Args:
            acting: loads at its end.
            step_s: its length.

        Raises:
            ConvergenceError: the film does not come to rest with its rings where the chain has them.
        """
        chain, film, section = self._chain, self._film, self._section
        saved, shape = chain.save_state(), chain.state.positions
        tips = self._tips(shape)
        last, pressure = saved.last, saved.last.pressure_Pa
        past = Past.of(last.chain, step_s)
        before, first = flange_of(past.motion[0]), flange_of(past.earlier[0])
        state, force = self._to_film(past.motion[0], acting.untouched, pressure)
        bridge = Bridge(force @ before.rotation, np.zeros(6), fade_steps(step_s))
        velocity = section.positions(past.motion[1], pressure)
        earlier = None
        if self._two_steps:
            carried = self._layout.carried(state.positions, past.motion[0], past.earlier[0])
            earlier = film.clamp.place(carried, first), section.positions(past.earlier[1], pressure)
        begin = replace(state, velocities=velocity, earlier=earlier)
        film.go_to(begin, 0.0, first, (before, acting.own))
        there = bridge.at(saved.flange, 0)
        try:
            reply: SoftReply | None = film.advance(saved.flange, with_force(acting.own, there), step_s)
        except ConvergenceError:
            self._film_stands(begin, last.chain, pressure, (before, saved.flange), acting)
            reply = None
        kinetic = _of_film(film) - self._of_chain(last.chain)
        wrench = acting.with_borne(supplied_wrench(last.figures), shape, saved.flange)
        reached = self._reached(bridge, film, reply)
        bridge, jumps = self._closed(bridge, (tips, wrench), reached, saved.flange)
        return bridge, replace(jumps, kinetic_J=kinetic, pressure_Pa=film.pressures_Pa[0] - pressure)

    def _film_stands(
        self,
        begin: SoftState,
        now: ChainState,
        pressure_Pa: float,
        flanges: tuple[Pose, Pose],
        acting: LoadsLeft,
    ) -> None:
        """Put the film where the chain is, without its own step."""
        before = now.frames if now.earlier is None else now.earlier[0]
        x = self._layout.carried(begin.positions, before, now.frames)
        start = replace(begin, positions=x, earlier=None)
        state = self._rings.at_rest(now.frames, start, acting.untouched.own, pressure_Pa).state
        velocity = self._section.positions(now.rates, pressure_Pa)
        earlier = (begin.positions, begin.velocities) if self._two_steps else None
        here = replace(state, velocities=velocity, earlier=earlier)
        self._film.go_to(here, 0.0, flanges[0], (flanges[1], acting.own))

    def chain_steps(self, acting: LoadsLeft, wrench: Wrench, step_s: float) -> tuple[Bridge, Jumps]:
        """Let the chain take the last tick of the film, and be where that ends.

        Args:
            acting: loads at its end.
            wrench: of the film on the flange there.
            step_s: its length.

        Raises:
            ConvergenceError: the chain cannot.
        """
        chain, film = self._chain, self._film
        saved, tips, pressure = film.save_state(), self._tips(film.state.positions), film.pressures_Pa[0]
        flange, before = saved.flange, saved.flange_before or saved.flange
        now, shape = self._fitted(saved.soft, (before, flange), step_s)
        past = Past.of(now, step_s)
        force = self._to_chain(past.motion[0], shape, acting, pressure)
        bridge = Bridge(force @ before.rotation, np.zeros(6), fade_steps(step_s))
        begin = ChainState(past.motion, past.earlier if self._two_steps else None)
        chain.go_to(chain.standing(begin, pressure), before, acting.own)
        there = bridge.at(flange, 0)
        reply = chain.advance(flange, with_force(acting.own, there), step_s)
        kinetic = self._of_chain(chain.last.chain) - _of_film(film)
        bridge, jumps = self._closed(bridge, (tips, wrench), self._reached(bridge, chain, reply), flange)
        return bridge, replace(jumps, kinetic_J=kinetic, pressure_Pa=chain.last.pressure_Pa - pressure)

    def _fitted(
        self, soft: SoftState, flanges: tuple[Pose, Pose], step_s: float
    ) -> tuple[ChainState, SoftState]:
        """Return the chain of a film with that one step before, and the film there, at rest."""
        x, v = soft.positions, soft.velocities
        x_before, v_before = (x - step_s * v, v) if soft.earlier is None else soft.earlier
        layout, motions = self._layout, []
        bases = layout.drawn[layout.bases]
        rate = (carried(bases, flanges[1]) - carried(bases, flanges[0])) / step_s
        for place, speed, flange in ((x, v, flanges[1]), (x_before, v_before, flanges[0])):
            frames = layout.fit(place, flange)
            rates = rates_from_nodes(layout, frames, speed)
            rates[layout.bases] = rate
            motions.append(np.array((frames, rates)))
        shape = SoftState.at_rest(self._film.clamp.place(x_before, flanges[0]), soft.memory, soft.touching)
        return ChainState(*motions), shape

    def film_rests(
        self, begin: Equilibrium, acting: LoadsLeft, bridged: bool
    ) -> tuple[Equilibrium, Bridge | None]:
        """Return the film at rest where the chain is at an equilibrium, by bridging forces, or near there.

        Args:
            begin: of the chain.
            acting: loads there.
            bridged: whether it is held there.

        Raises:
            ConvergenceError: it comes to rest nowhere.
        """
        chain, film = self._chain, self._film
        now, pressure = chain.chain_of(begin.state, begin.world_from_flange)
        flange = begin.world_from_flange
        state, force = self._to_film(now.frames, acting, pressure)
        if not bridged:
            return film.rest_near(state, flange, acting.own, _NEAR_ITERATIONS), None
        found = film.solve(state, flange, with_force(acting.own, force))
        bridge = Bridge(force @ flange.rotation, np.zeros(6), fade_steps(0.0))
        return self._joined(begin, *without(found, acting.own, bridge))

    def chain_rests(self, begin: Equilibrium, acting: LoadsLeft) -> tuple[Equilibrium, Bridge]:
        """Return the chain at rest where the film is at an equilibrium, by bridging forces.

        Args:
            begin: of the film.
            acting: loads there.

        Raises:
            ConvergenceError: it has none there, or none near when they have faded.
        """
        flange, pressure = begin.world_from_flange, self._film.pressures_Pa[0]
        frames = self._layout.fit(begin.state.positions, flange)
        force = self._to_chain(frames, begin.state, acting, pressure)
        still = self._chain.standing(ChainState.at_rest(frames), pressure)
        self._chain.go_to(still, flange, acting.own)
        found = self._chain.solve(self._chain.state, flange, with_force(acting.own, force))
        self._chain.follow(found, flange, acting.own)
        bridge = Bridge(force @ flange.rotation, np.zeros(6), fade_steps(0.0))
        return self._joined(begin, *without(found, acting.own, bridge))

    @staticmethod
    def _joined(begin: Equilibrium, found: Equilibrium, bridge: Bridge) -> tuple[Equilibrium, Bridge]:
        """Return an equilibrium with the wrench of one that was left, and what bridges both."""
        load = _between(found.wrench, begin.wrench, found.world_from_flange)
        return replace(found, wrench=begin.wrench), replace(bridge, load=load)

    def _tips(self, positions: Array) -> Array:
        """Return the tips (copies, 3) [m] of a film."""
        ends = [self._layout.rings[chain.stop - 2] for chain in self._layout.chains]
        return np.array([positions[ring].mean(axis=0) for ring in ends])

    def _of_chain(self, chain: ChainState) -> float:
        """Return the kinetic energy [J] of a chain."""
        return 0.5 * float(np.einsum("fab,far,fbr->", self._section.mass, chain.rates, chain.rates))

    def between(self, left: Equilibrium, new: Equilibrium, bridge: Bridge | None) -> Jumps:
        """Return the jumps from one equilibrium to another, of the other model, and what a bridge closes."""
        tip, new_tip = self._tips(left.state.positions), self._tips(new.state.positions)
        wrench, flange = new.wrench, new.world_from_flange
        if bridge is not None:
            load = bridge.load.reshape(2, 3) @ flange.rotation.T
            wrench = Wrench(wrench.force - load[0], wrench.torque - load[1])
        return self._apart(tip, left.wrench, new_tip, wrench, flange)

    def _closed(
        self, bridge: Bridge, left: tuple[Array, Wrench], new: tuple[Array, Wrench | None], flange: Pose
    ) -> tuple[Bridge, Jumps]:
        """Return a bridge that closes what the wrenches still differ by, and that; and the jump of the tips.

        Args:
            bridge: so far.
            left: tips (copies, 3) [m] and wrench of the model that is left.
            new: of the new one; no wrench where it has not taken the tick.
            flange: pose of the flange.
        """
        (tips, before), (new_tips, wrench) = left, new
        if wrench is None:
            tip_m = float(np.linalg.norm(new_tips - tips, axis=1).max())
            return bridge, Jumps(tip_m, np.nan, np.nan)
        jumps = self._apart(tips, before, new_tips, wrench, flange)
        if jumps.wrench > MOST_BRIDGED:  # a hit: what no film would pass on is not to last
            return bridge, jumps
        return replace(bridge, load=_between(wrench, before, flange)), jumps

    def _reached(
        self, bridge: Bridge, side: SoftSide, reply: SoftReply | None
    ) -> tuple[Array, Wrench | None]:
        """Return tips and wrench of a model at the end of a tick that it has answered."""
        x, flange = side.state.positions, side.save_state().flange
        return self._tips(x), reply and together(reply.wrench, bridge.on_flange(x, flange, 0))

    def _apart(self, tip: Array, left: Wrench, new_tip: Array, new: Wrench, flange: Pose) -> Jumps:
        """Return by how much tip and wrench differ, the latter over its size or the soft robot's weight."""
        away_N = float(np.linalg.norm(new.force - left.force))
        away_Nm = float(np.linalg.norm(new.torque - left.torque))
        weight = _G_m_s2 * self._film.mass_kg
        length = float(np.linalg.norm(tip - flange.translation, axis=1).max())
        size_N = max(float(np.linalg.norm(left.force)), weight)
        size_Nm = max(float(np.linalg.norm(left.torque)), 0.5 * weight * length)
        tip_m = float(np.linalg.norm(new_tip - tip, axis=1).max())
        return Jumps(tip_m, away_N, max(away_N / size_N, away_Nm / size_Nm))


def _between(found: Wrench, wanted: Wrench, flange: Pose) -> Array:
    """Return what a wrench lacks of another (6,), in the flange's axes."""
    force, torque = wanted.force - found.force, wanted.torque - found.torque
    return np.concatenate([force @ flange.rotation, torque @ flange.rotation])


def _of_film(film: lumped_arm.SoftArm) -> float:
    """Return the kinetic energy [J] of a film."""
    velocity = film.state.velocities
    return 0.5 * float(np.einsum("n,nr,nr->", film.body.node_mass, velocity, velocity))
