"""Tensions for heights that lie behind a valley, a snap or the end of all equilibria."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, UnreachableError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.elements.cable import Cable
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.solve.tension_search import find_tensions
from cosim.soft.solve.tip_target import TipTarget
from tests.soft.bodies import HANGING, hexagon_arm, no_load


@dataclass(frozen=True)
class Slope:
    """How the tip of a `Lift` moves."""

    tip: TipFrame
    slope: float

    def to_gravity(self) -> Array:
        return np.zeros((6, 3))

    def to_tension(self) -> Array:
        return np.array([[0.0], [0.0], [self.slope], [0.0], [0.0], [0.0]])


@dataclass(frozen=True)
class Lift:
    """A body with one cable, lifted as a whole by a given height [m] over tension [N]."""

    height: Callable[[float], float]
    body: SoftBody
    lost_at_N: float = np.inf
    slides_at_N: float = np.inf
    iterations: int = 0
    tried: list[float] = field(default_factory=list)

    def begin(self) -> Equilibrium:
        x = self.body.positions + HANGING.translation
        loads = no_load(self.body)
        start = Equilibrium(SoftState.at_rest(x, np.zeros(0)), HANGING, loads, np.zeros(6), 0.0, 0, 0.0, 0)  # type: ignore[arg-type]
        return self.follow(start, HANGING, loads)

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        (tension,) = loads.cable_tension_N
        self.tried.append(tension)
        if tension > self.lost_at_N:
            raise ConvergenceError("no equilibrium found", 1.0, 1)
        x = self.body.positions + HANGING.translation
        x[:, 2] += self.height(tension) - float(x[self.body.tip, 2].mean())
        slides = int(begin.loads.cable_tension_N[0] <= self.slides_at_N < tension)
        return replace(
            begin,
            state=SoftState.at_rest(x, np.zeros(0)),
            loads=loads,
            slides=slides,
            iterations=self.iterations,
        )

    def sensitivity(self, here: Equilibrium) -> Slope:
        (tension,) = here.loads.cable_tension_N
        slope = (self.height(tension + 1e-6) - self.height(tension)) / 1e-6
        return Slope(TipFrame.of(self.body, here.state.positions), slope)


@pytest.fixture(scope="module")
def body() -> SoftBody:
    arm = hexagon_arm(2)
    return arm.with_other(Cable, arm.cables[0])


def test_a_height_behind_a_valley_is_found(body: SoftBody) -> None:
    # the slope at no tension says: push; a cable cannot
    lift = Lift(lambda tension: 0.5 - 0.002 * tension + 0.0005 * tension**2, body)
    found = find_tensions(lift, lift.begin(), TipTarget(height=0.52))
    assert found.position_error_m <= 1e-5
    assert found.equilibrium.loads.cable_tension_N[0] == pytest.approx(2.0 + 44.0**0.5, abs=0.01)


def test_a_height_on_a_steepening_curve_is_found_without_being_overrun(body: SoftBody) -> None:
    # a full step from no tension goes to 10 N, where nothing stands
    lift = Lift(lambda tension: 0.5 + 0.002 * tension + 1e-5 * tension**4, body, lost_at_N=9.0)
    found = find_tensions(lift, lift.begin(), TipTarget(height=0.5 + 0.012 + 0.01296))
    assert found.equilibrium.loads.cable_tension_N[0] == pytest.approx(6.0, abs=0.01)


def test_a_snap_over_the_height_is_named_with_its_tension(body: SoftBody) -> None:
    lift = Lift(lambda tension: 0.5 + 0.002 * tension + 0.05 * (tension > 5.0), body)
    with pytest.raises(UnreachableError, match=r"snap from 0\.5100 to 0\.5600 m at \[5\.0\] N") as caught:
        find_tensions(lift, lift.begin(), TipTarget(height=0.53))
    assert caught.value.closest.position_error_m == pytest.approx(0.02, abs=0.001)


def test_a_snap_that_the_equilibrium_names_is_not_approached_in_short_steps(body: SoftBody) -> None:
    tried = []
    for slides_at_N in (np.inf, 5.0):
        lift = Lift(lambda tension: 0.5 + 0.05 * (tension > 5.0), body, slides_at_N=slides_at_N)
        with pytest.raises(UnreachableError, match=r"from 0\.5000 m at .* to 0\.5500 m at"):
            find_tensions(lift, lift.begin(), TipTarget(height=0.6))
        tried.append(len(lift.tried))
    assert tried[1] <= tried[0] - 3


def test_a_limp_arm_is_given_up_after_a_bounded_effort(body: SoftBody) -> None:
    lift = Lift(lambda _tension: 0.5, body, iterations=250)
    with pytest.raises(UnreachableError, match=r"this pull was given up after 1000 Newton iterations"):
        find_tensions(lift, lift.begin(), TipTarget(height=0.6))
    assert len(lift.tried) <= 6


def test_a_height_out_of_reach_is_refused_with_heights_that_are_found(body: SoftBody) -> None:
    lift = Lift(lambda tension: 0.5 + 0.002 * tension, body, lost_at_N=8.0)
    with pytest.raises(UnreachableError) as caught:
        find_tensions(lift, lift.begin(), TipTarget(height=0.53))
    found = re.search(r"ask for a height that was reached, (\S+) to (\S+) m", str(caught.value))
    assert found is not None
    for height in map(float, found.groups()):
        assert find_tensions(lift, lift.begin(), TipTarget(height=height)).position_error_m <= 1e-4


def test_what_was_reached_until_the_end_is_said(body: SoftBody) -> None:
    lift = Lift(lambda tension: 0.5 + 0.002 * tension, body, lost_at_N=8.0)
    with pytest.raises(UnreachableError) as caught:
        find_tensions(lift, lift.begin(), TipTarget(height=0.53))
    message = str(caught.value)
    closest = caught.value.closest
    assert closest.position_error_m == pytest.approx(0.014, abs=0.001)  # within the shortest step of the end
    assert "pulling all cables from [0.0] N to [" in message
    assert "from 0.5000 m at [0.0] N to 0.51" in message
    assert "beyond which no equilibrium found" in message
