"""Soft arms at the ends of what may be asked for: what is varied, how one is driven, how it ended.

Used by the stability atlas (benchmarks/stability.py) and by the tests that draw from the same ranges.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import CosimError, InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import Integrator, StepOptions

Kind: TypeAlias = Literal["stable", "slow", "named", "unnamed"]

RANGES: dict[str, tuple[float, float]] = {
    "tick_s": (1e-5, 0.1),
    "pressure_Pa": (-20e3, 200e3),
    "young_modulus_Pa": (1e5, 1e12),
    "thickness_m": (1e-6, 5e-3),
    "node_mass_kg": (1e-7, 1.0),
    "tension_N": (0.0, 1e3),
    "jump_m": (0.0, 0.5),
    "spin_rad_s": (0.0, 20.0),
    "gravity_m_s2": (0.0, 9.81),
    "sliver": (1e-12, 1.0),
}
HANGING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.7]))
RAMP, EVENT, CUT = 8, 10, 18  # ticks: loads ramped until, flange or cable event at, cable cut at
SLOW_ITERATIONS = 12.0  # Newton iterations a tick, mean over the run
SPIN_AXIS = np.array([2.0, 3.0, 6.0]) / 7.0


@dataclass(frozen=True)
class Extreme:
    """One soft arm and what happens to it; the defaults are harmless.

    Args:
        units: of the paper's hexagonal arm.
        sliver: mid rings lie this share of the way from the hole to the rim; small: slivers.
        flipped: so many triangles turned over.
        tension_N: of both cables.
        cable: "ramp": tension grows and stays; "jerk": it is there at once; "cut": grows, then is gone.
        jump_m: the flange is moved so far within one tick.
        spin_rad_s: the flange turns at once, and goes on turning.
        statics: equilibria at the same loads instead of time steps.
    """

    tick_s: float = 0.002
    pressure_Pa: float = 30e3
    young_modulus_Pa: float = 1.3e9
    thickness_m: float = 0.11e-3
    node_mass_kg: float = 2.04e-3
    gravity_m_s2: float = 9.81
    units: int = 2
    sliver: float = 0.5
    flipped: int = 0
    tension_N: float = 0.0
    cable: Literal["ramp", "jerk", "cut"] = "ramp"
    jump_m: float = 0.0
    spin_rad_s: float = 0.0
    law: FilmLaw = "plain"
    integrator: Integrator = "implicit_euler"
    closed: bool = True
    statics: bool = False
    ticks: int = 24


@dataclass(frozen=True)
class Verdict:
    """How it ended.

    Args:
        kind: "stable", "slow" (many iterations), "named" (an error of cosim, the state before it at hand) or
            "unnamed" (anything else: a fault of cosim).
        name: of the failure.
        iterations: Newton iterations a tick.
        seconds: CPU time of it all.
    """

    kind: Kind
    name: str = ""
    iterations: float = 0.0
    seconds: float = 0.0


def body_of(extreme: Extreme) -> SoftBody:
    """Return the soft body.

    Raises:
        MeshError: its mesh is degenerate.
    """
    mesh = PolygonalStack(
        6, extreme.units, 0.05, 0.01, 0.002, 0.95 if extreme.units <= 20 else 1.0, extreme.sliver
    ).mesh()
    film = Film(extreme.young_modulus_Pa, 0.2, extreme.thickness_m, extreme.law)
    triangles = mesh.triangles.copy()
    triangles[: extreme.flipped] = triangles[: extreme.flipped, ::-1]
    lines = [mesh.line("corner_0"), mesh.line("corner_1")] if extreme.units > 1 else []
    return SoftBody.from_arrays(
        mesh.positions,
        triangles,
        film,
        hinge_nodes=interior_hinges(mesh.triangles, mesh.seam),
        hinge_stiffness=10.0 * film.bending_stiffness_Nm,
        fold_barrier_rad=0.02 * np.pi,
        caps=mesh.caps,
        closed=extreme.closed,
        cables=tuple(Cable(line, 0.8) for line in lines),
        node_mass=extreme.node_mass_kg,
        base=mesh.ring("unit_1.hole"),
        tip=mesh.ring("tip"),
        rings=mesh.rings,
    )


def loads_at(extreme: Extreme, tick: int, cables: int) -> Loads:
    """Return the loads at the end of a tick."""
    share = min(1.0, tick / RAMP)
    pull = {"ramp": share, "jerk": float(tick >= EVENT), "cut": share * float(tick < CUT)}[extreme.cable]
    gravity = (0.0, 0.0, -extreme.gravity_m_s2)
    return Loads((share * extreme.pressure_Pa,), (pull * extreme.tension_N,) * cables, gravity)


def flange_at(extreme: Extreme, tick: int) -> Pose:
    """Return the flange's pose at the end of a tick."""
    since = max(0, tick - EVENT + 1)
    if not since:
        return HANGING
    turn = rotation_from_vector(extreme.spin_rad_s * extreme.tick_s * since * SPIN_AXIS)
    shift = extreme.jump_m * np.array([2.0, -1.0, 2.0]) / 3.0
    return Pose(turn @ HANGING.rotation, HANGING.translation + shift)


