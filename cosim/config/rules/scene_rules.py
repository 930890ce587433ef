"""Rules on the objects of a scenario, its cell, and what holds and loads a soft robot.

Rules that tie several values of a scenario's objects together.

Rules on what holds and loads a soft robot: rings, supports, forces, with and without an arm.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from cosim.base.triangle_mesh import read_mesh
from cosim.config.schema.objects import HingeJointTable, ObjectTable, SolidTable, WireTable, mesh_path
from cosim.config.schema.phase import ForceTable, PhaseTable, SupportTable, matching
from cosim.config.schema.scenario import NO_ARM, AnySoftRobot, Scenario
from cosim.config.toml.keys import listing, unknown_name_message
from cosim.config.toml.reading import Faults
from cosim.errors import MeshError, ScenarioError

SMALLEST_MESH_m: Final = 1e-6
LARGEST_MESH_m: Final = 100.0
LEAST_INERTIA_kg_m2: Final = 1e-15  # that MuJoCo takes
_SIZE_ENTRIES: Final = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 0}


def check_objects(scenario: Scenario, faults: Faults) -> None:
    """Check the objects and wires of a scenario, one by one and together.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    objects = scenario.objects
    with faults:
        for entry in objects:
            with faults:
                check_object(entry, f"object.{entry.name}", faults)
    names = tuple(entry.name for entry in objects)
    for entry in objects:
        with faults:
            _check_joint(entry, names, f"object.{entry.name}", faults)
    with faults:
        for wire in scenario.wires:
            with faults:
                _check_wire(wire, names, f"wire.{wire.name}", faults)
    parents = {entry.name: joint.parent for entry in objects if (joint := entry.hinge or entry.slide)}
    for name in names:
        with faults:
            _check_line(name, parents)


def _check_joint(entry: ObjectTable, names: tuple[str, ...], path: str, faults: Faults) -> None:
    if entry.hinge is not None and entry.slide is not None:
        raise ScenarioError(f"{path}.slide", "cannot stand beside hinge; an object has one joint")
    joint, key = entry.hinge or entry.slide, "hinge" if entry.hinge is not None else "slide"
    if joint is None:
        return
    with faults:
        if entry.mass_kg is None:
            raise ScenarioError(f"{path}.mass_kg", f"is missing; what hangs on a {key} needs mass")
    with faults:
        if joint.parent is not None and joint.parent not in names:
            raise ScenarioError(f"{path}.{key}.parent", unknown_name_message("object", joint.parent, names))
    unit = "rad" if isinstance(joint, HingeJointTable) else "m"
    limits = joint.range_rad if isinstance(joint, HingeJointTable) else joint.range_m
    if limits is not None and not (limits[0] <= 0.0 <= limits[1] and limits[0] < limits[1]):
        raise ScenarioError(
            f"{path}.{key}.range_{unit}", f"{list(limits)} must increase and hold 0, where the object starts"
        )


def _check_line(name: str, parents: dict[str, str | None]) -> None:
    """Follow the parents from an object on; none may come twice."""
    line = [name]
    while (parent := parents.get(line[-1])) is not None:
        if parent in line:
            raise ScenarioError(f"object.{name}", f"hangs on itself: {' on '.join([*line, parent])}")
        line.append(parent)


def _check_wire(wire: WireTable, names: tuple[str, ...], path: str, faults: Faults) -> None:
    for key in ("first", "last"):
        with faults:
            held = getattr(wire, key)
            if held is not None and held not in names:
                raise ScenarioError(f"{path}.{key}", unknown_name_message("object", held, names))
    points = np.array(wire.points_m)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if length / wire.segments <= 2.0 * wire.radius_m:
        most = int(length / (2.0 * wire.radius_m))
        raise ScenarioError(
            f"{path}.segments",
            f"{wire.segments} segments of {length:.3g} m are not longer than thick; fewer than {most} are",
        )
    least = LEAST_INERTIA_kg_m2 / (0.4 * wire.radius_m**2) * wire.segments
    if wire.mass_kg <= least:
        raise ScenarioError(
            f"{path}.mass_kg",
            f"{wire.mass_kg:g} is too light for {wire.segments} segments that thin, which would spin without "
            f"inertia; must be above {least:.3g}",
        )


