"""Rigid objects of a scenario as the rigid side wants them."""

from __future__ import annotations

from cosim.rigid.description import SceneObject
from cosim.scenario.object_schema import SceneObject as SceneObjectSchema


def rigid_object(entry: SceneObjectSchema) -> SceneObject:
    """Return a scenario's object for the rigid scene."""
    return SceneObject(
        name=entry.name,
        shape=entry.shape,
        size_m=entry.size_m,
        position_m=entry.position_m,
        quaternion=entry.quaternion,
        mass_kg=entry.mass_kg or 0.0,
        rgba=entry.rgba,
        friction=entry.friction,
    )
