"""The film law for wrinkles below the mesh: derivatives, borders, limits, its dual, convexity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.elements import wrinkling as laws
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.elements.wrinkling import wrinkling_forces
from tests.compiled import compiled
from tests.derivatives import RELATIVE, derivative_errors, differences, relative_error
from tests.soft.bodies import FILM, hexagon_arm, random_rotation, shapes
from tests.soft.test_film_laws import evaluation

wrinkling, hide_across = compiled(laws.wrinkling), compiled(laws.hide_across)
PANEL_M = 0.028
SIDE_M = 0.02
BY_POISSON = {nu: replace(FILM, poisson_ratio=nu, law="wrinkling", wrinkle_panel_m=PANEL_M)
              for nu in (0.2, 0.45, 0.0, -0.4)}  # fmt: skip
WRINKLED = BY_POISSON[0.2]
DRAWN = np.array([[0.0, 0.0, 0.0], [SIDE_M, 0.001, 0.0], [0.006, 0.8 * SIDE_M, 0.0]])
AREA_M2 = 0.5 * float(np.linalg.norm(np.cross(DRAWN[1], DRAWN[2])))
STATES = {
    "taut": (0.010, 0.004, 0.003),
    "taut in spite of compression": (0.010, -0.00205, 0.0),
    "wrinkled": (0.010, -0.020, 0.005),
    "wrinkled, hardly drawn": (4e-4, -0.030, 0.001),
    "slack": (-0.010, -0.020, 0.004),
    "slack, nearly equal": (-0.010, -0.010, 1e-7),
    "slack, equal": (-0.010, -0.010, 0.0),
    "slack, crushed": (-0.4, -0.45, 0.05),
}


def limits(film: Film, area_m2: float = AREA_M2) -> Array:
    """Return s0 and f0 (2,) [N/m] of a triangle."""
    young = film.young_modulus_Pa * film.thickness_m
    return wrinkling_forces(film.flexural_rigidity_Nm, young, np.array([PANEL_M]), np.array([area_m2]))[0]


def answer(strain: Array, film: Film = WRINKLED, area_m2: float = AREA_M2) -> tuple[float, Array, Array]:
    """Return density, n (3,) and c (3, 3) of the law at a strain (E11, E22, 2 E12)."""
    n, c = np.empty(3), np.empty((3, 3))
    values = tuple(np.asarray(strain, dtype=float).tolist())
    density = wrinkling(values, film.membrane_stiffness, *limits(film, area_m2), n, c)
    return density, n, c


def principal(n: Array) -> Array:
    """Return the principal values of (N11, N22, N12), largest first."""
    return np.linalg.eigvalsh(np.array([[n[0], n[2]], [n[2], n[1]]]))[::-1]


def complementary(n: Array, film: Film = WRINKLED, area_m2: float = AREA_M2) -> float:
    """Return the complementary density as it is defined."""
    plate, hardening = limits(film, area_m2)
    one, two = principal(n)
    young = film.young_modulus_Pa * film.thickness_m
    elastic = (one**2 + two**2 - 2.0 * film.poisson_ratio * one * two) / (2.0 * young)
    return float(elastic + sum(hardening / 4.0 * (max(-p - plate, 0.0) / hardening) ** 4 for p in (one, two)))


def random_strains(count: int) -> Array:
    return np.random.default_rng(4).normal(size=(count, 3)) * (0.02, 0.02, 0.02)


@pytest.mark.parametrize("share", 10.0 ** np.arange(-12.0, 5.0))
def test_what_is_hidden_answers_with_its_force_to_rounding(share: float) -> None:
    plate, hardening = (float(force) for force in limits(WRINKLED))
    stiffness, first = WRINKLED.membrane_stiffness, 0.01
    d00, ratio = stiffness[0, 0], stiffness[0, 1] / stiffness[0, 0]
    excess = share * hardening / d00
    force, pull = hide_across(first, -ratio * first - plate / d00 - excess, stiffness, plate, hardening)
    # the strain is a sum of three, of which the last is known to the rounding of the others
    rounding = 1e-15 * (1.0 + 0.02 / excess)
    assert force / d00 + (force / hardening) ** 3 == pytest.approx(excess, rel=4.0 * rounding)
    assert pull == pytest.approx(d00 * (1.0 - ratio**2) * first - ratio * (plate + force), rel=1e-14)


def triangle(film: Film = WRINKLED) -> Membranes:
    return Membranes.from_shape(DRAWN, np.array([[0, 1, 2]]), film)


def strained(strain: tuple[float, float, float]) -> Array:
    """Return the triangle DRAWN under a Green strain in the axes x and y, put askew."""
    e11, e22, e12 = strain
    values, axes = np.linalg.eigh(np.array([[1.0 + 2.0 * e11, e12], [e12, 1.0 + 2.0 * e22]]))
    stretch = axes * np.sqrt(values) @ axes.T
    return np.ascontiguousarray(DRAWN[:, :2] @ stretch @ random_rotation(6)[:2])


@pytest.mark.parametrize("poisson_ratio", BY_POISSON)
@pytest.mark.parametrize("state", STATES)
def test_derivatives_by_the_strain(state: str, poisson_ratio: float) -> None:
    film, strain = BY_POISSON[poisson_ratio], np.array(STATES[state])
    _, n, c = answer(strain, film)
    # rounding of a density of 1 J/m^2 over the step against forces of 100 N/m: 1e-8
    assert relative_error(n, differences(lambda e: answer(e, film)[0], strain, 1e-8)) < 1e-6
    assert relative_error(c, differences(lambda e: answer(e, film)[1], strain, 1e-7)) < 1e-6


@pytest.mark.parametrize("state", STATES)
def test_derivatives_by_the_nodes(state: str) -> None:
    errors = derivative_errors(evaluation(triangle(), 3), strained(STATES[state]), 5e-7)
    assert max(errors) < 10.0 * RELATIVE


def test_a_body_without_slots_has_the_same_gradient() -> None:
    # kernels of their own, so equal but for rounding: 100 triangles, more than the lanes of one group
    body, x = hexagon_arm(2), shapes(2)["random"]
    membranes = replace(body.membranes[0], film=WRINKLED)
    energy, gradient, _ = evaluation(membranes, body.nodes)(x)
    force, blocks = np.zeros_like(x), np.zeros((1, 3, 3))
    assert membranes.add(x, np.zeros((0, 0), np.int64), force, blocks) == pytest.approx(energy, rel=1e-13)
    assert force == pytest.approx(gradient, abs=1e-12 * np.abs(gradient).max())
    assert max(derivative_errors(evaluation(membranes, body.nodes), x, 5e-7)) < RELATIVE


def test_a_taut_film_is_the_plain_one_to_the_last_bit() -> None:
    body = hexagon_arm(1)
    x = body.positions * 1.01
    blocks = np.zeros((1, 3, 3))
    forces = []
    for film in (FILM, WRINKLED):
        membranes, force = replace(body.membranes[0], film=film), np.zeros_like(x)
        forces.append((membranes.add(x, np.zeros((0, 0), np.int64), force, blocks), force.tobytes()))
    assert forces[0] == forces[1]
    for strain in (STATES["taut"], STATES["taut in spite of compression"]):
        for one, other in zip(evaluation(triangle(), 3)(strained(strain)),
                              evaluation(triangle(FILM), 3)(strained(strain)), strict=True):  # fmt: skip
            assert one == pytest.approx(other, rel=1e-13, abs=1e-13 * float(np.abs(other).max()))


def test_energy_and_complementary_energy_are_dual() -> None:
    # psi + psi* = N : E at the answer; and psi* is larger than N : E - psi for any other N
    random = np.random.default_rng(5)
    for strain in random_strains(300):
        density, n, _ = answer(strain)
        assert density + complementary(n) == pytest.approx(float(n @ strain), rel=1e-12, abs=1e-12)
        other = n + random.normal(size=3) * 100.0
        assert density + complementary(other) >= float(other @ strain)


def test_the_law_is_convex_and_monotone_and_below_the_plain_one() -> None:
    strains = random_strains(400)
    for one, other in zip(strains[::2], strains[1::2], strict=True):
        psi_one, n_one, c_one = answer(one)
        psi_other, n_other, _ = answer(other)
        assert (n_one - n_other) @ (one - other) > 0.0
        assert answer(0.5 * (one + other))[0] < 0.5 * (psi_one + psi_other)
        assert np.abs(c_one - c_one.T).max() < 1e-12 * np.abs(c_one).max()
        values = np.linalg.eigvalsh(c_one)
        assert values[0] > 0.0
        assert psi_one <= 0.5 * one @ WRINKLED.membrane_stiffness @ one * (1.0 + 1e-13)


def test_more_compression_is_never_less_force() -> None:
    forces = [principal(answer(np.array([0.003, -e, 0.0]))[1]) for e in np.linspace(0.0, 0.45, 200)]
    assert (np.diff([second for _, second in forces]) < 0.0).all()
    assert forces[-1][1] > -0.01 * WRINKLED.young_modulus_Pa * WRINKLED.thickness_m


def borders(film: Film) -> dict[str, tuple[Array, Array]]:
    """Return a strain on each border, with a direction that crosses it."""
    plate, hardening = limits(film)
    compliance = np.linalg.inv(film.membrane_stiffness)
    r = 0.5 * hardening
    on_both = compliance @ (-plate, -plate - r, 0.0) - (0.0, (r / hardening) ** 3, 0.0)
    return {
        "taut to wrinkled": (compliance @ (500.0, -plate, 0.0), np.array([0.0, 1.0, 0.3])),
        "wrinkled to slack": (on_both, np.array([1.0, 0.2, 0.0])),
        "taut to slack": (compliance @ (-plate, -plate, 0.0), np.array([1.0, 1.0, 0.1])),
    }


@pytest.mark.parametrize("border", borders(WRINKLED))
def test_forces_and_tangent_are_continuous_where_the_state_changes(border: str) -> None:
    strain, direction = borders(WRINKLED)[border]
    young = WRINKLED.young_modulus_Pa * WRINKLED.thickness_m
    gaps = []
    for step in (1e-7, 1e-9):
        (_, n_one, c_one), (_, n_other, c_other) = (answer(strain + s * step * direction) for s in (1, -1))
        assert np.abs(n_one - n_other).max() < 4.0 * young * step
        gaps.append(np.abs(c_one - c_other).max())
    # 3 r^2 / f0^3 grows with the square of the strain beyond the border: 1e4 times less, but for rounding
    assert gaps[1] < 1e-2 * gaps[0] + 1e-6 * young
    assert gaps[1] < 1e-4 * young


@pytest.mark.parametrize("state", STATES)
def test_turned_axes_turn_the_forces(state: str) -> None:
    e11, e22, e12 = STATES[state]
    density, n, _ = answer(np.array(STATES[state]))
    turn = random_rotation(1)[:2, :2]
    turn, _ = np.linalg.qr(turn)
    e = turn @ np.array([[e11, 0.5 * e12], [0.5 * e12, e22]]) @ turn.T
    turned, m, _ = answer(np.array([e[0, 0], e[1, 1], 2.0 * e[0, 1]]))
    expected = turn @ np.array([[n[0], n[2]], [n[2], n[1]]]) @ turn.T
    assert turned == pytest.approx(density, rel=1e-11)
    # equal strains turn to ones that differ by rounding, 1e-17 of stiffness 1e5 N/m
    assert np.array([[m[0], m[2]], [m[2], m[1]]]) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_rigid_motion_and_balance() -> None:
    x, body = shapes(2)["random"], hexagon_arm(2)
    membranes, turn = replace(body.membranes[0], film=WRINKLED), random_rotation(2)
    energy, gradient, _ = evaluation(membranes, body.nodes)(x)
    turned, turned_gradient, _ = evaluation(membranes, body.nodes)(x @ turn.T + (1.0, -2.0, 0.5))
    assert turned == pytest.approx(energy, rel=1e-10)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-9 * np.abs(gradient).max())
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-13 * np.abs(gradient).sum() * np.abs(x).max()


def test_constants_give_the_forces_of_the_panel() -> None:
    # 1.3 GPa, 0.11 mm, nu = 0.2: sqrt(D Y) = 4.63 N
    plate, hardening = limits(WRINKLED, 1.2e-4)
    assert hardening == pytest.approx(2.974 * 4.634 / 0.028, rel=1e-3)
    assert plate == pytest.approx(2.3 * np.pi**2 * 1.502e-4 / 1.2e-4, rel=1e-3)
    tiny = limits(WRINKLED, 1e-9)
    assert tiny[0] == 1.5 * tiny[1]


@pytest.mark.parametrize(
    "strain", [(1e6, 1e6, 0.0), (1e6, -0.5, 0.0), (-0.5, -0.5, 0.0), (0.0, 0.0, 0.0), (1e3, -0.5, 700.0)]
)
def test_extreme_strains_have_finite_answers(strain: tuple[float, float, float]) -> None:
    for film in BY_POISSON.values():
        for area in (1e-12, AREA_M2, 10.0):
            density, n, c = answer(np.array(strain), film, area)
            assert np.isfinite(density)
            assert density >= 0.0
            assert np.isfinite(n).all()
            assert np.isfinite(c).all()


def test_principal_stress_is_that_of_the_law() -> None:
    stress = triangle().principal_stress(strained(STATES["wrinkled"]))[0] * FILM.thickness_m
    assert stress == pytest.approx(principal(answer(np.array(STATES["wrinkled"]))[1]), rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wrinkle_panel_m": 0.0}, "wrinkle_panel_m is 0"),
        ({"wrinkle_panel_m": float("inf")}, "wrinkle_panel_m is inf"),
        ({"wrinkle_panel_m": 0.02, "law": "plain"}, "the law is 'plain'"),
    ],
)
def test_wrong_panels_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(WRINKLED, **changes)


def test_a_mesh_without_panels_needs_their_width() -> None:
    film = replace(WRINKLED, wrinkle_panel_m=None)
    with pytest.raises(InputError, match="give wrinkle_panel_m"):
        triangle(film)
    stated = Membranes.from_shape(DRAWN, np.array([[0, 1, 2]]), film, np.array([PANEL_M]))
    x = strained(STATES["slack"])
    assert evaluation(stated, 3)(x)[0] == evaluation(triangle(), 3)(x)[0]
