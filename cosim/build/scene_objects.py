"""Rigid objects of a scenario, and the palm of a soft robot, as the rigid side wants them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from cosim.base.triangle_mesh import TriangleMesh, read_mesh
from cosim.build.blame import blamed_on
from cosim.config.schema.mesh_paths import mesh_path
from cosim.config.schema.objects import ObjectTable, SolidTable
from cosim.config.schema.soft_robot import PalmTable
from cosim.config.schema.wire import WireTable
from cosim.coupling.soft_sides.soft_side import MassProperties
from cosim.rigid.build.description import SceneObject
from cosim.rigid.build.geometry import Geometry
from cosim.rigid.build.joint import Joint
from cosim.rigid.build.wire import Wire

PALM_NAME = "palm"


def rigid_object(entry: ObjectTable) -> SceneObject:
    """Return a scenario's object for the rigid scene."""
    with blamed_on(f"object.{entry.name}"):
        return SceneObject(
            name=entry.name,
            shape=entry.shape,
            size_m=entry.size_m,
            position_m=entry.position_m,
            quaternion=entry.quaternion,
            mass_kg=entry.mass_kg or 0.0,
            rgba=entry.rgba,
            friction=entry.friction,
            mesh=_mesh(entry),
            convex=entry.convex,
            parts=tuple(_geometry(part, entry) for part in entry.parts),
            joint=_joint(entry),
            inertia=entry.inertia_kg_m2,
            center_of_mass_m=entry.center_of_mass_m or (0.0, 0.0, 0.0),
            spin_friction_m=_spin_friction(entry),
        )


def rigid_wire(entry: WireTable) -> Wire:
    """Return a scenario's wire for the rigid scene."""
    with blamed_on(f"wire.{entry.name}"):
        return Wire(**{field.name: getattr(entry, field.name) for field in fields(entry)})


def _spin_friction(entry: ObjectTable) -> tuple[float, float] | None:
    torsional, rolling = entry.torsional_friction_m, entry.rolling_friction_m
    return None if torsional is None and rolling is None else (torsional or 0.0, rolling or 0.0)


def _joint(entry: ObjectTable) -> Joint | None:
    if (hinge := entry.hinge) is not None:
        return Joint(
            "hinge", hinge.axis, hinge.anchor_m, hinge.parent, hinge.range_rad,
            hinge.damping_Nms, hinge.stiffness_Nm, hinge.friction_Nm,
        )  # fmt: skip
    if (slide := entry.slide) is not None:
        return Joint(
            "slide", slide.axis, entry.position_m, slide.parent, slide.range_m,
            slide.damping_Ns_m, slide.stiffness_N_m, slide.friction_N,
        )  # fmt: skip
    return None


def _geometry(part: SolidTable, entry: ObjectTable) -> Geometry:
    return Geometry(
        shape=part.shape,
        size_m=part.size_m,
        position_m=part.position_m,
        quaternion=part.quaternion,
        rgba=entry.rgba if part.rgba is None else part.rgba,
        friction=entry.friction if part.friction is None else part.friction,
        relative_density=part.relative_density,
        mesh=_mesh(part),
        convex=part.convex,
    )


def _mesh(entry: ObjectTable | SolidTable) -> TriangleMesh | None:
    return None if entry.file is None else read_mesh(mesh_path(entry.file)).scaled(entry.scale)


def palm_object(palm: PalmTable) -> SceneObject:
    """Return the plate in the flange frame."""
    return SceneObject(
        PALM_NAME, "cylinder", (palm.radius_m, palm.thickness_m), (0.0, 0.0, 0.5 * palm.thickness_m),
        mass_kg=palm.mass_kg, rgba=palm.rgba, friction=palm.friction,
    )  # fmt: skip


def palm_mass(palm: PalmTable) -> MassProperties:
    """Return the plate's mass in the flange frame; I_x = I_y = m (3 r^2 + t^2) / 12, I_z = m r^2 / 2."""
    r, t = palm.radius_m, palm.thickness_m
    across, along = palm.mass_kg * (3.0 * r * r + t * t) / 12.0, 0.5 * palm.mass_kg * r * r
    return MassProperties(palm.mass_kg, np.array([0.0, 0.0, 0.5 * t]), np.diag([across, across, along]))
