"""What draws the film of a soft robot, other than a stack of units: `[body]` of its file, of some kind."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, final

from annotated_types import Len

from cosim.config.toml.constraints import Name, Positive, Text, Vector3
from cosim.config.toml.registered_kinds import KindTable


@dataclass(frozen=True, kw_only=True)
class BodySourceTable(KindTable):
    """What draws the film of a soft robot.

    Args:
        kind: of the source; each kind has further keys of its own.
    """

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets, by which robots and scenarios hold, load and route cables."""
        raise NotImplementedError

    def mesh(self) -> Any:
        """Return the film (`cosim.soft.geometry.named_mesh.NamedMesh`), in the flange's frame.

        Its rings are the node sets; its lines are those that cables may lead through.

        Raises:
            InputError: there is no such film.
        """
        raise NotImplementedError


@final
@dataclass(frozen=True)
class NodeSetTable:
    """Nodes of a mesh by a name, said in one of three ways.

    Args:
        name: of the set; base, tip, cables, supports and forces name it.
        axis: of the flange's frame, with `at_m`: all nodes in a plane across it, in order around it.
        at_m: where that plane is.
        points_m: the nodes nearest to these points, in this order, such as those that a cable runs through.
        group: the nodes of a named group of triangles of the file.
    """

    name: Name
    axis: Literal["x", "y", "z"] | None = None
    at_m: float | None = None
    points_m: tuple[Vector3, ...] = ()
    group: Text | None = None


@final
@dataclass(frozen=True, kw_only=True)
class MeshTable(BodySourceTable):
    """A film from a mesh file, its open ends closed by caps.

    Args:
        kind: tells kinds of `[body]` apart.
        file: STL or OBJ, beside the file that names it; counter-clockwise seen from outside, in the flange's
            frame. The groups of an OBJ file (`g NAME`) are those that `[[group]]` gives a film of their own.
        scale: multiplies the numbers of the file, such as 0.001 for a file in mm.
        sets: `[[body.set]]` in the file.
        tip: the set around the free end.
    """

    kind: Literal["mesh"] = "mesh"
    file: Text
    scale: Positive = 1.0
    sets: Annotated[tuple[NodeSetTable, ...], Len(min_length=2)] = field(metadata={"alias": "set"})
    tip: Name = "tip"

    def set_names(self) -> tuple[str, ...]:
        """Return the names of the node sets."""
        return tuple(entry.name for entry in self.sets)


BodySourceTable.kinds["mesh"] = MeshTable
