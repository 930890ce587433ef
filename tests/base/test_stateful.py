"""Whatever changes while a run lasts can be saved: no class keeps a state that a checkpoint would miss."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from cosim.app.preparation import build_simulation
from tests.devices import device_parts

PACKAGE = Path(__file__).resolve().parents[2] / "cosim"
FOLDERS = (
    "soft", "reduced", "rigid", "kinematics", "coupling", "plan", "devices", "stepping", "telemetry", "build",
)  # fmt: skip
ROOMS = "cosim.devices", "cosim.plan"
"""Whose objects are among the parts of the commands."""
SAVES = {"state", "full_state", "save_state", "_lend_factor"}
"""Any of these saves: a property, a method, what a linear solver adds."""

SAVED_OTHERWISE = {
    "AddedInertia": "by RigidScene",
    "ArmServos": "torques of the last step, by RigidScene",
    "Arm": "the payload in its model is set anew for every payload",
    "Bodies": "by RigidScene",
    "_Step": "lives for one tick",
    "BodyEnds": "filled by every step; what it hands over by Interface",
    "Cameras": "its renderer",
    "CarriedInertia": "by StaggeredCoupling",
    "CellDrives": "where its joints are to be next, told anew before every step",
    "ChainLoads": "what it keeps by loads and pressure",
    "ChainStepper": "schemes by length of step",
    "ContactQuery": "poses, read anew for every search",
    "EquilibriumSolver": "iterations of the search in progress",
    "_BehindSearch": "neighbour lists, made again when out of date; what it finds is the same",
    "Factor": "by NewtonSolver",
    "FilmLists": "lists that are made again where they are out of date; what they find is the same",
    "Flange": "its sensor's reading by RigidScene",
    "Stepper": "coefficients of the last step, worked out anew for a step of another length",
    "Foresight": "filled anew in every tick",
    "InterfaceSearch": "lives for one tick",
    "LineStream": "what has come from a robot; a twin is not saved",
    "LinkContacts": "how clear the arm was last; what is found does not depend on it",
    "MountedFrame": "pose and twist are read anew after every step",
    "NewtonProgress": "lives for one solution",
    "NearSearch": "lists that are made again where they are out of date; what they find is the same",
    "Parts": "loads of the last command, from which they follow",
    "PatternWidening": "places of the last pairs of films, which follow from them and the last factorisation",
    "PlannedCommands": "references of the present phase, worked out anew; its parts have what it depends on",
    "RelaxedWrench": "lives for one increment of statics",
    "RobotFiles": "counts the files that are read for one scenario",
    "RtdeStream": "what has come from a robot; a twin is not saved",
    "SceneCarrier": "the exchange by the carriers that derive from it",
    "SharedScene": "a run of several arms is not saved",
    "SceneRenderer": "poses, set again for every picture",
    "SearchEffort": "lives for one search",
    "SectionBody": "what it keeps by pressure",
    "SelfContact": "what presses is in SoftState; lists that are made anew where they do not serve",
    "ShiftSearch": "where a search begins; what it finds does not depend on it",
    "FilmPotential": "workspace; NewtonSolver saves the gradient, which is read later",
    "StepLoads": "what it has applied for the length of a step of MuJoCo",
    "StepsInProgress": "loads of steps of MuJoCo that are in progress; nothing is saved inside of one",
    "Stream": "what has come from a robot; a twin is not saved",
    "Streams": "what has come from a robot; a twin is not saved",
    "SceneOfArms": "of runs of several arms, which are not saved",
    "StrainRates": "what a step begins with, filled anew for every step",
    "TensionSweep": "lives for one tip target of the plan",
    "TickReferences": "worked out anew from the phase",
    "_Contents": "lives while a file is read",
    "TicksTaken": "what ticks in progress leave",
    "TickWork": "lives for one tick",
    "_PairDistances": "lives while a run is planned",
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


def of_others(source: str, method: str, context: type[ast.expr_context]) -> Counter[str]:
    """Return how often methods of a name read, or set, attributes of other objects than their own."""
    return Counter(
        part.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name == method
        for part in ast.walk(node)
        if isinstance(part, ast.Attribute)
        if isinstance(part.ctx, context) and ast.unparse(part.value) != "self"
    )


def unsaved(source: str) -> Iterator[tuple[str, set[str]]]:
    """Yield the classes that change and have no `state` or way to save, with the attributes that change."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            methods = {entry.name for entry in node.body if isinstance(entry, ast.FunctionDef)}
            has_state = any(ast.unparse(part) == "self.state" for part in ast.walk(node))
            if (changed := changed_attributes(node)) and not has_state and not methods & SAVES:
                yield node.name, changed


