"""What is lost between both sides shows, wherever the flange is: force as it is, torque at its lever."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cosim.coupling.schemes.interface import Coupling, Interface, TransferredLoads
from cosim.coupling.schemes.iterated import IteratedCoupling
from cosim.coupling.schemes.staggered import StaggeredCoupling
from tests.coupling.pads import CoupledGrasp

FLANGE = np.array([4.0, 1.0, -2.0, 0.1, 0.2, 0.3])
HANDED = TransferredLoads((4.0, 1.0, -2.0, 0.1, 0.2, 0.3), (0.0, 1.0, 2.0, 3.0, 4.0, 5.0), 4.0, 5.0)


def test_nothing_is_lost_where_the_loads_about_the_world_s_origin_agree() -> None:
    assert HANDED.error(FLANGE, np.arange(6.0)) < 1e-15


@pytest.mark.parametrize(("component", "lost", "error"), [(1, 0.04, 0.01), (3, 0.004, 0.01), (5, -0.04, 0.1)])
def test_force_and_torque_count_by_their_size(component: int, lost: float, error: float) -> None:
    # of 4 N on the flange, torques at a lever of 0.1 m; of 5 N that press on bodies
    change = lost * (np.arange(6) == component)
    assert HANDED.error(FLANGE + change, np.arange(6.0)) == pytest.approx(error)
    assert HANDED.error(FLANGE, np.arange(6.0) + change) == pytest.approx(0.8 * error)


def test_loads_below_a_hundredth_of_a_newton_count_as_that() -> None:
    nothing = np.zeros(6)
    for size in (0.0, 5e-3, 1e-2):
        handed = TransferredLoads((size, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0,) * 6, size, size)
        flange = np.array([size, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert handed.error(flange, nothing) == 0.0
        for component, error in ((1, 0.01), (4, 0.1)):
            lost = 1e-4 * (np.arange(6) == component)
            assert handed.error(flange + lost, nothing) == pytest.approx(error)
            assert handed.error(flange, lost) == pytest.approx(error)


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
