"""What the rest of a run needs of a soft side, whatever model stands behind it.

A model with fewer unknowns than the film's mesh (frozen, or a frame per ring) still shows itself as that
mesh: `body` and `state` hold the film's nodes, and contacts, loads and supports are given on them. Such a
model must be able to find its own unknowns from the nodes of a state, so that a `SoftState` is all that
the next step depends on.

An implicit soft step answers a change of flange velocity dv with the wrench -M_a dv / h. M_a, its
algorithmic mass, never exceeds the whole mass carried rigidly, M_a <= sum_i m_i G_i^T G_i with
G_i = [1, -S(r_i)]; the staggered exchange is stable while the largest eigenvalue of W M_a stays below
about one (W: flange mobility), see `staggered` for what it carries beyond.
Source: Causin, Gerbeau and Nobile, CMAME 194 (2005) 4506, for the added-mass limit.

The flange's accelerations a_n are second differences of its places over h^2. To them the soft side's inertia
answers with -M a_n where it steps by implicit Euler, with -M (9 a_n - 6 a_n-1 + a_n-2) / 4 where it steps by
BDF2, whose difference quotient taken twice is (3 z - 1)^2 / 4 times those second differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench, cross_matrix
from cosim.coupling.robots.shape_reader import ShapeReader
from cosim.errors import ConvergenceError, TickWorkError
from cosim.reduced.sections.figures import CENTER, INERTIA
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact import contact_points, self_contact_pairs
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.mass_terms import mass_moments
from cosim.soft.solve import branching, newton_options
from cosim.soft.solve.state import Equilibrium, Integrator, Obstacles, SoftState, StepAccuracy, inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget

IMPLICIT_EULER: Final = (1.0, 0.0, 0.0)
_BDF2: Final = (9.0 / 4.0, -6.0 / 4.0, 1.0 / 4.0)


def reaction_weights(integrator: Integrator) -> tuple[float, ...]:
    """Return the weights s of the last accelerations, last first: the answer is -M sum_k s_k a_n-k."""
    return _BDF2 if integrator == "bdf2" else IMPLICIT_EULER


def exchange_gain(weights: tuple[float, ...]) -> float:
    """Return how many times less mass an exchange that is one tick late bears than with implicit Euler.

    Changes d of the flange's velocity follow d_n+1 = -r sum_k s_k d_n-k, r the mass ratio: stable below
    r = 1 / sum_k |s_k|, which is 1 and 1/4.

    Args:
        weights: s, of `reaction_weights`.
    """
    return float(np.abs(weights).sum())


@final
@dataclass(frozen=True)
class MassProperties:
    """Mass, centre and inertia of a cloud of nodes.

    Args:
        mass_kg: total.
        center: (3,) [m], world.
        inertia: (3, 3) [kg m^2], about the centre, world axes.
    """

    mass_kg: float
    center: Array
    inertia: Array

    @classmethod
    def of(cls, node_mass: Array, positions: Array) -> MassProperties:
        """Return those of nodes (n,) [kg] at positions (n, 3) [m]."""
        return cls.of_blocks(node_mass.reshape(-1, 1, 1), positions.reshape(-1, 1, 3))

    @classmethod
    def of_blocks(cls, mass: Array, points: Array) -> MassProperties:
        """Return those of blocks of points that carry a mass together, see `mass_moments`.

        Args:
            mass: (b, k, k) [kg].
            points: (b, k, 3) [m].
        """
        moments = np.empty(9)
        total = mass_moments(mass, points, moments)
        if total <= 0.0:  # what weighs nothing may have its centre anywhere
            return cls(total, points[:, 0].mean(axis=0), np.zeros((3, 3)))
        x, y, z, xx, xy, xz, yy, yz, zz = moments.tolist()
        a, b, c = x / total, y / total, z / total
        xx, yy, zz = xx - a * x, yy - b * y, zz - c * z
        xy, xz, yz = xy - a * y, xz - a * z, yz - b * z
        inertia = np.array((yy + zz, -xy, -xz, -xy, xx + zz, -yz, -xz, -yz, xx + yy))
        return cls(total, np.array((a, b, c)), inertia.reshape(3, 3))

    def moved(self, world_from_frame: Pose) -> MassProperties:
        """Return those in the world of what is given in a frame."""
        rotation = world_from_frame.rotation
        center = world_from_frame.apply(self.center[None])[0]
        return MassProperties(self.mass_kg, center, rotation @ self.inertia @ rotation.T)

    def joined(self, other: MassProperties) -> MassProperties:
        """Return those of two bodies that move as one."""
        mass = self.mass_kg + other.mass_kg
        offset = cross_matrix(self.center - other.center)
        center = (self.mass_kg * self.center + other.mass_kg * other.center) / mass
        reduced = self.mass_kg * other.mass_kg / mass
        return MassProperties(mass, center, self.inertia + other.inertia - reduced * offset @ offset)

    def figures(self) -> tuple[float, ...]:
        """Return (10,): mass, centre, inertia xx, yy, zz, xy, xz, yz."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.inertia.tolist()
        return (self.mass_kg, *self.center.tolist(), xx, yy, zz, xy, xz, yz)

    def in_frame(self, world_from_frame: Pose) -> tuple[Array, Array]:
        """Return centre (3,) and inertia (3, 3) in a frame's coordinates."""
        rotation = world_from_frame.rotation
        center = rotation.T.dot(self.center - world_from_frame.translation)
        return center, rotation.T.dot(self.inertia).dot(rotation)

    def spatial(self, origin: Array) -> Array:
        """Return the (6, 6) mass matrix, linear then angular, about a point (3,) [m], world axes."""
        m, (a, b, c) = self.mass_kg, (self.center - origin).tolist()
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.inertia.tolist()
        x, y, z, zero = m * a, m * b, m * c, 0.0
        xy, xz, yz = xy - x * b, xz - x * c, yz - y * c
        rows = (
            m, zero, zero, zero, z, -y,
            zero, m, zero, -z, zero, x,
            zero, zero, m, y, -x, zero,
            zero, -z, y, xx + y * b + z * c, xy, xz,
            z, zero, -x, xy, yy + x * a + z * c, yz,
            -y, x, zero, xz, yz, zz + x * a + y * b,
        )  # fmt: skip
        return np.array(rows).reshape(6, 6)


