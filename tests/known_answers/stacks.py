"""Stacks of film with open end holes, kept upright: the specimens of the finite-element references."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from cosim.base.frames import Array, Pose, cross, rotation_from_vector
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.hinge import shell_stiffness
from cosim.soft.elements.material import Film
from cosim.soft.elements.pressure import add_cap_force
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry import named_mesh, surface
from cosim.soft.geometry.polygonal_stack import PolygonalStack, with_finer_holes
from cosim.soft.solve import equilibrium, newton, newton_options
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.state import Equilibrium, SoftState

_ON_PLANE_m = 1e-9  # of a plane of symmetry, beyond rounding
_ROUNDS, _SETTLED_m = 20, 1e-6


def film_stack(
    stack: PolygonalStack, level: int, film: Film, *, holes: int = 0, rigid_seam: bool = False
) -> SoftBody:
    """Return a stack whose film bends as a discrete shell.

    Args:
        stack: drawn shape.
        level: how often its triangles are refined.
        film: material.
        holes: how often triangles at the holes are refined, before.
        rigid_seam: whether the films of a unit turn as one at their seam; they turn freely otherwise.
    """
    drawn = stack.mesh()
    mesh = named_mesh.refine(with_finer_holes(drawn, (*drawn.center_rings, drawn.tip_ring), holes), level)
    hinges = surface.interior_hinges(mesh.triangles, () if rigid_seam else mesh.seam)
    return SoftBody.from_arrays(
        mesh.positions, mesh.triangles, film, wrinkle_panel_m=mesh.face_values["wrinkle_panel_m"],
        hinge_nodes=hinges,
        hinge_stiffness=shell_stiffness(mesh.positions, mesh.triangles, hinges, film.flexural_rigidity_Nm),
        caps=mesh.caps, base=mesh.ring(mesh.base_ring), tip=mesh.ring(mesh.tip_ring), rings=mesh.rings,
    )  # fmt: skip


class OpenSpecimen:
    """A closed body whose cap forces are taken off as dead loads until they agree with the shape.

    The inner problem keeps a potential, so that Newton's method can go down it through wrinkling.

    Args:
        body: of film, upright; its caps are the open ends.
    """

    def __init__(self, body: SoftBody) -> None:
        self.body = body
        clamp = guided(body)
        self.newton = newton.NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
        options = newton_options.NewtonOptions(tolerance_N=1e-5, iterations_max=600, step_max_m=0.01)
        self.solver = equilibrium.EquilibriumSolver(self.newton, clamp, options)
        self.here: Equilibrium | None = None
        self.iterations = 0

    def loads(self, pressure_Pa: float, positions: Array) -> Loads:
        """Return the loads with the caps' pressure taken off at positions (n, 3) [m]."""
        force = np.zeros_like(positions)
        for ring in self.body.caps:
            add_cap_force(np.ascontiguousarray(positions), ring, -pressure_Pa, force)
        return Loads((pressure_Pa,), (), (0.0, 0.0, 0.0), force)

    def load_along(self, pressures_Pa: Iterable[float]) -> OpenSpecimen:
        """Follow the equilibrium from pressure to pressure; return itself.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        for pressure in pressures_Pa:
            self.load_to(pressure)
        return self

    def load_to(self, pressure_Pa: float) -> Equilibrium:
        """Follow the equilibrium to a pressure.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        state = SoftState.drawn(self.body, Pose()) if self.here is None else self.here.state
        for _ in range(_ROUNDS):
            found = self.solver.solve(state, Pose(), self.loads(pressure_Pa, state.positions))
            self.iterations += found.iterations
            moved = float(np.abs(found.state.positions - state.positions).max())
            state = found.state
            if moved < _SETTLED_m:
                break
        self.here = found
        return found

    @property
    def extension_m(self) -> float:
        """Mean height of the top ring above where it is drawn [m]."""
        assert self.here is not None
        drawn = self.body.tip_position(self.body.positions)
        return float((self.body.tip_position(self.here.state.positions) - drawn)[2])

    @property
    def volume_m3(self) -> float:
        """Volume that film and open ends enclose."""
        return float(self.newton.film.volume)


def guided(body: SoftBody) -> Clamp:
    """Return the clamp of the base, with the nodes on the planes x = 0 and y = 0 kept in them.

    Both are planes of symmetry of the drawn mesh. A free stack leans over above some pressure; the
    finite-element reference is the straight one. Holes may widen, as they do there.

    Raises:
        MeshError: a plane holds no node of a free hole ring, so nothing would keep the stack straight.
    """
    clamp = Clamp.of_base(body)
    on_plane = np.abs(body.positions) < _ON_PLANE_m
    on_plane[:, 2] = False
    rest = np.ones(body.nodes, dtype=bool)
    rest[body.base] = False
    if not on_plane[rest, :2].any(axis=0).all():
        raise MeshError("no free node lies on the planes x = 0 and y = 0")
    return clamp.holding(on_plane, body.positions, Pose())


FILM: Final = Film(1.3e9, 0.2, 0.11e-3)


def squares(units: int, hole_side_m: float = 0.004) -> PolygonalStack:
    """Return square units of 60 mm, drawn 2 mm high."""
    to_corner = 1.0 / math.sqrt(2.0)
    return PolygonalStack(
        4, units, 0.06 * to_corner, hole_side_m * to_corner, 0.002, ring_heights=(0.2, 0.5, 0.8)
    )


ANGLE_RAD: Final = math.radians(1.0)


def tilt_stiffness(sample: OpenSpecimen) -> float:
    """Return the moment over angle [N m/rad] of the upper ring, turned about x at the place it has.

    Raises:
        ConvergenceError: no equilibrium was found.
    """
    body, here = sample.body, sample.here
    assert here is not None
    x = here.state.positions
    clamp = Clamp.of_base(body).extended(body.tip, x, Pose())
    solver = equilibrium.EquilibriumSolver(
        newton.NewtonSolver(FilmPotential(body), clamp.mask(body.nodes)), clamp, sample.solver.options
    )
    centre, state = x[body.tip].mean(axis=0), here.state
    loads = sample.loads(here.loads.pressures(1)[0], x)
    moments = []
    for angle in (0.0, 0.5 * ANGLE_RAD, ANGLE_RAD):
        turn = rotation_from_vector(np.array([angle, 0.0, 0.0]))
        turned = x.copy()
        turned[body.tip] = centre + (x[body.tip] - centre) @ turn.T
        solver.clamp = Clamp.of_base(body).extended(body.tip, turned, Pose())
        state = solver.solve(state, Pose(), loads).state
        moments.append(_moment(solver.solver.film, body, state.positions, centre))
    return float(moments[-1] - moments[0]) / ANGLE_RAD


def _moment(system: FilmPotential, body: SoftBody, positions: Array, centre: Array) -> float:
    """Return the moment [N m] about x that holds the upper ring, the caps' pressure taken off."""
    arm = positions[body.tip] - centre
    return float(cross(arm, system.gradient[body.tip])[:, 0].sum())
