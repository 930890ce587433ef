"""Order of convergence in time of the coupled tick: a rigid carriage and the soft strip it carries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, final

import numpy as np
from scipy.integrate import solve_ivp

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array
from cosim.coupling.schemes.interface import Coupling, Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.ticks import Servos
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.support.case import Case, Figure, observed_order
from cosim.verification.support.specimen import UNLOADED, exact_steps

SPAN_S, PUSH_N = 0.1, 1.0
TICKS = (400, 800)
EXCHANGES: tuple[tuple[str, float, Callable[[Interface], Coupling]], ...] = (
    ("staggered, ratio 0.4", 0.4, StaggeredCoupling),
    ("staggered, ratio 2", 2.0, StaggeredCoupling),
    ("iterated, ratio 0.4", 0.4, IteratedCoupling),
    ("iterated, ratio 2", 2.0, IteratedCoupling),
)
"""Name, mass of the strip over that of the carriage, scheme; above 0.5 the staggered one carries a mass."""

_STRIP_kg, _LEVELS, _PITCH_M, _HALF_WIDTH_M = 0.17, 8, 0.02, 0.01
_STILL = np.zeros((64, 1))
_URDF = """<robot name="slide"><link name="rail"/><link name="carriage"><inertial><mass value="{mass}"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="along" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="-10" upper="10" effort="1000" velocity="100"/></joint></robot>"""


def strip() -> SoftBody:
    """Return a strip of soft film that hangs along -z from its first node."""
    rows = [
        (side, 0.0, -k * _PITCH_M) for k in range(1, _LEVELS + 1) for side in (-_HALF_WIDTH_M, _HALF_WIDTH_M)
    ]
    pairs = [(1 + 2 * k, 2 + 2 * k) for k in range(_LEVELS)]
    triangles = [(0, 1, 2)]
    for (a, b), (c, d) in pairwise(pairs):
        triangles += [(a, c, b), (b, c, d)]
    return SoftBody.from_arrays(
        np.array([(0.0, 0.0, 0.0), *rows]), np.array(triangles), Film(1e7, 0.0, 1e-4),
        node_mass=_STRIP_kg / (1 + len(rows)), base=np.array([0]), tip=np.array(pairs[-1]),
    )  # fmt: skip


def exact_rise(ratio: float) -> float:
    """Return how far [m] carriage and strip have risen after SPAN_S, as one system by an explicit method."""
    body = strip()
    system, n = SoftSystem(body), body.nodes
    mass = body.node_mass.copy()
    mass[0] += _STRIP_kg / ratio
    push = np.zeros(n)
    push[0] = PUSH_N

    def rates(_t: float, y: Array) -> Array:
        x = body.positions.copy()
        x[:, 2] += y[:n]
        system.evaluate(x, UNLOADED, np.zeros(0), system.memory.copy(), hessian=False)
        return np.concatenate([y[n:], (push - system.gradient[:, 2]) / mass])

    found = solve_ivp(rates, (0.0, SPAN_S), np.zeros(2 * n), method="DOP853", rtol=1e-11, atol=1e-13)
    return float(found.y[0, -1])


def ticked_rise(ratio: float, scheme: Callable[[Interface], Coupling], ticks: int) -> float:
    """Return the same after ticks of both sides: MuJoCo moves the carriage, the soft side the strip."""
    body = strip()
    urdf = _URDF.format(mass=_STRIP_kg / ratio)
    slide = ArmFile("slide", Path("slide.urdf"), urdf, "carriage", ("along",), np.zeros(1))
    scene = RigidScene(
        SceneDescription(
            slide, tick_s=SPAN_S / ticks, gravity=(0.0, 0.0, 0.0), floor_height_m=None, armature=0.0,
            gains=ServoGains(np.zeros(1), np.zeros(1)),
        )
    )  # fmt: skip
    pose = scene.flange_pose
    soft = SoftArm(body, pose, NewtonOptions(tolerance_N=1e-9), exact_steps("implicit_euler", 1e-10))
    soft.hold_also(np.tile([True, True, False], (body.nodes, 1)), pose)
    found = soft.solve(soft.state, pose, UNLOADED)
    soft.settle(found)
    coupling = scheme(Interface(scene, soft, found.wrench))
    servos, done = Servos.knowing_no_payload(_STILL, _STILL, _STILL + PUSH_N), 0
    while done < ticks:
        done += coupling.advance(servos, [UNLOADED] * min(len(_STILL), ticks - done)).done
    return float(scene.joint_position[0])


@final
@dataclass(frozen=True)
class CoupledTick(Case):
    """A push on the carriage sets strip and carriage in motion; how far the carriage gets, of every exchange.

    Both sides take first-order steps, and an exchange that is one tick late is of first order too: the order
    is 1. The strip's waves are resolved, and cross it a few times. A mass that is carried may cost a tick's
    impulse where the acceleration jumps, at the start: of first order as well. The finer ticks leave 0.4 %
    of the rise at most.
    """

    name: ClassVar[str] = "coupled_tick"
    title: ClassVar[str] = "Order of convergence in time of the coupled tick"
    source: ClassVar[str] = "one system of rigid and soft masses, reference solution by SciPy's DOP853"

    def run(self) -> tuple[Figure, ...]:
        figures = []
        for name, ratio, scheme in EXCHANGES:
            exact = exact_rise(ratio)
            rises = [ticked_rise(ratio, scheme, ticks) for ticks in TICKS]
            order = observed_order(*(rise - exact for rise in rises))
            figures += [
                Figure(f"rise, {name}", "m", rises[-1], exact, 5e-3, observed_order=order),
                Figure(f"order, {name}", "1", order, 1.0, 0.15, absolute=True),
            ]
        return tuple(figures)
