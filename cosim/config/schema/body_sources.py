"""Base class of what draws a soft robot's film (`[body]` of its file), and the table of a film from a mesh
file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, final

from annotated_types import Len

from cosim.base.names import ONLY_CHAMBER
from cosim.base.resources import is_file, quoted_name
from cosim.config.toml import keys
from cosim.config.toml.quantities import Length, Name, Position, Positive, Text
from cosim.config.toml.rules import Violations, rule
from cosim.config.toml.tables import KindTable, Table


@dataclass(frozen=True, kw_only=True)
class BodySourceTable(KindTable):
    """Draws the film of a soft robot.

    Args:
        kind: of the source; each kind has further keys.
    """

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets, by which robots and scenarios hold, load and route cables."""
        raise NotImplementedError

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of the gas chambers that the film encloses."""
        return (ONLY_CHAMBER,)

    def has_frames(self) -> bool:
        """Whether its mesh may have lines for stiffeners."""
        return False

    def mesh(self) -> Any:
        """Return the film (`cosim.soft.geometry.named_mesh.NamedMesh`), in the flange's frame.

        Its rings are the node sets; cables may run along its lines.

        Raises:
            InputError: the keys describe no film.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class NodeSetTable(Table):
    """A named set of nodes of a mesh, selected in one of three ways.

    Args:
        name: of the set; base, tip, cables, supports and forces name it.
        axis: of the flange's frame, with `at_m`: all nodes in a plane across it, in order around it.
        at_m: coordinate of that plane.
        points_m: the nodes nearest to these points, in this order, such as those of a cable.
        group: the nodes of a named group of triangles of the file.
    """

    name: Name
    axis: Literal["x", "y", "z"] | None = None
    at_m: Length | None = None
    points_m: tuple[Position, ...] = ()
    group: Text | None = None

    @rule
    def _is_selected_in_one_way(self) -> Violations:
        ways = (self.axis is not None, self.at_m is not None, bool(self.points_m), self.group is not None)
        if ways not in ((True, True, False, False), (False, False, True, False), (False, False, False, True)):
            yield "", "give axis and at_m, or points_m, or group, and one of these"


@final
@dataclass(frozen=True, kw_only=True)
class MeshTable(BodySourceTable):
    """A film from a mesh file, whose open ends are closed by caps.

    Args:
        kind: of `[body]`.
        file: STL or OBJ in the folder of the robot's file; triangles counter-clockwise seen from outside, in
            the flange's frame. `[[group]]` gives groups of an OBJ file (`g NAME`) a different film.
        scale: multiplies the numbers of the file, such as 0.001 for a file in mm.
        sets: `[[body.set]]` in the file.
        tip: the set around the free end.
    """

    kind: Literal["mesh"] = "mesh"
    file: Text
    scale: Positive = 1.0
    sets: Annotated[tuple[NodeSetTable, ...], Len(min_length=2)] = field(metadata={"alias": "set"})
    tip: Name = "tip"

    @rule
    def _has_its_file(self) -> Violations:
        if not is_file(Path(self.file)):
            yield "file", f"no file {quoted_name(self.file)} beside the one that names it"

    @rule
    def _has_its_tip(self) -> Violations:
        if self.tip not in self.set_names():
            yield "tip", keys.unknown_name_message("set", self.tip, self.set_names())

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets."""
        return tuple(entry.name for entry in self.sets)


BodySourceTable.kinds["mesh"] = MeshTable
