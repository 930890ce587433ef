"""Finds the mesh files of a scenario's objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from cosim.base.resources import is_file, list_object_meshes, object_mesh_path
from cosim.config.schema.objects import ObjectTable, SolidTable
from cosim.errors import ScenarioError

Solid = TypeVar("Solid", ObjectTable, SolidTable)


def mesh_path(file: str) -> Path:
    """Return where a mesh file is that `with_mesh_paths` has found."""
    return Path(file) if Path(file).is_absolute() else object_mesh_path(file)


def with_mesh_paths(objects: tuple[ObjectTable, ...], folder: Path) -> tuple[ObjectTable, ...]:
    """Return objects whose mesh files are absolute paths, or names of files that come with cosim.

    Args:
        objects: as in the scenario file.
        folder: of the scenario file.

    Raises:
        ScenarioError: a file is neither there nor among those that come with cosim.
    """
    found = []
    for entry in objects:
        path = f"object.{entry.name}"
        parts = tuple(_found(p, folder, f"{path}.part.{k}") for k, p in enumerate(entry.parts, start=1))
        found.append(replace(_found(entry, folder, path), parts=parts))
    return tuple(found)


def _found(entry: Solid, folder: Path, path: str) -> Solid:
    if entry.file is None:
        return entry
    beside = folder / entry.file
    if is_file(beside):
        return replace(entry, file=str(beside.resolve()))
    known = list_object_meshes()
    if entry.file in known:
        return entry
    raise ScenarioError(
        f"{path}.file",
        f"{entry.file!r} is neither beside the scenario nor one of cosim's: {', '.join(known) or 'none'}",
    )
