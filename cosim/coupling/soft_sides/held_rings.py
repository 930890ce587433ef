"""The film at rest with the frames of its rings held, and forces that bridge what two models answer there.

A chain of frames says where rings are, not how the film between them lies. Springs on the frame of every ring
(`RingGuides`) hold it while the film comes to rest: the springs' forces G on the nodes are what it takes.

With g (f, 6) the chain's gradient at the same frames under the same loads, at rest, and J^T spreading force
and moment of a ring over its nodes, the film under the dead forces

    B = G - J^T g

answers as the chain does, and the chain under -B as the film. B fades (`Bridge`). The flange bears its
resultant, so that it is a force within the soft robot, as the film's own are. By what the wrenches of both
still differ, of inertia and of what is touched, is put on the flange and fades as well.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, Mask, Pose, Wrench, cross, vector_from_rotation
from cosim.errors import ConvergenceError
from cosim.reduced import sampling, section_model
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.solve import assembly, equilibrium, self_contact
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, SoftState

_STIFFNESS = np.array([3e5, 3e5, 3e5, 300.0, 300.0, 300.0])  # far above a section's own
_LEAST_PIECE = 0.02  # of the way from the straight chain
_COUPLING_N_m = 1e-9  # of rings whose nodes only need places for each other in the tangent
_OPTIONS = NewtonOptions(tolerance_N=1e-6, start_tolerance_N=1e-6, iterations_max=60, shift_max_N_m=1e9)


@final
@dataclass(frozen=True)
class HeldFilm:
    """A film at rest whose rings are held.

    Args:
        state: of its nodes.
        force: (n, 3) [N], that holds it.
    """

    state: SoftState
    force: Array


@final
class HeldRings:
    """Brings a film to rest with the frames of its rings held.

    Args:
        body: of the film.
        films: their contact with one another; None for none.
        in_shape: returns a shape (n, 3) [m] at a pose of the flange as a state at rest.
        section: its section model.
    """

    def __init__(
        self,
        body: SoftBody,
        films: self_contact.SelfContact | None,
        in_shape: Callable[[Array, Pose], SoftState],
        section: section_model.SectionBody,
    ) -> None:
        frames = section.frames
        if body.frames is None:
            ends = {chain.stop - 1 for chain in frames.chains}  # whose nodes a cap joins
            rings = np.array([r for f, r in enumerate(frames.rings, 1) if len(r) and f not in ends])
            body = body.with_elements(FrameRings.from_shape(body.positions, rings, _COUPLING_N_m))
        self._in_shape, self._section, self._frames = in_shape, section, frames
        system = assembly.SoftSystem(body)
        self._groups = sampling.RingGroup.all_of(system.pattern, frames)
        clamp = Clamp.of_base(body)
        newton = NewtonSolver(system, clamp.mask(body.nodes))
        self._solver = equilibrium.EquilibriumSolver(newton, clamp, _OPTIONS, films, slides_max=0)

    def at_rest(self, frames: Array, start: SoftState | None, loads: Loads, pressure_Pa: float) -> HeldFilm:
        """Return the film at rest with its rings held.

        Args:
            frames: (f, 4, 3), where they are held; the first is the flange.
            start: of the film, near there; None for the shape that the chain draws.
            loads: that act.
            pressure_Pa: of the gas.

        Raises:
            ConvergenceError: it comes to rest nowhere.
        """
        if start is None:
            drawn = self._section.positions(frames, pressure_Pa)
            start = self._in_shape(drawn, flange_of(frames))
        with self._solver.effort.search("the film on the rings of a chain"):
            with suppress(ConvergenceError):
                return self._held(frames, start, loads)
            near = self._bent(frames, replace(loads, contact=None), pressure_Pa)
            return self._held(frames, near.state, loads)

    def _held(self, frames: Array, start: SoftState, loads: Loads) -> HeldFilm:
        guides = sampling.RingGuides(self._frames, self._groups, frames, _STIFFNESS)
        held = replace(loads, extra=guides, self_contact=None)
        found = self._solver.solve(start, flange_of(frames), held)
        return HeldFilm(found.state, guides.force(found.state.positions))

    def _bent(self, frames: Array, loads: Loads, pressure_Pa: float) -> HeldFilm:
        """Return the film at rest at frames, bent there from a straight chain in ever shorter pieces.

        Films that a bent chain draws may lie in one another, and be folded as no film is.

        Raises:
            ConvergenceError: it does not get there.
        """
        first = section_model.carried(self._section.straight(pressure_Pa), flange_of(frames))
        begin, wanted = self._frames.strains(first), self._frames.strains(frames)
        straight = self._section.positions(first, pressure_Pa)
        found = self._held(first, self._in_shape(straight, flange_of(frames)), loads)
        here, done, piece = first, 0.0, 0.5
        while done < 1.0:
            share = min(1.0, done + piece)
            there = self._frames.strained(first, begin + share * (wanted - begin))
            x = self._frames.carried(found.state.positions, here, there)
            try:
                found = self._held(there, replace(found.state, positions=x), loads)
            except ConvergenceError:
                piece *= 0.5
                if piece < _LEAST_PIECE:
                    raise
                continue
            here, done = there, share
        return found


def flange_of(frames: Array) -> Pose:
    """Return the flange's pose of a chain of frames (f, 4, 3)."""
    return Pose.owning(np.ascontiguousarray(frames[0, 1:].T), frames[0, 0].copy())


