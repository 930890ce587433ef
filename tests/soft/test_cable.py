"""Cables: derivatives, pairs of forces, losses, slack."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.soft.elements.cable import Cable, ROUNDED_m, add_segments
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors
from tests.soft.bodies import hexagon_arm, random_rotation, shapes

UNITS = 3
ROUTE = np.array([4, 1, 0, 3, 2])
TENSION = np.array([8.0, 5.0, 0.0, 2.0])


def evaluation(segments: IntArray, tension: Array, nodes: int) -> Evaluate:
    def add(x, slots, force, blocks):  # type: ignore[no-untyped-def]
        return add_segments(x, segments, tension, slots, force, blocks)

    return assembled(segments, add, nodes)


def eyelets(seed: int = 0) -> Array:
    return 0.03 * np.random.default_rng(seed).normal(size=(5, 3)) + (0.3, 0.0, 0.7)


@pytest.mark.parametrize("shape", ["random", "nearly flat", "inflated"])
def test_derivatives_of_every_segment(shape: str) -> None:
    x = shapes(UNITS)[shape]
    for cable in hexagon_arm(UNITS).cables:
        for near, far in cable.segments:
            for segment in (np.array([[0, 1]]), np.array([[1, 0]])):
                evaluate = evaluation(segment, np.array([7.0]), 2)
                # units of the drawn shape are 2 mm apart
                assert max(derivative_errors(evaluate, x[[near, far]], 2e-6)) < RELATIVE


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_of_a_routed_cable(seed: int) -> None:
    evaluate = evaluation(Cable(ROUTE).segments, TENSION, 5)
    assert max(derivative_errors(evaluate, eyelets(seed), 1e-5)) < RELATIVE


def test_a_segment_pulls_its_eyelets_together_with_its_tension() -> None:
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.03, 0.04]])
    energy, gradient, hessian = evaluation(np.array([[0, 1]]), np.array([2.0]), 2)(x)
    assert energy == pytest.approx(2.0 * 0.05)
    assert -gradient[0] == pytest.approx([0.0, 1.2, 1.6])
    assert -gradient[1] == pytest.approx([0.0, -1.2, -1.6])
    # across the segment a taut string has stiffness T / L, along it none: the tension is given
    assert hessian[:3, :3] @ [1.0, 0.0, 0.0] == pytest.approx([2.0 / 0.05, 0.0, 0.0])
    assert hessian[:3, :3] @ [0.0, 0.6, 0.8] == pytest.approx(np.zeros(3), abs=1e-13)


def test_pairs_of_forces_are_in_balance() -> None:
    x = eyelets()
    _, gradient, _ = evaluation(Cable(ROUTE).segments, TENSION, 5)(x)
    assert gradient.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-14)
    assert np.cross(x, gradient).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-14)
    turn = random_rotation(1)
    assert evaluation(Cable(ROUTE).segments, TENSION, 5)(x @ turn.T)[1] == pytest.approx(
        gradient @ turn.T, abs=1e-13
    )


def test_a_slack_cable_does_nothing_even_where_eyelets_meet() -> None:
    x = eyelets()
    x[1] = x[4]  # a segment without length has no direction
    energy, gradient, hessian = evaluation(Cable(ROUTE).segments, np.zeros(4), 5)(x)
    assert energy == 0.0
    assert not gradient.any()
    assert not hessian.any()


def test_loss_per_eyelet() -> None:
    ratio = Cable(ROUTE, loss_factor=0.8).tension_ratio(eyelets())
    assert ratio == pytest.approx([0.8, 0.64, 0.512, 0.4096], rel=1e-14)


@pytest.mark.parametrize("count", [2, 5, 40])
def test_capstan_loss_over_half_a_turn(count: int) -> None:
    # a straight run, half a turn in equal corners, a straight run back
    angle = np.pi / count * (np.arange(count + 1))
    heading = np.stack([np.cos(angle), np.sin(angle), np.zeros(count + 1)], axis=1)
    points = np.concatenate([[[0.0, 0.0, 0.0]], np.cumsum(0.01 * heading, axis=0)])
    cable = Cable(np.arange(len(points)), friction_coefficient=0.2)
    ratio = cable.tension_ratio(points @ random_rotation(9).T)
    assert ratio[0] == 1.0
    # the arc cosine of a half turn's corners loses digits as count grows
    assert ratio[0] / ratio[-1] == pytest.approx(1.8745, abs=5e-5)
    assert ratio[0] / ratio[-1] == pytest.approx(np.exp(0.2 * np.pi), rel=1e-9)
    assert (np.diff(ratio) < 0.0).all()


def test_both_losses_multiply() -> None:
    x = eyelets()
    both = Cable(ROUTE, 0.9, 0.3).tension_ratio(x)
    assert both == pytest.approx(Cable(ROUTE, 0.9).tension_ratio(x) * Cable(ROUTE, 1.0, 0.3).tension_ratio(x))


def test_length_of_the_route() -> None:
    points = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 12.0]])
    assert Cable(np.array([0, 1, 2])).length(points) == pytest.approx(17.0)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((np.array([3]),), "at least two"),
        ((np.array([3, 4, 3]),), "twice"),
        ((ROUTE, 0.0), r"loss factor 0\.0"),
        ((ROUTE, 1.1), r"loss factor 1\.1"),
        ((ROUTE, 1.0, -0.1), r"friction coefficient -0\.1"),
        ((ROUTE, 1.0, float("nan")), "friction coefficient nan"),
    ],
)
def test_wrong_cables_are_refused(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(InputError, match=text):
        Cable(*arguments)  # type: ignore[arg-type]


def at_distance(length: float) -> Array:
    way = np.array([0.36, -0.48, 0.8])
    return np.stack([np.array([0.3, 0.0, 0.7]), np.array([0.3, 0.0, 0.7]) + length * way])


@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_derivatives_where_eyelets_meet(share: float) -> None:
    evaluate = evaluation(np.array([[0, 1]]), np.array([2.0]), 2)
    assert max(derivative_errors(evaluate, at_distance(share * ROUNDED_m), 1e-7)) < RELATIVE


def test_rounding_joins_the_length_with_two_derivatives() -> None:
    evaluate, tiny = evaluation(np.array([[0, 1]]), np.array([2.0]), 2), 1e-6 * ROUNDED_m
    below, above = evaluate(at_distance(ROUNDED_m - tiny)), evaluate(at_distance(ROUNDED_m + tiny))
    assert above[0] - below[0] == pytest.approx(2.0 * 2.0 * tiny, rel=1e-5)
    assert below[1] == pytest.approx(above[1], abs=1e-9)
    # the third derivative is 3 T / e^2: over 2e-6 e a change of 6e-6 T / e
    assert below[2] == pytest.approx(above[2], abs=1e-5 * 2.0 / ROUNDED_m)
    cable = Cable(np.array([0, 1]))
    for share in (0.5, 1.5):
        assert cable.length(at_distance(share * ROUNDED_m)) == pytest.approx(
            evaluate(at_distance(share * ROUNDED_m))[0] / 2.0, rel=1e-12
        )


def test_eyelets_that_meet_are_in_balance() -> None:
    energy, gradient, hessian = evaluation(np.array([[0, 1]]), np.array([2.0]), 2)(at_distance(0.0))
    assert np.isfinite(energy)
    assert not gradient.any()
    assert np.linalg.eigvalsh(hessian[:3, :3]).min() == pytest.approx(1.5 * 2.0 / ROUNDED_m)
    assert np.isfinite(
        Cable(np.array([0, 1, 2]), friction_coefficient=0.3).tension_ratio(np.zeros((3, 3)))
    ).all()
