"""The interface of soft robots of any model: film, reduced beam model, or frozen shape.

A model with fewer unknowns than the film's mesh also presents itself as that mesh: `body` and `state` hold
the film's nodes, and contacts, loads and supports are given on nodes. Such a model must be able to recover
its unknowns from the nodes of a state, so that a `SoftState` is all that the next step depends on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property
from typing import Any

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.coupling.robots.shape_reader import ShapeReader
from cosim.coupling.robots.soft_step import SoftReply
from cosim.coupling.robots.stability_ratio import IMPLICIT_EULER
from cosim.reduced.sections.figures import CENTER, INERTIA
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact import contact_points, self_contact_pairs
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve import branching, search_effort, tick_work
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState
from cosim.soft.solve.step_scheme import StepAccuracy, inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget


class SoftRobot(ABC):
    """A soft body on the flange: stepped in dynamic mode, solved for equilibrium in quasistatic mode.

    Dynamics: `commit` the equilibrium that `start` finds, then `advance` tick by tick. Statics: `commit`
    after every `solve` or `follow`. `effort` counts the iterations of long searches and reports their
    progress; None if no search is long. `body` is the mesh that is drawn, touched and loaded; `state` is its
    present state.
    """

    body: SoftBody
    state: SoftState
    obstacles: Obstacles | None = None
    supports_substeps: bool = False
    """Whether a tick may be divided, see `Substepping`."""
    effort: search_effort.SearchEffort | None = None

    @cached_property
    def work(self) -> tick_work.TickWork:
        """Counts and bounds the work of a tick."""
        return tick_work.TickWork()

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
        """Advance as `advance` does, to a given accuracy; a model without iterations ignores it.

        Args:
            world_from_flange: at the end of the step.
            loads: at the end of the step.
            step_s: length [s].
            accuracy: of the solution.
        """
        return self.advance(world_from_flange, loads, step_s)

    def restore(self, before: SoftState) -> None:
        """Undo the last step; a factorisation made in it may stay.

        Args:
            before: the state at its start.
        """
        self.state = before

    @property
    def loads(self) -> Loads:
        """Loads at the end of the last step, without contacts; for models that support substeps."""
        raise NotImplementedError("this model does not support substeps")

    def restart(self) -> None:
        """Restart a two-step integrator with the next step."""
        self.state = replace(self.state, earlier=None)

    def searching(self, place: str) -> AbstractContextManager[None]:
        """Report the progress of searches in this context as being of `place`.

        Args:
            place: such as the key of a phase.
        """
        return nullcontext() if self.effort is None else self.effort.at(place)

    def hang(self, world_from_flange: Pose, gravity: tuple[float, float, float]) -> Equilibrium | None:
        """Return the first equilibrium of `start`, without pressure and tension; None if it is fast to find.

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
            hung: result of `hang`, if the present state is that after `hang`; None to find it.

        Raises:
            ConvergenceError: none was found near the drawn shape.
        """

    @abstractmethod
    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state without continuation; the present state is not changed.

        Args:
            state: initial guess, whose hinge angles are known.
            world_from_flange: pose of the flange.
            loads: that act.
            start: (n, 3) [m], better guess of the positions, or None.

        Raises:
            ConvergenceError: none was found.
        """

    def overlap(self, shape: Array) -> branching.FilmOverlap | None:
        """Return where films overlap because self-contact is not modelled; None if nowhere.

        Args:
            shape: (n, 3) [m], of the film.
        """
        return None

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of an unstable one; a stable one is returned unchanged.

        Args:
            begin: equilibrium from which `found` was followed; None for a first one.
            found: result of `solve`.

        Raises:
            ConvergenceError: the search reached its bound of iterations.
        """
        return found

    def find_instability(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> branching.Branching | None:
        """Return the instability of a shape as if it was at rest; None if it is stable or unknown.

        Contacts are left out.

        Args:
            shape: of `current_shape`, after the last step or some steps before.
            world_from_flange: pose of the flange then.
            loads: that act then.
        """
        return None

    def assess_stability(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> branching.StabilityReport | None:
        """Return the stability of a shape as if it was at rest; None if the model cannot assess it.

        Args:
            shape: of `current_shape`, after the last step.
            world_from_flange: pose of the flange.
            loads: that act.
        """
        return None

    def find_rest_tip(
        self, shape: Any, world_from_flange: Pose, loads: Loads
    ) -> tuple[float, float, float] | None:
        """Return the tip [m] of the stable equilibrium that a shape slides to; None if it is not known.

        Args:
            shape: of `current_shape`, after the last step.
            world_from_flange: pose of the flange.
            loads: that act.
        """
        return None

    @abstractmethod
    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state is not changed.

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
        """Make an equilibrium the present state."""

    @property
    def end_state(self) -> Any:
        """The present state for studies of a finished run, as a frozen dataclass; None if they need none.

        It is `full_state` without the solver's factorisation.
        """
        return None

    @abstractmethod
    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; wholly held nodes move with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """

    @abstractmethod
    def release(self, nodes: IntArray) -> None:
        """Release the given nodes (m,)."""

    @abstractmethod
    def contact_surface(self) -> contact_points.ContactSurface:
        """Return where the body can be touched."""

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Set the contacts of equilibria from now on; models without contact in statics ignore them.

        Args:
            obstacles: positions -> possible contacts near them; None for no contact.
        """
        self.obstacles = obstacles

    @abstractmethod
    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return the displacements of the nodes by small forces within the last step.

        Args:
            forces: (k, n, 3) [N], k cases.
            contact: contacts with the body; None for none.
            step_s: length of the step [s].

        Returns:
            (k, n, 3) [m]; None where the tangent is indefinite.
        """

    @abstractmethod
    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of the flange's reactions at the last solution over a displacement.

        Args:
            displacement: (n, 3) [m], of all nodes.
        """

    @property
    @abstractmethod
    def full_state(self) -> Any:
        """The whole state, as a frozen dataclass; a state of another robot of the same model can be set."""

    @full_state.setter
    @abstractmethod
    def full_state(self, state: Any) -> None:
        """Restore a state.

        Raises:
            InputError: the state is of another body.
        """

    @property
    @abstractmethod
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber at the present shape."""

    def current_shape(self) -> Any:
        """Return the present shape, without a copy, for `shape_reader` to read now or after later steps."""
        return self.state.positions

    @abstractmethod
    def shape_reader(self) -> ShapeReader:
        """Return a reader of the shapes that `current_shape` returns."""

    @property
    def touching(self) -> self_contact_pairs.FilmMemory | None:
        """Memory of self-contact; None if nothing presses, or self-contact is not modelled."""
        return self.state.touching

    @property
    @abstractmethod
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: commanded, or that of the sealed gas at the present volume."""

    @property
    def reach_m(self) -> float | None:
        """A distance from the flange's origin that no node exceeds; None if it is not known."""
        return None

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """Weights of the flange's last accelerations in the reaction, see `stability_ratio`."""
        return IMPLICIT_EULER

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2], the inertia of nodes in a step: c m X for a motion X.

        Args:
            step_s: length of the step [s].
        """
        return inertia_weight(step_s, 0.0)

    @property
    def mass_kg(self) -> float:
        """Total mass."""
        return self.body.mass_kg

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return MassProperties.of(self.body.node_mass, self.state.positions)

    def fill_mass(self, figures: Array) -> None:
        """Fill centre and inertia of the mass at the present shape in figures (FIGURES,)."""
        mass = self.mass_properties()
        figures[CENTER:INERTIA], figures[INERTIA:] = mass.center, mass.inertia.ravel()
