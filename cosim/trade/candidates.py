"""The candidates of a trade: one scenario with other fidelities, ticks, integrators and models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, Literal, TypeAlias, get_args

from cosim.config.loading import load_scenario
from cosim.config.schema.fidelity import Fidelity
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError, ScenarioError
from cosim.trade.candidate import Candidate, Group
from cosim.trade.model_candidates import model_candidates

__all__ = [
    "Candidate",
    "Group",
    "Truth",
    "candidates_of",
    "durations",
    "lower_fidelities",
    "short_candidates",
]

Truth: TypeAlias = Literal["finest", "refined"]

_TICKS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02)
_QUICK_TICKS_S: Final = (0.002, 0.005, 0.02)
_RUNG_TICKS_S: Final[Mapping[str, tuple[float, ...]]] = {
    "rigid": (0.002, 0.02),
    "section": (0.001, 0.002, 0.005, 0.01, 0.02),
}
"""Ticks of the fidelities below the lumped one."""

_SHORT_TICKS_S: Final = (0.002, 0.005, 0.01, 0.02)
_GRID_S: Final = 0.02
"""Durations are cut to multiples of this, so that every tick divides them."""

_CONVERGED_SHARE: Final = 0.01
"""Residual of a converged tick over that of one with one tangent."""


def candidates_of(
    scenario: Scenario, *, quick: bool = False, time_scale: float = 1.0, truth: Truth = "finest"
) -> tuple[Candidate, ...]:
    """Return the candidates of a scenario's trade, each group's reference before its others.

    Args:
        scenario: checked, in the dynamic mode.
        quick: fewer of them, none with a refined mesh.
        time_scale: factor on the duration of every phase that does not shake.
        truth: what the choice is measured against: "finest", the scenario's own mesh at the finest tick, or
            "refined", what stands for the truth among the models.

    Raises:
        InputError: the scenario is quasistatic, or the factor not positive.
    """
    if scenario.mode != "dynamic":
        raise InputError(f"a trade is of dynamic runs; the mode of '{scenario.name}' is {scenario.mode}")
    if not time_scale > 0.0:
        raise InputError(f"the time scale is {time_scale}; it must be positive")
    if truth == "refined" and quick:
        raise InputError("a quick trade runs no refined mesh to measure against")
    hurried = durations(scenario, time_scale)
    time = _time_candidates(scenario, _QUICK_TICKS_S if quick else _TICKS_S, converge=True)
    model = model_candidates(scenario, lower_fidelities(), quick=quick)
    candidates = (*time, *model)
    if truth == "refined":
        references = [m for m in model if m.reference]
        others = [replace(m, group="model", reference=False) for m in (*time, *model) if m not in references]
        candidates = (*references, *others)
    return tuple(replace(m, changes={**m.changes, **hurried}) for m in candidates)


def short_candidates(scenario: Scenario) -> tuple[Candidate, ...]:
    """Return the few candidates that an automatic choice is made from.

    Without anything to touch BDF2 is nearer at every tick and costs the same; with contact Euler's damping
    may help, so both are tried.
    """
    both = ("implicit_euler", "bdf2")
    integrators = both if scenario.objects or scenario.wires else both[1:]
    return tuple(_time_candidates(scenario, _SHORT_TICKS_S, converge=False, integrators=integrators))


def lower_fidelities() -> tuple[str, ...]:
    """Return the fidelities below the lumped one, the cheapest first."""
    return tuple(name for name in get_args(Fidelity) if name in _RUNG_TICKS_S)


def _time_candidates(
    scenario: Scenario,
    ticks_s: tuple[float, ...],
    *,
    converge: bool,
    integrators: tuple[str, ...] = ("implicit_euler", "bdf2"),
) -> list[Candidate]:
    """Return the ways to step time, and the lower fidelities, the longest tick last.

    Args:
        scenario: checked.
        ticks_s: of the lumped model.
        converge: whether there are candidates that converge every tick.
        integrators: to try.
    """
    loose = scenario.solver.dynamic_tolerance_N
    one = {"solver.dynamic_newton_iterations": 1}
    converged = {
        "solver.dynamic_newton_iterations": 50,
        "solver.dynamic_tolerance_N": _CONVERGED_SHARE * loose,
    }
    finest = {"fidelity": "lumped", "clock.tick_s": 0.5 * ticks_s[0], "solver.integrator": "bdf2"}
    name = f"BDF2, {_milliseconds(0.5 * ticks_s[0])}, converged"
    candidates = [Candidate(name, "time", {**finest, **converged}, reference=True)]
    labels = {"implicit_euler": "Euler", "bdf2": "BDF2"}
    for tick in ticks_s:
        for integrator in integrators:
            changes = {"fidelity": "lumped", "clock.tick_s": tick, "solver.integrator": integrator}
            # converging every tick gains nothing where the integrator's own error is larger
            ways: list[tuple[dict[str, Any], str]] = [(one, "1 tangent")]
            if converge and integrator == "bdf2":
                ways.append((converged, "converged"))
            for iterations, suffix in ways:
                name = f"{labels[integrator]}, {_milliseconds(tick)}, {suffix}"
                family = f"{labels[integrator]}, {suffix}"
                candidates.append(Candidate(name, "time", {**changes, **iterations}, family=family))
    for fidelity in lower_fidelities():
        rungs = [tick for tick in _RUNG_TICKS_S[fidelity] if tick >= ticks_s[0]]
        for tick in rungs if _can_be(scenario, fidelity) else rungs[:1]:
            changes = {"fidelity": fidelity, "clock.tick_s": tick, "solver.integrator": "bdf2"}
            name = f"{fidelity}, {_milliseconds(tick)}"
            candidates.append(Candidate(name, "time", {**changes, **one}, family=fidelity))
    return candidates


def _can_be(scenario: Scenario, fidelity: str) -> bool:
    """Whether a scenario can be run at a fidelity; where not, one candidate says why."""
    try:
        load_scenario(scenario, {"fidelity": fidelity})
    except ScenarioError:
        return False
    return True


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms"


def durations(scenario: Scenario, scale: float) -> dict[str, float]:
    """Return the changes that make every phase shorter by a factor, but those that shake or follow a path."""
    if scale == 1.0:
        return {}

    def cut(seconds: float) -> float:
        return round(seconds * scale / _GRID_S) * _GRID_S

    changes: dict[str, float] = {}
    for phase in scenario.phases:
        if phase.flange_shake is not None or phase.tip_path is not None:  # their times would not fit
            continue
        changes[f"phase.{phase.name}.duration_s"] = max(_GRID_S, cut(phase.duration_s))
        changes[f"phase.{phase.name}.settle_s"] = cut(phase.settle_s)
    return changes
