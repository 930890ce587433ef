"""Bodies from bodies: copies side by side, such as the fingers of a gripper; a body on another's tip."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.base.names import ONLY_CHAMBER
from cosim.errors import MeshError
from cosim.soft.body.body import GasChamber, SoftBody
from cosim.soft.elements.element import Element
from cosim.soft.elements.frame_ring import FrameRings


def copies(body: SoftBody, poses: Sequence[Pose]) -> SoftBody:
    """Return copies of a body side by side, as one body; they share only the flange and gravity.

    The gas chamber of copy k is called `copy_k`. The first copy gives the tip and keeps the names of its
    rings, which are `copy_1/` and the name as well; those of copy k = 2, 3, ... are called `copy_k/` and the
    name. Cables come copy by copy.

    Args:
        body: in the flange frame.
        poses: flange_from_copy of each.

    Raises:
        MeshError: no pose is given.
    """
    if not poses:
        raise MeshError("no pose is given; a body needs at least one copy")
    count, number = body.nodes, len(poses)
    shift = [count * k for k in range(number)]
    rings = dict(body.rings)
    for k in range(number):
        rings.update({f"copy_{k + 1}/{name}": ring + shift[k] for name, ring in body.rings.items()})
    return SoftBody(
        positions=np.concatenate([pose.apply(body.positions) for pose in poses]),
        elements=_elements(body, shift),
        caps=tuple(cap + s for s in shift for cap in body.caps),
        closed=body.closed,
        node_mass=np.tile(body.node_mass, number),
        base=np.concatenate([body.base + s for s in shift]),
        tip=body.tip,
        rings=rings,
        center_rings=body.center_rings,
        frame_rings=body.frame_rings,
        chambers=_chambers(body, number),
        tip_along=None if body.tip_along is None else poses[0].rotation @ body.tip_along,
        copies=tuple(poses),
    )


def _elements(body: SoftBody, shift: Sequence[int]) -> tuple[Element, ...]:
    """Return the elements of all copies; nodes of copy k are shifted by shift[k]."""
    elements: list[Element] = []
    for kind in body.kinds:
        of_kind = body.of_kind(kind)
        if kind.merges:
            elements += [kind.joined([entry.shifted(s) for s in shift]) for entry in of_kind]
        else:
            elements += [entry.shifted(s) for s in shift for entry in of_kind]
    return tuple(elements)


def _chambers(body: SoftBody, number: int) -> tuple[GasChamber, ...]:
    """Return the chambers of all copies: "copy_2", or "copy_2/NAME" if a copy has several."""
    triangles, caps, chambers = len(body.triangles), len(body.caps), body.gas_chambers
    return tuple(
        chamber.shifted(
            f"copy_{k + 1}" if len(chambers) == 1 else f"copy_{k + 1}/{chamber.name}", k * triangles, k * caps
        )
        for k in range(number)
        for chamber in chambers
    )


def around_axis(
    count: int, radius_m: float, tilt_rad: float, spin_rad: float = 0.0, height_m: float = 0.0
) -> tuple[Pose, ...]:
    """Return poses evenly spaced about the flange's z axis, the first towards +x.

    Each copy's z axis leans outwards by the tilt; its x axis points away from the flange's axis, and from
    there it is turned about its own z axis by the spin.

    Args:
        count: of the copies.
        radius_m: of their origins from the axis.
        tilt_rad: of their z axes from the flange's.
        spin_rad: about their own z axes.
        height_m: of their origins along the flange's z axis.
    """
    poses = []
    lean = rotation_from_vector(np.array([0.0, tilt_rad, 0.0]))
    spin = rotation_from_vector(np.array([0.0, 0.0, spin_rad]))
    for k in range(count):
        turn = rotation_from_vector(np.array([0.0, 0.0, 2.0 * np.pi * k / count]))
        origin: Array = turn @ np.array([radius_m, 0.0, height_m])
        poses.append(Pose(turn @ lean @ spin, origin))
    return tuple(poses)


@final
@dataclass(frozen=True)
class Plate:
    """The stiff plate between two bodies.

    Args:
        mass_kg: distributed evenly over the nodes that it joins.
        stiffness_N_m: of the springs that keep its shape.
    """

    mass_kg: float
    stiffness_N_m: float


def attached(
    body: SoftBody, own_chamber: str, part: SoftBody, name: str, body_from_part: Pose, plate: Plate
) -> SoftBody:
    """Return a body with a part on its tip; the base of the part and the tip of the body sit on one plate.

    Base and tip stay those of the body. Rings, cables and chambers of the part come after the body's; its
    rings and chambers are called `name/` and their name, a single chamber `name`.

    Args:
        body: carrier.
        own_chamber: name of the body's chamber, if it has only one.
        part: to attach.
        name: of the part.
        body_from_part: pose of the part.
        plate: between them.

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
            *_attached_elements(body, part, name),
            FrameRings.plate(positions, joined, plate.stiffness_N_m),
        ),
        caps=(*body.caps, *(cap + shift for cap in part.caps)),
        node_mass=mass,
        rings={**body.rings, **{f"{name}/{key}": ring + shift for key, ring in part.rings.items()}},
        chambers=_attached_chambers(body, own_chamber, part, name),
    )


def _attached_elements(body: SoftBody, part: SoftBody, name: str) -> tuple[Element, ...]:
    """Return the elements of the body, then those of the part; kinds allowed once per body are joined."""
    elements: list[Element] = []
    for kind in dict.fromkeys((*body.kinds, *part.kinds)):
        of_body, of_part = body.of_kind(kind), [_beyond(entry, body.nodes) for entry in part.of_kind(kind)]
        try:
            elements += [kind.joined([*of_body, *of_part])] if kind.single else [*of_body, *of_part]
        except MeshError as error:
            raise MeshError(f"{name} cannot be attached: {error}") from None
    return tuple(elements)


def _beyond(element: Element, nodes: int) -> Element:
    """Return an element of a part, with its nodes shifted by `nodes`."""
    shifted = element.shifted(nodes)
    return replace(shifted, leads_on=True) if isinstance(shifted, FrameRings) else shifted


def _attached_chambers(body: SoftBody, own_chamber: str, part: SoftBody, name: str) -> tuple[GasChamber, ...]:
    of_body = tuple(
        replace(chamber, name=own_chamber) if chamber.name == ONLY_CHAMBER else chamber
        for chamber in body.gas_chambers
    )
    triangles, caps = len(body.triangles), len(body.caps)
    return of_body + tuple(
        chamber.shifted(name if chamber.name == ONLY_CHAMBER else f"{name}/{chamber.name}", triangles, caps)
        for chamber in part.gas_chambers
    )
