"""Converts the rigid objects of a scenario, and the palm of a soft robot, to objects of the MuJoCo scene."""

import math
from typing import Any, Final

import numpy as np

from cosim.base import triangle_mesh
from cosim.config.schema.objects import ObjectTable, SolidTable, mesh_path
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import ContactTable
from cosim.config.schema.soft_robot import PalmTable
from cosim.config.toml.rules import errors_at
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.rigid.build.description import Geometry, Joint, SceneObject
from cosim.rigid.build.pair_friction import PairFriction

PALM_NAME = "palm"
_OF_A_SOLID = ("shape", "size_m", "position_m", "quaternion", "convex")
_THROWN_M: Final = 2.5e-5
"""Largest displacement of a free object by the film's force within a rigid step. The film responds to an
impact as a wave, within some tenths of a millisecond: with rigid steps of 1 ms an object of 100 g loses too
much energy in a bounce, and 0.5 ms suffice."""
_PRESS_N: Final = 8.0  # force of a gripper's fingers
_MOST_SUBSTEPS: Final = 4
"""8 substeps give the same result for rolls of 50 g; a roll of 20 g came loose as a unit snapped."""


def rigid_object(entry: ObjectTable) -> SceneObject:
    """Return a scenario's object for the rigid scene.

    Raises:
        ScenarioError: its mesh cannot be read.
    """
    with errors_at(f"object.{entry.name}"):
        return SceneObject(
            name=entry.name,
            mass_kg=entry.mass_kg or 0.0,
            rgba=entry.rgba,
            friction=entry.friction,
            parts=tuple(_object_geometry(part, entry) for part in entry.parts),
            joint=_joint(entry),
            inertia=entry.inertia_kg_m2,
            center_of_mass_m=entry.center_of_mass_m or (0.0, 0.0, 0.0),
            spin_friction_m=_spin_friction(entry),
            **_solid(entry),
        )


def pair_friction(contact: ContactTable) -> PairFriction:
    """Return the rule that combines coefficients of friction, and the measured pairs."""
    pairs = tuple((*pair.between, pair.friction) for pair in contact.pairs)
    return PairFriction(contact.pair_friction, contact.film_friction, pairs)


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


def _object_geometry(part: SolidTable, entry: ObjectTable) -> Geometry:
    return Geometry(
        rgba=entry.rgba if part.rgba is None else part.rgba,
        friction=entry.friction if part.friction is None else part.friction,
        relative_density=part.relative_density,
        **_solid(part),
    )


def _solid(entry: ObjectTable | SolidTable) -> dict[str, Any]:
    """Return the arguments of a shape, which objects and their parts have in common."""
    mesh = None if entry.file is None else triangle_mesh.read_mesh(mesh_path(entry.file)).scaled(entry.scale)
    return {"mesh": mesh} | {name: getattr(entry, name) for name in _OF_A_SOLID}


def rigid_substeps(scenario: Scenario) -> int:
    """Return the number n of rigid steps per tick T, so that F (T / n)^2 / m of the lightest object is 25 um.

    It is 1 if the film touches no free object; in the iterated exchange, which solves for one step of each
    side; and with wires, whose many contacts make rigid steps slow.
    """
    free = [entry.mass_kg for entry in scenario.objects if entry.mass_kg and not (entry.hinge or entry.slide)]
    touched = (
        scenario.mode == "dynamic" and scenario.contact.enabled and scenario.coupling.scheme != "iterated"
    )
    if not touched or scenario.wires or not free:
        return 1
    longest = math.sqrt(_THROWN_M * min(free) / _PRESS_N)
    return min(_MOST_SUBSTEPS, math.ceil(scenario.clock.tick_s / longest))


def palm_object(palm: PalmTable) -> SceneObject:
    """Return the palm as an object of the rigid scene, in the flange frame."""
    return SceneObject(
        PALM_NAME, "cylinder", (palm.radius_m, palm.thickness_m), (0.0, 0.0, 0.5 * palm.thickness_m),
        mass_kg=palm.mass_kg, rgba=palm.rgba, friction=palm.friction,
        contact_time_s=palm.contact_time_s,
    )  # fmt: skip


def palm_mass(palm: PalmTable) -> MassProperties:
    """Return the palm's mass properties, flange frame: I_x = I_y = m (3 r^2 + t^2) / 12, I_z = m r^2 / 2."""
    r, t = palm.radius_m, palm.thickness_m
    across, along = palm.mass_kg * (3.0 * r * r + t * t) / 12.0, 0.5 * palm.mass_kg * r * r
    return MassProperties(palm.mass_kg, np.array([0.0, 0.0, 0.5 * t]), np.diag([across, across, along]))