def stability_ratio(mobility: Array, algorithmic_mass: Array) -> float:
    """Return the largest eigenvalue of W M_a.

    Args:
        mobility: W (6, 6), symmetric, flange velocity change per impulse.
        algorithmic_mass: M_a (6, 6), symmetric.
    """
    from scipy.linalg import lapack  # imported here because it takes long to load

    values, _, failure = lapack.dsygv(mobility, algorithmic_mass, itype=2, jobz="N")
    if failure == 0:
        return float(values[-1])
    # a mass without extent is not positive definite
    return float(np.linalg.eigvals(mobility @ algorithmic_mass).real.max())


Drive: TypeAlias = tuple[Pose, Loads]
"""Pose of the flange and loads at one instant."""
StepTaken: TypeAlias = Callable[[Drive, Drive, float, StepAccuracy | None], int]
_HALVINGS_MAX = 5


@final
@dataclass(frozen=True)
class SoftReply:
    """What the soft side answers to a motion of the flange.

    Args:
        wrench: exerted on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component.
        iterations: Newton iterations.
        films_work_J: of contacts between its films on these.
        eyelets_J: lost at eyelets that know their direction.
    """

    wrench: Wrench
    residual_N: float
    iterations: int
    films_work_J: float = 0.0
    eyelets_J: float = 0.0


