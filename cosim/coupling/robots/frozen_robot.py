"""The soft robot with a frozen shape: the flange feels its weight, inertia and contacts only."""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench, cross
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.coupling.robots.shape_reader import MeshReader
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.robots.soft_step import SoftReply
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.solve.step_scheme import inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget


@final
@dataclass(frozen=True)
class FrozenRobotState:
    """State of a `FrozenRobot`.

    Args:
        soft: positions and velocities of the nodes.
        shape: (n, 3) [m], the frozen shape, flange frame.
        volumes_m3: of its chambers.
        pressures_Pa: gauge, of its chambers in the last step.
        flange: pose of the flange at the end of the last step.
        supplied: (n, 3) [N], force of the flange on each node.
    """

    soft: SoftState
    shape: Array
    volumes_m3: tuple[float, ...]
    pressures_Pa: tuple[float, ...]
    flange: Pose
    supplied: Array


@final
class FrozenRobot(SoftRobot):
    """A soft body that keeps its shape at the start; every node moves with the flange.

    The force of the flange on node i is r_i = m_i (a_i + beta v_i - g) - f_i, and the wrench on the flange
    -(sum r_i, sum (x_i - o) x r_i). Accelerations are backward differences, as in implicit Euler; the
    reaction of BDF2 to the flange's last motion is four times as large, which would make the exchange
    unstable. Gas and cables are internal forces and do not appear.

    Args:
        flexible: the same body with its elasticity, which finds the shape at the start.
        air_drag_per_s: beta [1/s].
    """

    def __init__(self, flexible: SoftRobot, air_drag_per_s: float = 0.0) -> None:
        self.body, self.state, self.effort = flexible.body, flexible.state, flexible.effort
        self._flexible, self._drag = flexible, air_drag_per_s
        self._pressures, self._flange = flexible.pressures_Pa, Pose()
        self._supplied = np.zeros_like(self.body.positions)
        self._set_shape(self.body.positions, flexible.volumes_m3)
        self._begin = self.full_state  # of the last step

    def _set_shape(self, shape: Array, volumes_m3: tuple[float, ...]) -> None:
        """Set the frozen shape (n, 3) [m], flange frame."""
        self._shape, self._volumes = shape, volumes_m3
        self._mass = MassProperties.of(self.body.node_mass, shape)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the flexible body's equilibrium before the first phase, and freeze its shape."""
        equilibrium = self._flexible.start(world_from_flange, loads)
        self._flexible.commit(equilibrium)
        shape = equilibrium.world_from_flange.inverse().apply(equilibrium.state.positions)
        self._set_shape(shape, self._flexible.volumes_m3)
        return self.follow(equilibrium, world_from_flange, loads)

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose."""
        self._begin = self.full_state
        before, x = self.state, np.ascontiguousarray(world_from_flange.apply(self._shape))
        v = (x - before.positions) / step_s
        acceleration = (v - before.velocities) / step_s + self._drag * v
        self.state = SoftState(x, v, before.memory)
        self._set_supply(world_from_flange, loads, acceleration)
        return SoftReply(self._wrench(x), 0.0, 0)

    def restore(self, before: SoftState) -> None:
        """Undo the last step."""
        begin = self._begin
        self.state, self._pressures = before, begin.pressures_Pa
        self._flange, self._supplied = begin.flange, begin.supplied

    def _set_supply(self, flange: Pose, loads: Loads, acceleration: Array) -> None:
        """Compute the forces of the flange on the nodes at their acceleration (n, 3) [m/s^2]."""
        self._flange = flange
        self._pressures = loads.pressures_at(self._volumes)
        self._supplied = self.body.node_mass[:, None] * (acceleration - np.array(loads.gravity))
        if loads.nodal_force is not None:
            self._supplied -= loads.nodal_force
        for potential in (loads.contact, loads.extra):
            if potential is not None:
                potential.add(self.state.positions, Sums(self._supplied), hessian=False)

    def _wrench(self, x: Array) -> Wrench:
        arm = x - self._flange.translation
        return Wrench(-self._supplied.sum(axis=0), -cross(arm, self._supplied).sum(axis=0))

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Return the frozen shape at a pose of the flange; there is nothing to solve."""
        x = np.ascontiguousarray(world_from_flange.apply(self._shape))
        self._set_supply(world_from_flange, loads, np.zeros(3))
        potential = -float(self.body.node_mass @ x @ np.array(loads.gravity))
        return Equilibrium(
            SoftState.at_rest(x, state.memory),
            world_from_flange,
            loads,
            self._wrench(x),
            0.0,
            0,
            potential,
            0,
        )

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Return the frozen shape at a pose of the flange; there is nothing to follow."""
        return self.solve(begin.state, world_from_flange, loads)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Refuse: cables do not move a frozen body."""
        raise InputError("cables do not move a frozen body; plan its tip targets on the flexible one")

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Refuse: targets are for the tip of the sagging body."""
        raise InputError("a frozen body does not sag; plan its tip targets on the flexible one")

    def commit(self, found: Equilibrium) -> None:
        """Make an equilibrium the present state."""
        self.state = found.state
        self._set_supply(found.world_from_flange, found.loads, np.zeros(3))

    @property
    def full_state(self) -> FrozenRobotState:
        """The whole state."""
        return FrozenRobotState(
            self.state, self._shape, self._volumes, self._pressures, self._flange, self._supplied
        )

    @full_state.setter
    def full_state(self, state: FrozenRobotState) -> None:
        if len(state.shape) != self.body.nodes:
            raise InputError(f"the saved soft robot has {len(state.shape)} nodes, this one {self.body.nodes}")
        self._set_shape(state.shape, state.volumes_m3)
        self.state, self._pressures = state.soft, state.pressures_Pa
        self._flange, self._supplied = state.flange, state.supplied

    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Do nothing: every node is held already."""

    def release(self, nodes: IntArray) -> None:
        """Do nothing: a frozen body stays on the flange."""

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return self._flexible.contact_surface()

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return zeros (k, n, 3): the nodes move with the flange only."""
        return np.zeros_like(forces)

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2], the inertia of nodes in a step: c m X for a motion X."""
        return inertia_weight(step_s, self._drag)

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of the flange's reactions at the last solution over a displacement."""
        return float(np.einsum("nr,nr->", self._supplied, displacement))

    def shape_reader(self) -> MeshReader:
        """Return a reader of nodal positions; the volumes are those of the frozen shape."""
        return MeshReader(self.body, lambda shapes: np.tile(self._volumes, (len(shapes), 1)))

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber of the frozen shape."""
        return self._volumes

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: commanded, or that of the sealed gas, of constant volume."""
        return self._pressures

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present pose."""
        turn, mass = self._flange.rotation, self._mass
        return MassProperties(mass.mass_kg, self._flange.apply(mass.center), turn @ mass.inertia @ turn.T)
