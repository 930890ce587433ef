"""The paper's figures, run with three models and drawn beside its code's output.

"solved" is the paper's own model at true equilibrium (open ends, its subset of hinges, strains along edges),
"published" the same film with closed ends and a hinge on every fold, "default" the robot as its file has it.
"code" is the output of the published code (Sim-FAST by Y. Zhu, CC-BY 4.0), from tests/reference/.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

import cosim
from cosim.base.frames import Array, IntArray
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.results.result import RunResult

REFERENCE: Final = Path(__file__).resolve().parents[1] / "tests" / "reference"
_ALL: Final = {"recording.frames_per_s": 10_000.0}
MODELS: Final[dict[str, dict[str, Any]]] = {
    "solved": {
        "model.published": True, "model.closed": False, "model.all_hinges": False,
        "soft_robot.film.law": "edge_strain",
    },
    "published": {"model.published": True, "model.closed": True, "model.all_hinges": True},
    "default": {"model.published": False, "model.closed": True, "model.all_hinges": True},
}  # fmt: skip
COLOURS: Final = {"solved": "tab:orange", "published": "tab:blue", "default": "tab:red", "code": "0.25"}
_SEARCH_MAX: Final = 400
"""Newton iterations of a variant's search for an equilibrium: bare film can slide for thousands."""
PRESSURES_kPa: Final = (10, 20, 30)
ANGLES_deg: Final = (10, 20, 30, 40, 50)


@dataclass
class Row:
    """One number of a figure: by model, and by the code where that gives it; units are in the name."""

    name: str
    values: dict[str, float] = field(default_factory=dict)


@dataclass
class Runs:
    """Runs of scenarios by model.

    Args:
        change: makes another variant of a scenario with the default robot; None: as it is.
        models: names out of MODELS.
        seconds: CPU seconds by scenario and model, filled.
    """

    change: Callable[[Scenario], Scenario] | None = None
    models: Sequence[str] = tuple(MODELS)
    seconds: dict[tuple[str, str], float] = field(default_factory=dict)

    def scenario(self, name: str, model: str, changes: Mapping[str, Any]) -> Scenario:
        """Return a scenario with a model, changed."""
        bound = {} if self.change is None else {"solver.search_iterations_max": _SEARCH_MAX}
        scenario = load_scenario(name, {**_ALL, **MODELS[model], **bound, **changes})
        return scenario if self.change is None else self.change(scenario)

    def run(self, name: str, model: str, changes: Mapping[str, Any], phases: int | None = None) -> RunResult:
        """Return the run of a scenario with a model, of its first `phases` phases only if given."""
        scenario = self.scenario(name, model, changes)
        if phases is not None:
            scenario = replace(scenario, phases=scenario.phases[:phases])
        began, key = time.process_time(), (name, model)
        result = cosim.run(scenario, error=False)
        self.seconds[key] = self.seconds.get(key, 0.0) + time.process_time() - began
        return result

    def each(self, name: str, changes: Mapping[str, Any] | None = None) -> Iterator[tuple[RunResult, str]]:
        """Yield the run of a scenario with every model, and the model's name."""
        for model in self.models:
            yield self.run(name, model, changes or {}), model


def in_phase(result: RunResult, name: str) -> slice:
    """Return the rows of a phase, the last row of the one before it included."""
    rows = np.flatnonzero(result.phase == result.stage.phase_names.index(name))
    return slice(max(int(rows[0]) - 1, 0), int(rows[-1]) + 1)


def tilt(result: RunResult, phase: str) -> Array:
    """Return the angle between the tip ring's normal and the world's z axis through a phase [deg]."""
    z = result.tip_direction[in_phase(result, phase), 2]
    return np.degrees(np.arccos(np.clip(z, -1.0, 1.0)))


def reference(name: str) -> Any:
    """Return the published code's arrays of an example."""
    return np.load(REFERENCE / f"{name}.npz")


def _at(x: Array, y: Array, at: float) -> float:
    return float(np.interp(at, x, y))


