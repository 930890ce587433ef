"""Negative pivots count the ways down; the search for lower states takes one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cosim.soft.body import Loads
from cosim.soft.equilibrium import Equilibrium
from cosim.soft.stability import PerturbationOptions, find_lower_state, negative_pivots
from cosim.verification.specimen import UNLOADED, Specimen
from cosim.verification.strip import Strip

STRIP = Strip(12)
EULER_N = math.pi**2 * STRIP.bending_stiffness / (4.0 * STRIP.length_m**2)


def pushed(load_N: float) -> Loads:
    """Return an axial push at the tip."""
    return replace(UNLOADED, nodal_force=STRIP.tip_force((-load_N, 0.0, 0.0)))


def straight(share: float) -> tuple[Specimen, Equilibrium]:
    """Return the straight equilibrium at a share of Euler's load."""
    specimen = STRIP.specimen()
    return specimen, specimen.solve(specimen.drawn(), pushed(share * EULER_N))


# the n-th buckling load of a clamped-free column is (2 n - 1)^2 times the first
@pytest.mark.parametrize(("share", "ways_down"), [(0.9, 0), (1.2, 1), (8.0, 1), (10.5, 2), (30.0, 3)])
def test_each_buckling_load_passed_adds_a_negative_pivot(share: float, ways_down: int) -> None:
    specimen, here = straight(share)
    assert negative_pivots(specimen.newton, here) == ways_down


def test_a_pushed_strip_is_found_to_buckle() -> None:
    specimen, here = straight(1.5)
    found = find_lower_state(specimen.equilibria, here, PerturbationOptions(1e-3, 2))
    assert found.potential_J < here.potential_J
    assert negative_pivots(specimen.newton, found) == 0
    assert abs(STRIP.deflection(found.state.positions)[1]) > 0.3 * STRIP.length_m


def test_a_minimum_is_kept() -> None:
    specimen, here = straight(0.5)
    found = find_lower_state(specimen.equilibria, here, PerturbationOptions(1e-3, 2))
    # perturbed and solved again, the same state comes back: nothing lower than rounding allows
    assert found.potential_J == pytest.approx(here.potential_J, rel=1e-9)
    assert found.state.positions == pytest.approx(np.array(here.state.positions), abs=1e-6)
