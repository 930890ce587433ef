"""A soft body on the tip of another one: both become one body, joined by a stiff plate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Pose
from cosim.base.names import ONLY_CHAMBER
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.gas_chamber import GasChamber
from cosim.soft.elements.element import Element
from cosim.soft.elements.frame_ring import FrameRings


@final
@dataclass(frozen=True)
class Plate:
    """The stiff plate between two bodies.

    Args:
        mass_kg: spread evenly over the nodes that it joins.
        stiffness_N_m: of the springs that keep its shape.
    """

    mass_kg: float
    stiffness_N_m: float


def attached(
    body: SoftBody, own_chamber: str, part: SoftBody, name: str, body_from_part: Pose, plate: Plate
) -> SoftBody:
    """Return a body with a part on its tip; the base of the part and the tip of the body sit on one plate.

    Base and tip stay those of the body. Rings, cables' places and chambers of the part come after the body's;
    its rings are called `name/` and their own name, its chambers too, or `name` where it has only one.

    Args:
        body: that carries.
        own_chamber: name of the body's chamber, where it has only one.
        part: that is carried.
        name: of the part.
        body_from_part: where it is.
        plate: that joins them.

    Raises:
        MeshError: fold barriers or ends (closed or open) of the two differ.
    """
    if body.closed != part.closed:
        raise MeshError(
            f"{name} cannot be attached: ends closed is {part.closed}, that of the carrier is {body.closed}"
        )
    shift = body.nodes
    positions = np.concatenate([body.positions, body_from_part.apply(part.positions)])
    joined = np.unique(np.concatenate([body.tip, part.base + shift]))
    mass = np.concatenate([body.node_mass, part.node_mass])
    mass[joined] += plate.mass_kg / len(joined)
    return replace(
        body,
        positions=positions,
        elements=(
            *_elements(body, part, name),
            FrameRings.plate(positions, joined, plate.stiffness_N_m),
        ),
        caps=(*body.caps, *(cap + shift for cap in part.caps)),
        node_mass=mass,
        rings={**body.rings, **{f"{name}/{key}": ring + shift for key, ring in part.rings.items()}},
        chambers=_chambers(body, own_chamber, part, name),
    )


def _elements(body: SoftBody, part: SoftBody, name: str) -> tuple[Element, ...]:
    """Return the elements of the body, then those of the part; kinds of which a body has one are joined."""
    found: list[Element] = []
    for kind in dict.fromkeys((*body.kinds, *part.kinds)):
        own, further = body.of_kind(kind), [_beyond(entry, body.nodes) for entry in part.of_kind(kind)]
        try:
            found += [kind.joined([*own, *further])] if kind.single else [*own, *further]
        except MeshError as error:
            raise MeshError(f"{name} cannot be attached: {error}") from None
    return tuple(found)


def _beyond(element: Element, nodes: int) -> Element:
    """Return an element of a part, where this many nodes come before its own."""
    shifted = element.shifted(nodes)
    return replace(shifted, leads_on=True) if isinstance(shifted, FrameRings) else shifted


def _chambers(body: SoftBody, own_chamber: str, part: SoftBody, name: str) -> tuple[GasChamber, ...]:
    own = tuple(
        replace(chamber, name=own_chamber) if chamber.name == ONLY_CHAMBER else chamber
        for chamber in body.gas_chambers
    )
    triangles, caps = len(body.triangles), len(body.caps)
    return own + tuple(
        chamber.shifted(name if chamber.name == ONLY_CHAMBER else f"{name}/{chamber.name}", triangles, caps)
        for chamber in part.gas_chambers
    )