def check_object(entry: ObjectTable, path: str, faults: Faults) -> None:
    """Check one object.

    Args:
        entry: may hold UNKNOWN.
        path: of its table.
        faults: gets the rules that are broken.
    """
    with faults:
        if entry.shape is None and not entry.parts:
            raise ScenarioError(path, "give a shape, or [[object.part]] tables; neither is given")
    with faults:
        _check_inertia(entry, path)
    solids: list[tuple[str, ObjectTable | SolidTable]] = [(path, entry)]
    solids += [(f"{path}.part.{k}", part) for k, part in enumerate(entry.parts, start=1)]
    for where, solid in solids:
        for check in (_check_size, _check_mesh):
            with faults:
                check(solid, where)


def _check_inertia(entry: ObjectTable, path: str) -> None:
    inertia = entry.inertia_kg_m2
    if inertia is None:
        if entry.center_of_mass_m is not None:
            raise ScenarioError(f"{path}.center_of_mass_m", "goes with inertia_kg_m2; none is given")
        return
    if entry.mass_kg is None:
        raise ScenarioError(f"{path}.mass_kg", "is missing; what has inertia_kg_m2 needs mass")
    if 2.0 * max(inertia) > sum(inertia):
        raise ScenarioError(
            f"{path}.inertia_kg_m2",
            f"{list(inertia)} is of no body: the largest must not be above the sum of the other two",
        )


def _check_size(entry: ObjectTable | SolidTable, path: str) -> None:
    if entry.shape is None:
        if entry.size_m:
            raise ScenarioError(f"{path}.size_m", "goes with a shape; none is given")
    elif len(entry.size_m) != _SIZE_ENTRIES[entry.shape]:
        raise ScenarioError(
            f"{path}.size_m",
            f"has {len(entry.size_m)} entries; a {entry.shape} has {_SIZE_ENTRIES[entry.shape]}",
        )


def _check_mesh(entry: ObjectTable | SolidTable, path: str) -> None:
    if entry.shape != "mesh":
        if entry.file is not None:
            raise ScenarioError(f"{path}.file", "goes with shape = 'mesh'")
        return
    if entry.file is None:
        raise ScenarioError(f"{path}.file", "is missing; a mesh needs an .stl or .obj file")
    try:
        mesh = read_mesh(mesh_path(entry.file))
    except MeshError as error:
        raise ScenarioError(f"{path}.file", str(error)) from error
    size = entry.scale * float(np.abs(mesh.vertices).max())
    if not SMALLEST_MESH_m <= size <= LARGEST_MESH_m:
        raise ScenarioError(
            f"{path}.scale",
            f"{entry.scale:g} makes the mesh reach {size:g} m from its origin; must be within "
            f"{SMALLEST_MESH_m:g} and {LARGEST_MESH_m:g} m",
        )


CELL_KEYS: Final = ("cell_shift_m", "cell_angle_rad", "cell_speed_m_s", "cell_speed_rad_s")
"""Keys of a phase that drive joints of the cell."""


