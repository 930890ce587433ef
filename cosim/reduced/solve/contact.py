"""Contact of the film on a chain of frames: contact points as combinations of the points of two frames.

A contact point is a combination of the nodes of one triangle, these are combinations of the points of the
frames beside them, and no triangle reaches across an outer ring: y = sum_s (w_s0 r_s + q_s), q_s = sum_i w_si
a_si, s the two frames. A change of the frames moves it by sum_s (w_s0 dr_s + phi_s x q_s) = J (dr, phi); its
energy adds J^T g to the gradient, J^T K J and the second order of the rotations to the Hessian, g and K by y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, INDICES, MATRIX, VECTOR, kernel
from cosim.errors import InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.contact_terms import ANCHOR, COLUMNS, FRICTION, NORMAL, OFFSET, STIFFNESS
from cosim.reduced.sections.section_strains import CUBE
from cosim.soft.contact.obstacle_contact import ContactPlanes


@kernel(
    types.boolean(
        INDEX_TABLE, MATRIX, INDICES, CUBE, MATRIX, VECTOR, VECTOR, VECTOR, MATRIX, INDICES, MATRIX
    )
)  # fmt: skip
def _fill_rows(  # type: ignore[no-untyped-def]
    nodes, weights, before, combination, normal, offset, stiffness, friction, anchor, first, rows
):
    """Fill first (k,) and rows (k, COLUMNS); False where a triangle reaches across a frame."""
    for k in range(nodes.shape[0]):
        f = min(before[nodes[k, 0]], before[nodes[k, 1]], before[nodes[k, 2]])
        first[k] = f
        rows[k, :NORMAL] = 0.0
        for a in range(3):
            node = nodes[k, a]
            # a node on the second frame of its contact is the first of its own two, and of that one alone
            shift = before[node] - f
            for i in range(4):
                rows[k, 4 * min(shift, 1) + i] += weights[k, a] * combination[node, 0, i]
                beyond = weights[k, a] * combination[node, 1, i]
                if shift == 0:
                    rows[k, 4 + i] += beyond
                elif shift > 1 or beyond != 0.0:
                    return False
        rows[k, OFFSET], rows[k, STIFFNESS], rows[k, FRICTION] = offset[k], stiffness[k], friction[k]
        for r in range(3):
            rows[k, NORMAL + r], rows[k, ANCHOR + r] = normal[k, r], anchor[k, r]
    return True


@final
@dataclass(frozen=True)
class FrameContacts:
    """What a chain may touch in one step.

    Args:
        first: (k,) the first of the two frames of each contact point.
        rows: (k, 17): its eight weights, then normal, offset [m], stiffness [N/m], friction [N], anchor [m].
        widths: (2,) [m], smoothing and stick length.
    """

    first: IntArray
    rows: Array
    widths: Array

    @classmethod
    def none(cls) -> FrameContacts:
        """Return no contact."""
        return cls(np.zeros(0, np.int64), np.zeros((0, COLUMNS)), np.ones(2))

    @classmethod
    def of(cls, section: SectionBody, planes: ContactPlanes, pressure_Pa: float) -> FrameContacts:
        """Return contacts of the film's nodes as contacts of the frames.

        Args:
            section: of the film.
            planes: what its nodes may touch.
            pressure_Pa: of the gas.

        Raises:
            InputError: a triangle of the film reaches across a frame.
        """
        first, rows = np.empty(len(planes), np.int64), np.empty((len(planes), COLUMNS))
        fits = _fill_rows(
            planes.nodes, planes.weights, section.frames.before, section.node_weights(pressure_Pa),
            planes.normal, planes.offset, planes.stiffness, planes.friction, planes.anchor, first, rows,
        )  # fmt: skip
        if not fits:
            raise InputError("section models need films between neighbouring rings; use fidelity = 'lumped'")
        return cls(first, rows, np.array((planes.law.smoothing_m, planes.law.stick_m)))
