"""An arm that is straight along the flange's z axis: where the flange is to be for its tip to be on a target.

With the length l, the flange's axes R turned by the least angle to the wanted direction, and the wanted tip
p, the flange is at p - l R e_z.
"""

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.body.places import center_line_length, center_rings
from cosim.soft.solve.tip_target import shortest_turn


@final
@dataclass(frozen=True)
class StraightArm:
    """A straight arm.

    Args:
        length_m: from the flange to the tip.
    """

    length_m: float

    @classmethod
    def of(cls, body: SoftBody, positions: Array) -> "StraightArm":
        """Return a straight arm as long as the centre line of a soft body at positions (n, 3) [m]."""
        return cls(center_line_length(center_rings(body), positions))

    def pose(self, here: Pose, position: Array, direction: Array | None) -> Pose:
        """Return the flange's next pose, for a tip at a position, with a direction unless that is None.

        Args:
            here: present pose of the flange.
            position: (3,) [m], world, wanted of the tip.
            direction: (3,), unit vector, wanted of the tip; None keeps the present one.
        """
        axis = here.rotation[:, 2]
        turn = shortest_turn(axis, axis if direction is None else direction)
        rotation = rotation_from_vector(turn) @ here.rotation
        return Pose(rotation, position - self.length_m * rotation[:, 2])
