"""Where a step begins: folds that free flight would close move as one, others fly on."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.soft.solve.step_prediction import keep_folds_open

THETA1_rad = 0.1
PLACES = np.arange(12.0).reshape(4, 3)
FLOWN = PLACES + np.array([[3.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]])
AS_ONE = PLACES + np.array([1.0, 0.5, 1.0])


@pytest.mark.parametrize(
    ("before", "after", "closes"),
    [
        (0.05, 0.01, True),
        (2.0 * np.pi - 0.05, 2.0 * np.pi - 0.01, True),  # folded the other way
        (2e-6, 1e-6, True),  # closed already, and further
        (0.05, 0.03, False),  # opens again within an iteration
        (0.05, 0.09, False),
        (0.2, 0.01, False),  # no barrier where it comes from
        (2e-6, 2e-6, False),  # stays as closed as it is
        (2e-6, 4e-6, False),
    ],
)
def test_a_fold_that_flight_would_close_moves_as_one(before: float, after: float, closes: bool) -> None:
    flight, angles = FLOWN.copy(), (np.array([before]), np.array([after]))
    assert keep_folds_open(PLACES, np.arange(4)[None], THETA1_rad, *angles, flight) == closes
    np.testing.assert_allclose(flight, AS_ONE if closes else FLOWN, atol=1e-14)
