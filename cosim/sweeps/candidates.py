"""The candidates of `cosim trade`: other fidelities, meshes, ticks, integrators and iterations."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, TypeAlias, final

from cosim.config import loading, rules
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.errors import InputError, ScenarioError

Truth: TypeAlias = Literal["finest", "refined"]

SLOWEST: Final = 0.05
"""Real-time factor below which a candidate is stopped, unless the user gives another one."""
_REFERENCE_SLOWEST: Final = 0.1
"""The bound of a reference, over that of a candidate: without a reference there are no errors."""
_TICKS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02)
_QUICK_TICKS_S: Final = (0.002, 0.005, 0.02)
_RUNG_TICKS_S: Final = {"rigid": (0.002, 0.02), "section": _TICKS_S}
"""Ticks of the fidelities below the lumped one, the cheapest fidelity first."""
_MESH_TICK_S: Final = 0.01
_TRIANGLES_MAX: Final = 5000
"""Triangles of a refined reference: with more, its run takes hours."""
_GRID_S: Final = 0.02
"""Durations are rounded to multiples of this, so that every tick divides them."""
_CONVERGED_RATIO: Final = 0.01
"""Residual of a converged tick over that of a tick with one tangent."""


@final
@dataclass(frozen=True)
class Candidate:
    """One way to run the scenario.

    Args:
        name: for the table.
        changes: overrides of the scenario, by key path.
        reference: whether other candidates are compared with it; of several, with the first that completes.
        commanded: whether tensions and flange poses for the tip's targets are those of the scenario's model;
            otherwise they are planned again, as `cosim run` does.
        slowest: real-time factor below which its run is stopped; 0: none.
    """

    name: str
    changes: Mapping[str, Any] = field(hash=False)
    reference: bool = False
    commanded: bool = False
    slowest: float = 0.0

    @property
    def words(self) -> str:
        """The changes as words of the command line, without the durations."""
        shown = {key: value for key, value in self.changes.items() if not key.startswith("phase.")}
        return " ".join(f"--set {key}={_toml(value)}" for key, value in shown.items())


def _toml(value: Any) -> str:
    """Return a value as text for `--set`."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def candidates_of(
    scenario: Scenario,
    *,
    quick: bool = False,
    time_scale: float = 1.0,
    truth: Truth = "finest",
    slowest: float = SLOWEST,
) -> tuple[Candidate, ...]:
    """Return the candidates of a scenario's trade, the reference before the others.

    Args:
        scenario: checked, in the dynamic mode.
        quick: whether there are fewer, none with a refined mesh.
        time_scale: factor on the duration of every phase that does not shake.
        truth: the reference: "finest", the scenario's mesh at the finest tick, or "refined", a wrinkling film
            on the finest affordable mesh.
        slowest: real-time factor below which a candidate is stopped, a reference at a tenth of it; 0: none.

    Raises:
        InputError: the scenario is quasistatic, or the factor is not positive.
    """
    if scenario.mode != "dynamic":
        raise InputError(f"a trade needs dynamic runs; the mode of '{scenario.name}' is {scenario.mode}")
    if not time_scale > 0.0:
        raise InputError(f"the time scale is {time_scale}; it must be positive")
    if truth == "refined" and quick:
        raise InputError("a quick trade has no refined mesh: leave out --quick or --truth refined")
    candidates = _time_candidates(scenario, _QUICK_TICKS_S if quick else _TICKS_S)
    meshes = [] if quick else _mesh_candidates(scenario)
    if truth == "refined":
        candidates = [*meshes, *(replace(each, reference=False) for each in candidates)]
    elif meshes:
        candidates.append(replace(meshes[-1], reference=False))
    hurried = _durations(scenario, time_scale)
    return tuple(
        replace(
            each,
            changes={**each.changes, **hurried},
            slowest=slowest * (_REFERENCE_SLOWEST if each.reference else 1.0),
        )
        for each in candidates
    )


