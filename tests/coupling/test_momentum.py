"""What is lost between both sides shows, wherever the flange is: force as it is, torque at its lever."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.coupling.schemes.interface import TransferredLoads

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
