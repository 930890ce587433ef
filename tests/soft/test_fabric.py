"""Woven film: derivatives, closed forms along and across its yarns, its tension field, wrong constants."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.build.soft_body import build_film, build_soft_body
from cosim.config.loading import load_soft_robot
from cosim.config.schema.settings import ModelTable
from cosim.errors import InputError, MeshError
from cosim.soft.body.body import stored_energy
from cosim.soft.elements.fabric import Fabric
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.elements.membrane import Membranes
from tests.derivatives import RELATIVE, derivative_errors
from tests.soft.bodies import FILM, hexagon_arm, random_rotation, shapes
from tests.soft.test_film_laws import DRAWN, STATES, evaluation, strained

WARP_Pa, WEFT_Pa, SHEAR_Pa, NU, THICKNESS_m = 0.9e9, 0.5e9, 0.08e9, 0.25, 2e-4
X = (1.0, 0.0, 0.0)
LAWS: tuple[FilmLaw, FilmLaw] = ("plain", "tension_field")
WOVEN = Film(WARP_Pa, NU, THICKNESS_m, fabric=Fabric(WEFT_Pa, SHEAR_Pa, X, (WARP_Pa, WEFT_Pa)))
STRAIGHTENED = replace(
    WOVEN, fabric=Fabric(WEFT_Pa, SHEAR_Pa, X, (4.0 * WARP_Pa, 2.0 * WEFT_Pa), (0.004, 0.03))
)
FILMS = {
    f"{name}, {law}": replace(film, law=law)
    for name, film in (("woven", WOVEN), ("straightening", STRAIGHTENED))
    for law in LAWS
}
FILMS["straightening, buckling"] = replace(STRAIGHTENED, law="tension_field", buckling_force_N_m=400.0)
SKEW = (0.3, 0.5, 0.2)
COMPLIANCE = np.array([
    [1.0 / WARP_Pa, -NU / WARP_Pa, 0.0], [-NU / WARP_Pa, 1.0 / WEFT_Pa, 0.0], [0.0, 0.0, 1.0 / SHEAR_Pa]
]) / THICKNESS_m  # fmt: skip


def triangle(film: Film, warp: tuple[float, float, float] = X) -> Membranes:
    return Membranes.from_shape(DRAWN, np.array([[0, 1, 2]]), turned_film(film, warp))


def turned_film(film: Film, warp: tuple[float, float, float]) -> Film:
    assert film.fabric is not None
    return replace(film, fabric=replace(film.fabric, warp_direction=warp))


def forces(membranes: Membranes, strain: Array) -> tuple[float, Array]:
    """Return the density [J/m^2] and N (3,) [N/m] along x and y at a strain there, by the nodes' forces."""
    x = strained((strain[0], strain[1], strain[2]))
    energy, gradient, _ = evaluation(membranes, 3)(x)
    edges = np.stack([(DRAWN[1] - DRAWN[0])[:2], (DRAWN[2] - DRAWN[0])[:2]])
    f = np.linalg.solve(edges, np.stack([x[1] - x[0], x[2] - x[0]]))  # F^T
    force = np.linalg.lstsq(f.T, (edges.T @ gradient[1:]).T, rcond=None)[0] / membranes.areas[0]
    return energy / membranes.areas[0], np.array([force[0, 0], force[1, 1], force[0, 1]])