def inflation(axes: Axes, runs: Runs, name: str, pressures_kPa: Sequence[int]) -> list[Row]:
    """Return lengths [mm] of a stack at pressures, and the last one over its stored length."""
    rows = [Row(f"length at {p} kPa [mm]") for p in pressures_kPa]
    ratio = Row(f"length at {pressures_kPa[-1]} kPa over stored length")
    strain = Row(f"strain of frames at {pressures_kPa[-1]} kPa, over that at yield")
    for result, model in runs.each(name):
        pressure, length = 1e-3 * result.pressure_Pa, 1e3 * result.tip_position[:, 2]
        axes.plot(pressure, length, color=COLOURS[model], label=model)
        for row, at in zip(rows, pressures_kPa, strict=True):
            row.values[model] = _at(pressure, length, at)
        last = result.summary["phases"][-1]
        ratio.values[model] = last["extension_ratio"]
        if "stiffener" in last:
            strain.values[model] = last["stiffener"]["peak_strain"] / last["stiffener"]["strength_strain"]
    axes.set(xlabel="pressure [kPa]", ylabel="length [mm]")
    return [*rows, ratio, strain]


def three_unit_inflation(axes: Axes, runs: Runs) -> list[Row]:
    """Length of three square units, compared with shells of the same film."""
    rows = inflation(axes, runs, "three_unit_inflation", (10,))
    data = reference("Three_Unit_Compare")
    length = 1e3 * data["inflation_tip_ring_mean_z_m"]
    axes.plot(1e-3 * data["inflation_pressure_Pa"], length, ":", color=COLOURS["code"], label="code")
    axes.errorbar(
        [2, 10], [42, 77], [1.5, 3], fmt="o", color="tab:green", capsize=3, label="converged shells"
    )
    rows[0].values["code"] = float(length[-1])
    return rows


def ten_unit_extension(axes: Axes, runs: Runs) -> list[Row]:
    """Length of ten square units at 10 to 40 kPa."""
    rows = inflation(axes, runs, "ten_unit_extension", (10, 20, 30, 40))
    data = reference("Three_Point_Bending_pressure_sweep")
    pressure, length = 1e-3 * data["P30000_inflation_pressure_Pa"], 1e3 * data["P30000_inflation_tip_z_m"]
    axes.plot(pressure, length, ":", color=COLOURS["code"], label="code")
    axes.errorbar([20], [259.5], [4.5], fmt="o", color="tab:green", capsize=3, label="shells")
    for row, at in zip(rows, PRESSURES_kPa, strict=False):
        row.values["code"] = _at(pressure, length, at)
    return rows


_TOP_MIDDLE: Final = [f"unit_{k}.outer" for k in (5, 6)]
_BEND_N: Final = 1.2


