"""Contact of the film on a chain of frames: that of its nodes, and exact derivatives by the frames."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, cross_matrix
from cosim.reduced.sections.chain_shape import change_frames
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.clamp import node_motion
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums
from cosim.soft.film.film import FilmPotential
from tests.derivatives import RELATIVE, derivative_errors
from tests.small_section import body, section
from tests.soft.contacts import half_space

PRESSURE = 25e3
LAW = ContactLaw(stiffness_N_m3=3e8, smoothing_m=2e-3, stick_m=1e-3)


def changed(frames: Array, step: Array) -> Array:
    """Return the frames (f, 4, 3) moved by a step (f, 6) of translations and rotations."""
    result = np.empty_like(frames)
    change_frames(frames, step, 1.0, result)
    return result


def frames() -> Array:
    """Return bent and twisted frames (f, 4, 3) within the range of the model."""
    straight = section().straight(PRESSURE)
    rng = np.random.default_rng(2)
    return changed(straight, rng.normal(0.0, 1.0, (len(straight), 6)) * ([1e-3] * 3 + [0.05] * 3))


def planes(x: Array, share: float) -> ContactPlanes:
    """Return a half-space in which points of the film at nodes (n, 3) sink in, each with friction."""
    surface = ContactSurface.of(body(), FilmPotential(body()).pattern)
    rng = np.random.default_rng(0)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    points = surface.points(x)
    height = float(np.quantile(points @ normal, 0.7))
    anchor = points + share * LAW.stick_m * rng.normal(size=points.shape)
    return half_space(surface, normal, height, LAW, rng.uniform(0.0, 2.0, len(surface)), anchor)


def left_jacobian(turn: Array) -> Array:
    """Return how exp(S(turn + d)) turns on from exp(S(turn)) per d, up to the second order."""
    skew = cross_matrix(turn)
    return np.asarray(np.eye(3) + 0.5 * skew + skew @ skew / 6.0)


def of_contact(here: Array, loads: Loads, step: Array) -> tuple[float, Array, Array]:
    """Return what a contact adds to potential, gradient (f, 6) and Hessian (6 f, 6 f) by a step (f, 6)."""
    moved, found = changed(here, step), []
    solver, free = ChainSolver(section()), np.zeros(len(here), dtype=bool)
    for load in (loads, Loads(loads.pressure_Pa, (0.0, 0.0))):
        energy = solver.solve(moved, free, load, 1e9, 1).potential_J
        gradient = solver.evaluate(moved, load, PRESSURE, hessian=True).copy()
        gradient[:, 3:] = [left_jacobian(s[3:]).T @ m for s, m in zip(step, gradient[:, 3:], strict=True)]
        full = np.zeros((len(here), 6, len(here), 6))
        for f in range(len(here)):
            full[f, :, f] = solver.work.diagonal[f]
            if f:
                full[f, :, f - 1], full[f - 1, :, f] = solver.work.off[f], solver.work.off[f].T
        found.append((energy, gradient, full.reshape(6 * len(here), -1)))
    (e, g, h), (e0, g0, h0) = found
    return e - e0, g - g0, h - h0


def test_the_frames_feel_what_their_nodes_feel() -> None:
    here = frames()
    x = section().positions(here, PRESSURE)
    touched = planes(x, 0.5)
    force = np.zeros_like(x)
    expected = touched.add(x, Sums(force), hessian=False)
    loads = Loads((PRESSURE,), (0.0, 0.0), contact=touched)
    energy, gradient, _ = of_contact(here, loads, np.zeros((len(here), 6)))
    assert energy == pytest.approx(expected, rel=1e-9)
    by_nodes = np.einsum("nrfi,nr->fi", node_motion(section(), here, PRESSURE), force)
    assert gradient == pytest.approx(by_nodes, abs=1e-9 * float(np.abs(gradient).max()))


@pytest.mark.parametrize("share", [0.02, 0.5, 3.0])
def test_derivatives_by_the_frames_are_exact(share: float) -> None:
    here = frames()
    loads = Loads((PRESSURE,), (0.0, 0.0), contact=planes(section().positions(here, PRESSURE), share))
    still = np.zeros((len(here), 6))
    errors = derivative_errors(lambda step: of_contact(here, loads, step), still, 1e-6)
    assert max(errors) < RELATIVE