def turned(force: Array, angle: float) -> Array:
    """Return (N11, N22, N12), or half strains, in axes turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    n = turn @ np.array([[force[0], force[2]], [force[2], force[1]]]) @ turn.T
    return np.array([n[0, 0], n[1, 1], n[0, 1]])


def test_the_bending_stiffness_does_not_depend_on_which_direction_is_called_the_warp() -> None:
    other = Fabric(WARP_Pa, SHEAR_Pa, X, (WEFT_Pa, WARP_Pa))
    renamed = Film(WEFT_Pa, NU * WEFT_Pa / WARP_Pa, THICKNESS_m, fabric=other)
    assert renamed.flexural_rigidity_Nm == pytest.approx(WOVEN.flexural_rigidity_Nm, rel=1e-12)
    across = np.linalg.inv(COMPLIANCE * THICKNESS_m)[:2, :2] * THICKNESS_m**3 / 12.0
    mean = np.sqrt(across[0, 0] * across[1, 1])  # of the plate's stiffness along warp and weft
    assert WOVEN.flexural_rigidity_Nm == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("state", STATES)
def test_derivatives_in_every_state(film: str, state: str) -> None:
    errors = derivative_errors(evaluation(triangle(FILMS[film], SKEW), 3), strained(STATES[state]), 5e-7)
    assert max(errors) < 10.0 * RELATIVE


@pytest.mark.parametrize("film", FILMS)
def test_derivatives_and_balance_of_a_body(film: str) -> None:
    body, x = hexagon_arm(1), shapes(1)["random"]
    membranes = Membranes.from_shape(body.positions, body.triangles, turned_film(FILMS[film], SKEW))
    evaluate, turn = evaluation(membranes, body.nodes), random_rotation(2)
    assert max(derivative_errors(evaluate, x, 5e-7)) < RELATIVE
    energy, gradient, _ = evaluate(x)
    again = np.zeros_like(x)
    assert membranes.add(x, np.zeros((0, 0), np.int64), again, np.zeros((1, 3, 3))) == pytest.approx(energy)
    assert again == pytest.approx(gradient, abs=1e-12 * np.abs(gradient).max())
    assert evaluate(x @ turn.T)[1] == pytest.approx(gradient @ turn.T, abs=1e-9 * np.abs(gradient).max())
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-13 * np.abs(gradient).sum() * np.abs(x).max()


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 0.25 * np.pi, 0.6])
@pytest.mark.parametrize("law", LAWS)
def test_pulled_along_one_direction_it_stretches_as_orthotropic_plane_stress(
    angle: float, law: FilmLaw
) -> None:
    # 1 / E(angle) = c^4 / E1 + s^4 / E2 + (1 / G - 2 nu / E1) c^2 s^2
    c, s = np.cos(angle), np.sin(angle)
    along = c**4 / WARP_Pa + s**4 / WEFT_Pa + (1.0 / SHEAR_Pa - 2.0 * NU / WARP_Pa) * c**2 * s**2
    tension = 40.0
    strain = COMPLIANCE @ (tension * np.array([c * c, s * s, c * s]))
    warp = (float(c), -float(s), 0.0)  # the pull is along x, at the angle from the warp
    half = turned(strain * (1.0, 1.0, 0.5), angle)
    assert half[0] == pytest.approx(tension * along / THICKNESS_m)
    slack = 0.0 if law == "plain" else 0.05  # narrower by wrinkles that no force opposes
    density, n = forces(triangle(replace(WOVEN, law=law), warp), half * (1.0, 1.0, 2.0) - (0.0, slack, 0.0))
    assert n == pytest.approx([tension, 0.0, 0.0], abs=1e-9 * tension)
    assert density == pytest.approx(0.5 * tension**2 * along / THICKNESS_m, rel=1e-9)


def test_yarns_straighten_as_stated() -> None:
    assert STRAIGHTENED.fabric is not None
    free = replace(STRAIGHTENED, poisson_ratio=0.0)
    for k, drawn in enumerate((WARP_Pa, WEFT_Pa)):
        end, straight = STRAIGHTENED.fabric.straight_strain[k], STRAIGHTENED.fabric.straight_modulus_Pa[k]
        for share in (-0.5, 0.2, 0.7, 1.0, 2.5):
            strain, e = np.zeros(3), max(share * end, 0.0)
            strain[k] = share * end
            grown = (straight - drawn) * (e**2 / (2.0 * end) if share < 1.0 else e - 0.5 * end)
            _, n = forces(triangle(free), strain)
            assert n[k] == pytest.approx(THICKNESS_m * (drawn * strain[k] + grown), rel=1e-9)


def test_of_equal_directions_it_is_the_isotropic_film() -> None:
    shear, young = 0.5 * FILM.young_modulus_Pa / (1.0 + FILM.poisson_ratio), FILM.young_modulus_Pa
    body, x = hexagon_arm(1), shapes(1)["random"]
    for law in LAWS:
        film = replace(FILM, law=law)
        woven = replace(film, fabric=Fabric(young, shear, SKEW, (young, young)))
        one, other = (
            evaluation(Membranes.from_shape(body.positions, body.triangles, each), body.nodes)(x)
            for each in (film, woven)
        )
        for a, b in zip(one, other, strict=True):
            assert b == pytest.approx(a, rel=1e-9, abs=1e-9 * float(np.abs(np.asarray(a)).max()))


def test_the_tension_field_is_the_largest_of_all_pulls_without_compression() -> None:
    # psi = max over N without compression of N : E - N : S : N / 2; of single threads that is
    # <a : E>^2 / (2 a : S : a), a the square of their direction
    angle = np.linspace(0.0, np.pi, 20001)
    a = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.cos(angle) * np.sin(angle)], axis=1)
    random, wrinkled = np.random.default_rng(3), 0
    membranes = triangle(replace(WOVEN, law="tension_field"))
    for strain in random.normal(size=(200, 3)) * (0.01, 0.01, 0.03):
        pull = np.maximum(a @ strain, 0.0)
        threads = (pull**2 / (2.0 * np.einsum("ai,ij,aj->a", a, COMPLIANCE, a))).max()
        density, n = forces(membranes, strain)
        assert density >= threads * (1.0 - 1e-9)
        if n[0] * n[1] - n[2] ** 2 < 1e-6 * (n[0] + n[1]) ** 2:
            wrinkled += 1
            assert density == pytest.approx(threads, rel=1e-6, abs=1e-9)
    assert 50 < wrinkled < 190


def test_forces_and_energy_stay_convex_and_without_compression() -> None:
    random = np.random.default_rng(8)
    membranes = triangle(FILMS["straightening, tension_field"], SKEW)
    for scale in (1e-6, 1e-3, 0.03, 0.1):
        for strain in random.normal(size=(100, 3)) * scale:
            x = strained(tuple(np.clip(strain, -0.25, 0.25)))
            values = np.linalg.eigvalsh(evaluation(membranes, 3)(x)[2])
            assert np.isfinite(values).all()
            assert values[0] >= -1e-11 * max(values[-1], 1e-30)
            stress = membranes.principal_stress(x)[0]
            assert stress[1] >= -1e-10 * max(stress[0], 1e-30)


def test_a_robots_file_lays_the_warp_along_its_boom() -> None:
    # pulled along its axis alone: psi = t (C11 e^2 / 2 + (H - E) e^3 / (6 s)), e the Green strain
    robot = load_soft_robot("fabric_boom")
    assert robot.film.fabric is not None
    fabric = replace(robot.film.fabric, modulus_weft_Pa=1e8)
    soft = replace(robot.film, fabric=fabric)
    body = build_soft_body(replace(robot, film=soft), ModelTable())
    nu, e = soft.poisson_ratio, 0.5 * (1.003**2 - 1.0)
    across = fabric.modulus_warp_Pa / (1.0 - nu**2 * fabric.modulus_weft_Pa / fabric.modulus_warp_Pa)
    grown = fabric.straight_modulus_Pa[0] - fabric.modulus_warp_Pa
    density = 0.5 * across * e**2 + grown * e**3 / (6.0 * fabric.straight_strain_warp)
    stored = stored_energy(body, body.positions * (1.0, 1.0, 1.003))[Membranes]
    assert stored == pytest.approx(soft.thickness_m * density * float(body.areas.sum()), rel=1e-6)
    assert build_film(replace(soft, buckling_force_N_m=50.0)).buckling_force_N_m == 50.0


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "weft": ({"modulus_weft_Pa": 0.0}, "not positive"),
    "shear": ({"shear_modulus_Pa": np.inf}, "not positive"),
    "strain": ({"straight_strain": (0.0, 0.1)}, "not positive"),
    "direction": ({"warp_direction": (0.0, 0.0, 0.0)}, "must have a length"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_constants_are_refused(case: str) -> None:
    changes, message = WRONG[case]
    assert WOVEN.fabric is not None
    with pytest.raises(InputError, match=message):
        replace(WOVEN.fabric, **changes)


def test_what_does_not_go_with_fabric_is_refused() -> None:
    with pytest.raises(InputError, match="the law is 'edge_strain'"):
        replace(WOVEN, law="edge_strain")
    with pytest.raises(InputError, match="its square must be less than"):
        replace(WOVEN, young_modulus_Pa=0.01e9)
    with pytest.raises(InputError, match="no softer"):
        replace(WOVEN, fabric=Fabric(WEFT_Pa, SHEAR_Pa, X, (WARP_Pa, 0.5 * WEFT_Pa)))
    with pytest.raises(MeshError, match="is normal to 1 of 1 film triangles"):
        triangle(WOVEN, (0.0, 0.0, 1.0))
