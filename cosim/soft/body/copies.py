"""Several copies of one soft body as one body, such as the fingers of a gripper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.gas_chamber import GasChamber
from cosim.soft.elements.element import Element


def copies(body: SoftBody, poses: Sequence[Pose]) -> SoftBody:
    """Return copies of a body side by side, as one body; they share nothing but the flange and gravity.

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
    )


def _elements(body: SoftBody, shift: Sequence[int]) -> tuple[Element, ...]:
    """Return the elements of all copies, copy k's nodes after shift[k] others."""
    found: list[Element] = []
    for kind in body.kinds:
        own = body.of_kind(kind)
        if kind.merges:
            found += [kind.joined([entry.shifted(s) for s in shift]) for entry in own]
        else:
            found += [entry.shifted(s) for s in shift for entry in own]
    return tuple(found)


def _chambers(body: SoftBody, number: int) -> tuple[GasChamber, ...]:
    """Return the chambers of all copies: "copy_2", or "copy_2/NAME" where a copy has several."""
    triangles, caps, own = len(body.triangles), len(body.caps), body.gas_chambers
    return tuple(
        part.shifted(
            f"copy_{k + 1}" if len(own) == 1 else f"copy_{k + 1}/{part.name}", k * triangles, k * caps
        )
        for k in range(number)
        for part in own
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
