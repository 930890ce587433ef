"""What the rest of a run needs of a soft side, whatever model stands behind it.

A model with fewer unknowns than the film's mesh (frozen, or a frame per ring) still shows itself as that
mesh: `body` and `state` hold the film's nodes, and contacts, loads and supports are given on them. Such a
model must be able to find its own unknowns from the nodes of a state, so that a `SoftState` is all that
the next step depends on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, final

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.coupling.soft_sides.answer_weights import IMPLICIT_EULER
from cosim.coupling.soft_sides.mass import MassProperties
from cosim.coupling.soft_sides.shape_reader import ShapeReader
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.contact.self_contact_memory import FilmMemory
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState
from cosim.soft.solve.time_scheme import StepAim, inertia_weight
from cosim.soft.targets.target_solution import TargetOptions
from cosim.soft.targets.tip_target import TipTarget


@final
@dataclass(frozen=True)
class SoftReply:
    """What the soft side answers to a motion of the flange.

    Args:
        wrench: exerted on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component.
        iterations: Newton iterations.
    """

    wrench: Wrench
    residual_N: float
    iterations: int


class SoftSide(ABC):
    """A soft body on the flange: stepped in the dynamic mode, solved for equilibrium in the other.

    Dynamics: `settle` on the equilibrium that `start` finds, then `advance` tick by tick. Statics: `settle`
    after every `solve` or `follow`. `body` is the mesh that is drawn, touched and loaded; `state` is where
    it is now.
    """

    body: SoftBody
    state: SoftState
    obstacles: Obstacles | None = None

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

    def advance_closely(
        self, world_from_flange: Pose, loads: Loads, step_s: float, aim: StepAim
    ) -> SoftReply:
        """Advance as `advance` does, as closely as asked for; a model without iterations has no need to.

        Args:
            world_from_flange: at the end of the step.
            loads: at the end of the step.
            step_s: length [s].
            aim: how closely.
        """
        return self.advance(world_from_flange, loads, step_s)

    def restore(self, before: SoftState) -> None:
        """Undo the last step; what a solver has learned in it may stay.

        Args:
            before: the state that it began with.
        """
        self.state = before

    def hang(self, world_from_flange: Pose, gravity: tuple[float, float, float]) -> Equilibrium | None:
        """Return where `start` begins, hung up without pressure and tension; None if that takes no time.

        Args:
            world_from_flange: pose of the flange.
            gravity: (3,) [m/s^2], world.

        Raises:
            ConvergenceError: there is none near the drawn shape.
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
            ConvergenceError: there is none near the drawn shape.
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
            UnreachableError: there is none.
            ConvergenceError: the equilibrium was lost on the way.
        """

    @abstractmethod
    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay.

        Raises:
            UnreachableError: there is none.
            ConvergenceError: the equilibrium was lost on the way.
        """

    @abstractmethod
    def settle(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""

    @abstractmethod
    def hold_also(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; what is held as a whole goes with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """

    @abstractmethod
    def let_go(self, nodes: IntArray) -> None:
        """Hold the given nodes (m,) no longer."""

    @abstractmethod
    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""

    def stand_against(self, obstacles: Obstacles | None) -> None:
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
    def work_taken_in(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement.

        Args:
            displacement: (n, 3) [m], of all nodes.
        """

    @abstractmethod
    def save_state(self) -> Any:
        """Return everything that the next step depends on, as a frozen dataclass; see `stateful`."""

    @abstractmethod
    def restore_state(self, state: Any) -> None:
        """Return to a state of `save_state`, of this side or of one with the same body.

        Raises:
            InputError: the state is of another body.
        """

    @property
    @abstractmethod
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber at the present shape."""

    def shape_now(self) -> Any:
        """Return the present shape, for `shape_reader` to read now or after later steps; costs nothing."""
        return self.state.positions

    @abstractmethod
    def shape_reader(self) -> ShapeReader:
        """Return what reads the shapes that `shape_now` returns."""

    @property
    def touching(self) -> FilmMemory | None:
        """What the films press on one another at present; None where that is not modelled."""
        return self.state.touching

    @property
    @abstractmethod
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: the given one, or that of the sealed gas at the present volume."""

    @property
    def reach_m(self) -> float | None:
        """A distance from the flange's origin that no node exceeds; None where only the film's size tells."""
        return None

    @property
    def answer_weights(self) -> tuple[float, ...]:
        """How the flange's last accelerations count in the answer of inertia, see `answer_weights`."""
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