def _finite(arm: FilmRobot) -> bool:
    state = arm.state
    return bool(np.isfinite(state.positions).all() and np.isfinite(state.velocities).all())


def _advance(arm: FilmRobot, extreme: Extreme) -> int:
    """Take all ticks; return the Newton iterations."""
    iterations, cables = 0, len(arm.body.cables)
    for tick in range(1, extreme.ticks + 1):
        reply = arm.advance(flange_at(extreme, tick), loads_at(extreme, tick, cables), extreme.tick_s)
        iterations += reply.iterations
        forces = np.concatenate([reply.wrench.force, reply.wrench.torque, [reply.residual_N]])
        if not (np.isfinite(forces).all() and _finite(arm)):
            raise ArithmeticError("a number that is not finite left the solver")
    return iterations


def _equilibria(arm: FilmRobot, extreme: Extreme) -> int:
    """Find equilibria at the same loads and poses; return the Newton iterations a tick would have had."""
    solver, cables = arm.equilibrium_solver, len(arm.body.cables)

    def settle(found: Equilibrium) -> Equilibrium:
        arm.commit(found)
        if not (_finite(arm) and np.isfinite(found.wrench.force).all() and np.isfinite(found.potential_J)):
            raise ArithmeticError("a number that is not finite left the solver")
        return found

    here = settle(solver.solve(arm.state, HANGING, loads_at(extreme, 0, cables)))
    spent = here.iterations
    for tick in (RAMP, EVENT, extreme.ticks):
        here = settle(solver.follow(here, flange_at(extreme, tick), loads_at(extreme, tick, cables)))
        spent += here.iterations
    return spent // 4


def failure_name(error: CosimError) -> str:
    """Return the error's class and, where Newton's method gave one, its outcome."""
    outcomes = [outcome.name for outcome in Outcome if outcome.value in str(error)]
    return " ".join([type(error).__name__, *outcomes])


def judged(run: Callable[[], float], intact: Callable[[], bool]) -> Verdict:
    """Run something that returns its Newton iterations a tick, and say how it ended.

    Args:
        run: may raise anything; warnings of numerical libraries count as errors.
        intact: whether the state before the failure is at hand and finite.
    """
    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            iterations = run()
        except CosimError as error:
            kind: Kind = "named" if intact() else "unnamed"
            return Verdict(kind, failure_name(error), seconds=time.process_time() - began)
        except Exception as error:
            name = f"{type(error).__name__}: {error}"
            return Verdict("unnamed", name, seconds=time.process_time() - began)
    kind = "stable" if iterations <= SLOW_ITERATIONS else "slow"
    return Verdict(kind, iterations=iterations, seconds=time.process_time() - began)


def probe(extreme: Extreme, options: StepOptions | None = None) -> Verdict:
    """Build the soft arm, let happen to it what shall happen, and say how it ended."""
    arms: list[FilmRobot] = []

    def run() -> float:
        chosen = options or StepOptions(integrator=extreme.integrator)
        arm = FilmRobot(body_of(extreme), HANGING, NewtonOptions(), chosen)
        arms.append(arm)
        return _equilibria(arm, extreme) if extreme.statics else _advance(arm, extreme) / extreme.ticks

    return judged(run, lambda: not arms or _finite(arms[0]))


__all__ = ["RANGES", "Extreme", "InputError", "Verdict", "body_of", "failure_name", "judged", "probe"]
