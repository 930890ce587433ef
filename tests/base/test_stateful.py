"""Whatever changes while a run lasts can be saved: no class keeps a state that a checkpoint would miss."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "cosim"
FOLDERS = (
    "soft", "reduced", "rigid", "kinematics", "coupling", "plan", "devices", "stepping", "telemetry", "build",
)  # fmt: skip
SAVES = {"save_state", "_save_own", "_lend_factor"}
"""Any of these methods saves: its own, what a run adds to its base class, what a linear solver adds."""

SAVED_OTHERWISE = {
    "AddedInertia": "by RigidScene",
    "Arm": "the payload in its model is set anew for every payload",
    "Bodies": "by RigidScene",
    "_Step": "lives for one tick",
    "CellDrives": "where its joints are to be next, told anew before every step",
    "ChainSolver": "workspace, and what it keeps by pressure and loads",
    "ContactQuery": "poses, read anew for every search",
    "EquilibriumSolver": "iterations of the search in progress",
    "ErrorFinder": "ends of phases that this part of a run has seen; errors of other phases are left out",
    "FilmLook": "lists that are made anew where they do not serve; what is found does not depend on them",
    "FilmShapes": "figures of shapes that never change",
    "FinerMesh": "workspace of solutions after the run; each begins from the shape that it is given",
    "Flange": "its sensor's reading by RigidScene; pose and twist are read anew after every step",
    "ImplicitStepper": "coefficients of the last step, worked out anew for a step of another length",
    "InterfaceSearch": "lives for one tick",
    "LinkContacts": "how clear the arm was last; what is found does not depend on it",
    "Parts": "loads of the last command, from which they follow",
    "PatternWidening": "places of the last pairs of films, which follow from them and the last factorisation",
    "QuickStepper": "a step that a row of ticks has begun: nothing is saved while a tick is half done",
    "RelaxedWrench": "lives for one increment of statics",
    "RobotFiles": "counts the files that are read for one scenario",
    "SearchEffort": "lives for one search",
    "SectionBody": "what it keeps by pressure",
    "SelfContact": "what presses is in SoftState; lists that are made anew where they do not serve",
    "SoftHalves": "room for the ticks in progress",
    "ShiftSearch": "where a search begins; what it finds does not depend on it",
    "SoftSystem": "workspace; NewtonSolver saves the gradient, which is read later",
    "TensionSweep": "lives for one tip target of the plan",
    "TickReferences": "worked out anew from the phase",
    "_Contents": "lives while a file is read",
    "TicksTaken": "what ticks in progress leave",
    "_Watch": "lives while a run is planned",
}


def changed_attributes(kind: ast.ClassDef) -> set[str]:
    """Return the attributes of `self` that other methods than the constructor assign, whole or in part."""
    found: set[str] = set()
    for method in kind.body:
        if not isinstance(method, ast.FunctionDef) or method.name in ("__init__", "__post_init__"):
            continue
        for node in ast.walk(method):
            targets = node.targets if isinstance(node, ast.Assign) else []
            if isinstance(node, ast.AugAssign | ast.AnnAssign):
                targets = [node.target]
            for target in targets:
                for part in target.elts if isinstance(target, ast.Tuple) else [target]:
                    while isinstance(part, ast.Subscript):
                        part = part.value
                    if isinstance(part, ast.Attribute) and ast.unparse(part.value) == "self":
                        found.add(part.attr)
    return found


def unsaved(source: str) -> Iterator[str]:
    """Yield the classes that change and do not save."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            methods = {entry.name for entry in node.body if isinstance(entry, ast.FunctionDef)}
            if changed_attributes(node) and not methods & SAVES:
                yield node.name


@pytest.mark.parametrize("folder", FOLDERS)
def test_what_changes_is_saved(folder: str) -> None:
    paths = sorted((PACKAGE / folder).rglob("*.py"))
    found = {name for path in paths for name in unsaved(path.read_text(encoding="utf-8"))}
    # give the class save_state() and restore_state(), and let the one that owns it call them
    assert found <= set(SAVED_OTHERWISE)


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        ("self.a = 1", True),
        ("self.a[3] += 1", True),
        ("b, self.a = 1, 2", True),
        ("a[self.b] = 1", False),
        ("b = self.a", False),
    ],
)
def test_the_rule_finds_changes(body: str, changes: bool) -> None:
    assert list(unsaved(f"class A:\n    def act(self):\n        {body}\n")) == ["A"] * changes


def test_the_list_of_exceptions_is_current() -> None:
    texts = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")]
    assert set(SAVED_OTHERWISE) <= {name for text in texts for name in unsaved(text)}
