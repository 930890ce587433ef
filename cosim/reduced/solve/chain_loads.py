"""Loads on a chain of frames: its sections at a pressure, dead loads, cables, contacts of its film. A contact
point is a combination of the nodes of one triangle. These are combinations of the points of their two frames
s, as no triangle extends across an outer ring: y = sum_s (w_s0 r_s + q_s), q_s = sum_i w_si a_si. A change of
the frames moves it by sum_s (w_s0 dr_s + phi_s x q_s) = J (dr, phi). With the derivatives g and K of its
energy by y, it adds J^T g to the gradient, and J^T K J and the second order of the rotations to the Hessian.
"""

from itertools import pairwise
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix
from cosim.base.kernels import kernel
from cosim.errors import InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.chain_arrays import LoadedChain
from cosim.reduced.sections.contact_terms import ANCHOR, COLUMNS, FRICTION, NORMAL, OFFSET, STIFFNESS
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes


@kernel
def fill_rows(
    planes: ContactPlanes, before: Indices, combination: Blocks, first: Indices, rows: Matrix
) -> bool:
    """Fill contacts of the film's nodes as contacts of the frames, as a `LoadedChain` has them.

    Args:
        planes: k contacts.
        before: (n,), the first of the two frames that each node is between.
        combination: (n, 2, 4), each as a combination of their points.
        first: (k,), filled.
        rows: (k, COLUMNS), filled.

    Returns:
        False where a triangle reaches across a frame.
    """
    for k in range(planes.nodes.shape[0]):
        nodes = planes.nodes[k]
        f = min(before[nodes[0]], before[nodes[1]], before[nodes[2]])
        first[k] = f
        for i in range(NORMAL):
            rows[k, i] = 0.0
        for a in range(3):
            # a node on the contact's second frame has that frame as the first of its two, with all its weight
            node, weight = nodes[a], planes.weights[k, a]
            shift = before[node] - f
            for i in range(4):
                rows[k, 4 * min(shift, 1) + i] += weight * combination[node, 0, i]
                beyond = weight * combination[node, 1, i]
                if shift == 0:
                    rows[k, 4 + i] += beyond
                elif shift > 1 or beyond != 0.0:
                    return False
        rows[k, OFFSET], rows[k, STIFFNESS] = planes.offset[k], planes.stiffness[k]
        rows[k, FRICTION] = planes.friction[k]
        for r in range(3):
            rows[k, NORMAL + r], rows[k, ANCHOR + r] = planes.normal[k, r], planes.anchor[k, r]
    return True


def nothing_touched() -> tuple[IntArray, Array, Array]:
    """Return the arrays of no contact for a `LoadedChain`."""
    return np.zeros(0, np.int64), np.zeros((0, COLUMNS)), np.ones(2)


@final
class ChainLoads:
    """Loads on one chain; only changed ones are computed again.

    `losses_follow_shape` says whether the tension of a cable's segments depends on the shape.

    Args:
        section: of the chain.

    Raises:
        InputError: a cable does not run from unit to next unit.
    """

    def __init__(self, section: SectionBody) -> None:
        self._section = section
        body, frames = section.body, section.frames
        segments = np.concatenate([np.zeros((0, 2), np.int64), *(cable.segments for cable in body.cables)])
        nearest = frames.before + (frames.fraction > 0.5)
        far = nearest[segments[:, 1]].astype(np.int64)
        # eyelets are on rings of neighbouring units
        on_rings = np.isin(frames.fraction[segments], (0.0, 1.0)).all()
        if not on_rings or (nearest[segments[:, 0]] != far - 1).any():
            raise InputError(
                "section models need every cable to run from unit to next unit through outer rings; "
                "use fidelity = 'lumped'"
            )
        side = (frames.fraction[segments] > 0.5).astype(int)
        table = section.model.nodes[:, segments, side, 1:]
        self._eyelet_table = np.ascontiguousarray(table).reshape(len(table), -1)
        self.losses_follow_shape = any(cable.friction_coefficient for cable in body.cables)
        self._ratios = [cable.tension_ratio(body.positions) for cable in body.cables]
        load, eyelets, tension = np.zeros((len(frames), 4, 3)), np.zeros((len(far), 2, 3)), np.zeros(len(far))
        self._chain = LoadedChain(*section.chain, load, far, eyelets, tension, *nothing_touched())
        ends = np.cumsum([0, *map(len, self._ratios)]).tolist()
        self._tensions = [tension[a:b] for a, b in pairwise(ends)]
        self._loads: Loads | None = None
        self._pressure = np.nan

    def acting(self, loads: Loads, pressure_Pa: float, frames: Array) -> LoadedChain:
        """Set the pressure of the section; return the chain with its loads; the next call changes its arrays.

        Args:
            loads: on the film.
            pressure_Pa: of the gas.
            frames: (f, 4, 3) near the solution; losses of cables with friction depend on it.

        Raises:
            InputError: a cable's length is commanded, or a triangle of a contact extends across a frame.
        """
        self._section.set_pressure(pressure_Pa)
        if loads is not self._loads or pressure_Pa != self._pressure:
            self._update(loads, pressure_Pa)
        if self.losses_follow_shape:
            x = self._section.positions(frames, pressure_Pa)
            self._pull(loads, [cable.tension_ratio(x) for cable in self._section.body.cables])
        return self._chain if loads.contact is None else self._touching(loads.contact, pressure_Pa)

    def _update(self, loads: Loads, pressure_Pa: float) -> None:
        """Update dead loads, eyelets and tensions."""
        if any(length is not None for length in loads.cable_length_m):
            raise InputError("a chain is solved at tensions; `solve_loaded` takes commanded lengths")
        before, other_pressure = self._loads, pressure_Pa != self._pressure
        self._loads, self._pressure = loads, pressure_Pa
        if (
            before is None
            or before.gravity != loads.gravity
            or before.nodal_force is not loads.nodal_force
            or (other_pressure and loads.nodal_force is not None)
        ):
            self._chain.load[:] = self._section.mass[:, 0, :, None] * np.array(loads.gravity)
            if loads.nodal_force is not None:
                self._chain.load[:] += self._section.spread(loads.nodal_force, pressure_Pa)
        if other_pressure and self._ratios:
            spline = self._section.model.spline
            spline.fill(pressure_Pa, self._eyelet_table, self._chain.eyelets.reshape(-1))
        self._pull(loads, self._ratios)

    def _pull(self, loads: Loads, ratios: list[Array]) -> None:
        """Update the tension of all segments from ratios to the tension at each base end."""
        for tension, ratio, tension_N in zip(
            self._tensions, ratios, loads.cable_tension_N if ratios else (), strict=True
        ):
            np.multiply(ratio, tension_N, out=tension)

    def _touching(self, planes: ContactPlanes, pressure_Pa: float) -> LoadedChain:
        """Return the chain with contacts of the film's nodes as contacts of the frames."""
        section, count = self._section, len(planes.nodes)
        first, rows = np.empty(count, np.int64), np.empty((count, COLUMNS))
        weights = section.node_weights(pressure_Pa)
        if not fill_rows(planes, section.frames.before, weights, first, rows):
            raise InputError("section models need films between neighbouring rings; use fidelity = 'lumped'")
        return self._chain._replace(touching=first, rows=rows, widths=planes.widths)