def unsaved_in(sources: Iterable[str]) -> set[str]:
    """Return the classes of a room that change, and that neither save nor have an owner that does.

    An owner saves a class that keeps all that changes in one public attribute: it reads that in save_state()
    and sets it in restore_state(), once for each class that has such an attribute.
    """
    source = "\n".join(sources)
    kept = of_others(source, "save_state", ast.Load) & of_others(source, "restore_state", ast.Store)
    found = list(unsaved(source))
    having = Counter(name for _, changed in found if len(changed) == 1 for name in changed)
    owned = {name for name, count in having.items() if not name.startswith("_") and count <= kept[name]}
    return {name for name, changed in found if len(changed) > 1 or not changed <= owned}


@pytest.mark.parametrize("folder", FOLDERS)
def test_what_changes_is_saved(folder: str) -> None:
    paths = sorted((PACKAGE / folder).rglob("*.py"))
    found = unsaved_in(path.read_text(encoding="utf-8") for path in paths)
    # let the class keep what changes in one attribute, `state`, and name it among the parts of a run
    assert found <= set(SAVED_OTHERWISE)


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        ("self.a = 1", True),
        ("self.a[3] += 1", True),
        ("b, self.a = 1, 2", True),
        ("a[self.b] = 1", False),
        ("b = self.a", False),
        ("self.state = 1", False),
    ],
)
def test_the_rule_finds_changes(body: str, changes: bool) -> None:
    assert unsaved_in([f"class A:\n    def act(self):\n        {body}\n"]) == ({"A"} if changes else set())


def within(owner: Any) -> dict[int, Any]:
    """Return the objects of cosim within one, by identity."""
    found: dict[int, Any] = {}
    waiting = [owner]
    while waiting:
        here = waiting.pop()
        if isinstance(here, Mapping):
            waiting += here.values()
        elif isinstance(here, list | tuple):
            waiting += here
        elif type(here).__module__.startswith("cosim.") and id(here) not in found:
            found[id(here)] = here
            waiting += vars(here).values() if hasattr(here, "__dict__") else ()
    return found


def leaves(parts: Any) -> list[Any]:
    """Return the parts in a dictionary or sequence of them."""
    if isinstance(parts, Mapping):
        parts = [*parts.values()]
    return [leaf for part in parts for leaf in leaves(part)] if isinstance(parts, list) else [parts]


def test_every_state_of_the_commands_is_among_their_parts(tmp_path: Path) -> None:
    sensor = '[[sensor]]\nname = "angle"\nkind = "bending_angle"\n'
    devices = device_parts.PUMP, device_parts.WINCH, device_parts.CONTROLLER, sensor
    run = build_simulation(device_parts.scenario(tmp_path, *devices, device_parts.INFLATE))
    commands, parts = run._parts.commands, leaves(run._parts.commands.parts())
    named, kinds = {id(part) for part in parts}, {type(part).__name__ for part in parts}
    having = [each for each in within(commands).values() if type(each).__module__.startswith(ROOMS)]
    missing = [type(each).__name__ for each in having if hasattr(each, "state") and id(each) not in named]
    assert not missing
    assert kinds == {
        "ChamberGas", "CableDrive", "PumpDrive", "ZeroOrderHold", "Actuation", "FlangeOffset", "Sensors",
        "LiveCommands",
    }  # fmt: skip


CHANGING = "class {}:\n    def act(self):\n        self.{} = 1\n"
OWNER = """class Owner:
    def save_state(self):
        return {}

    def restore_state(self, state):
        {} = state
"""


@pytest.mark.parametrize(
    ("sources", "found"),
    [
        ([CHANGING.format("A", "held"), OWNER.format("self.a.held", "self.a.held")], set()),
        ([CHANGING.format("A", "_held"), OWNER.format("self.a._held", "self.a._held")], {"A"}),
        ([CHANGING.format("A", "held"), OWNER.format("self.a.other", "self.a.held")], {"A"}),
        ([CHANGING.format("A", "held"), OWNER.format("self.a.held", "self.a.other")], {"A"}),
        ([CHANGING.format("A", "held = self.b"), OWNER.format("self.a.held", "self.a.held")], {"A"}),
        ([CHANGING.format("A", "held"), OWNER.format("self.held", "self.held")], {"A"}),
        (
            [
                CHANGING.format("A", "held"),
                CHANGING.format("B", "held"),
                OWNER.format("self.a.held", "self.a.held"),
            ],
            {"A", "B"},
        ),
    ],
)
def test_an_owner_saves_what_it_reads_and_sets_for_each_class(sources: list[str], found: set[str]) -> None:
    assert unsaved_in(sources) == found


def test_the_list_of_exceptions_is_current() -> None:
    texts = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")]
    assert set(SAVED_OTHERWISE) <= {name for text in texts for name, _ in unsaved(text)}
