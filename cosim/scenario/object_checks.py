"""Rules that tie several values of a scenario's objects together."""

from __future__ import annotations

from typing import Final

from cosim.errors import MeshError, ScenarioError
from cosim.mesh_files import read_mesh
from cosim.scenario.mesh_lookup import mesh_path
from cosim.scenario.object_schema import Part, SceneObject

_SIZE_ENTRIES: Final = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 0}


def check_object(entry: SceneObject, path: str) -> None:
    """Check one object; `path` is that of its table.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    if entry.shape is None and not entry.parts:
        raise ScenarioError(path, "give a shape, or [[object.part]] tables; neither is given")
    _check_solid(entry, path)
    for index, part in enumerate(entry.parts, start=1):
        _check_solid(part, f"{path}.part.{index}")


def _check_solid(entry: SceneObject | Part, path: str) -> None:
    if entry.shape is None:
        if entry.size_m:
            raise ScenarioError(f"{path}.size_m", "goes with a shape; none is given")
    elif len(entry.size_m) != _SIZE_ENTRIES[entry.shape]:
        raise ScenarioError(
            f"{path}.size_m",
            f"has {len(entry.size_m)} entries; a {entry.shape} has {_SIZE_ENTRIES[entry.shape]}",
        )
    if entry.shape != "mesh":
        if entry.file is not None:
            raise ScenarioError(f"{path}.file", "goes with shape = 'mesh'")
        return
    if entry.file is None:
        raise ScenarioError(f"{path}.file", "is missing; a mesh needs an .stl or .obj file")
    try:
        read_mesh(mesh_path(entry.file))
    except MeshError as error:
        raise ScenarioError(f"{path}.file", str(error)) from error
