"""The candidates of a trade: one scenario with other fidelities, ticks, integrators and models.

Candidates of a trade that differ in what is modelled: models, and switches of what a run leaves out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, TypeAlias, final, get_args

from cosim.config import loading, rules
from cosim.config.schema.scenario import NO_ARM, Fidelity, Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.errors import InputError, ScenarioError
from cosim.plan.decision import CONTACT

Group: TypeAlias = Literal["time", "model"]


@final
@dataclass(frozen=True)
class Candidate:
    """One way to run the scenario.

    Args:
        name: for the table.
        group: "time": candidates differ in fidelity and in how time is stepped; "model": in what is modelled.
        changes: overrides of the scenario, by key path.
        reference: whether the others of its group are measured against it: of several, against the first that
            runs to its end.
        family: what it has in common with others of one colour in the plot.
        base: whether it is the scenario's own model, from which its group's switches start.
        decision: what of `modelled` in summary.json it decides otherwise; empty for none.
        commanded: whether tensions and flange poses for the tip's targets are those of the scenario's own
            model; otherwise they are planned again, as `cosim run` does.
    """

    name: str
    group: Group
    changes: Mapping[str, Any] = field(hash=False)
    reference: bool = False
    family: str = ""
    base: bool = False
    decision: str = ""
    commanded: bool = False

    @property
    def words(self) -> str:
        """The changes as words of the command line, without the durations."""
        shown = {key: value for key, value in self.changes.items() if not key.startswith("phase.")}
        return " ".join(f"--set {key}={_toml(value)}" for key, value in shown.items())


def _toml(value: Any) -> str:
    """Return a value as `--set` reads it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


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
        quick: leave out what represents the truth; the model as it is is the reference then.
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
    """Return what represents the truth, by name, the best first.

    That is the wrinkling film on the finest mesh that can be afforded. On the mesh before that one it tells
    how far from converged it is. The scenario's own film stands in where neither has an equilibrium.
    """
    robot, times = rules.file_of(scenario, "a trade"), 1
    if robot.stack is None:  # a film with a source of its own is not divided
        laws = {f"{path}.film.law": "wrinkling" for path in _parts(robot, "soft_robot")}
        return {"wrinkling film": {**_AS_IN_FILE, **laws}}
    while robot.triangles << 2 * (times + 1) <= _TRIANGLES_MAX:
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
    robot = rules.file_of(scenario, "a trade")
    found: dict[str, dict[str, Any]] = {f"film law {law}": {_LAW: law} for law in robot.film.other_laws()}
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
    itself = replace(scenario, fidelity="lumped").touches_itself
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


Truth: TypeAlias = Literal["finest", "refined"]

_TICKS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02)
_QUICK_TICKS_S: Final = (0.002, 0.005, 0.02)
_RUNG_TICKS_S: Final[Mapping[str, tuple[float, ...]]] = {
    "rigid": (0.002, 0.02),
    "section": (0.001, 0.002, 0.005, 0.01, 0.02),
}
"""Ticks of the fidelities below the lumped one."""

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
            "refined", what represents the truth among the models.

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
        loading.load_scenario(scenario, {"fidelity": fidelity})
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