def check_cell(scenario: Scenario, faults: Faults) -> None:
    """Check that what is driven is there, in a run that has time.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    for phase in scenario.phases:
        for key in CELL_KEYS:
            with faults:
                if getattr(phase, key) is None:
                    continue
                path = f"phase.{phase.name}.{key}"
                if scenario.scene is None:
                    raise ScenarioError(path, "needs a cell with a joint of that name: [scene] mjcf")
                if scenario.mode == "quasistatic":
                    raise ScenarioError(path, "needs mode = 'dynamic': in statics a cell stands still")


_MOTIONS = ("flange", "flange_turn", "flange_shift_m", "tip_path")


def check_holding(scenario: Scenario, faults: Faults) -> None:
    """Check rings, supports and forces of all phases, and what a scenario without an arm cannot have.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        if scenario.robot == NO_ARM and scenario.objects:
            raise ScenarioError("object", f"needs an arm; robot is '{NO_ARM}'")
    for key in ("scene", "arm_base"):
        with faults:
            if scenario.robot == NO_ARM and getattr(scenario, key) is not None:
                raise ScenarioError(key, f"needs an arm; robot is '{NO_ARM}'")
    for phase in scenario.phases:
        with faults:
            _check_named(phase, scenario.soft_robot, f"phase.{phase.name}", faults)
        with faults:
            _check_carrier(phase, scenario.robot, f"phase.{phase.name}", faults)
    robot = scenario.soft_robot
    held, supported = expanded(robot.base, robot), False
    for phase in scenario.phases:
        path = f"phase.{phase.name}"
        with faults:
            _check_release(phase, held, robot, path)
        held = held - expanded(phase.release, robot) | expanded(phase.clamp, robot)
        supported = supported or bool(phase.supports)
        if not held and not supported:
            raise ScenarioError(f"{path}.release", "lets go of all that holds the soft robot; support it")


def _check_named(phase: PhaseTable, robot: AnySoftRobot, path: str, faults: Faults) -> None:
    """Check that the rings and corners that a phase names exist."""
    for key in ("release", "clamp"):
        with faults:
            check_rings(getattr(phase, key), robot, f"{path}.{key}")
    for key, groups in (("support", "supports"), ("force", "forces")):
        with faults:
            for place, group in enumerate(getattr(phase, groups), start=1):
                with faults:
                    _check_group(group, robot, f"{path}.{key}.{place}")


def check_rings(rings: Iterable[str], robot: AnySoftRobot, path: str) -> None:
    """Check that rings, or patterns of rings, exist.

    Raises:
        ScenarioError: one does not; the message lists those that do.
    """
    known = robot.ring_names()
    for ring in rings:
        if not matching(ring, known):
            raise ScenarioError(path, unknown_name_message("ring", ring, known))


def expanded(rings: Iterable[str], robot: AnySoftRobot) -> set[str]:
    """Return the names of the rings that names and patterns stand for."""
    known = robot.ring_names()
    return {name for ring in rings for name in matching(ring, known)}


def _check_group(group: SupportTable | ForceTable, robot: AnySoftRobot, path: str) -> None:
    check_rings(group.rings, robot, f"{path}.rings")
    if group.corners is None:
        return
    if not group.corners:
        raise ScenarioError(f"{path}.corners", "is empty; leave it out for all nodes of the rings")
    sides = min(robot.sides_of(ring) for ring in expanded(group.rings, robot))
    if not sides:
        raise ScenarioError(f"{path}.corners", "are of stacks of units; name a ring of these nodes alone")
    for corner in group.corners:
        if not 0 <= corner < sides:
            raise ScenarioError(f"{path}.corners", f"{corner} does not exist; corners 0 to {sides - 1} do")


def _check_carrier(phase: PhaseTable, robot: str, path: str, faults: Faults) -> None:
    """Check that a phase asks for motion only of an arm, and for supports only without one."""
    if robot != NO_ARM:
        if phase.supports:
            raise ScenarioError(
                f"{path}.support",
                f"needs robot = '{NO_ARM}'; on an arm, use clamp",
            )
        return
    for key in _MOTIONS:
        with faults:
            if getattr(phase, key) is not None:
                raise ScenarioError(
                    f"{path}.{key}", f"needs an arm; robot is '{NO_ARM}', which holds the base"
                )
    if phase.tip_target is not None and phase.tip_target.reach_with != "cables":
        raise ScenarioError(
            f"{path}.tip_target.reach_with", f"must be 'cables': robot is '{NO_ARM}', which holds the base"
        )


def _check_release(phase: PhaseTable, held: set[str], robot: AnySoftRobot, path: str) -> None:
    for ring in phase.release:
        if not expanded([ring], robot) <= held:
            raise ScenarioError(f"{path}.release", f"'{ring}' is not held; held are: {listing(sorted(held))}")
