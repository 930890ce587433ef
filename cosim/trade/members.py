"""The members of a trade: one scenario with other fidelities, ticks, integrators, iterations and models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, TypeAlias, final, get_args

from cosim.errors import InputError
from cosim.scenario.fidelity_schema import Fidelity
from cosim.scenario.schema import NO_ARM, Scenario

Group: TypeAlias = Literal["time", "model"]
Truth: TypeAlias = Literal["finest", "refined"]

_TICKS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02)
_QUICK_TICKS_S: Final = (0.002, 0.005, 0.02)
_RUNG_TICKS_S: Final[Mapping[str, tuple[float, ...]]] = {
    "rigid": (0.002, 0.02),
    "section": (0.002, 0.005, 0.01, 0.02),
}
"""Ticks of the fidelities below the lumped one."""

_MODEL_TICK_S: Final = 0.01
_GRID_S: Final = 0.02
"""Durations are cut to multiples of this, so that every tick divides them."""

_ONE: Final = {"solver.dynamic_newton_iterations": 1, "solver.dynamic_tolerance_N": 1e-4}
_CONVERGED: Final = {"solver.dynamic_newton_iterations": 50, "solver.dynamic_tolerance_N": 1e-6}


@final
@dataclass(frozen=True)
class Member:
    """One way to run the scenario.

    Args:
        name: for the table.
        group: "time": members differ in fidelity and in how time is stepped; "model": in what is modelled.
        changes: overrides of the scenario, by key path.
        reference: whether the others of its group are measured against it.
        family: what it has in common with others of one colour in the plot.
    """

    name: str
    group: Group
    changes: Mapping[str, Any] = field(hash=False)
    reference: bool = False
    family: str = ""

    @property
    def words(self) -> str:
        """The changes as words of the command line, without the durations."""
        shown = {key: value for key, value in self.changes.items() if not key.startswith("phase.")}
        return " ".join(f"--set {key}={value}" for key, value in shown.items())


def members_of(
    scenario: Scenario, *, quick: bool = False, time_scale: float = 1.0, truth: Truth = "finest"
) -> tuple[Member, ...]:
    """Return the members of a scenario's trade, each group's reference before its others.

    Args:
        scenario: checked, in the dynamic mode.
        quick: fewer of them, none with a refined mesh.
        time_scale: factor on the duration of every phase that does not shake.
        truth: what the choice is measured against: "finest", the scenario's own mesh at the finest tick, or
            "refined", the finer mesh that is the reference of what is modelled.

    Raises:
        InputError: the scenario is quasistatic, or the factor not positive.
    """
    if scenario.mode != "dynamic":
        raise InputError(f"a trade is of dynamic runs; the mode of '{scenario.name}' is {scenario.mode}")
    if not time_scale > 0.0:
        raise InputError(f"the time scale is {time_scale}; it must be positive")
    if truth == "refined" and quick:
        raise InputError("a quick trade runs no refined mesh to measure against")
    hurried = _durations(scenario, time_scale)
    time = _time_members(_QUICK_TICKS_S if quick else _TICKS_S, _CONVERGED)
    model = _model_members(scenario, quick=quick)
    members = (*time, *model)
    if truth == "refined":
        members = (model[0], *(replace(m, group="model", reference=False) for m in (*time, *model[1:])))
    return tuple(replace(m, changes={**m.changes, **hurried}) for m in members)


def short_members() -> tuple[Member, ...]:
    """Return the few members that an automatic choice is made from."""
    return tuple(_time_members((0.002, 0.005, 0.01, 0.02), {}, integrators=("bdf2",)))


def lower_fidelities() -> tuple[str, ...]:
    """Return the fidelities below the lumped one, the cheapest first."""
    return tuple(name for name in get_args(Fidelity) if name in _RUNG_TICKS_S)


def _time_members(
    ticks_s: tuple[float, ...],
    converged: Mapping[str, Any],
    integrators: tuple[str, ...] = ("implicit_euler", "bdf2"),
) -> list[Member]:
    """Return the ways to step time, and the lower fidelities.

    Args:
        ticks_s: of the lumped model.
        converged: changes of a member that converges every tick; empty for no such members.
        integrators: to try.
    """
    finest = {"fidelity": "lumped", "clock.tick_s": 0.5 * ticks_s[0], "solver.integrator": "bdf2"}
    name = f"BDF2, {_milliseconds(0.5 * ticks_s[0])}, converged"
    members = [Member(name, "time", {**finest, **_CONVERGED}, reference=True)]
    labels = {"implicit_euler": "Euler", "bdf2": "BDF2"}
    for tick in ticks_s:
        for integrator in integrators:
            # converging every tick gains nothing where the integrator's own error is larger
            solved = [(_ONE, "1 tangent"), *([(converged, "converged")] if converged else [])]
            for iterations, suffix in solved if integrator == "bdf2" else solved[:1]:
                changes = {"fidelity": "lumped", "clock.tick_s": tick, "solver.integrator": integrator}
                name = f"{labels[integrator]}, {_milliseconds(tick)}, {suffix}"
                family = f"{labels[integrator]}, {suffix}"
                members.append(Member(name, "time", {**changes, **iterations}, family=family))
    for fidelity in lower_fidelities():
        for tick in _RUNG_TICKS_S[fidelity]:
            changes = {"fidelity": fidelity, "clock.tick_s": tick, "solver.integrator": "bdf2"}
            name = f"{fidelity}, {_milliseconds(tick)}"
            members.append(Member(name, "time", {**changes, **_ONE}, family=fidelity))
    return members


def _model_members(scenario: Scenario, *, quick: bool) -> list[Member]:
    """Return what is modelled otherwise, all at one tick, so that errors of time stepping nearly cancel."""
    robot = scenario.soft_robot
    same = {"clock.tick_s": _MODEL_TICK_S, "solver.integrator": "bdf2", "fidelity": "lumped"}
    film = "soft_robot.film"
    laws = {
        "plain": {f"{film}.law": "plain", f"{film}.compressive_fraction": 0.0},
        "tension_field": {f"{film}.law": "tension_field", f"{film}.compressive_fraction": 0.01},
        "edge_strain": {f"{film}.law": "edge_strain", f"{film}.compressive_fraction": 0.0},
    }
    base = Member("model as it is", "model", same, reference=quick)
    members = [Member(f"film law {law}", "model", {**same, **changes})
               for law, changes in laws.items() if law != robot.film.law]  # fmt: skip
    if robot.calibration is not None and not scenario.chamber.calibrated:
        members.append(Member("calibrated", "model", {**same, "chamber.calibrated": True}))
    other = "shell" if robot.hinge.rule == "uniform" else "uniform"
    members.append(Member(f"hinge rule {other}", "model", {**same, "soft_robot.hinge.rule": other}))
    members.append(Member("no hinges", "model", {**same, "soft_robot.hinge.stiffness_factor": 0.0}))
    if scenario.robot != NO_ARM and scenario.contact.enabled:
        members.append(Member("no contact", "model", {**same, "contact.enabled": False}))
    members.append(Member("statics", "model", {**same, "mode": "quasistatic"}))
    members += [
        Member(f"fidelity {name}", "model", {**same, "fidelity": name}, family=name)
        for name in lower_fidelities()
    ]
    if quick:
        return [base, *members]
    finer = {**same, "fidelity": "refined", "chamber.calibrated": False}
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
        if phase.flange_shake is not None:  # its periods would not fit
            continue
        changes[f"phase.{phase.name}.duration_s"] = max(_GRID_S, cut(phase.duration_s))
        changes[f"phase.{phase.name}.settle_s"] = cut(phase.settle_s)
    return changes
