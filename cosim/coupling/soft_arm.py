"""The soft side of the coupling: a body on the flange, stepped or solved for equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.coupling.mass import MassProperties
from cosim.errors import ConvergenceError
from cosim.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.soft.body import Loads, SoftBody
from cosim.soft.contact import ContactPlanes
from cosim.soft.contact_surface import ContactSurface
from cosim.soft.dynamics import ImplicitStepper, StepOptions
from cosim.soft.equilibrium import Equilibrium, EquilibriumSolver
from cosim.soft.newton import NewtonOptions, NewtonSolver
from cosim.soft.state import Clamp, SoftState
from cosim.soft.system import SoftSystem

_HALVINGS_MAX = 5

_Drive: TypeAlias = tuple[Pose, Loads]


@final
@dataclass(frozen=True)
class SoftReply:
    """What the soft side answers to a motion of the flange.

    Args:
        wrench: exerted on the flange, at its origin, world axes.
        power_W: power taken in at the clamped nodes, sum of nodal reaction times nodal velocity.
        residual_N: largest out-of-balance component.
        iterations: Newton iterations.
    """

    wrench: Wrench
    power_W: float
    residual_N: float
    iterations: int


@final
class SoftArm:
    """A soft body held by the flange; owns solver and state.

    Args:
        body: what it is.
        world_from_flange: where the flange is at first; the body starts in its drawn shape.
        statics: bounds of equilibrium solutions.
        dynamics: how time steps are solved.
    """

    def __init__(
        self, body: SoftBody, world_from_flange: Pose, statics: NewtonOptions, dynamics: StepOptions
    ) -> None:
        self.body = body
        self.state = SoftState.drawn(body, world_from_flange)
        self._system = SoftSystem(body)
        self._statics, self._dynamics = statics, dynamics
        self._flange = world_from_flange
        self._loads = Loads(0.0, (0.0,) * len(body.cables), (0.0, 0.0, 0.0))
        self._residual = 0.0
        self._hold(Clamp.of_base(body))

    def _hold(self, clamp: Clamp) -> None:
        self.clamp = clamp
        newton = NewtonSolver(self._system, clamp.mask(self.body.nodes))
        self.equilibrium_solver = EquilibriumSolver(newton, clamp, self._statics)
        self._stepper = ImplicitStepper(newton, clamp, self._dynamics)

    def hold_also(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; what is held as a whole goes with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """
        self._hold(self.clamp.holding(held, self.state.positions, world_from_flange))

    def let_go(self, nodes: IntArray) -> None:
        """Hold the given nodes (m,) no longer."""
        self._hold(self.clamp.without(nodes))

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose.

        Args:
            world_from_flange: at the end of the step.
            loads: at the end of the step.
            step_s: length [s].

        Raises:
            ConvergenceError: no acceptable solution; the state is that before the step.
        """
        start, before = (self._flange, self._loads), self.state
        try:
            iterations = self._step(start, (world_from_flange, loads), step_s, _HALVINGS_MAX)
        except ConvergenceError:
            self.state = before
            raise
        self._flange, self._loads = world_from_flange, loads
        wrench = self.clamp.wrench(self._system.gradient, self.state.positions, world_from_flange)
        power = float(np.einsum("kr,kr->", self.reaction, self.state.velocities[self.clamp.nodes]))
        return SoftReply(wrench, power, self._residual, iterations)

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return ContactSurface.of(self.body, self._system.pattern)

    def response(self, forces: Array, contact: ContactPlanes, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step.

        Args:
            forces: (k, n, 3) [N], k cases.
            contact: with the body.
            step_s: length of the step [s].

        Returns:
            (k, n, 3) [m]; None where the tangent is indefinite.
        """
        loads = replace(self._loads, contact=contact)
        if not self._stepper.factorise(self.state, self._flange, loads, step_s):
            return None
        return np.array([self._stepper.solver.linear.solve(force) for force in forces])

    def _step(self, begin: _Drive, end: _Drive, step_s: float, halvings: int) -> int:
        """Take one step, or two halves where it does not converge; return the Newton iterations."""
        (flange, loads) = end
        try:
            self.state, result = self._stepper.step(self.state, flange, loads, step_s)
        except ConvergenceError as error:
            if halvings == 0:
                raise
            middle = (begin[0].interpolated(flange, 0.5), begin[1].interpolated(loads, 0.5))
            # a two-step integrator cannot look back over a change of step
            self.state = replace(self.state, earlier=None)
            spent = error.iterations + self._step(begin, middle, 0.5 * step_s, halvings - 1)
            spent += self._step(middle, end, 0.5 * step_s, halvings - 1)
            self.state = replace(self.state, earlier=None)
            return spent
        self._residual = result.residual_N
        return result.iterations

    def settle(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""
        self.state = found.state
        self._flange, self._loads = found.world_from_flange, found.loads

    @property
    def reaction(self) -> Array:
        """Force (k, 3) [N] that the flange supplies to each held node, at the last solution."""
        return self.clamp.reaction(self._system.gradient)

    @property
    def volume_m3(self) -> float:
        """Volume inside film and caps at the present shape."""
        return self._system.enclosed_volume(self.state.positions)

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure in the chamber: the given one, or that of the sealed gas at the present volume."""
        gas = self._loads.gas
        return self._loads.pressure_Pa if gas is None else gas.gauge_pressure(self.volume_m3)

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return MassProperties.of(self.body.node_mass, self.state.positions)
