"""Finds the mesh files of a scenario's objects, and the file of its scene."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from cosim.base.resources import is_file, list_object_meshes, object_mesh_path
from cosim.config.schema.objects import ObjectTable, SceneTable, SolidTable
from cosim.config.toml.faults import UNKNOWN, Faults, copy_with, guard
from cosim.errors import ScenarioError

Solid = TypeVar("Solid", ObjectTable, SolidTable)


def mesh_path(file: str) -> Path:
    """Return where a mesh file is that `with_mesh_paths` has found."""
    return Path(file) if Path(file).is_absolute() else object_mesh_path(file)


def with_mesh_paths(
    objects: tuple[ObjectTable, ...], folder: Path, faults: Faults
) -> tuple[ObjectTable, ...]:
    """Return objects whose mesh files are absolute paths, or names of files that come with cosim.

    Args:
        objects: as in the scenario file.
        folder: of the scenario file.
        faults: gets files that are neither there nor among those that come with cosim.
    """
    found = []
    for entry in objects:
        here = entry
        with faults:
            path = f"object.{entry.name}"
            here = _found(here, folder, path, faults)
            pairs = enumerate(entry.parts, start=1)
            parts = tuple(_found(part, folder, f"{path}.part.{k}", faults) for k, part in pairs)
            here = copy_with(here, parts=parts)
        found.append(here)
    return tuple(found)


def with_scene_path(scene: SceneTable | None, folder: Path) -> SceneTable | None:
    """Return a scene whose file is an absolute path.

    Args:
        scene: as in the scenario file.
        folder: of the scenario file.

    Raises:
        ScenarioError: there is no such file.
    """
    if scene is None:
        return None
    path = folder / scene.mjcf
    if path.suffix.lower() != ".xml" or not is_file(path):
        raise ScenarioError("scene.mjcf", f"{str(path)!r} is no file that ends in .xml")
    return copy_with(scene, mjcf=str(path.resolve()))


def _found(entry: Solid, folder: Path, path: str, faults: Faults) -> Solid:
    with faults:
        return entry if entry.file is None else copy_with(entry, file=_path(entry.file, folder, path))
    unknown = copy_with(entry, file=UNKNOWN)
    guard(unknown)
    return unknown


def _path(file: str, folder: Path, path: str) -> str:
    beside = folder / file
    if is_file(beside):
        return str(beside.resolve())
    known = list_object_meshes()
    if file in known:
        return file
    raise ScenarioError(
        f"{path}.file",
        f"{file!r} is neither beside the scenario nor one of cosim's: {', '.join(known) or 'none'}",
    )
