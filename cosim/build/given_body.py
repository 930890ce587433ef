"""A soft body that is given from Python as arrays, with the names that a scenario uses for it."""

from dataclasses import dataclass, replace
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base import identity
from cosim.config.schema import given_body, soft_robot
from cosim.config.toml import parsing
from cosim.config.toml.rules import Faults
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry.surface import check_mesh

LEAST_RING: Final = 3


@final
@dataclass(frozen=True)
class NamedBody:
    """A soft body with the names that a scenario uses for it and its cables.

    Args:
        body: in the flange's frame; a film that holds gas is closed by caps. Its base and tip are rings
            "base" and "tip", unless it has rings of these names.
        name: of the body.
        cable_names: of its cables, in order; omitted: cable_1, cable_2, ...

    Raises:
        MeshError: the film is not a sound surface, the base is empty, the tip is not a ring, a node has no
            mass, or the number of names is not that of cables.
        ScenarioError: a name has characters that are not allowed.
    """

    body: SoftBody
    name: str = "body"
    cable_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        body = self.body
        check_mesh(body.positions, body.triangles)
        if not len(body.base):
            raise MeshError("the soft body has no base: no node would follow the flange")
        if len(body.tip) < LEAST_RING:
            raise MeshError(f"the tip has {len(body.tip)} nodes; a ring of {LEAST_RING} is needed at least")
        light = np.flatnonzero(body.node_mass < soft_robot.LEAST_NODE_MASS_kg)
        if light.size:
            raise MeshError(
                f"node {light[0]} has a mass of {body.node_mass[light[0]]:g} kg; every node needs "
                f"{soft_robot.LEAST_NODE_MASS_kg:g} kg at least"
            )
        names = self.cable_names or tuple(f"cable_{k + 1}" for k in range(len(body.cables)))
        if len(names) != len(body.cables) or len(set(names)) < len(names):
            raise MeshError(f"cable_names are {list(names)}; {len(body.cables)} names that differ are needed")
        rings = {"base": body.base, "tip": body.tip, **body.rings}
        object.__setattr__(self, "cable_names", names)
        object.__setattr__(self, "body", replace(body, rings=rings))
        self.table()

    @classmethod
    def of(cls, body: "SoftBody | NamedBody") -> "NamedBody":
        """Return a body with names; a `SoftBody` gets the default ones."""
        return body if isinstance(body, NamedBody) else cls(body)

    def table(self) -> given_body.GivenBodyTable:
        """Return the table of names that a scenario may use."""
        body = self.body
        described = {
            "name": self.name,
            "arrays": identity.content_name(body),
            "triangles": len(body.triangles),
            "closed": body.closed,
            "rings": list(body.rings),
            "base": [name for name, ring in body.rings.items() if np.isin(ring, body.base).all()],
            "cables": list(self.cable_names),
            "chambers": [chamber.name for chamber in body.gas_chambers],
        }
        return parsing.parse(given_body.GivenBodyTable, described, "body", Faults())


AnyBody: TypeAlias = SoftBody | NamedBody
"""A body that Python may give in place of a scenario's soft robot."""
