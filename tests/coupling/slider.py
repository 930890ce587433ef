"""A strip of film that hangs from a carriage on a slide: the smallest pair with a known common motion.

All nodes move along the slide only, and the strip is held by one node. So the pair, taken as one body, is
that strip with the carriage's mass on its first node: an implicit step of it is what an exchange without lag
has to reproduce.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from cosim.base.arm_file import ArmFile
from cosim.base.columns import TickRow
from cosim.base.frames import Mask, Pose
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.coupling.one_tick import one_tick

URDF = """<robot name="slider"><link name="rail"/>
<link name="carriage"><inertial><mass value="{mass}"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-10" upper="10" effort="1000" velocity="100"/></joint></robot>"""

TICK_S, PULL_N, PUSH_N = 2e-3, 5.0, 1.0
STRIP_KG, LEVELS, PITCH_M, WIDTH_M = 0.17, 8, 0.02, 0.02
FREE = (0.0, 0.0, 0.0)
TIGHT = StepOptions(tolerance_N=1e-9, iterations=50, residual_bound_N=1e-6)


def strip(young_modulus_Pa: float, on_top_kg: float = 0.0) -> SoftBody:
    """Return the strip along -z, held by its first node, `on_top_kg` heavier there."""
    rows = [[side * 0.5 * WIDTH_M, 0.0, -k * PITCH_M] for k in range(1, LEVELS + 1) for side in (-1, 1)]
    pairs = [(1 + 2 * k, 2 + 2 * k) for k in range(LEVELS)]
    triangles = [(0, 1, 2)]
    for (a, b), (c, d) in pairwise(pairs):
        triangles += [(a, c, b), (b, c, d)]
    mass = np.full(1 + len(rows), STRIP_KG / (1 + len(rows)))
    mass[0] += on_top_kg
    return SoftBody.from_arrays(
        np.array([[0.0, 0.0, 0.0], *rows]), np.array(triangles), Film(young_modulus_Pa, 0.0, 1e-4),
        node_mass=mass, base=np.array([0]), tip=np.array(pairs[-1]),
    )  # fmt: skip


def loads(body: SoftBody, push_N: float = 0.0) -> Loads:
    """Return a pull at the lower end that keeps the strip taut, and a push on its first node."""
    force = np.zeros((body.nodes, 3))
    force[body.tip, 2] = -0.5 * PULL_N
    force[0, 2] = push_N
    return Loads((), (), FREE, nodal_force=force)


def along_the_slide(body: SoftBody) -> Mask:
    """Return (n, 3) bool: the components that no node can move in."""
    return np.tile([True, True, False], (body.nodes, 1))


class Slider:
    """Carriage and strip, at rest under the pull until `tick` pushes the carriage up with another force.

    Args:
        ratio: mass of the strip over that of the carriage.
        young_modulus_Pa: of the film.
    """

    def __init__(self, ratio: float, young_modulus_Pa: float) -> None:
        self.carriage_kg = STRIP_KG / ratio
        urdf = URDF.format(mass=self.carriage_kg)
        arm = ArmFile("slider", Path("slider.urdf"), urdf, "carriage", ("slide",), np.zeros(1))
        gains = ServoGains(np.zeros(1), np.zeros(1))
        self.scene = RigidScene(
            SceneDescription(arm, tick_s=TICK_S, gravity=FREE, floor_height_m=None, armature=0.0, gains=gains)
        )
        self.body = strip(young_modulus_Pa)
        pose = self.scene.flange_pose
        self.soft = FilmRobot(self.body, pose, NewtonOptions(tolerance_N=1e-9), TIGHT)
        self.soft.hold_components(along_the_slide(self.body), pose)
        self.loads = loads(self.body)
        found = self.soft.solve(self.soft.state, pose, self.loads)
        self.soft.commit(found)
        self.start = found.state
        self.interface = Interface(self.scene, self.soft, found.wrench)

    def tick(self, coupling: Coupling) -> TickRow:
        """Advance by a tick, the carriage pushed up by more than the pull."""
        return one_tick(coupling, np.zeros(1), np.array([PULL_N + PUSH_N]), self.loads)

    @property
    def height_m(self) -> float:
        """Of the carriage."""
        return float(self.scene.joint_position[0])


class OneBody:
    """The same pair as one soft body, stepped by itself.

    Args:
        slider: at its start.
        young_modulus_Pa: of the film.
    """

    def __init__(self, slider: Slider, young_modulus_Pa: float) -> None:
        body = strip(young_modulus_Pa, slider.carriage_kg)
        held = along_the_slide(body)
        clamp = Clamp(np.arange(body.nodes), body.positions, held)
        self._stepper = Stepper(NewtonSolver(FilmPotential(body), held), clamp, TIGHT)
        self._loads = loads(body, PULL_N + PUSH_N)
        self.state: SoftState = slider.start

    def tick(self) -> None:
        """Take one implicit step."""
        self.state, _ = self._stepper.step(
            self.state, Pose(), self._loads, TICK_S, accuracy=StepAccuracy(1e-10)
        )

    @property
    def height_m(self) -> float:
        """Of the carriage."""
        return float(self.state.positions[0, 2])
