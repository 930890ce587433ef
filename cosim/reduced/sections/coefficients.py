"""Layout of the coefficients of a section's energy: polynomial, functions of gaps, and limits of the strains.
Kernels (`cosim.base.kernels`) read these constants.
"""

from typing import Final

_ORDERS: Final = {"A": 6, "B": 4, "B2": 2, "B3": 1, "S": 2, "Q": 2, "Q2": 1, "T": 2}
POLYNOMIAL: Final = sum(order + 1 for order in _ORDERS.values()) + 4
GAP_KINDS, GAP_INTERVALS = 3, 12
COEFFICIENTS: Final = POLYNOMIAL + GAP_KINDS * (GAP_INTERVALS + 3)
"""Number of coefficients: of the polynomial, and of the functions of gaps (see `gap_energy`)."""
_LOWEST: Final = {"A": -1, "B": 0, "B2": 1, "B3": 2, "S": 0, "Q": 0, "Q2": 1, "T": 0}
DEGREES: Final = (
    *(max(0, power + _LOWEST[name]) for name, order in _ORDERS.items() for power in range(order + 1)),
    *(3,) * (COEFFICIENTS - POLYNOMIAL + 4),
)
"""Degree of each term above that of a linear spring: powers of z, products, functions of gaps."""
LOW, HIGH, BENT = COEFFICIENTS, COEFFICIENTS + 1, COEFFICIENTS + 2
"""Columns after the coefficients: limits of z, and of b."""
