"""Soft bodies that are given from Python, as arrays, in place of a scenario's soft robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base.identity import content_name
from cosim.config.rules.scenario_rules import LEAST_NODE_MASS_kg
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.parsing import parse
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry.surface import check_mesh

LEAST_RING: Final = 3


@final
@dataclass(frozen=True)
class NamedBody:
    """A soft body with the names that a scenario calls it and its cables by.

    Args:
        body: in the flange's frame; its film closed by caps where it holds gas. Its base and tip are rings
            "base" and "tip", unless it has rings of these names.
        name: of the body.
        cable_names: of its cables, in order; omitted: cable_1, cable_2, ...

    Raises:
        MeshError: the film is no sound surface, the base is empty, the tip no ring, a node has no mass, or
            there are more or fewer names than cables.
        ScenarioError: a name cannot be one.
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
        light = np.flatnonzero(body.node_mass < LEAST_NODE_MASS_kg)
        if light.size:
            raise MeshError(
                f"node {light[0]} has a mass of {body.node_mass[light[0]]:g} kg; every node needs "
                f"{LEAST_NODE_MASS_kg:g} kg at least"
            )
        names = self.cable_names or tuple(f"cable_{k + 1}" for k in range(len(body.cables)))
        if len(names) != len(body.cables) or len(set(names)) < len(names):
            raise MeshError(f"cable_names are {list(names)}; {len(body.cables)} names that differ are needed")
        rings = {"base": body.base, "tip": body.tip, **body.rings}
        object.__setattr__(self, "cable_names", names)
        object.__setattr__(self, "body", replace(body, rings=rings))
        self.table()

    @classmethod
    def of(cls, body: SoftBody | NamedBody) -> NamedBody:
        """Return a body with names, the usual ones where it has none."""
        return body if isinstance(body, NamedBody) else cls(body)

    def table(self) -> GivenBodyTable:
        """Return what a scenario may name of it."""
        body, faults = self.body, Faults()
        described = {
            "name": self.name,
            "arrays": content_name(body),
            "triangles": len(body.triangles),
            "closed": body.closed,
            "rings": list(body.rings),
            "base": [name for name, ring in body.rings.items() if np.isin(ring, body.base).all()],
            "cables": list(self.cable_names),
            "chambers": [chamber.name for chamber in body.gas_chambers],
        }
        found = parse(GivenBodyTable, described, "body", faults)
        faults.tell()
        return found


AnyBody: TypeAlias = SoftBody | NamedBody
"""What may be given in place of a scenario's soft robot."""
