"""Tip paths in coupled runs: errors with and without compensation, and MuJoCo alone driven by the export.

    python benchmarks/tip_paths.py [--fidelity section|lumped] [--speeds 20 50 100] [--paths NAME ...]

Ten paths of at least 150 mm: lines, bends and circles, two of which turn the tip by 30 degrees. A UR5e
carries the arm, inflated, brings its tip to the begin, waits, and follows; the error is the largest
distance of the tip from where it is to be at that instant, over all ticks of the path, and the largest
angle. Uncompensated runs have the flange where a straight arm would be on the path. For the export, the
CSV is read back and MuJoCo moves the bare arm by it, with the servos of the run; its flange is compared
with the planned one and with that of the coupled run.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import cosim
from cosim.base.frames import Array
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm
from cosim.results.joint_table import JointTable
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

CENTER = np.array([0.45, 0.0, 0.5])
DOWN = np.array([0.0, 0.0, -1.0])
SETTINGS: dict[str, dict[str, Any]] = {
    "section": {"soft_robot": "hexagon_arm", "solver.damping_per_s": 2.0},
    "lumped": {"soft_robot": "light_hexagon_arm", "solver.damping_per_s": 5.0},
}
"""The paper's 869 g on the quick model, film and frames alone (40 g) on the film itself."""
BOUND_MM, BOUND_DEGREES, EXPORT_MM = 1.0, 1.0, 0.1


@dataclass(frozen=True)
class TipCurve:
    """A path: points (n, 3) [m] and directions (n, 3) or (1, 3)."""

    points: Array
    directions: Array


def tilted(x_degrees: Array | float, y_degrees: Array | float) -> Array:
    """Return directions (n, 3) that lean from straight down towards x and y."""
    x, y = np.broadcast_arrays(np.tan(np.radians(x_degrees)), np.tan(np.radians(y_degrees)))
    rows = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def line(shift: tuple[float, float, float], directions: Array, count: int = 2) -> TipCurve:
    """Return a line through the centre."""
    share = np.linspace(-0.5, 0.5, count)
    return TipCurve(CENTER + share[:, None] * np.array(shift), directions)


def bend(shape: Callable[[Array], tuple[Any, Any, Any]], directions: Array, count: int = 25) -> TipCurve:
    """Return a curve around the centre, of a parameter from 0 to 1."""
    x, y, z = np.broadcast_arrays(*shape(np.linspace(0.0, 1.0, count)))
    return TipCurve(CENTER + np.stack([x, y, z], axis=1), directions)


def paths() -> dict[str, TipCurve]:
    """Return the ten paths."""
    turn, share = 2.0 * np.pi, np.linspace(0.0, 1.0, 9)
    down, leaning = DOWN[None], tilted(8.0, 0.0)
    return {
        "line, sideways": line((0.0, 0.2, 0.0), down),
        "line, outwards": line((0.16, 0.0, 0.0), leaning),
        "line, upwards": line((0.0, 0.0, 0.15), down),
        "line, aslant": line((0.1, 0.12, 0.08), tilted(5.0, 5.0)),
        "line, turning 30 degrees": line((0.0, 0.18, 0.0), tilted(0.0, np.linspace(-15.0, 15.0, 9)), 9),
        "half circle, r = 60 mm": bend(
            lambda s: (0.06 * np.sin(np.pi * s), 0.06 * np.cos(np.pi * s), 0.0), down
        ),
        "circle, r = 40 mm": bend(lambda s: (0.04 * np.cos(turn * s), 0.04 * np.sin(turn * s), 0.0), leaning),
        "upright circle, r = 40 mm": bend(
            lambda s: (0.0, 0.04 * np.sin(turn * s), 0.04 * np.cos(turn * s)), down
        ),
        "wave": bend(lambda s: (0.02 * np.sin(turn * s), 0.2 * (s - 0.5), 0.01 * np.cos(turn * s)), leaning),
        "arc, turning 30 degrees": TipCurve(
            CENTER
            + np.stack(
                [0.12 * np.cos(1.4 * (share - 0.5)) - 0.12, 0.12 * np.sin(1.4 * (share - 0.5)), 0.0 * share],
                1,
            ),
            tilted(np.linspace(-13.0, 17.0, 9), 0.0),
        ),
    }


def scenario(path: TipCurve, speed_m_s: float, fidelity: str, reach_with: str) -> dict[str, Any]:
    """Return the changes that make the reference scenario follow a path."""
    first = path.points[0].tolist()
    reach = {"position_m": first, "direction": path.directions[0].tolist(), "reach_with": reach_with}
    follow = {
        "points_m": path.points.tolist(), "directions": path.directions.tolist(), "speed_m_s": speed_m_s,
        "reach_with": reach_with,
    }  # fmt: skip
    return {
        "fidelity": fidelity,
        **SETTINGS[fidelity],
        "start.flange": {"position_m": [first[0], first[1], first[2] + 0.18], "direction": DOWN.tolist()},
        "start.pressure_Pa": 40e3,
        "phase": [
            {"name": "reach", "duration_s": 2.0, "settle_s": 3.0, "tip_target": reach},
            {"name": "follow", "settle_s": 0.1, "tip_path": follow},
        ],
    }