def on_rings(layout: section_model.RingFrames, frames: Array, loads: Array, free: Mask, nodes: int) -> Array:
    """Return nodal forces (n, 3) [N] with the resultants of loads on frames, spread over their rings.

    Args:
        layout: which rings are frames.
        frames: (f, 4, 3), where they are.
        loads: (f, 6), force [N] and moment [N m] about the origin of each.
        free: (f,) of which frames.
        nodes: n.
    """
    result = np.zeros((nodes, 3))
    measures = layout.measures(frames)
    for f, (ring, measure) in enumerate(zip(layout.rings, measures, strict=True), start=1):
        if free[f]:
            result[ring] += np.einsum("amr,a->mr", measure, loads[f])
    return result


@final
@dataclass(frozen=True)
class Bridge:
    """Forces that fade: all of them at first, none after some steps.

    Args:
        force: (n, 3) [N], flange frame.
        load: (6,) [N, N m], on the flange besides what it bears of these, at its origin, its axes; it fades
            in a tenth of the steps, as hits do.
        steps: in which they fade.
        done: steps taken.
        work_J: that they have done on the soft robot, as seen from the flange, and on the flange.
    """

    force: Annotated[Array, ("nodes", 3)]
    load: Annotated[Array, (6,)]
    steps: int
    done: int = 0
    work_J: float = 0.0

    @property
    def over(self) -> bool:
        """Whether nothing of it is left."""
        return self.done >= self.steps

    def share(self, step: int) -> float:
        """Return what is left of the forces at the end of a step."""
        return _left(step / self.steps)

    def share_of_load(self, step: int) -> float:
        """Return the same of the load on the flange."""
        return _left(step / max(1, self.steps // 10))

    def at(self, flange: Pose, step: int) -> Array:
        """Return the forces (n, 3) [N] at the end of a step, world axes."""
        return np.asarray(self.share(step) * self.force @ flange.rotation.T)

    def on_flange(self, positions: Array, flange: Pose, step: int) -> Wrench:
        """Return what it puts on the flange at the end of a step, world axes.

        Args:
            positions: (n, 3) [m], of the film.
            flange: its pose.
            step: which.
        """
        inner, load = borne(self.at(flange, step), positions, flange), self.share_of_load(step) * self.load
        turn = flange.rotation.T
        return Wrench(inner.force + load[:3] @ turn, inner.torque + load[3:] @ turn)

    def after(self, before: tuple[Array, Pose], after: tuple[Array, Pose]) -> "Bridge":
        """Return it one step later.

        Args:
            before: the film (n, 3) [m], world, and the flange's pose, before the step.
            after: the same after it.
        """
        (x, flange), (x_after, flange_after) = before, after
        moved = flange_after.inverse().apply(x_after) - flange.inverse().apply(x)
        shift = (flange_after.translation - flange.translation) @ flange.rotation
        turn = vector_from_rotation(flange.rotation.T @ flange_after.rotation)
        steps = self.done, self.done + 1
        mean, of_load = (0.5 * sum(map(share, steps)) for share in (self.share, self.share_of_load))
        work = mean * float(np.einsum("nr,nr->", self.force, moved))
        work += of_load * float(self.load[:3] @ shift + self.load[3:] @ turn)
        return replace(self, done=self.done + 1, work_J=self.work_J + work)


def _left(share: float) -> float:
    """Return what is left after a share of the time in which something fades, from 1 to 0 without a kink."""
    u = min(1.0, share)
    return 1.0 - u * u * (3.0 - 2.0 * u)


def borne(force: Array, positions: Array, flange: Pose) -> Wrench:
    """Return what the flange bears of forces (n, 3) [N] on nodes (n, 3) [m]: the opposite of their sum."""
    arm = positions - flange.translation
    return Wrench(-force.sum(axis=0), -cross(arm, force).sum(axis=0))
