"""What a snapshot shows of the film's shape, made when somebody asks for it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, final

from cosim.base.frames import Array, Pose

if TYPE_CHECKING:  # who only looks at snapshots needs no kernels
    from cosim.coupling.soft_sides.shape_reader import ShapeFigures, ShapeReader


@final
class FilmShape:
    """The film at the end of one tick; each value is made once.

    Args:
        reader: of the shape.
        shape: as its reader needs it; nothing that happens later changes it.
        flange: world_from_flange at the end of the tick.
    """

    def __init__(self, reader: ShapeReader, shape: Any, flange: Pose) -> None:
        self.reader, self.shape, self._flange = reader, shape, flange

    @cached_property
    def node_position(self) -> Array:
        """(n, 3) [m], world."""
        return self.reader.positions(self.shape)

    @cached_property
    def chamber_volume_m3(self) -> Array:
        """(chambers,)."""
        found: Array = self._figures.volumes_m3[0]
        return found

    @cached_property
    def volume_m3(self) -> float:
        """Of all chambers."""
        return float(sum(self.chamber_volume_m3.tolist()))

    @cached_property
    def tip_position(self) -> Array:
        """(3,) [m], mean of the last hole ring."""
        found: Array = self._figures.tip_position[0]
        return found

    @cached_property
    def tip_direction(self) -> Array:
        """(3,), unit normal of the last hole ring, away from the base."""
        found: Array = self._figures.tip_direction[0]
        return found

    @cached_property
    def sag_m(self) -> float:
        """Distance of the tip from where a straight arm of the same length would have it."""
        flange = self._flange
        return float(self._figures.sag_m(flange.translation, flange.rotation[:, 2])[0])

    @cached_property
    def _figures(self) -> ShapeFigures:
        return self.reader.figures([self.shape])
