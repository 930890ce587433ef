"""Film laws beyond the plain one: derivatives, invariance, balance, closed forms, limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors
from tests.soft.bodies import FILM, hexagon_arm, random_rotation, shapes

UNITS = 2
STEP_M = 5e-7
"""Of edges of 5 mm; a state change within two steps would spoil the differences, so steps are short."""
LAWS: dict[str, dict[str, Any]] = {
    "tension field": {"law": "tension_field"},
    "with compression": {"law": "tension_field", "compressive_fraction": 0.05},
    "with a buckling force": {
        "law": "tension_field", "compressive_fraction": 0.05, "buckling_force_N_m": 800.0,
    },
    "edge strain": {"law": "edge_strain"},
}  # fmt: skip
STATES = {
    "taut": (0.010, 0.004, 0.003),
    "taut, equal": (0.006, 0.006, 0.0),
    "taut, nearly equal": (0.006, 0.006, 1e-9),
    "wrinkled": (0.010, -0.020, 0.005),
    "wrinkled, barely": (4e-4, -0.030, 0.001),
    "slack": (-0.010, -0.020, 0.004),
    "slack, equal": (-0.010, -0.010, 0.0),
    "slack, packed": (-0.420, -0.020, 0.010),
}
DRAWN = np.array([[0.0, 0.0, 0.0], [0.012, 0.001, 0.0], [0.004, 0.009, 0.0]])


def film(law: str, poisson_ratio: float = FILM.poisson_ratio) -> Film:
    return replace(FILM, poisson_ratio=poisson_ratio, **LAWS[law])


def with_law(membranes: Membranes, law: str) -> Membranes:
    return replace(membranes, film=film(law))


def evaluation(membranes: Membranes, nodes: int) -> Evaluate:
    return assembled(membranes.triangles, membranes.add, nodes)


def strained(strain: tuple[float, float, float]) -> Array:
    """Return the triangle DRAWN under a Green strain (E11, E22, 2 E12) in the axes x and y, put askew."""
    e11, e22, e12 = strain
    values, axes = np.linalg.eigh(np.array([[1.0 + 2.0 * e11, e12], [e12, 1.0 + 2.0 * e22]]))
    stretch = axes * np.sqrt(values) @ axes.T
    return np.ascontiguousarray(DRAWN[:, :2] @ stretch @ random_rotation(6)[:2])


def one_triangle(material: Film) -> Membranes:
    return Membranes.from_shape(DRAWN, np.array([[0, 1, 2]]), material)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("poisson_ratio", [0.2, 0.45, 0.0, -0.4])
def test_derivatives_in_every_state(law: str, state: str, poisson_ratio: float) -> None:
    membranes, x = one_triangle(film(law, poisson_ratio)), strained(STATES[state])
    # rounding of edges of 1 cm, 1e-18 m, over the step
    assert max(derivative_errors(evaluation(membranes, 3), x, STEP_M)) < 10.0 * RELATIVE


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_of_a_body(law: str) -> None:
    body, x = hexagon_arm(1), shapes(1)["random"]
    evaluate = evaluation(with_law(body.membranes[0], law), body.nodes)
    assert max(derivative_errors(evaluate, x, STEP_M)) < RELATIVE


@pytest.mark.parametrize("law", LAWS)
def test_rigid_motion_and_balance(law: str) -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    membranes, turn = with_law(body.membranes[0], law), random_rotation(2)
    evaluate = evaluation(membranes, body.nodes)
    energy, gradient, _ = evaluate(x)
    turned_energy, turned_gradient, _ = evaluate(x @ turn.T + (1.0, -2.0, 0.5))
    # moving by metres costs digits of strains of 1e-2 on edges of 1e-2 m
    assert turned_energy == pytest.approx(energy, rel=1e-10)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-10 * np.abs(gradient).max())
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-14 * size
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-14 * size * np.abs(x).max()


@pytest.mark.parametrize("law", LAWS)
def test_without_slots_the_gradient_is_the_same(law: str) -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    membranes = with_law(body.membranes[0], law)
    energy, gradient, _ = evaluation(membranes, body.nodes)(x)
    force, blocks = np.zeros_like(x), np.zeros((1, 3, 3))
    assert membranes.add(x, np.zeros((0, 0), np.int64), force, blocks) == energy
    assert (force == gradient).all()
    assert not blocks.any()


def pulls(x: Array) -> int:
    """Return in how many directions a film pulls that bears no compression."""
    return int((one_triangle(film("tension field")).principal_stress(x) > 0.0).sum())


@pytest.mark.parametrize("state", STATES)
def test_states_are_told_apart(state: str) -> None:
    expected = {"taut": 2, "wrinkled": 1, "slack": 0}[state.split(",")[0]]
    assert pulls(strained(STATES[state])) == expected


@pytest.mark.parametrize("angle", np.linspace(0.0, np.pi, 7))
def test_a_wrinkled_film_is_a_bundle_of_threads(angle: float) -> None:
    # Threads along u with strain e: W = E t A e^2 / 2, whatever the strain across (below -nu e).
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    first, area = 0.004, 0.5 * (0.012 * 0.009 - 0.001 * 0.004)
    for second in (-0.001, -0.02, -0.2):
        e = first * np.outer(along, along) + second * np.outer(across, across)
        x = strained((e[0, 0], e[1, 1], 2.0 * e[0, 1]))
        membranes = one_triangle(film("tension field"))
        energy, _, _ = evaluation(membranes, 3)(x)
        young_t = FILM.young_modulus_Pa * FILM.thickness_m
        assert energy == pytest.approx(0.5 * young_t * area * first**2, rel=1e-10)
        tension, compression = membranes.principal_stress(x)[0]
        assert tension == pytest.approx(FILM.young_modulus_Pa * first, rel=1e-10)
        assert compression == pytest.approx(0.0, abs=1e-9 * tension)


@pytest.mark.parametrize("strain", [(0.01, -0.0019, 0.0), (0.004, 0.01, 0.003), (0.006, 0.006, 0.0)])
def test_a_taut_film_is_the_plain_one(strain: tuple[float, float, float]) -> None:
    x = strained(strain)  # the first is taut by a narrow margin: e2 > -nu e1 = -0.002
    relaxed, plain = evaluation(one_triangle(film("tension field")), 3), evaluation(one_triangle(FILM), 3)
    for a, b in zip(relaxed(x), plain(x), strict=True):
        assert a == pytest.approx(b, rel=1e-13, abs=1e-13 * float(np.abs(b).max()))


def test_slack_film_is_free() -> None:
    membranes = one_triangle(film("tension field"))
    energy, gradient, hessian = evaluation(membranes, 3)(strained(STATES["slack"]))
    assert energy == 0.0
    assert not gradient.any()
    assert not hessian.any()
    assert not membranes.principal_stress(strained(STATES["slack"])).any()


@pytest.mark.parametrize(
    "border", [(0.01, -0.002), (0.0, -0.01)], ids=["taut to wrinkled", "wrinkled to slack"]
)
def test_forces_are_continuous_where_the_state_changes(border: tuple[float, float]) -> None:
    membranes = one_triangle(film("tension field"))
    forces, energies, states = [], [], []
    for offset in (-1e-9, 1e-9):
        x = strained((border[0] + offset, border[1] + offset, 0.0))
        energy, gradient, _ = evaluation(membranes, 3)(x)
        energies.append(energy)
        forces.append(gradient)
        states.append(pulls(x))
    assert states[0] < states[1]
    young_t = FILM.young_modulus_Pa * FILM.thickness_m
    # a change of strain by 2e-9 may change forces by E t 2e-9 times an edge of 12 mm
    assert np.abs(forces[1] - forces[0]).max() < 4e-9 * young_t * 0.012
    assert abs(energies[1] - energies[0]) < 4e-9 * young_t * 0.01 * 6e-5


def test_the_relaxed_energy_is_convex_and_below_the_plain_one() -> None:
    # Positive semi-definite blocks on the strain, seen on the whole Hessian: without compression no direction
    # of the nodes softens a film.
    random = np.random.default_rng(7)
    relaxed, plain = one_triangle(film("tension field")), one_triangle(FILM)
    for _ in range(200):
        x = strained(tuple(0.02 * random.normal(size=3)))
        energy, _, hessian = evaluation(relaxed, 3)(x)
        assert energy <= evaluation(plain, 3)(x)[0] * (1.0 + 1e-12)
        values = np.linalg.eigvalsh(hessian)
        assert values[0] >= -1e-12 * max(values[-1], 1e-30)


def test_the_compressive_fraction_mixes_two_laws() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)

    def evaluate(**changes: Any) -> tuple[float, Array, Array]:
        membranes = replace(body.membranes[0], film=replace(FILM, **changes))
        return evaluation(membranes, body.nodes)(x)

    none, some, plain = (
        evaluate(law="tension_field"),
        evaluate(law="tension_field", compressive_fraction=0.3),
        evaluate(law="plain"),
    )
    whole = evaluate(law="tension_field", compressive_fraction=1.0)
    for a, b, c, d in zip(none, some, plain, whole, strict=True):
        size = np.abs(c).max()
        assert b == pytest.approx(0.7 * a + 0.3 * c, abs=1e-13 * size)
        assert d == pytest.approx(c, abs=1e-13 * size)


@pytest.mark.parametrize("state", ["wrinkled", "slack"])
def test_a_buckling_force_is_all_that_compression_meets(state: str) -> None:
    # Under 800 N/m the film is the plain one; beyond, what it bears across its wrinkles is 800 N/m.
    force = 800.0
    buckling = replace(FILM, law="tension_field", buckling_force_N_m=force)
    strain, softer = np.array(STATES[state]), 0.9 * force / (FILM.young_modulus_Pa * FILM.thickness_m)
    least = one_triangle(buckling).principal_stress(strained(tuple(strain)))[0, 1]
    assert FILM.thickness_m * least == pytest.approx(-force, rel=1e-12)
    x = strained((0.3 * softer * FILM.poisson_ratio, -softer, 0.0))
    found, plain = evaluation(one_triangle(buckling), 3)(x), evaluation(one_triangle(FILM), 3)(x)
    for a, b in zip(found, plain, strict=True):
        assert a == pytest.approx(b, abs=1e-9 * np.abs(b).max())


def test_edge_strains_are_those_of_bars() -> None:
    # A triangle stretched so that each edge has a strain of its own; energy by the definition.
    x = np.array([[0.0, 0.0, 0.0], [0.0124, 0.0005, 0.001], [0.004, 0.0091, -0.002]])
    rows, strains = [], []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        edge = (DRAWN[b] - DRAWN[a])[:2]
        length = np.linalg.norm(edge)
        d = edge / length
        rows.append((d[0] ** 2, d[1] ** 2, d[0] * d[1]))
        strains.append(np.linalg.norm(x[b] - x[a]) / length - 1.0)
    e = np.linalg.solve(np.array(rows), np.array(strains))
    area = 0.5 * (0.012 * 0.009 - 0.001 * 0.004)
    membranes = one_triangle(film("edge strain"))
    energy, _, _ = evaluation(membranes, 3)(x)
    assert energy == pytest.approx(0.5 * area * e @ FILM.membrane_stiffness @ e, rel=1e-12)


def test_edge_strain_is_the_plain_law_at_small_strain() -> None:
    x = strained((1e-6, -2e-6, 1e-6))
    plain, bars = evaluation(one_triangle(FILM), 3)(x), evaluation(one_triangle(film("edge strain")), 3)(x)
    assert bars[0] == pytest.approx(plain[0], rel=1e-5)
    assert bars[1] == pytest.approx(plain[1], abs=1e-5 * np.abs(plain[1]).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("state", ["taut", "wrinkled"])
def test_principal_stress_does_the_work(law: str, state: str) -> None:
    # dW = A t S : dE along a proportional change of the strain, by principal values where S, E are coaxial.
    membranes, strain = one_triangle(film(law)), np.array(STATES[state])
    step = 1e-5
    ahead, behind = (evaluation(membranes, 3)(strained(tuple(strain * (1.0 + s))))[0] for s in (step, -step))
    work = (ahead - behind) / (2.0 * step)
    mean, half = 0.5 * (strain[0] + strain[1]), 0.5 * (strain[0] - strain[1])
    radius = np.hypot(half, 0.5 * strain[2])
    s1, s2 = membranes.principal_stress(strained(STATES[state]))[0]
    expected = membranes.areas[0] * FILM.thickness_m * (s1 * (mean + radius) + s2 * (mean - radius))
    # edge strains are not isotropic: their stress is off the strain's axes by the strain itself
    assert work == pytest.approx(expected, rel=1e-6 if law != "edge strain" else 0.03)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"law": "tension"}, "'tension' is unknown; there are plain, tension_field, edge_strain"),
        ({"law": "tension_field", "compressive_fraction": 1.5}, "compressive_fraction is 1.5"),
        ({"law": "tension_field", "compressive_fraction": float("nan")}, "compressive_fraction is nan"),
        ({"compressive_fraction": 0.1}, "the law is 'plain'"),
        ({"law": "tension_field", "buckling_force_N_m": -1.0}, "buckling_force_N_m is -1.0"),
        ({"law": "tension_field", "buckling_force_N_m": float("nan")}, "buckling_force_N_m is nan"),
        ({"buckling_force_N_m": 10.0}, "the law is 'plain'"),
    ],
)
def test_wrong_laws_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(FILM, **changes)