def measured(path: TipCurve, speed_m_s: float, fidelity: str) -> dict[str, float]:
    """Return the largest errors [mm, degrees] of a run, and of one without compensation."""
    found: dict[str, float] = {}
    for reach_with, prefix in (("flange", ""), ("none", "uncompensated_")):
        try:
            changes = scenario(path, speed_m_s, fidelity, reach_with)
            figures = cosim.run("ur5e_hexagon_arm", overrides=changes).summary["phases"][-1]["tip_path"]
        except cosim.CosimError as error:
            print(f"  {reach_with}: {error}")
            figures = {"largest_error_m": np.nan, "mean_error_m": np.nan, "largest_angle_rad": np.nan}
        found[f"{prefix}mm"] = 1e3 * figures["largest_error_m"]
        found[f"{prefix}mean_mm"] = 1e3 * figures["mean_error_m"]
        found[f"{prefix}degrees"] = float(np.degrees(figures["largest_angle_rad"]))
    return found


def bare_arm(table: JointTable) -> tuple[Array, Array]:
    """Return the flange's places (n, 3) [m] of MuJoCo's bare arm driven by a table, and those asked for."""
    file = find_arm("ur5e")
    arm, step_s = Arm(file), float(table.time_s[1])
    scene = RigidScene(
        SceneDescription(arm=file, tick_s=step_s, gravity=(0.0, 0.0, -9.81), objects=(), wires=())
    )
    q = table.joints
    v = np.gradient(q, step_s, axis=0)
    a = np.gradient(v, step_s, axis=0)
    scene.set_joint_state(q[0])
    scene.begin_step()
    places = [scene.flange_pose.translation]
    for k in range(len(q) - 1):
        scene.set_control(q[k], v[k], arm.inverse_dynamics(q[k], v[k], a[k], scene.armature))
        scene.step()
        places.append(scene.flange_pose.translation)
    return np.array(places), np.array([arm.forward(row).translation for row in q])


def exported(path: TipCurve, speed_m_s: float, fidelity: str) -> dict[str, float]:
    """Return how far [mm] the bare arm's flange is from the planned one, and from that of the coupled run."""
    changes = scenario(path, speed_m_s, fidelity, "flange")
    result = cosim.run("ur5e_hexagon_arm", overrides=changes)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "follow.csv"
        cosim.plan_path("ur5e_hexagon_arm", overrides=changes).write(file)
        table = JointTable.read(file)
    driven, asked = bare_arm(table)
    first = int(np.flatnonzero(result.phase == 1)[0]) - 1
    coupled = result.flange_position[first : first + len(driven)]
    count = min(len(coupled), len(driven))
    return {
        "planned_mm": 1e3 * float(np.linalg.norm(driven - asked, axis=1).max()),
        "coupled_mm": 1e3 * float(np.linalg.norm(driven[:count] - coupled[:count], axis=1).max()),
    }


def main() -> None:
    """Print a line for every path, and whether the bounds at the lowest speed are kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fidelity", choices=tuple(SETTINGS), default="section")
    parser.add_argument("--speeds", type=float, nargs="+", default=[20.0, 50.0, 100.0], metavar="MM_S")
    parser.add_argument("--paths", nargs="+", default=list(paths()), metavar="NAME")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows: dict[str, Any] = {}
    for name in options.paths:
        path, row = paths()[name], {}
        for speed in options.speeds:
            row[f"{speed:g}"] = figures = measured(path, 1e-3 * speed, options.fidelity)
            print(
                f"{name:28} {speed:4g} mm/s: {figures['mm']:7.3f} mm {figures['degrees']:6.3f} deg, "
                "uncompensated "
                f"{figures['uncompensated_mm']:7.2f} mm {figures['uncompensated_degrees']:6.2f} deg",
                flush=True,
            )
        row["export"] = exported(path, 1e-3 * options.speeds[0], options.fidelity)
        print(f"{name:28} export: {row['export']}", flush=True)
        rows[name] = row
        if options.json:
            options.json.write_text(json.dumps(rows, indent=2), encoding="utf-8")
    slowest = [row[f"{options.speeds[0]:g}"] for row in rows.values()]
    kept = sum(found["mm"] <= BOUND_MM and found["degrees"] <= BOUND_DEGREES for found in slowest)
    alike = sum(row["export"]["coupled_mm"] <= EXPORT_MM for row in rows.values())
    print(
        f"{kept} of {len(rows)} paths within {BOUND_MM:g} mm and {BOUND_DEGREES:g} degree; {alike} exports "
        "alike"
    )


if __name__ == "__main__":
    main()