def _time_candidates(scenario: Scenario, ticks_s: tuple[float, ...]) -> list[Candidate]:
    """Return the candidates of each way to step time, and of the lower fidelities, the longest tick last."""
    one = {"solver.dynamic_newton_iterations": 1}
    converged = {
        "solver.dynamic_newton_iterations": 50,
        "solver.dynamic_tolerance_N": _CONVERGED_RATIO * scenario.solver.dynamic_tolerance_N,
    }

    def lumped(label: str, tick_s: float, iterations: str) -> Candidate:
        integrator = "bdf2" if label == "BDF2" else "implicit_euler"
        name = f"{label}, {_milliseconds(tick_s)}, {iterations}"
        further = converged if iterations == "converged" else one
        return Candidate(name, {**_stepped("lumped", tick_s, integrator), **further})

    # converging every tick gains nothing with Euler, whose integration error is larger
    ways = ("Euler", "1 tangent"), ("BDF2", "1 tangent"), ("BDF2", "converged")
    candidates = [replace(lumped("BDF2", 0.5 * ticks_s[0], "converged"), reference=True)]
    candidates += [lumped(label, tick_s, iterations) for tick_s in ticks_s for label, iterations in ways]
    for fidelity, all_ticks_s in _RUNG_TICKS_S.items():
        rungs = [tick_s for tick_s in all_ticks_s if tick_s >= ticks_s[0]]
        for tick_s in rungs if _can_be(scenario, fidelity) else rungs[:1]:
            changes = {**_stepped(fidelity, tick_s, "bdf2"), **one}
            candidates.append(Candidate(f"{fidelity}, {_milliseconds(tick_s)}", changes))
    return candidates


def _stepped(fidelity: str, tick_s: float, integrator: str) -> dict[str, Any]:
    return {"fidelity": fidelity, "clock.tick_s": tick_s, "solver.integrator": integrator}


def _can_be(scenario: Scenario, fidelity: str) -> bool:
    """Return whether a scenario can be run at a fidelity; if not, a single candidate shows the reason."""
    try:
        loading.load_scenario(scenario, {"fidelity": fidelity})
    except ScenarioError:
        return False
    return True


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:g} ms"


def _durations(scenario: Scenario, scale: float) -> dict[str, float]:
    """Return changes that shorten every phase by a factor, except those that shake or follow a path."""
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


def _mesh_candidates(scenario: Scenario) -> list[Candidate]:
    """Return the references, the best first, the scenario's film on a refined mesh last.

    The best is the wrinkling film on the finest affordable mesh. The same film on the next coarser mesh shows
    its error. If neither has an equilibrium, the scenario's film is the reference. The tick is long, because
    these runs are slow. With movable objects it is the scenario's tick, because grasps fail with long ticks.
    """
    movable = any(entry.mass_kg is not None for entry in scenario.objects) or bool(scenario.wires)
    same = {"fidelity": "lumped", "clock.tick_s": scenario.clock.tick_s if movable else _MESH_TICK_S}
    films = {**_wrinkling_films(scenario), "refined once more": {"fidelity": "refined"}}
    return [Candidate(name, {**same, **changes}, True, commanded=True) for name, changes in films.items()]


def _wrinkling_films(scenario: Scenario) -> dict[str, dict[str, Any]]:
    robot, times = rules.file_of(scenario, "a trade"), 1
    parts = _parts(robot, "soft_robot")
    wrinkling = {"model.published": False, **{f"{path}.film.law": "wrinkling" for path in parts}}
    if robot.stack is None:  # the mesh of a film from a file or pattern is not refined
        return {"wrinkling film": wrinkling}
    while robot.triangles << 2 * (times + 1) <= _TRIANGLES_MAX:
        times += 1
    stacks = {path: part.stack for path, part in parts.items() if part.stack is not None}
    films: dict[str, dict[str, Any]] = {}
    for finer in (times, times - 1):
        unchanged = finer == 0 and not scenario.model.published
        if unchanged and all(part.film.law == "wrinkling" for part in parts.values()):
            continue  # this is the scenario's model
        refined = {f"{path}.stack.refine": stack.refine + finer for path, stack in stacks.items()}
        films[f"wrinkling film, refine +{finer}"] = {**wrinkling, **refined}
    return films


def _parts(robot: SoftRobotTable, path: str) -> dict[str, SoftRobotTable]:
    """Return a robot and its attached robots, by key path."""
    parts = {path: robot}
    for part in robot.attachments:
        parts |= _parts(part.robot, f"{path}.attach.{part.name}.robot")
    return parts
