"""Candidates of a trade that differ in what is modelled: models, and switches of what a run leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, get_args, get_type_hints

from cosim.config.rules.given_body_rules import file_of
from cosim.config.rules.size_rules import triangle_count
from cosim.config.schema.film import FilmTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.telemetry.choices import CONTACT
from cosim.trade.candidate import Candidate

_TICK_S: Final = 0.01
_SUBSTEP_ERROR_M: Final = 2e-5
_LAW: Final = "soft_robot.film.law"
_AS_IN_FILE: Final[dict[str, Any]] = {"model.published": False}
_TRIANGLES_MAX: Final = 5000  # of the truth: beyond, its run takes hours


def model_candidates(scenario: Scenario, fidelities: tuple[str, ...], *, quick: bool) -> list[Candidate]:
    """Return what is modelled otherwise, all at one tick, so that errors of time stepping nearly cancel.

    That tick is long, as the reference is dear; where something can move it is the scenario's own, as
    a grasp does not stand long ones. What the scenario's targets need is planned once, on its own model.

    Args:
        scenario: checked.
        fidelities: below the lumped one.
        quick: leave out what stands for the truth; the model as it is is the reference then.
    """
    same: dict[str, Any] = {"fidelity": "lumped", "clock.tick_s": _TICK_S}
    if any(entry.mass_kg is not None for entry in scenario.objects) or scenario.wires:
        same["clock.tick_s"] = scenario.clock.tick_s

    def candidate(name: str, changes: Mapping[str, Any], decision: str = "", **more: Any) -> Candidate:
        return Candidate(name, "model", {**same, **changes}, decision=decision, commanded=True, **more)

    candidates = [
        candidate("model as it is", {}, reference=quick, base=True),
        *(candidate(name, changes) for name, changes in _films(scenario).items()),
        *(candidate(name, changes, decision) for name, (changes, decision) in _switches(scenario).items()),
        *(
            candidate(
                f"fidelity {name}", {"fidelity": name}, "elasticity" if name == "rigid" else "", family=name
            )
            for name in fidelities
        ),
    ]  # fmt: skip
    if quick:
        return candidates
    truths = [candidate(name, changes, reference=True) for name, changes in _truths(scenario).items()]
    return [*truths, *candidates]


def _truths(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return what stands for the truth, by name, the best first.

    That is the wrinkling film on the finest mesh that can be afforded. On the mesh before that one it tells
    how far from converged it is. The scenario's own film stands in where neither has an equilibrium.
    """
    robot, times = file_of(scenario, "a trade"), 1
    if robot.stack is None:  # a film with a source of its own is not divided
        laws = {f"{path}.film.law": "wrinkling" for path in _parts(robot, "soft_robot")}
        return {"wrinkling film": {**_AS_IN_FILE, **laws}}
    while triangle_count(robot) << 2 * (times + 1) <= _TRIANGLES_MAX:
        times += 1
    parts = _parts(robot, "soft_robot")
    found: dict[str, dict[str, Any]] = {}
    for finer in (times, times - 1):
        as_it_is = finer == 0 and not scenario.model.published
        if as_it_is and all(part.film.law == "wrinkling" for part in parts.values()):
            continue  # the model as it is
        changes = {**_AS_IN_FILE, **{f"{path}.film.law": "wrinkling" for path in parts}}
        stacks = {path: part.stack for path, part in parts.items() if part.stack is not None}
        changes |= {f"{path}.stack.refine": stack.refine + finer for path, stack in stacks.items()}
        found[f"wrinkling film, refine +{finer}"] = changes
    return {**found, "refined once more": {"fidelity": "refined"}}


def _parts(robot: SoftRobotTable, path: str) -> dict[str, SoftRobotTable]:
    """Return a robot and all that it carries, by key path."""
    found = {path: robot}
    for part in robot.attachments:
        found |= _parts(part.robot, f"{path}.attach.{part.name}.robot")
    return found


def _films(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return other films and hinges, by name; of the paper's model, the robot as in its file."""
    if scenario.model.published:
        return {"robot as in its file": _AS_IN_FILE}
    robot = file_of(scenario, "a trade")
    laws = get_args(get_type_hints(FilmTable)["law"])
    found: dict[str, dict[str, Any]] = {
        f"film law {law}": {_LAW: law} for law in laws if law != robot.film.law
    }
    other = "shell" if robot.hinge.rule == "uniform" else "uniform"
    found[f"hinge rule {other}"] = {"soft_robot.hinge.rule": other}
    return found


def _switches(scenario: Scenario) -> dict[str, tuple[dict[str, Any], str]]:
    """Return every other setting of what a run may leave out, and whose decision it checks, by name."""
    found: dict[str, tuple[dict[str, Any], str]] = {
        "no hinges": ({"soft_robot.hinge.stiffness_factor": 0.0}, "hinges"),
        "statics": ({"mode": "quasistatic"}, "inertia"),
    }
    slack = _slack_cables(scenario)
    if slack:
        found["cables slack"] = (slack, "cables")
    itself = scenario.contact.self_contact
    name = "no contact with itself" if itself else "contact with itself"
    found[name] = ({"contact.self_contact": not itself}, "contact with itself")
    if scenario.robot != NO_ARM:
        enabled = scenario.contact.enabled
        everywhere = {"contact.enabled": True, "contact.only_in_reach": False}
        found["contact searched for everywhere"] = (everywhere, CONTACT)
        if enabled:
            found["no contact"] = ({"contact.enabled": False}, CONTACT)
        scheme = "staggered" if scenario.coupling.scheme == "iterated" else "iterated"
        found[f"exchange {scheme}"] = ({"coupling.scheme": scheme}, "")
    substeps = {"solver.substep_error_m": _SUBSTEP_ERROR_M}
    found[f"substeps of {1e6 * _SUBSTEP_ERROR_M:g} um"] = (substeps, "")
    return found


def _slack_cables(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that leave all cables slack; none where there are none, or lengths are commanded."""
    lengths = any(phase.cable_length_m or phase.cable_shortening_m for phase in scenario.phases)
    count = len(scenario.soft_robot.cable_names())
    if not count or lengths or scenario.winches or scenario.controllers or scenario.commands:
        return {}
    none = [0.0] * count
    pulled = [
        phase.name
        for phase in scenario.phases
        if phase.cable_tension_N is not None
        or (phase.tip_target is not None and phase.tip_target.reach_with == "cables")
    ]
    keys = ["start.cable_tension_N", *(f"phase.{name}.cable_tension_N" for name in pulled)]
    return dict.fromkeys(keys, none)
