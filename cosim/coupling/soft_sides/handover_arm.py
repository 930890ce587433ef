"""The soft side of a run that changes between a section model and its film: two models behind one interface.

The chain represents the soft robot while it can. A tick that it cannot take, as it is at the end of its range
or loses its equilibrium, is taken by the film; the chain takes back when the film has been well within its
range for a while. How one begins where the other is: `taking_over`.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.coupling.schemes.ledger import ShapeFigures
from cosim.coupling.soft_sides import handover, lumped_arm, soft_side, taking_over
from cosim.coupling.soft_sides.held_rings import Bridge
from cosim.coupling.soft_sides.section_arm import ChainShape, ChainShapes, SectionArm, SectionArmState
from cosim.coupling.soft_sides.taking_over import Jumps, LoadsLeft, TakingOver, together, with_force, without
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.solve.clamp import place_in_range
from cosim.soft.body.loads import Loads
from cosim.soft.contact import contact_points, self_contact_pairs
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve import branching, newton_options
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState, StepAim
from cosim.soft.solve.tip_target import TargetOptions, TipTarget


@final
class HandoverReader(soft_side.ShapeReader):
    """Reads shapes of chain and film.

    Args:
        chain: reads those of the chain.
        film: reads those of the film.
    """

    def __init__(self, chain: soft_side.ShapeReader, film: soft_side.ShapeReader) -> None:
        self._chain, self._film = chain, film

    def positions(self, shape: ChainShape | Array) -> Array:
        """Return the film's nodes (n, 3) [m]."""
        return (self._chain if isinstance(shape, ChainShape) else self._film).positions(shape)

    def films(self, shapes: Sequence[ChainShape | Array]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of some shapes."""
        return np.concatenate([reader.films(some) for reader, some in self._runs(shapes)])

    def figures(self, shapes: Sequence[ChainShape | Array]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        parts = [vars(reader.figures(some)).values() for reader, some in self._runs(shapes)]
        return ShapeFigures(*map(np.concatenate, zip(*parts, strict=True)))

    def tips(self, shapes: Sequence[ChainShape | Array]) -> Array:
        """Return the tips; see `ShapeReader.tips`."""
        return np.concatenate([reader.tips(some) for reader, some in self._runs(shapes)])

    def _runs(self, shapes: Sequence[Any]) -> list[tuple[soft_side.ShapeReader, Sequence[Any]]]:
        """Return the shapes in runs of one kind, with their readers."""
        if isinstance(shapes, ChainShapes):
            return [(self._chain, shapes)]
        kinds = [isinstance(shape, ChainShape) for shape in shapes]
        ends = [k for k in range(1, len(kinds)) if kinds[k] != kinds[k - 1]]
        begins = zip([0, *ends], [*ends, len(kinds)], strict=True)
        return [(self._chain if kinds[a] else self._film, shapes[a:b]) for a, b in begins]


@final
@dataclass(frozen=True)
class HandoverState:
    """What the next step depends on.

    Args:
        model: that represents the soft robot.
        chain: of both.
        film: of both.
        bridge: forces that fade; None for none.
        given: (n, 3) [N], dead forces of the last step besides them; None for none.
        inside: how long the film has been within the chain's range.
        ticks: steps taken.
        why: the film has taken over.
    """

    model: handover.Model
    chain: SectionArmState
    film: lumped_arm.SoftArmState
    bridge: Bridge | None
    given: Annotated[Array, ("nodes", 3)] | None
    inside: handover.Inside
    ticks: int
    why: str


@final
@dataclass(frozen=True)
class _Pending:
    """A change of models in statics, which is made once somebody takes its equilibrium over.

    Args:
        state: of that equilibrium.
        bridge: forces that fade; None for none.
        why: the change.
        jumps: of the models.
    """

    state: SoftState
    bridge: Bridge | None
    why: str
    jumps: Jumps


@final
class HandoverArm(soft_side.SoftSide):
    """A chain of frames and its film, one of which represents the soft robot.

    Args:
        chain: section model.
        film: that it was condensed from.
        bridged: whether forces bridge what the models differ by; a plan has no use for them.
    """

    def __init__(self, chain: SectionArm, film: lumped_arm.SoftArm, *, bridged: bool = True) -> None:
        self.chain, self.film, self.body = chain, film, film.body
        self.effort: newton_options.SearchEffort = film.effort
        self.work = chain.work = film.work
        chain.final = OutOfRangeError  # halves near the end of its range only put the change off
        self._bridged, self._over = bridged, TakingOver(chain, film)
        self._film_acts, self._why = False, ""
        self._bridge: Bridge | None = None
        self._given: Array | None = None
        self._inside, self._ticks, self._step_s, self._begun = handover.Inside(), 0, 0.0, False
        self._before: tuple[SoftState, Pose] | None = None  # before the step in progress, while forces fade
        self._due = ""  # why the film takes over in the next tick
        self._pending: _Pending | None = None
        self._events: list[handover.Handover | handover.BridgeEnd] = []

    @property
    def acting(self) -> SectionArm | lumped_arm.SoftArm:
        """The model that represents the soft robot."""
        return self.film if self._film_acts else self.chain

    @property
    def rowing(self) -> soft_side.SoftSide:
        """What kernels may step: itself, which they do not know, while forces fade or the film is due."""
        return self.acting if self._bridge is None and not self._due else self

    @property
    def state(self) -> SoftState:
        """Of the acting model; that of a chain remembers nothing of its film."""
        return self.acting.state

    @state.setter
    def state(self, film: SoftState) -> None:
        self._of(film).state = film

    def _of(self, state: SoftState) -> SectionArm | lumped_arm.SoftArm:
        """Return the model that a state is of."""
        return self.film if len(state.memory) else self.chain

    def _in_shape(self, shape: Any) -> SectionArm | lumped_arm.SoftArm:
        return self.chain if isinstance(shape, ChainShape) else self.film

    # ticks

    def begin_ticks(self, wrench: Wrench, step_s: float, *, touching: bool) -> int:
        """Change back to the chain where that is due; return how many ticks may follow.

        Copies do not while they touch something: a chain would let go of what dents the film.
        """
        self._step_s, self._begun = step_s, True
        copies = self.chain.section.copies > 1
        if self._film_acts and self._inside.due and self._bridge is None and not (touching and copies):
            self._take_back(wrench, step_s)
        if self._film_acts or not copies:
            every = handover.look_every(step_s)
            return every - self._inside.since % every if self._film_acts else sys.maxsize
        every = handover.look_every(step_s, handover.HOLDING_LOOK_S)
        if touching and self._ticks % every == 0:
            last = self.chain.last
            place = place_in_range(self.chain.section, last.frames, last.pressure_Pa, bends_only=True)
            self._due = place.text if place.fraction > handover.HOLDING else ""
        return every - self._ticks % every

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> soft_side.SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance(world_from_flange, loads, step_s, None)

    def advance_closely(
        self, world_from_flange: Pose, loads: Loads, step_s: float, aim: StepAim
    ) -> soft_side.SoftReply:
        """Advance by one step, as closely as asked for."""
        return self._advance(world_from_flange, loads, step_s, aim)

    def _advance(self, flange: Pose, loads: Loads, step_s: float, aim: StepAim | None) -> soft_side.SoftReply:
        self._step_s, due, self._due = step_s, self._due, ""
        if due:
            with suppress(ConvergenceError):  # the chain can continue
                self._hand_over(due, flange, loads)
        try:
            return self._step(flange, loads, aim)
        except ConvergenceError as error:
            if self._film_acts:
                raise
            try:
                self._hand_over(_reason(error), flange, loads)
            except ConvergenceError as failed:
                raise error.at(f"the film did not take over ({failed})") from failed
        return self._step(flange, loads, None if aim is None else replace(aim, start=None))

    def _step(self, flange: Pose, loads: Loads, aim: StepAim | None) -> soft_side.SoftReply:
        side, bridge, force = self.acting, self._bridge, None
        if bridge is not None:
            force = bridge.at(flange, bridge.done + 1)
            self._given = loads.nodal_force
        acted = with_force(loads, force)
        if aim is None:
            reply = side.advance(flange, acted, self._step_s)
        else:
            reply = side.advance_closely(flange, acted, self._step_s, aim)
        if force is None:
            return reply
        assert bridge is not None, "of which the force is"
        more = bridge.on_flange(side.state.positions, flange, bridge.done + 1)
        return replace(reply, wrench=together(reply.wrench, more))

    def restore(self, before: SoftState) -> None:
        """Undo the last step; a change of models in it stays."""
        if self._film_acts and self._of(before) is self.chain and self._before is not None:
            before = self._before[0]
        self.acting.restore(before)

    def restart(self) -> None:
        """Let the next step be the first one of a two-step integrator."""
        self.acting.restart()

    def passed(self, count: int) -> None:
        """Take note of ticks that have been taken, however many a row may have."""
        self._ticks += count
        self._inside = replace(self._inside, since=self._inside.since + count)
        bridge = self._bridge
        if bridge is not None:
            here = self._here()
            before = here if self._before is None else self._before
            bridge = bridge.after((before[0].positions, before[1]), (here[0].positions, here[1]))
            self._before = here
            self._bridge = None if bridge.over else bridge
            if bridge.over:
                self._events.append(handover.BridgeEnd(self._ticks, bridge.work_J))
        if self._film_acts and self._inside.since % handover.look_every(self._step_s) == 0:
            self._inside = self._inside.looked(self._is_inside())

    def handovers(self) -> tuple[handover.Handover | handover.BridgeEnd, ...]:
        """Return the changes since this was asked last."""
        told, self._events = self._events, []
        if not self._begun and self._film_acts:
            told = [handover.Handover(0, "film", self._why)]
        return tuple(told)

    def _is_inside(self) -> bool:
        """Return whether the film is well within the chain's range."""
        section, film, pressure = self.chain.section, self.film.save_state(), self.film.pressures_Pa[0]
        if not 0.0 <= pressure <= handover.INSIDE * section.model.spline.largest_Pa:
            return False
        frames = section.frames.fit(film.soft.positions, film.flange)
        return place_in_range(section, frames, pressure).fraction <= handover.INSIDE

    def _here(self) -> tuple[SoftState, Pose]:
        """Return the acting model's state and the flange's pose."""
        return self.acting.state, self.acting.save_state().flange

    def _loads_left(self, whole: Loads) -> LoadsLeft:
        """Return the loads at the end of the last step with bridging forces, and without."""
        own = whole if self._bridge is None else replace(whole, nodal_force=self._given)
        return LoadsLeft(whole, own)

    def _hand_over(self, why: str, flange: Pose, loads: Loads) -> None:
        """Let the film take over instead of a tick of the chain.

        Args:
            why: it does.
            flange: pose of the flange at the end of the tick.
            loads: then, with what may be touched in it.

        Raises:
            ConvergenceError: it cannot.
            TakenOver: it has, where copies may touch something.
        """
        over, chain, planes = self._over, self.chain, loads.contact
        left, x = self._loads_left(chain.save_state().loads), chain.state.positions
        if planes is not None and chain.section.copies > 1 and planes.at(x).normal_force.any():
            bridge, jumps, off = over.film_holds(left, flange, planes, self._step_s)
        else:
            bridge, jumps = over.film_steps(left, self._step_s)
            off = self.film.state.positions - x
        self._inside = self._inside.left(self._step_s)
        self._change("film", why, bridge, jumps)
        if planes is not None and chain.section.copies > 1:
            raise handover.TakenOver(off)

    def _take_back(self, wrench: Wrench, step_s: float) -> None:
        """Let the chain take over, if it can."""
        left = self._loads_left(self.film.save_state().loads)
        try:
            bridge, jumps = self._over.chain_steps(left, wrench, step_s)
        except ConvergenceError:
            self._inside = self._inside.refused()
            return
        if not (jumps.tip_m <= handover.MOST_TIP_M and jumps.wrench <= handover.MOST_WRENCH):
            self._inside = self._inside.refused()
            return
        self._inside = self._inside.taken_back()
        self._change("section", "well within its range again", bridge, jumps)

    def _change(self, to: handover.Model, why: str, bridge: Bridge | None, jumps: Jumps) -> None:
        self._film_acts, self._why = to == "film", why
        self._bridge = bridge if self._bridged else None
        self._before = self._here()
        self._events.append(
            handover.Handover(
                self._ticks + 1, to, why, jumps.tip_m, jumps.force_N, jumps.wrench, jumps.kinetic_J,
                jumps.pressure_Pa, jumps.touched_N,
            )
        )  # fmt: skip

    # statics

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: of the chain, or of the film where that has none."""
        try:
            return self.chain.start(world_from_flange, loads)
        except ConvergenceError as error:
            found = self.film.start(world_from_flange, loads)
            self._pending = _Pending(found.state, None, _reason(error), taking_over.NO_JUMPS)
            return found

    def begin_increment(self, here: Equilibrium) -> Equilibrium:
        """Change back to the chain where that is due; return the equilibrium that it begins with."""
        self._begun = True
        if not (self._film_acts and self._inside.due and self._bridge is None):
            return here
        acting = LoadsLeft(here.loads, here.loads)
        try:
            found, bridge = self._over.chain_rests(here, acting)
        except ConvergenceError:
            self._inside = self._inside.refused()
            return here
        jumps = self._over.between(here, found, bridge)
        self.chain.settle(found)
        self._inside = self._inside.taken_back()
        self._change("section", "well within its range again", bridge, jumps)
        return found

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go, by the model that the state is of."""
        side = self._of(state)
        force = self._force(side, world_from_flange)
        found = side.solve(state, world_from_flange, with_force(loads, force), start)
        return self._stripped(found, loads, self._bridge_of(side))

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads, on the film where the chain ends."""
        side = self._of(begin.state)
        force = self._force(side, world_from_flange)
        try:
            found = side.follow(self._loaded(begin), world_from_flange, with_force(loads, force))
            return self._stripped(found, loads, self._bridge_of(side))
        except ConvergenceError as error:
            if side is self.film:
                raise
            first, bridge = self._film_begins(begin, error)
            failed = error
        force = None if bridge is None else bridge.at(world_from_flange, 1)
        found = self.film.follow(first, world_from_flange, with_force(loads, force))
        found = self._stripped(found, loads, bridge)
        self._pending = _Pending(
            found.state, bridge, _reason(failed), self._over.between(begin, first, bridge)
        )
        return found

    def _film_begins(self, begin: Equilibrium, error: ConvergenceError) -> tuple[Equilibrium, Bridge | None]:
        """Return the film at rest where the chain is; raise the error where there is no such place."""
        whole = self._loaded(begin).loads
        try:
            bridged = self._bridged and not self._film_acts
            return self._over.film_rests(begin, LoadsLeft(whole, begin.loads), bridged)
        except ConvergenceError as failed:
            raise error.at(f"the film did not take over ({failed})") from failed

    def _bridge_of(self, side: soft_side.SoftSide) -> Bridge | None:
        """Return what bridges the last change on a model."""
        return self._bridge if side is self.acting else None

    def _force(self, side: soft_side.SoftSide, flange: Pose) -> Array | None:
        """Return the bridging forces (n, 3) [N] on a model at the end of the increment in progress."""
        bridge = self._bridge_of(side)
        return None if bridge is None else bridge.at(flange, bridge.done + 1)

    @staticmethod
    def _stripped(found: Equilibrium, loads: Loads, bridge: Bridge | None) -> Equilibrium:
        """Return an equilibrium at the end of an increment without the bridging forces among its loads."""
        return found if bridge is None else without(found, loads, bridge, bridge.done + 1)[0]

    def _loaded(self, here: Equilibrium) -> Equilibrium:
        """Return an equilibrium with the bridging forces among its loads."""
        force = self._force(self._of(here.state), here.world_from_flange)
        return here if force is None else replace(here, loads=with_force(here.loads, force))

    def leave(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of one that is not, see `SoftSide.leave`."""
        side = self._of(found.state)
        same = begin is not None and self._of(begin.state) is side
        force = self._force(side, found.world_from_flange)
        left = side.leave(begin if same else None, self._loaded(found))
        if force is None or left.state is found.state:
            return found if left.state is found.state else left
        return self._stripped(left, found.loads, self._bridge_of(side))

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        return self._by_either(begin, lambda side, here: side.find_tensions(here, target))

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        return self._by_either(begin, lambda side, here: side.find_flange_pose(here, target, options))

    def _by_either(
        self, begin: Equilibrium, find: Callable[[SectionArm | lumped_arm.SoftArm, Equilibrium], Equilibrium]
    ) -> Equilibrium:
        """Return what is found from an equilibrium, on the film where the chain ends before."""
        side = self._of(begin.state)
        try:
            return find(side, begin)
        except ConvergenceError as error:
            if side is self.film:
                raise
            first, _ = self._over.film_rests(begin, LoadsLeft(begin.loads, begin.loads), bridged=False)
            found = find(self.film, first)
            self._pending = _Pending(found.state, None, _reason(error), taking_over.NO_JUMPS)
            return found

    def settle(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state, and the model that it is of."""
        side, pending = self._of(found.state), self._pending
        if side is self.acting:
            side.settle(self._loaded(found))
            return
        self._pending = None
        known = pending if pending is not None and pending.state is found.state else None
        bridge = None if known is None else known.bridge
        force = None if bridge is None else bridge.at(found.world_from_flange, 1)
        side.settle(replace(found, loads=with_force(found.loads, force)))
        if side is self.film:
            self._inside = self._inside.left(0.0)
        to: handover.Model = "film" if side is self.film else "section"
        why, jumps = ("", taking_over.NO_JUMPS) if known is None else (known.why, known.jumps)
        self._change(to, why, bridge, jumps)
        if not self._begun:
            self._events = []  # told by what the run begins with

    # what holds it, what it touches

    def stand_against(self, obstacles: Obstacles | None) -> None:
        """Let equilibria from now on take in what the film touches."""
        self.obstacles = obstacles
        self.chain.stand_against(obstacles)
        self.film.stand_against(obstacles)

    def hold_also(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold whole rings where they are now; they go with the flange."""
        if not self._film_acts:
            self.chain.hold_also(held, world_from_flange)
            return
        self.film.hold_also(held, world_from_flange)
        section = self.chain.section
        frames = section.frames.fit(self.film.state.positions, world_from_flange)
        self.chain.hold_as(self.chain.clamp.holding(section, held, frames, world_from_flange))

    def let_go(self, nodes: IntArray) -> None:
        """Hold the rings of the given nodes (m,) no longer."""
        self.chain.let_go(nodes)
        if np.isin(self.film.clamp.nodes, nodes).any():
            self.film.let_go(nodes)

    def contact_surface(self) -> contact_points.ContactSurface:
        """Return where the body can be touched."""
        return self.film.contact_surface()

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step."""
        return self.acting.response(forces, contact, step_s)

    def work_taken_in(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
        return self.acting.work_taken_in(displacement)

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2]: a motion X of the nodes in a step meets the inertia c m X."""
        return self.acting.inertia_weight(step_s)

    # what is seen

    def overlap(self, shape: Array) -> branching.FilmOverlap | None:
        """Return where films that are not modelled to touch have passed through one another."""
        return self.acting.overlap(shape)

    def undecided(self, shape: Any, world_from_flange: Pose, loads: Loads) -> branching.Branching | None:
        """Return in which direction a shape would give way if it was at rest; None: in none."""
        return self._in_shape(shape).undecided(shape, world_from_flange, loads)

    def footing(self, shape: Any, world_from_flange: Pose, loads: Loads) -> branching.Footing | None:
        """Return how firmly a shape stands, as if it was at rest."""
        return self._in_shape(shape).footing(shape, world_from_flange, loads)

    def rests_at(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> tuple[float, float, float] | None:
        """Return the tip [m] of the stable equilibrium that a shape slides to; None where it is not known."""
        return self._in_shape(shape).rests_at(shape, world_from_flange, loads)

    def shape_now(self) -> Any:
        """Return the present shape, of the acting model."""
        return self.acting.shape_now()

    def shape_reader(self) -> HandoverReader:
        """Return what reads shapes of both models."""
        return HandoverReader(self.chain.shape_reader(), self.film.shape_reader())

    @property
    def touching(self) -> self_contact_pairs.FilmMemory | None:
        """What the films press on one another at present; None of a chain."""
        return self.acting.touching

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of the chamber at the present shape."""
        return self.acting.volumes_m3

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in the chamber."""
        return self.acting.pressures_Pa

    @property
    def answer_weights(self) -> tuple[float, ...]:
        """How the flange's last accelerations count in the answer of inertia, see `answer_weights`."""
        return self.film.answer_weights

    @property
    def mass_kg(self) -> float:
        """Of all that hangs on the flange by it."""
        return self.acting.mass_kg

    def mass_properties(self) -> soft_side.MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return self.acting.mass_properties()

    def save_state(self) -> HandoverState:
        """Return what the next step depends on."""
        model: handover.Model = "film" if self._film_acts else "section"
        return HandoverState(
            model, self.chain.save_state(), self.film.save_state(), self._bridge, self._given, self._inside,
            self._ticks, self._why,
        )  # fmt: skip

    def restore_state(self, state: HandoverState) -> None:
        """Return to a state of `save_state`, of this arm or of one with the same body.

        Raises:
            InputError: the state is of another body.
        """
        self.chain.restore_state(state.chain)
        self.film.restore_state(state.film)
        self._film_acts = state.model == "film"
        self._bridge, self._given, self._inside = state.bridge, state.given, state.inside
        self._ticks, self._why, self._events, self._pending, self._due = state.ticks, state.why, [], None, ""
        self._begun = state.ticks > 0
        self._before = self._here()


def _reason(error: ConvergenceError) -> str:
    """Return why a chain could not continue: where it leaves its range, or what its solver says."""
    return error.place if isinstance(error, OutOfRangeError) else str(error)
