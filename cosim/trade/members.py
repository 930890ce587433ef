"""The members of a trade: one scenario with other ticks, integrators, iterations, film laws and meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias, final

from cosim.errors import InputError
from cosim.scenario.schema import Scenario

Group: TypeAlias = Literal["time", "model"]

_TICKS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02)
_QUICK_TICKS_S: Final = (0.002, 0.005, 0.02)
_MODEL_TICK_S: Final = 0.01
_GRID_S: Final = 0.02
"""Durations are cut to multiples of this, so that every tick divides them."""

_ONE: Final = {"solver.dynamic_newton_iterations": 1}
_CONVERGED: Final = {"solver.dynamic_newton_iterations": 50, "solver.dynamic_tolerance_N": 1e-6}


@final
@dataclass(frozen=True)
class Member:
    """One way to run the scenario.

    Args:
        name: for the table.
        group: "time": members differ in how time is stepped, of one model; "model": in what is modelled.
        changes: overrides of the scenario, by key path.
        reference: whether the others of its group are measured against it.
    """

    name: str
    group: Group
    changes: Mapping[str, Any] = field(hash=False)
    reference: bool = False

    @property
    def words(self) -> str:
        """The changes as words of the command line, without the durations."""
        shown = {key: value for key, value in self.changes.items() if not key.startswith("phase.")}
        return " ".join(f"--set {key}={value}" for key, value in shown.items())


def members_of(scenario: Scenario, *, quick: bool = False, time_scale: float = 1.0) -> tuple[Member, ...]:
    """Return the members of a scenario's trade, each group's reference first.

    Args:
        scenario: checked, in the dynamic mode.
        quick: fewer of them, none with a refined mesh.
        time_scale: factor on the duration of every phase.

    Raises:
        InputError: the scenario is quasistatic, or the factor not positive.
    """
    if scenario.mode != "dynamic":
        raise InputError(f"a trade is of dynamic runs; the mode of '{scenario.name}' is {scenario.mode}")
    if not time_scale > 0.0:
        raise InputError(f"the time scale is {time_scale}; it must be positive")
    hurried = _durations(scenario, time_scale)
    time = _time_members(_QUICK_TICKS_S if quick else _TICKS_S)
    members = (*time, *_model_members(scenario, quick=quick))
    return tuple(Member(m.name, m.group, {**m.changes, **hurried}, m.reference) for m in members)


def _time_members(ticks_s: tuple[float, ...]) -> list[Member]:
    finest = {"clock.tick_s": 0.5 * ticks_s[0], "solver.integrator": "bdf2", **_CONVERGED}
    members = [Member(f"BDF2, {_milliseconds(0.5 * ticks_s[0])}, converged", "time", finest, reference=True)]
    for tick in ticks_s:
        for integrator, label in (("implicit_euler", "Euler"), ("bdf2", "BDF2")):
            for iterations, suffix in ((_ONE, "1 tangent"), (_CONVERGED, "converged")):
                changes = {"clock.tick_s": tick, "solver.integrator": integrator, **iterations}
                members.append(Member(f"{label}, {_milliseconds(tick)}, {suffix}", "time", changes))
    return members


def _model_members(scenario: Scenario, *, quick: bool) -> list[Member]:
    """Return what is modelled otherwise, all at one tick, so that errors of time stepping nearly cancel."""
    robot, same = scenario.soft_robot, {"clock.tick_s": _MODEL_TICK_S}
    film, refine = "soft_robot.film", "soft_robot.chamber.refine"
    laws = {
        "plain": {f"{film}.law": "plain", f"{film}.compressive_fraction": 0.0},
        "tension_field": {f"{film}.law": "tension_field", f"{film}.compressive_fraction": 0.01},
        "edge_strain": {f"{film}.law": "edge_strain", f"{film}.compressive_fraction": 0.0},
    }
    base = Member("model as it is", "model", same, reference=quick)
    members = [Member(f"film law {law}", "model", {**same, **changes})
               for law, changes in laws.items() if law != robot.film.law]  # fmt: skip
    other = "shell" if robot.hinge.rule == "uniform" else "uniform"
    members.append(Member(f"hinge rule {other}", "model", {**same, "soft_robot.hinge.rule": other}))
    if scenario.robot != "none" and scenario.contact.enabled:
        members.append(Member("no contact", "model", {**same, "contact.enabled": False}))
    if quick:
        return [base, *members]
    finer = {**same, refine: robot.chamber.refine + 1, "chamber.calibrated": False}
    return [Member("refined once more", "model", finer, reference=True), base, *members]


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms"


def _durations(scenario: Scenario, scale: float) -> dict[str, float]:
    if scale == 1.0:
        return {}

    def cut(seconds: float) -> float:
        return round(seconds * scale / _GRID_S) * _GRID_S

    changes: dict[str, float] = {}
    for phase in scenario.phases:
        changes[f"phase.{phase.name}.duration_s"] = max(_GRID_S, cut(phase.duration_s))
        changes[f"phase.{phase.name}.settle_s"] = cut(phase.settle_s)
    return changes
