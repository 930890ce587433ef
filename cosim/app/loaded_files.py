"""What a run was loaded from: a digest of the scenario, and of each file that it names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path

from cosim.app.run_files import SCENARIO
from cosim.build.arms import find_arm
from cosim.build.cells import cell_of
from cosim.config.schema.mesh_paths import mesh_path
from cosim.config.schema.objects import ObjectTable, SolidTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.writing import scenario_text


def loaded_digests(scenario: Scenario) -> dict[str, str]:
    """Return SHA-256 digests by names of files: of the scenario as it was loaded, of meshes and the arm.

    Args:
        scenario: checked; soft robots' files are part of it.

    Raises:
        InputError: the arm is not found.
    """
    found = {SCENARIO: sha256(scenario_text(scenario).encode()).hexdigest()}
    for name, path in (*_meshes(scenario), *_arm_files(scenario.robot), *_cell_files(scenario)):
        found[name] = sha256(path.read_bytes()).hexdigest() if path.is_file() else "absent"
    return found


def changed_file(before: Mapping[str, str], now: Mapping[str, str]) -> str | None:
    """Return the name of a file that differs; None where none does."""
    return next((name for name in sorted({*before, *now}) if before.get(name) != now.get(name)), None)


def _meshes(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    solids: list[ObjectTable | SolidTable] = [*scenario.objects]
    for entry in scenario.objects:
        solids += entry.parts
    for solid in solids:
        if solid.file is not None:
            yield solid.file, mesh_path(solid.file)


def _arm_files(robot: str) -> Iterator[tuple[str, Path]]:
    """Yield the files of an arm, named below the arm: they may be installed anywhere."""
    if robot == NO_ARM:
        return
    arm = find_arm(robot)
    for path in arm.files:
        folder = "" if path.parent == arm.path.parent else f"{path.parent.name}/"
        yield f"{arm.name}/{folder}{path.name}", path


def _cell_files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    if scenario.scene is not None:
        for path in cell_of(scenario.scene).files:
            yield f"scene/{path.name}", path