def _loaded_corners(scenario: Scenario) -> IntArray:
    """Return the nodes that carry the force: the first two corners of the middle units' outer rings."""
    assert isinstance(scenario.soft_robot, SoftRobotTable)
    rings = build_soft_body(scenario.soft_robot, scenario.model).rings
    return np.concatenate([rings[name][[0, len(rings[name]) // 4]] for name in _TOP_MIDDLE])


def _deflection_mm(result: RunResult, nodes: IntArray) -> Array:
    """Return the mean shift of nodes along y since the bending began."""
    y = result.node_position[in_phase(result, "bend")][:, nodes, 1].mean(axis=1)
    return np.asarray(1e3 * (y - y[0]))


def three_point_bending(axes: Axes, runs: Runs, tension_N: float = 0.0) -> list[Row]:
    """Deflection at 1.2 N and at three pressures, four cables at one tension."""
    name, rows = "three_point_bending_cables", []
    for line, kPa in zip(("-", "--", "-."), PRESSURES_kPa, strict=True):
        row = Row(f"deflection at {_BEND_N} N, {kPa} kPa, cables at {tension_N} N [mm]")
        changes = {
            "phase.inflate.pressure_Pa": 1e3 * kPa,
            "phase.tighten.cable_tension_N": [tension_N] * 4,
            "phase.bend.force": [{
                "rings": _TOP_MIDDLE, "corners": [0, 1], "total_N": [0.0, _BEND_N, 0.0],
            }],
        }  # fmt: skip
        for result, model in runs.each(name, changes):
            shift = _deflection_mm(result, _loaded_corners(runs.scenario(name, model, changes)))
            force = np.linspace(0.0, _BEND_N, len(shift))
            axes.plot(force, shift, line, color=COLOURS[model], label=f"{model}, {kPa} kPa")
            row.values[model] = float(shift[-1])
        for force, shift in _code_deflections(kPa, tension_N):
            axes.plot(force, shift, line, color=COLOURS["code"], lw=0.8, label=f"code, {kPa} kPa")
            row.values["code"] = _at(force, shift, _BEND_N)
        rows.append(row)
    axes.set(xlabel="force [N]", ylabel="deflection [mm]")
    return rows


def _code_deflections(kPa: int, tension_N: float) -> Iterator[tuple[Array, Array]]:
    """Yield forces [N] and deflections [mm] of the published code, where it has been run."""
    sweep = reference("Three_Point_Bending_pressure_sweep")
    if tension_N == 0.0:
        yield sweep["load_total_N"], 1e3 * sweep[f"P{1000 * kPa}_deflection_m"]
    elif kPa == 20:
        yield sweep["cable_load_total_N"], 1e3 * sweep["cable_P20000_deflection_m"]
    elif kPa == 30:
        data = reference("Three_Point_Bending_Cable")
        yield data["bend_load_total_N"], 1e3 * data["bend_deflection_relative_to_stage_start_m"]


def bending_angle(axes: Axes, runs: Runs) -> list[Row]:
    """Tilt of the tip over the tension of two cables."""
    row = Row("tilt of the tip at 0.5 N a cable [deg]")
    for result, model in runs.each("bending_angle"):
        angle = tilt(result, "pull")
        axes.plot(
            result.cable_tension_N[in_phase(result, "pull"), 0], angle, color=COLOURS[model], label=model
        )
        row.values[model] = float(angle[-1])
    code = reference("Bending_Angle")["bending_angle_deg_cable_path"]
    axes.plot(np.linspace(0.005, 0.5, 100), code, ":", color=COLOURS["code"], label="code")
    row.values["code"] = float(code[-1])
    axes.set(xlabel="tension of each cable [N]", ylabel="tilt of the tip [deg]")
    return [row]


def bending_angle_tip_load(axes: Axes, runs: Runs) -> list[Row]:
    """Tilt under a load at the tip of 0.5 N as the text says and 1 N as the code has it, then pulled back."""
    rows = []
    for line, force in (("--", 0.5), ("-", 1.0)):
        pair = [Row(f"tilt under {force} N, {words} [deg]") for words in ("slack", "cables at 0.96 N")]
        load = [{"rings": ["unit_3.outer"], "corners": [2, 3], "total_N": [0.0, force, 0.0]}]
        for result, model in runs.each("bending_angle_tip_load", {"phase.load.force": load}):
            place = in_phase(result, "pull")
            # towards the load is positive
            angle = np.degrees(np.arctan2(result.tip_direction[place, 1], result.tip_direction[place, 2]))
            axes.plot(
                result.cable_tension_N[place, 0],
                angle,
                line,
                color=COLOURS[model],
                label=f"{model}, {force} N",
            )
            pair[0].values[model], pair[1].values[model] = float(angle[0]), float(angle[-1])
        rows += pair
    axes.axhline(0.0, color="0.8", lw=0.8)
    axes.set(xlabel="tension of each cable [N]", ylabel="tilt of the tip towards the load [deg]")
    return rows


def hexagon_arm_bending(axes: Axes, runs: Runs) -> list[Row]:
    """Path of the tip, seen from above, through six directions; the paper pulls one cable."""
    name = "hexagon_arm_bending"
    directions = ("a", "ab", "b", "bc", "c", "ca")
    rows = [
        Row("length at 40 kPa [mm]"),
        Row("length over stored length"),
        *(Row(f"tip aside, {cables} at 30 N [mm]") for cables in directions),
    ]
    for model in runs.models:
        # with open ends the round fails in its third direction: no stable equilibrium follows
        result = runs.run(name, model, {}, phases=2 if model == "solved" else None)
        x, y, z = 1e3 * result.tip_position.T
        axes.plot(x, y, color=COLOURS[model], label=model)
        rows[0].values[model] = float(z[in_phase(result, "inflate")][-1])
        rows[1].values[model] = result.summary["phases"][0]["extension_ratio"]
        for row, phase in zip(rows[2:], directions, strict=True):
            if phase in result.stage.phase_names[: result.phase.max() + 1]:
                row.values[model] = float(np.hypot(x, y)[in_phase(result, phase)][-1])
    axes.set(xlabel="tip x [mm]", ylabel="tip y [mm]", aspect="equal")
    return rows


_HELD: Final = {"rings": ["unit_1.outer"], "corners": [0, 1, 2, 3, 4, 5]}
_STATICS: Final = {
    "mode": "quasistatic",
    "controller": [],
    "phase": [
        {"name": "inflate", "duration_s": 1.0, "increments": 60, "pressure_Pa": 40e3},
        {
            "name": "pull", "duration_s": 1.0, "increments": 50, "ramp": "linear",
            "release": ["unit_1.hole"], "support": [_HELD], "cable_tension_N": [5.0, 5.0],
        },
    ],
}  # fmt: skip


def statics_of_angles(runs: Runs, model: str) -> RunResult:
    """Return the run in which two cables of the arm of figure 7H are pulled slowly, in statics."""
    return runs.run("hexagon_arm_angles", model, _STATICS)


def static_tensions(result: RunResult) -> tuple[Array, Array]:
    """Return the angles [deg] that two cables reach in statics, and the tensions [N] for them."""
    place = in_phase(result, "pull")
    return tilt(result, "pull"), result.cable_tension_N[place, 0]


def held_tensions(result: RunResult) -> dict[int, float]:
    """Return the mean tension [N] by target angle [deg], over the last quarter of each target's phase."""
    found = {}
    for index, name in enumerate(result.stage.phase_names):
        if name.startswith("angle_"):
            rows = np.flatnonzero(result.phase == index)
            found[int(name[6:])] = float(result.cable_tension_N[rows[3 * len(rows) // 4 :], 0].mean())
    return found


def hexagon_arm_angles(axes: Axes, runs: Runs) -> list[Row]:
    """Tension over target angle of two cables under the paper's bang-bang law, and in statics (figure 7H)."""
    name = "hexagon_arm_angles"
    rows = [Row(f"{words}, {angle} deg [N]") for angle in ANGLES_deg for words in ("held", "statics")]
    for model in runs.models:
        if model == "solved":  # with open ends the arm has no stable equilibria far from straight
            continue
        angle, tension = static_tensions(statics_of_angles(runs, model))
        axes.plot(angle, tension, color=COLOURS[model], label=f"{model}, statics")
        # a variant is asked for its statics alone
        held = {} if runs.change is not None else held_tensions(runs.run(name, model, {}))
        axes.plot(list(held), list(held.values()), "o", color=COLOURS[model], label=f"{model}, bang-bang")
        for k, target in enumerate(ANGLES_deg):
            rows[2 * k + 1].values[model] = _at(angle, tension, target)
            if held:
                rows[2 * k].values[model] = held[target]
    axes.set(xlabel="bending angle [deg]", ylabel="tension of each cable [N]", xlim=(-2, 55))
    return rows


def gripper_finger_closing(axes: Axes, runs: Runs) -> list[Row]:
    """Path of the tip in the finger's plane."""
    rows = [Row(f"tip {way} at {t:g} N [mm]") for t in (0.6, 3.0) for way in ("outwards", "upwards")]
    for result, model in runs.each("gripper_finger_closing"):
        _, y, z = 1e3 * result.tip_position.T
        axes.plot(y, z, color=COLOURS[model], label=model)
        for k, tension in enumerate((0.6, 3.0)):
            at = int(np.argmax(result.cable_tension_N[:, 0] >= tension - 1e-9))
            axes.plot(y[at], z[at], "o", ms=4, color=COLOURS[model])
            axes.annotate(f"{tension:g} N", (y[at], z[at]))
            rows[2 * k].values[model], rows[2 * k + 1].values[model] = float(y[at]), float(z[at])
    axes.set(xlabel="tip, outwards from the gripper's axis [mm]", ylabel="tip z [mm]", aspect="equal")
    return rows


def hexagon_arm_torsion(axes: Axes, runs: Runs) -> list[Row]:
    """Angle over tension of three spiral cables, on the scenario's mesh and on those next to it."""
    name = "hexagon_arm_torsion"
    rows = [Row(f"twist at {tension} N a cable [deg]") for tension in (5, 10, 15, 20)]
    meshes = {"default": None, "coarser": 0, "finer": 2}
    for words, refine in meshes.items():
        changes = {} if refine is None else {"soft_robot.stack.refine": refine}
        result = runs.run(name, "default", changes)
        scenario = runs.scenario(name, "default", changes)
        assert isinstance(scenario.soft_robot, SoftRobotTable)
        tip = build_soft_body(scenario.soft_robot, scenario.model).rings["tip"]
        place = in_phase(result, "twist")
        arm = result.node_position[place, tip[0], :2] - result.tip_position[place, :2]
        angle = np.degrees(np.unwrap(np.arctan2(arm[:, 1], arm[:, 0])))
        angle, tension = angle[0] - angle, result.cable_tension_N[place, 0]
        axes.plot(tension, angle, label="default" if refine is None else f"refine = {refine}")
        for row, at in zip(rows, (5, 10, 15, 20), strict=True):
            row.values[words] = _at(tension, angle, at)
    for row in rows:
        row.values["default less finer [%]"] = 100.0 * (row.values["default"] / row.values["finer"] - 1.0)
    axes.set(xlabel="tension of each cable [N]", ylabel="twist of the tip [deg]")
    return rows


def hexagon_arm_deploys(axes: Axes, runs: Runs) -> list[Row]:
    """Length from the pack to the inflated arm and back, in time, in statics, and from the drawn shape."""
    name, ends = "hexagon_arm_deploys", dict[str, RunResult]()
    drawn = {"soft_robot.stiffener.rest_on_one_another": False, "start.cable_tension_N": [0.0] * 3}
    changes: dict[str, dict[str, Any]] = {
        "in time": {},
        "statics": {"mode": "quasistatic"},
        "statics, drawn": {"mode": "quasistatic", "phase.stow.cable_tension_N": [0.0] * 3, **drawn},
    }
    rows = [Row(f"{phase}, length [mm]") for phase in ("carry", "deploy", "stow")]
    rows += [Row("deploy, pack ratio"), Row("deploy, largest distance of a node from statics, drawn [mm]")]
    rows += [Row("simulated over CPU seconds")]
    for words, change in changes.items():
        before = runs.seconds.get((name, "default"), 0.0)
        result = ends[words] = runs.run(name, "default", change)
        if words == "in time":
            rows[5].values[words] = float(result.time_s[-1]) / (runs.seconds[name, "default"] - before)
        phases = {phase["name"]: phase for phase in result.summary["phases"]}
        for row, phase in zip(rows, ("carry", "deploy", "stow"), strict=False):
            row.values[words] = 1e3 * phases[phase]["length_m"]
        rows[3].values[words] = phases["deploy"]["pack_ratio"]
        axes.plot(result.time_s, 1e3 * (result.flange_position - result.tip_position)[:, 2], label=words)
    last = {words: run.node_position[in_phase(run, "deploy").stop - 1] for words, run in ends.items()}
    for words in ("in time", "statics"):
        away = np.linalg.norm(last[words] - last["statics, drawn"], axis=1).max()
        rows[4].values[words] = 1e3 * float(away)
    axes.set(xlabel="time [s]", ylabel="tip below the flange [mm]")
    return rows


def _open(scenario: Scenario) -> Scenario:
    """Return a scenario without its loops."""
    return replace(scenario, phases=tuple(replace(phase, control=()) for phase in scenario.phases))


def tip_path_control(axes: Axes, runs: Runs) -> list[Row]:
    """Error of the tip along a path: in closed loop, in open loop, and with the sag planned for."""
    name, rows = "tip_path_control", [Row("error along the path, rms [mm]"), Row("largest [mm]")]
    planned = {f"phase.{phase}.reach_with": "flange" for phase in ("reach.tip_target", "follow.tip_path")}
    planned["phase.hold.tip_target.reach_with"] = "flange"
    changes: dict[str, dict[str, Any]] = {
        "closed loop": {},
        "another seed": {"sensor.tip_camera.seed": 1},
        "without noise": {"sensor.tip_camera.noise": 0.0},
        "open loop": {},
        "open loop, sag planned": planned,
    }
    for words, change in changes.items():
        own = replace(runs, change=_open if words.startswith("open") else None)
        result = own.run(name, "default", change)
        path = own.scenario(name, "default", change).phases[-1].tip_path
        assert path is not None
        course, place = path.course(), in_phase(result, "follow")
        time_s = result.time_s[place] - result.time_s[place][0]
        away = np.linalg.norm(result.tip_position[place] - course.at(time_s).position, axis=1)
        along = away[time_s <= course.duration_s]
        rows[0].values[words], rows[1].values[words] = 1e3 * np.sqrt((along**2).mean()), 1e3 * along.max()
        axes.plot(time_s, 1e3 * away, label=words)
    axes.set(xlabel="time on the path [s]", ylabel="distance of the tip from its target [mm]", ylim=(0, None))
    return rows


def paper_figure_9(axes: Axes, runs: Runs) -> list[Row]:
    """Place of the tip of the arm on a UR5e: inflated, turned, lifted."""
    stages = {"inflate": "inflate", "turn": "rotate", "lift": "cable"}
    rows = [Row(f"tip {axis}, {phase} [mm]") for phase in stages for axis in "xz"]
    for result, model in runs.each("paper_figure_9"):
        x, _, z = 1e3 * result.tip_position.T
        axes.plot(x, z, color=COLOURS[model], label=model)
        for k, phase in enumerate(stages):
            place = in_phase(result, phase)
            rows[2 * k].values[model], rows[2 * k + 1].values[model] = (
                float(x[place][-1]),
                float(z[place][-1]),
            )
    data = reference("UR_Pneumatic")
    for k, stage in enumerate(stages.values()):
        tip = 1e3 * data[f"X_end_{stage}_m"][data["tip_ring_nodes"][0]].mean(axis=0)
        rows[2 * k].values["code"], rows[2 * k + 1].values["code"] = float(tip[0]), float(tip[2])
        axes.plot(tip[0], tip[2], "o", color=COLOURS["code"], label="code" if k == 0 else None)
    axes.set(xlabel="tip x [mm]", ylabel="tip z [mm]", aspect="equal")
    return rows


Figure = Callable[[Axes, Runs], list[Row]]
FIGURES: Final[dict[str, Figure]] = {
    "three_unit_inflation": three_unit_inflation,
    "ten_unit_extension": ten_unit_extension,
    "three_point_bending": three_point_bending,
    "three_point_bending_cables": partial(three_point_bending, tension_N=0.5),
    "bending_angle": bending_angle,
    "bending_angle_tip_load": bending_angle_tip_load,
    "hexagon_arm_bending": hexagon_arm_bending,
    "hexagon_arm_angles": hexagon_arm_angles,
    "gripper_finger_closing": gripper_finger_closing,
    "paper_figure_9": paper_figure_9,
    "hexagon_arm_torsion": hexagon_arm_torsion,
    "hexagon_arm_deploys": hexagon_arm_deploys,
    "tip_path_control": tip_path_control,
}
