"""What the next step of a soft arm depends on, of film or of sections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Pose
from cosim.base.state_check import check_indices
from cosim.errors import InputError
from cosim.reduced.solve.clamp import FrameClamp
from cosim.reduced.solve.kept_tangent import KeptTangentState
from cosim.reduced.solve.time_step import ChainStep
from cosim.soft.body.loads import Loads
from cosim.soft.linear.kept_factor import NewtonState
from cosim.soft.solve.state import Clamp, SoftState


@final
@dataclass(frozen=True)
class SoftArmState:
    """What the next step of a soft arm depends on.

    Args:
        soft: shape and motion.
        clamp: what is held.
        flange: pose of the flange at the end of the last step.
        loads: there.
        residual_N: of the last step.
        newton: what its solver has kept.
        flange_before: pose of the flange one step earlier, if there was one.
        pieces: into which a step is cut.
        piece_s: length of the last one [s].
    """

    soft: SoftState
    clamp: Clamp
    flange: Pose
    loads: Loads
    residual_N: float
    newton: NewtonState
    flange_before: Pose | None
    pieces: int
    piece_s: float

    def check(self, nodes: int) -> None:
        """Check that it is of a body with so many nodes.

        Raises:
            InputError: it is not.
        """
        if len(self.soft.positions) != nodes:
            raise InputError(f"the saved soft robot has {len(self.soft.positions)} nodes, this one {nodes}")
        check_indices(self.clamp.nodes, nodes, "nodes")
        if len(self.loads.cable_length_m) not in (0, len(self.loads.cable_tension_N)):
            raise InputError(f"the saved loads have {len(self.loads.cable_length_m)} cables with a length")


@final
@dataclass(frozen=True)
class SectionArmState:
    """What the next step of a section arm depends on.

    Args:
        last: where the last step ended.
        clamp: frames held by the flange.
        flange: world_from_flange.
        loads: that act.
        tangent: factor that the next step may begin with; None for none.
    """

    last: ChainStep
    clamp: FrameClamp
    flange: Pose
    loads: Loads
    tangent: KeptTangentState | None

    def check(self, frames: int) -> None:
        """Check that it is of an arm with so many frames.

        Raises:
            InputError: it is not.
        """
        if len(self.clamp.held) != frames:
            raise InputError(f"the saved soft robot has {len(self.clamp.held)} frames, this one {frames}")
