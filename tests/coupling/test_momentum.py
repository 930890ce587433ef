"""What is lost between both sides shows, wherever the flange is: force as it is, torque at its lever."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cosim.base.frames import SixNumbers
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.schemes.transfer import TransferredLoads, six_numbers
from tests.coupling.pads import CoupledGrasp

FLANGE = (4.0, 1.0, -2.0, 0.1, 0.2, 0.3)
HANDED = TransferredLoads(FLANGE, (0.0,) * 6, 4.0, 5.0)
NOTHING = (0.0,) * 6


def changed(load: SixNumbers, component: int, lost: float) -> SixNumbers:
    """Return a load of which something is lost."""
    return six_numbers(np.array(load) + lost * (np.arange(6) == component))


def test_nothing_is_lost_where_the_loads_about_the_world_s_origin_agree() -> None:
    assert HANDED.error(NOTHING, FLANGE) < 1e-15
    assert HANDED.error(changed(NOTHING, 2, 3.0), changed(FLANGE, 2, 3.0)) < 1e-15


@pytest.mark.parametrize(("component", "lost", "error"), [(1, 0.04, 0.01), (3, 0.004, 0.01), (5, -0.04, 0.1)])
def test_force_and_torque_count_by_their_size(component: int, lost: float, error: float) -> None:
    # of 4 N on the flange, torques at a lever of 0.1 m
    assert HANDED.error(NOTHING, changed(FLANGE, component, lost)) == pytest.approx(error)


def test_loads_below_a_hundredth_of_a_newton_count_as_that() -> None:
    for size in (0.0, 5e-3, 1e-2):
        flange = changed(NOTHING, 0, size)
        transferred = TransferredLoads(flange, NOTHING, size, size)
        assert transferred.error(NOTHING, flange) == 0.0
        for component, error in ((1, 0.01), (4, 0.1)):
            assert transferred.error(NOTHING, changed(flange, component, 1e-4)) == pytest.approx(error)


@pytest.mark.parametrize("scheme", [StaggeredCoupling, IteratedCoupling])
def test_nothing_is_lost_of_a_film_that_comes_near_touches_and_lets_go(
    scheme: Callable[[Interface], Coupling],
) -> None:
    here, seen = CoupledGrasp(0.05, 2e-3, scheme, edge_m=0.0315), set()
    for _ in range(10):
        entry = here.tick()
        seen.add((here.grasp.exchange.planes is not None, here.interface.touched.normal_force_N > 0.0))
        assert entry.momentum_error < 1e-10
    assert seen == {(False, False), (True, False), (True, True)}
