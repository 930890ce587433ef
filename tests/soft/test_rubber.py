"""Incompressible rubber: derivatives, a strip pulled, small strain, convexity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.soft.elements.material import Film
from tests.derivatives import RELATIVE, derivative_errors
from tests.soft.test_film_laws import STATES, evaluation, one_triangle, strained

RUBBER = Film(1e6, 0.5, 5e-4, "neo_hookean")
STIFFENING = replace(RUBBER, stiffening=0.05)
FAR = {"drawn out": (1.5, -0.2, 0.1), "blown up": (2.0, 3.0, -0.5), "crushed": (-0.4, -0.3, 0.1)}
SHEAR_N_m = 1e6 * 5e-4 / 3.0


@pytest.mark.parametrize("film", [RUBBER, STIFFENING])
@pytest.mark.parametrize("strain", [*STATES.values(), *FAR.values()])
def test_derivatives(film: Film, strain: tuple[float, float, float]) -> None:
    errors = derivative_errors(evaluation(one_triangle(film), 3), strained(strain), 2e-6)
    assert max(errors) < 10.0 * RELATIVE


@pytest.mark.parametrize("stretch", [0.7, 1.2, 2.0, 4.0])
def test_a_strip_is_pulled_as_rubber_is(stretch: float) -> None:
    # its width and thickness shrink with the root: energy mu (l^2 + 2 / l - 3) / 2, stress mu (1 - l^-3)
    x, film = strained((0.5 * (stretch**2 - 1.0), 0.5 * (1.0 / stretch - 1.0), 0.0)), one_triangle(RUBBER)
    density = evaluation(film, 3)(x)[0] / film.areas[0]
    assert density == pytest.approx(0.5 * SHEAR_N_m * (stretch**2 + 2.0 / stretch - 3.0), rel=1e-9)
    stress = RUBBER.thickness_m * np.sort(film.principal_stress(x)[0])
    assert stress == pytest.approx(sorted((0.0, SHEAR_N_m * (1.0 - stretch**-3.0))), abs=1e-9 * SHEAR_N_m)


@pytest.mark.parametrize("stretch", [0.7, 1.2, 2.0, 4.0])
def test_a_strip_that_stiffens_is_pulled_as_by_yeohs_law(stretch: float) -> None:
    # energy mu (i + c i^2) / 2 with i = l^2 + 2 / l - 3, its derivative by l over l is the stress
    x, film = strained((0.5 * (stretch**2 - 1.0), 0.5 * (1.0 / stretch - 1.0), 0.0)), one_triangle(STIFFENING)
    i = stretch**2 + 2.0 / stretch - 3.0
    density = evaluation(film, 3)(x)[0] / film.areas[0]
    assert density == pytest.approx(0.5 * SHEAR_N_m * (i + 0.05 * i**2), rel=1e-9)
    expected = SHEAR_N_m * (1.0 + 0.1 * i) * (1.0 - stretch**-3.0)
    stress = RUBBER.thickness_m * np.sort(film.principal_stress(x)[0])
    assert stress == pytest.approx(sorted((0.0, expected)), abs=1e-9 * SHEAR_N_m * (1.0 + 0.1 * i))


def test_only_rubber_stiffens() -> None:
    with pytest.raises(InputError, match="stiffening goes with law 'neo_hookean'"):
        Film(1e6, 0.3, 5e-4, stiffening=0.1)


def test_at_small_strain_it_is_the_plain_law() -> None:
    x = strained((1e-6, -2e-6, 1e-6))
    plain, rubber = (evaluation(one_triangle(film), 3)(x) for film in (replace(RUBBER, law="plain"), RUBBER))
    assert rubber[1] == pytest.approx(plain[1], abs=2e-5 * np.abs(plain[1]).max())
    assert rubber[2] == pytest.approx(plain[2], abs=2e-5 * np.abs(plain[2]).max())


def test_a_compressible_one_is_refused() -> None:
    with pytest.raises(InputError, match="has poisson_ratio 0"):
        replace(RUBBER, poisson_ratio=0.49)