class SoftRobot(ABC):
    """A soft body on the flange: stepped in the dynamic mode, solved for equilibrium in the other.

    Dynamics: `commit` on the equilibrium that `start` finds, then `advance` tick by tick. Statics: `commit`
    after every `solve` or `follow`. `effort` counts the iterations of searches that may last and says what
    they try; None where none lasts. `body` is the mesh that is drawn, touched and loaded; `state` is where
    it is now.
    """

    body: SoftBody
    state: SoftState
    obstacles: Obstacles | None = None
    supports_substeps: bool = False
    """Whether a tick may be taken in pieces, see `Substepping`."""
    effort: newton_options.SearchEffort | None = None

    @cached_property
    def work(self) -> newton_options.TickWork:
        """Counts and bounds the work of a tick; models that take parts of the same ticks share it."""
        return newton_options.TickWork()

    @abstractmethod
    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose.

        Args:
            world_from_flange: at the end of the step.
            loads: at the end of the step.
            step_s: length [s].

        Raises:
            ConvergenceError: no acceptable solution; the state is that before the step.
        """

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> SoftReply:
        """Advance as `advance` does, as closely as asked for; a model without iterations has no need to.

        Args:
            world_from_flange: at the end of the step.
            loads: at the end of the step.
            step_s: length [s].
            accuracy: how closely.
        """
        return self.advance(world_from_flange, loads, step_s)

    def restore(self, before: SoftState) -> None:
        """Undo the last step; what a solver has learned in it may stay.

        Args:
            before: the state that it began with.
        """
        self.state = before

    @property
    def loads(self) -> Loads:
        """Loads at the end of the last step, contacts not counted; of models that take pieces of ticks."""
        raise NotImplementedError("this model takes whole ticks")

    def restart(self) -> None:
        """Let the next step be the first one of a two-step integrator."""
        self.state = replace(self.state, earlier=None)

    def searching(self, place: str) -> AbstractContextManager[None]:
        """Let searches within say where they are, while they last; those that take no time say nothing.

        Args:
            place: such as the key of a phase.
        """
        return nullcontext() if self.effort is None else self.effort.at(place)

    def hang(self, world_from_flange: Pose, gravity: tuple[float, float, float]) -> Equilibrium | None:
        """Return where `start` begins, hung up without pressure and tension; None if that takes no time.

        Args:
            world_from_flange: pose of the flange.
            gravity: (3,) [m/s^2], world.

        Raises:
            ConvergenceError: none was found near the drawn shape.
        """
        return None

    @abstractmethod
    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: hung up without pressure, then loaded.

        Args:
            world_from_flange: pose of the flange.
            loads: that act.
            hung: what `hang` returns, where it is known and the present state is what that has left.

        Raises:
            ConvergenceError: none was found near the drawn shape.
        """

    @abstractmethod
    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go; the present state stays.

        Args:
            state: a state whose hinge angles are known.
            world_from_flange: pose of the flange.
            loads: that act.
            start: (n, 3) [m], better guess of the positions, if there is one.

        Raises:
            ConvergenceError: none was found.
        """

    def overlap(self, shape: Array) -> branching.FilmOverlap | None:
        """Return where films whose contact is not modelled have passed through one another; None if nowhere.

        Args:
            shape: (n, 3) [m], of the film.
        """
        return None

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium beside one that is not; one that is stable as it is.

        Args:
            begin: equilibrium before, from where it was followed; None for a first one.
            found: what `solve` has found.

        Raises:
            ConvergenceError: the search took all the iterations that it may.
        """
        return found

    def find_instability(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> branching.Branching | None:
        """Return in which direction a shape would give way if it was at rest; None: in none, or unknown.

        What the body touches is left out.

        Args:
            shape: of `current_shape`, after the last step or some steps before.
            world_from_flange: pose of the flange then.
            loads: that act then.
        """
        return None

    def assess_stability(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> branching.StabilityReport | None:
        """Return how firmly a shape stands, as if it was at rest; None where that is not known.

        Args:
            shape: of `current_shape`, after the last step.
            world_from_flange: pose of the flange.
            loads: that act.
        """
        return None

    def find_rest_tip(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> tuple[float, float, float] | None:
        """Return the tip [m] of the stable equilibrium that a shape slides to; None where it is not known.

        Args:
            shape: of `current_shape`, after the last step.
            world_from_flange: pose of the flange.
            loads: that act.
        """
        return None

    @abstractmethod
    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state stays.

        Args:
            begin: where to start.
            world_from_flange: wanted pose of the flange.
            loads: wanted loads.

        Raises:
            ConvergenceError: it was lost on the way.
        """

    @abstractmethod
    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays.

        Raises:
            UnreachableError: none was found.
            ConvergenceError: the equilibrium was lost on the way.
        """

    @abstractmethod
    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay.

        Raises:
            UnreachableError: none was found.
            ConvergenceError: the equilibrium was lost on the way.
        """

    @abstractmethod
    def commit(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""

    @property
    def end_state(self) -> Any:
        """What studies of a finished run need of the present state, as a frozen dataclass; None: nothing.

        It is `full_state` without what the solver has kept.
        """
        return None

    @abstractmethod
    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; what is held as a whole goes with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """

    @abstractmethod
    def release(self, nodes: IntArray) -> None:
        """Hold the given nodes (m,) no longer."""

    @abstractmethod
    def contact_surface(self) -> contact_points.ContactSurface:
        """Return where the body can be touched."""

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Let equilibria from now on take in what the film touches; some models know no such contact.

        Args:
            obstacles: returns what may be touched near given positions; None for nothing.
        """
        self.obstacles = obstacles

    @abstractmethod
    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step.

        Args:
            forces: (k, n, 3) [N], k cases.
            contact: with the body; None for none.
            step_s: length of the step [s].

        Returns:
            (k, n, 3) [m]; None where the tangent is indefinite.
        """

    @abstractmethod
    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement.

        Args:
            displacement: (n, 3) [m], of all nodes.
        """

    @property
    @abstractmethod
    def full_state(self) -> Any:
        """All that the next step depends on, as a frozen dataclass; that of another such side can be set."""

    @full_state.setter
    @abstractmethod
    def full_state(self, state: Any) -> None:
        """Set it.

        Raises:
            InputError: the state is of another body.
        """

    @property
    @abstractmethod
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber at the present shape."""

    def current_shape(self) -> Any:
        """Return the present shape, for `shape_reader` to read now or after later steps; costs nothing."""
        return self.state.positions

    @abstractmethod
    def shape_reader(self) -> ShapeReader:
        """Return what reads the shapes that `current_shape` returns."""

    @property
    def touching(self) -> self_contact_pairs.FilmMemory | None:
        """What the films press on one another at present; None where that is not modelled."""
        return self.state.touching

    @property
    @abstractmethod
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: the given one, or that of the sealed gas at the present volume."""

    @property
    def reach_m(self) -> float | None:
        """A distance from the flange's origin that no node exceeds; None where it is not known."""
        return None

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """How the flange's last accelerations count in the answer of inertia, see `reaction_weights`."""
        return IMPLICIT_EULER

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2]: a motion X of the nodes in a step meets the inertia c m X.

        Args:
            step_s: length of the step [s].
        """
        return inertia_weight(step_s, 0.0)

    @property
    def mass_kg(self) -> float:
        """Of all that hangs on the flange by it."""
        return self.body.mass_kg

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return MassProperties.of(self.body.node_mass, self.state.positions)

    def fill_mass(self, figures: Array) -> None:
        """Fill centre and inertia of the mass at the present shape in figures (FIGURES,)."""
        mass = self.mass_properties()
        figures[CENTER:INERTIA], figures[INERTIA:] = mass.center, mass.inertia.ravel()


def step_with_halving(
    stepper: tuple[StepTaken, Callable[[], None], newton_options.TickWork],
    begin: Drive,
    end: Drive,
    step_s: float,
    accuracy: StepAccuracy | None,
    final: type[ConvergenceError] = TickWorkError,
) -> int:
    """Take one step, or two halves where it does not converge; return the Newton iterations.

    Args:
        stepper: takes a step between two flange poses and loads, or leaves the state as it is; lets the next
            step be the first one, as a two-step integrator cannot look back over a change of step; counts.
        begin: flange pose and loads at the beginning; `end`: at the end of `step_s` [s].
        accuracy: None for an ordinary step.
        final: a kind of error after which no halves are tried.

    Raises:
        ConvergenceError: not even the shortest pieces converge.
    """

    def take(begin: Drive, end: Drive, step_s: float, accuracy: StepAccuracy | None, halvings: int) -> int:
        try:
            return step(begin, end, step_s, accuracy)
        except ConvergenceError as error:
            if isinstance(error, final | TickWorkError):
                raise
            if halvings == 0:
                raise error.at(f"even in steps of {1e3 * step_s:.3g} ms") from None
            spent, left_N = error.iterations, error.residual_N
        work.divide(left_N)
        middle = (begin[0].interpolated(end[0], 0.5), begin[1].interpolated(end[1], 0.5))
        restart()
        accuracy = None if accuracy is None else StepAccuracy(accuracy.tolerance_N)
        for first, last in ((begin, middle), (middle, end)):
            spent += take(first, last, 0.5 * step_s, accuracy, halvings - 1)
        restart()
        return spent

    step, restart, work = stepper
    return take(begin, end, step_s, accuracy, _HALVINGS_MAX)
