"""A cube between two inflated balls whose far sides are held: the smallest grasp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.base.columns import TickRow
from cosim.base.frames import Array, IntArray, Pose, SixNumbers, Twist, Wrench
from cosim.build.arms import find_arm
from cosim.config.schema.objects import WireTable
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.contact.contact_report import ContactReport
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.schemes.transfer import six_numbers
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene, RigidState
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import Integrator, StepOptions
from tests.coupling.one_tick import one_tick
from tests.soft.bodies import icosphere

EDGE_M, RADIUS_M, OVERLAP_M, PRESSURE_PA = 0.04, 0.025, 0.004, 5e3
GRASP = np.array([0.0, 0.0, 1.5])  # above everything else in the scene


def pads() -> SoftBody:
    """Return two balls at either side of the grasp, their far caps held."""
    x, triangles = icosphere(2, RADIUS_M)
    # a corner of the mesh never lies on a plane of symmetry of the cube
    away = 0.5 * EDGE_M + RADIUS_M - OVERLAP_M
    both = np.concatenate([x + np.array([away, 0.0, 0.0]), x * (-1.0, 1.0, 1.0) - np.array([away, 0.0, 0.0])])
    mirrored = triangles[:, ::-1] + len(x)
    held = np.flatnonzero(np.abs(both[:, 0]) > away + 0.6 * RADIUS_M)
    film = Film(1e8, 0.3, 1e-4)
    return SoftBody.from_arrays(
        both, np.concatenate([triangles, mirrored]), film, node_mass=1.2e-4, base=held, tip=held
    )


class Grasp:
    """The cube and its pads, stepped in lockstep.

    Args:
        mass_kg: of the cube.
        tick_s: of the clock.
        light: whether the cube may give way within the film's step; it bears the load a tick late otherwise.
        law: of contact.
        gravity: (3,) [m/s^2].
        objects: held instead of the free cube; one is called "cube" unless there is a wire.
        wires: besides.
        integrator: of the pads.
        substeps: of MuJoCo in a tick.
    """

    def __init__(
        self,
        mass_kg: float,
        tick_s: float,
        *,
        light: bool = True,
        law: ContactLaw | None = None,
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
        objects: tuple[SceneObject, ...] | None = None,
        wires: tuple[WireTable, ...] = (),
        integrator: Integrator = "implicit_euler",
        substeps: int = 1,
    ) -> None:
        if objects is None:
            objects = (SceneObject("cube", "box", (EDGE_M,) * 3, (0.0, 0.0, 1.5), mass_kg=mass_kg),)
        self.scene = RigidScene(
            SceneDescription(
                find_arm("ur5e"),
                tick_s=tick_s,
                substeps=substeps,
                gravity=gravity,
                objects=objects,
                wires=wires,
            )
        )
        self.scene.set_control(self.scene.joint_position)
        options = StepOptions(integrator, tolerance_N=1e-6, damping_per_s=5.0)
        self.flange = Pose(np.eye(3), GRASP)
        self.soft = FilmRobot(pads(), self.flange, NewtonOptions(), options)
        x = self.soft.state.positions.copy()
        face = 0.5 * EDGE_M
        x[:, 0] = np.where(np.abs(x[:, 0]) < face, np.copysign(face, x[:, 0]), x[:, 0])
        self.soft.state = replace(self.soft.state, positions=x)
        self.exchange = ContactExchange(
            self.scene.contact_query(), self.scene.bodies, self.soft.contact_surface(), law
        )
        self.loads = Loads((PRESSURE_PA,), (), gravity)
        holder: Any = FixedFlange(self.scene, self.flange)
        self.coupling: StaggeredCoupling | None = None
        if light:
            interface = Interface(holder, self.soft, Wrench(), self.exchange)
            self.coupling = StaggeredCoupling(interface, np.inf)
        self._joints = self.scene.joint_position
        self._cube = self.scene.body_names.index(f"{wires[0].name}/2" if wires else "cube")

    def tick(self) -> ContactReport:
        """Advance by one tick."""
        if self.coupling is not None:
            one_tick(self.coupling, self._joints, np.zeros(6), self.loads)
            return self.exchange.report
        self.scene.step()
        before = self.soft.state.positions
        planes = self.exchange.find(self.soft.state, self.scene.tick_s)
        self.soft.advance(self.flange, replace(self.loads, contact=planes), self.scene.tick_s)
        return self.exchange.commit(before, self.soft.state.positions)

    @property
    def ratio(self) -> float:
        """Contact ratio."""
        return 0.0 if self.coupling is None else self.coupling.interface.contact_ratio

    @property
    def cube_position(self) -> Array:
        """(3,) [m], world; of the second segment of a wire."""
        return np.array(self.scene.body_poses()[0][self._cube])


class FixedFlange:
    """A rigid scene whose flange is held where it is told to be, whatever acts on it.

    Args:
        scene: everything else is its.
        pose: of the flange.
    """

    def __init__(self, scene: RigidScene, pose: Pose) -> None:
        self._scene, self._wrench = scene, Wrench()
        self._origin, self._axes = np.empty(3), np.empty((3, 3))
        self.flange_pose, self.flange_twist = pose, Twist()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)

    @property
    def state(self) -> RigidState:
        """State of the scene."""
        return self._scene.state

    @state.setter
    def state(self, state: RigidState) -> None:
        self._scene.state = state

    @property
    def flange_pose(self) -> Pose:
        """World from flange."""
        return Pose(self._axes.copy(), self._origin.copy())

    @flange_pose.setter
    def flange_pose(self, pose: Pose) -> None:
        self._origin[:], self._axes[:] = pose.translation, pose.rotation

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Take note of it."""
        self._wrench = wrench.moved(-self.flange_pose.translation)

    def received_wrench(self) -> SixNumbers:
        """Return it, about the world's origin."""
        return six_numbers(np.concatenate([self._wrench.force, self._wrench.torque]))

    def mobility(self, bodies: IntArray | None = None) -> Array:
        """Return the scene's, the flange not moving."""
        found = self._scene.mobility(bodies)
        found[:6] = found[:, :6] = 0.0
        return found


class CoupledGrasp:
    """The same grasp, exchanged by a coupling.

    Args:
        mass_kg: of the cube.
        tick_s: of the clock.
        scheme: makes the coupling.
        integrator: of the pads.
        edge_m: of the cube.
        substeps: of MuJoCo in a tick.
    """

    def __init__(
        self,
        mass_kg: float,
        tick_s: float,
        scheme: Callable[[Interface], Coupling],
        integrator: Integrator = "implicit_euler",
        edge_m: float = EDGE_M,
        substeps: int = 1,
    ) -> None:
        cube = SceneObject("cube", "box", (edge_m,) * 3, (0.0, 0.0, 1.5), mass_kg=mass_kg)
        self.grasp = Grasp(
            mass_kg, tick_s, light=False, objects=(cube,), integrator=integrator, substeps=substeps
        )
        self.holder = FixedFlange(self.grasp.scene, self.grasp.flange)
        scene: Any = self.holder
        self.interface = Interface(scene, self.grasp.soft, Wrench(), self.grasp.exchange)
        self.coupling = scheme(self.interface)
        self._joints = self.grasp.scene.joint_position

    def tick(self) -> TickRow:
        """Advance by one tick."""
        return one_tick(self.coupling, self._joints, np.zeros(6), self.grasp.loads)
