"""Stacks of film under pressure against independent finite elements.

Sources: quadratic membranes with bending (energies minimised), CalculiX S8R and Kratos thin shells, on films
of 0.11 mm, 1.3 GPa and Poisson's ratio 0.2; open holes, first hole ring held, the films of a unit joined at
the seam without stiffness against turning, neither weight nor contact. Bands are as judged from meshes,
branches and codes; a tolerance is a share of the band's nearer edge. No constant of the wrinkling law was
fitted to them. At 2 and 5 kPa films snap, and what they hold depends on their history: 15 %. From 10 kPa
on: 7 %.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from tests.known_answers.stacks import FILM, OpenSpecimen, film_stack, squares

WRINKLING = replace(FILM, law="wrinkling")
SNAPPING, FOLDED = 0.15, 0.07
PATH_KPA = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
HEXAGONS = PolygonalStack(6, 5, 0.05, 0.01, 0.002, 0.95)
# three times as stiff in bending, as stiff in tension
STIFF = replace(
    WRINKLING,
    young_modulus_Pa=FILM.young_modulus_Pa / math.sqrt(3.0),
    thickness_m=FILM.thickness_m * math.sqrt(3.0),
)
Bands = dict[float, tuple[float, float, float]]
"""Lower and upper edge [mm] and tolerance, by pressure [kPa]."""

# refined once, one square is 7.2 % short at 10 kPa; at 2 kPa the band reaches from loading to unloading
ONE: Bands = {
    2: (11.2, 22.4, SNAPPING), 5: (22.6, 24.2, SNAPPING), 10: (24.5, 25.5, 0.08), 20: (25.7, 26.5, FOLDED),
    40: (26.8, 27.2, FOLDED),
}  # fmt: skip
THREE: Bands = {
    2: (34.5, 67.2, SNAPPING), 5: (58, 66, SNAPPING), 10: (68, 74, FOLDED), 20: (74, 77, FOLDED),
    40: (79, 81, FOLDED),
}  # fmt: skip
# of one mesh (4 mm, 2 mm at the seam); 5 kPa is just above the snap of this film
THICK: Bands = {2: (9.2, 9.2, SNAPPING), 5: (14.3, 14.3, 0.2), 10: (19.6, 19.6, FOLDED)}
FIVE: Bands = {5: (111.7, 111.7, SNAPPING), 20: (143.3, 143.3, FOLDED), 40: (151.2, 153.7, FOLDED)}
# hinges along the seam bend like the film around them; below 1 kPa these meshes do not resolve it
SEAMS: Bands = {2: (31, 43, SNAPPING), 10: (62, 72, FOLDED), 20: (72.5, 77.5, FOLDED)}
# 2 x 2 mm, 2 GPa along the seam. The sides of the frame, two beams each on the drawn mesh, bow unequally
# above 7 kPa, which the drawn mesh does 10 % late; refined ones are within 6 %
FRAMED: Bands = {
    2: (4.47, 4.51, 0.07), 5: (6.72, 6.76, 0.07), 10: (10.0, 10.4, 0.12), 20: (15.0, 15.6, 0.12),
    40: (19.4, 19.8, 0.07),
}  # fmt: skip
# constant strain, the same 168 triangles in another code; whether hole rings may widen makes 1.5 %
PLAIN: Bands = {2: (16.06, 16.06, 0.02), 10: (30.63, 30.63, 0.02), 20: (39.51, 39.51, 0.02)}


def sample_of(stack: PolygonalStack, level: int, film: Film = WRINKLING, **given: Any) -> OpenSpecimen:
    return OpenSpecimen(film_stack(stack, level, film, **given))


def framed(level: int) -> OpenSpecimen:
    body = film_stack(squares(1), level, WRINKLING)
    rims = np.stack([ring for name, ring in body.rings.items() if name.endswith(".outer")])
    section = RectangularSection(2e-3, 2e-3, 2e9)
    return OpenSpecimen(body.with_elements(BeamRings.from_shape(body.positions, rims, section)))


def errors(sample: OpenSpecimen, bands: Bands) -> dict[float, float]:
    """Return by how much the extension is beyond a band, as a share of its nearer edge, by pressure [kPa]."""
    found = {}
    for pressure in (step for step in PATH_KPA if step <= max(bands)):
        sample.load_to(1e3 * pressure)
        if pressure in bands:
            low, high, _ = bands[pressure]
            extension = 1e3 * sample.extension_m
            found[pressure] = extension / min(max(extension, low), high) - 1.0
    return found


CASES = {
    "three plain squares": (lambda: sample_of(squares(3), 0, FILM), PLAIN),
    "three squares": (lambda: sample_of(squares(3), 0), THREE),
    "three squares, refined": (lambda: sample_of(squares(3), 1), THREE),
    "three squares, refined twice": (lambda: sample_of(squares(3), 2), THREE),
    "thick square": (lambda: sample_of(squares(1), 0, STIFF), THICK),
    "thick square, refined": (lambda: sample_of(squares(1), 1, STIFF), THICK),
    "five hexagons": (lambda: sample_of(HEXAGONS, 0), FIVE),
    "five hexagons, refined": (lambda: sample_of(HEXAGONS, 1), FIVE),
    "rigid seams": (lambda: sample_of(squares(3), 0, rigid_seam=True), SEAMS),
    "rigid seams, refined": (lambda: sample_of(squares(3), 1, rigid_seam=True), SEAMS),
    "framed square": (lambda: framed(0), FRAMED),
    "framed square, refined": (lambda: framed(1), FRAMED),
}


@pytest.mark.parametrize("case", CASES)
def test_a_stack_extends_as_finite_elements_say(case: str) -> None:
    sample, bands = CASES[case]
    off = errors(sample(), bands)
    assert {kPa: error for kPa, error in off.items() if abs(error) > bands[kPa][2]} == {}


@pytest.mark.parametrize(("level", "least_ml"), [(0, 36.0), (1, 39.5)])
def test_one_square_wrinkles_where_plain_film_is_too_stiff(level: int, least_ml: float) -> None:
    plain, wrinkling = sample_of(squares(1), level, FILM), sample_of(squares(1), level)
    assert max(errors(plain, ONE).values()) < -0.19
    off = errors(wrinkling, ONE)
    assert {kPa: error for kPa, error in off.items() if abs(error) > ONE[kPa][2]} == {}
    assert wrinkling.iterations < 1.5 * plain.iterations
    # chords of the drawn mesh enclose less than the bulging film: finite elements have 42.4 ml at 10 kPa
    sample = sample_of(squares(1), level).load_along(1e3 * step for step in PATH_KPA if step <= 10.0)
    assert least_ml < 1e6 * sample.volume_m3 < 42.4


def test_a_tension_field_extends_as_converged_finite_elements_do() -> None:
    # finite elements with a tension field, no bending, converged on two meshes. 5 % at 2 kPa, where hardly
    # anything resists the last millimetres: what is left of compressive stiffness counts against the gas
    bands: Bands = {2: (79.4, 80.2, 0.05), 10: (82.6, 83.4, 0.02), 20: (83.5, 84.3, 0.02)}
    sample = sample_of(squares(3), 1, FILM).load_along((100.0, 250.0, 500.0, 1e3, 2e3))
    for share in (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4):
        here, film = sample.here, replace(FILM, law="tension_field", compressive_fraction=share)
        sample = sample_of(squares(3), 1, film)
        sample.here = here
        sample.load_to(2e3)
    for pressure, (low, high, tolerance) in bands.items():
        sample.load_to(1e3 * pressure)
        assert low * (1.0 - tolerance) < 1e3 * sample.extension_m < high * (1.0 + tolerance)


def test_what_keeps_a_stack_straight_holds_nothing_else() -> None:
    # a free stack of plain film comes to 97.8 mm; with x and y of every hole node held it came to 92.4 mm
    sample = sample_of(HEXAGONS, 0, FILM).load_along((0.1e3, 0.5e3, 2e3, 5e3, 10e3, 20e3, 40e3))
    assert 1e3 * sample.extension_m == pytest.approx(97.8, abs=0.2)


def pushed(law: FilmLaw) -> tuple[list[float], int]:
    """Return heights [mm] of three squares at 10 kPa, pulled and pushed by up to 10 N, and the iterations."""
    sample = sample_of(squares(3), 0, replace(FILM, law=law))
    sample.load_along(1e3 * step for step in PATH_KPA if step <= 10.0)
    assert sample.here is not None
    state, iterations, heights = sample.here.state, 0, []
    for force in (*range(1, 11), *range(9, -11, -1), *range(-9, 1)):
        loads = sample.loads(10e3, state.positions)
        assert loads.nodal_force is not None
        loads.nodal_force[sample.body.tip, 2] += force / len(sample.body.tip)
        found = sample.solver.solve(state, Pose(), loads)
        state, iterations = found.state, iterations + found.iterations
        heights.append(1e3 * float(sample.body.tip_position(state.positions)[2]))
    return heights, iterations


def test_pull_and_push_cost_three_times_the_iterations_at_most() -> None:
    (plain, plain_iterations), (wrinkling, iterations) = pushed("plain"), pushed("wrinkling")
    assert iterations < 3.0 * plain_iterations
    assert wrinkling[9] > 2.0 * plain[9]
