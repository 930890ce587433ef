"""The soft side that does not deform: the flange feels its weight, inertia and contacts, nothing else."""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench, cross
from cosim.coupling.robots.shape_reader import MeshReader
from cosim.coupling.robots.soft_robot import MassProperties, SoftReply, SoftRobot
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.solve.state import Equilibrium, SoftState, inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget


@final
@dataclass(frozen=True)
class FrozenRobotState:
    """What the next step of a frozen body depends on.

    Args:
        soft: where the nodes are, and how they move.
        shape: (n, 3) [m], that is kept, flange frame.
        volumes_m3: of its chambers.
        pressures_Pa: gauge, of its chambers in the last step.
        flange: pose of the flange at its end.
        supplied: (n, 3) [N], by the flange to each node.
    """

    soft: SoftState
    shape: Array
    volumes_m3: tuple[float, ...]
    pressures_Pa: tuple[float, ...]
    flange: Pose
    supplied: Array


@final
class FrozenRobot(SoftRobot):
    """A soft body that keeps the shape of its start; every node moves with the flange.

    What the flange supplies to node i, accelerations by backward differences (implicit Euler; the answer of
    BDF2 to the flange's motion of the last tick is four times as large, which the exchange would not bear):
    r_i = m_i (a_i + beta v_i - g) - f_i; the wrench is -(sum r_i, sum (x_i - o) x r_i). Gas and cables are
    forces within the body and have no part in it.

    Args:
        flexible: the same body with its elasticity; it finds the shape of the start.
        air_drag_per_s: beta [1/s].
    """

    def __init__(self, flexible: SoftRobot, air_drag_per_s: float = 0.0) -> None:
        self.body, self.state, self.effort = flexible.body, flexible.state, flexible.effort
        self._flexible, self._drag = flexible, air_drag_per_s
        self._pressures, self._flange = flexible.pressures_Pa, Pose()
        self._supplied = np.zeros_like(self.body.positions)
        self._keep(self.body.positions, flexible.volumes_m3)

    def _keep(self, shape: Array, volumes_m3: tuple[float, ...]) -> None:
        """Keep a shape (n, 3) [m], flange frame."""
        self._shape, self._volumes = shape, volumes_m3
        self._mass = MassProperties.of(self.body.node_mass, shape)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the flexible body's equilibrium before the first phase; its shape is kept from here on."""
        found = self._flexible.start(world_from_flange, loads)
        self._flexible.commit(found)
        shape = found.world_from_flange.inverse().apply(found.state.positions)
        self._keep(shape, self._flexible.volumes_m3)
        return self.follow(found, world_from_flange, loads)

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose."""
        before, x = self.state, np.ascontiguousarray(world_from_flange.apply(self._shape))
        v = (x - before.positions) / step_s
        acceleration = (v - before.velocities) / step_s + self._drag * v
        self.state = SoftState(x, v, before.memory)
        self._take(world_from_flange, loads, acceleration)
        return SoftReply(self._wrench(x), 0.0, 0)

    def _take(self, flange: Pose, loads: Loads, acceleration: Array) -> None:
        """Find what the flange supplies to the nodes at their acceleration (n, 3) [m/s^2]."""
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
        """Return the kept shape at a pose of the flange; there is nothing to solve."""
        x = np.ascontiguousarray(world_from_flange.apply(self._shape))
        self._take(world_from_flange, loads, np.zeros(3))
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
        """Return the kept shape at a pose of the flange; there is nothing to follow."""
        return self.solve(begin.state, world_from_flange, loads)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Refuse: a frozen body does not answer to its cables."""
        raise InputError("cables do not move a frozen body; plan its tip targets on the flexible one")

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Refuse: the tip of a frozen body is not where the target asks the sagging one to be."""
        raise InputError("a frozen body does not sag; plan its tip targets on the flexible one")

    def commit(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""
        self.state = found.state
        self._take(found.world_from_flange, found.loads, np.zeros(3))

    @property
    def full_state(self) -> FrozenRobotState:
        """All that the next step depends on."""
        return FrozenRobotState(
            self.state, self._shape, self._volumes, self._pressures, self._flange, self._supplied
        )

    @full_state.setter
    def full_state(self, state: FrozenRobotState) -> None:
        if len(state.shape) != self.body.nodes:
            raise InputError(f"the saved soft robot has {len(state.shape)} nodes, this one {self.body.nodes}")
        self._keep(state.shape, state.volumes_m3)
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
        """Return zeros (k, n, 3): the nodes go where the flange goes."""
        return np.zeros_like(forces)

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2]: a motion X of the nodes in a step meets the inertia c m X."""
        return inertia_weight(step_s, self._drag)

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
        return float(np.einsum("nr,nr->", self._supplied, displacement))

    def shape_reader(self) -> MeshReader:
        """Return what reads nodes; the volumes are those of the kept shape."""
        return MeshReader(self.body, lambda shapes: np.tile(self._volumes, (len(shapes), 1)))

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber of the kept shape."""
        return self._volumes

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: the given one, or that of the sealed gas, whose volume stays."""
        return self._pressures

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present pose."""
        turn, mass = self._flange.rotation, self._mass
        return MassProperties(mass.mass_kg, self._flange.apply(mass.center), turn @ mass.inertia @ turn.T)
