"""Moments of a film's shape: few numbers from which amplitudes of slow modes can be computed later."""

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody

_POWERS: Final = 8  # of the height: more do not resolve the modes of long stacks better


@final
class ShapeMoments:
    """Sums functions f_j of the nodes: moment j of a shape x is sum_i f_j(i) m_i^1/2 x_i.

    The functions are Legendre polynomials of the drawn height, alone and times both coordinates across it,
    each times m_i^1/2, made orthonormal. Attribute `along` (m, n) [kg^1/2] holds the weights of positions.

    Args:
        body: mesh of the shapes.
    """

    def __init__(self, body: SoftBody) -> None:
        low, high = body.positions.min(axis=0), body.positions.max(axis=0)
        x, y, height = (2.0 * (body.positions - low) / np.where(high > low, high - low, 1.0) - 1.0).T
        powers, root = np.polynomial.legendre.legvander(height, _POWERS - 1), np.sqrt(body.node_mass)
        functions = np.concatenate([powers * across[:, None] for across in (np.ones_like(x), x, y)], axis=1)
        self.along = np.ascontiguousarray(np.linalg.qr(root[:, None] * functions)[0].T * root)

    def of(self, shapes: Array) -> Array:
        """Return the moments (k, m, 3) [kg^1/2 m] of shapes (k, n, 3) [m]."""
        columns = np.moveaxis(shapes, 2, 0).reshape(-1, shapes.shape[1])  # for a single product
        return np.ascontiguousarray(np.moveaxis((columns @ self.along.T).reshape(3, len(shapes), -1), 0, 2))
