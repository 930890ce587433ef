"""How the elastic energy of a body is shared between its film and its hinges."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import DirectElement, Instant
from cosim.soft.elements.hinge import Hinges
from cosim.soft.elements.membrane import Membranes

_ROUNDING_J = 1e-15
_NO_TABLE = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


def stored_energy(body: SoftBody, positions: Array) -> dict[type[DirectElement], float]:
    """Return the energy [J] that the elements of each kind store at rest, whatever acts on the body.

    Args:
        body: whose elements.
        positions: (n, 3) [m].
    """
    x, unused = (
        np.array(positions, order="C"),
        np.zeros_like(positions),
    )  # kernels take none that is read-only
    energy: dict[type[DirectElement], float] = {}
    for element in body.of_kind(DirectElement):  # type: ignore[type-abstract]
        memory = element.first_memory(body.positions)
        added = element.add(x, _NO_TABLE, unused, _NO_BLOCKS, Instant(memory, memory.copy()))
        energy[type(element)] = energy.get(type(element), 0.0) + added
    return energy


def hinge_energy_share(body: SoftBody, positions: Array) -> float:
    """Return U_hinges / (U_hinges + U_film); 0 where there is no elastic energy.

    Args:
        body: whose film and hinges.
        positions: (n, 3) [m].
    """
    energy = stored_energy(body, positions)
    bending, total = energy[Hinges], energy[Membranes] + energy[Hinges]
    return bending / total if total > _ROUNDING_J else 0.0
