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

from cosim.errors import InputError
from cosim.frames import Array, IntArray
from cosim.soft.contact import ContactPlanes
from cosim.soft.section.chain_touch import ANCHOR, COLUMNS, FRICTION, NORMAL, OFFSET, STIFFNESS
from cosim.soft.section.model import SectionBody


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
        nodes = section.node_weights(pressure_Pa)
        owner = section.frames.before[planes.nodes]
        first = owner.min(axis=1)
        further = owner > first[:, None]
        weights = planes.weights[:, :, None, None] * nodes[planes.nodes]
        if (owner > first[:, None] + 1).any() or weights[further, 1].any():
            raise InputError("section models need films between neighbouring rings; use fidelity = 'lumped'")
        # a node on the second frame of its contact is the first of its own two
        rows = np.empty((len(first), COLUMNS))
        near = np.where(further[:, :, None], 0.0, weights[:, :, 0]).sum(axis=1)
        far = np.where(further[:, :, None], weights[:, :, 0], weights[:, :, 1]).sum(axis=1)
        rows[:, :4], rows[:, 4:NORMAL] = near, far
        rows[:, NORMAL:OFFSET], rows[:, OFFSET] = planes.normal, planes.offset
        rows[:, STIFFNESS], rows[:, FRICTION] = planes.stiffness, planes.friction
        rows[:, ANCHOR:] = planes.anchor
        return cls(first, rows, np.array((planes.law.smoothing_m, planes.law.stick_m)))
