"""Runs the paper's specimens, as the paper models them and as we do, and plots both beside its output.

    python benchmarks/specimens.py [--out DIR] [--figures DIR] [--recordings] [SPECIMEN ...]

One PNG per specimen goes to docs/specimens/. "Paper's model" is ours with open ends, the published
hinges and strains measured along edges, at true equilibrium; "paper's code" is the published code's own
output (Sim-FAST by Y. Zhu, CC-BY 4.0, in tests/reference/). With --recordings every run leaves its
directory, with a Rerun recording, under --out.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import cosim
from cosim.base.frames import Array
from cosim.config.loading import load_scenario
from cosim.results.result import RunResult

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / "tests" / "reference"
EVERY_INCREMENT = {"recording.frames_per_s": 10_000.0}
PAPER = {"model.closed": False, "model.all_hinges": False, "soft_robot.film.law": "edge_strain"}
OURS, MODEL, CODE, FEM = "tab:blue", "tab:orange", "0.25", "tab:green"
PRESSURES_kPa = (10, 20, 30)
TOP_MIDDLE = (124, 126, 152, 154)  # the loaded corners of units 5 and 6


@dataclass(frozen=True)
class Runs:
    """Where runs go and how they are made."""

    out: Path
    recordings: bool

    def pair(
        self, name: str, changes: Mapping[str, Any] | None = None, label: str = ""
    ) -> tuple[tuple[RunResult, str, str], tuple[RunResult, str, str]]:
        """Return our run of a scenario and that of the paper's model, with the colour and words of each."""
        changes = {**EVERY_INCREMENT, **(changes or {})}
        ours = self.single(name, changes, f"{name}{label}-ours")
        model = self.single(name, {**changes, **PAPER}, f"{name}{label}-paper")
        return (ours, OURS, "ours"), (model, MODEL, "paper's model")

    def single(
        self, name: str, changes: Mapping[str, Any], directory: str, phases: int | None = None
    ) -> RunResult:
        """Return one run, of the first `phases` phases only if given."""
        scenario = load_scenario(name, changes)
        if phases is not None:
            scenario = replace(scenario, phases=scenario.phases[:phases])
        out = self.out / directory if self.recordings else None
        return cosim.run(scenario, out=out, recording=self.recordings)


def in_phase(result: RunResult, name: str) -> slice:
    """Return the rows of a phase, the last row of the one before it included."""
    rows = np.flatnonzero(result.phase == result.stage.phase_names.index(name))
    first = max(int(rows[0]) - 1, 0) if rows[0] else 0
    return slice(first, int(rows[-1]) + 1)


def deflection(result: RunResult, phase: str) -> Array:
    """Return the mean shift along y of the loaded nodes since a phase began [mm]."""
    y = result.node_position[in_phase(result, phase)][:, TOP_MIDDLE, 1].mean(axis=1)
    return np.asarray(1e3 * (y - y[0]))


def tilt(result: RunResult, phase: str) -> Array:
    """Return the angle between the tip ring's normal and the world's z axis through a phase [deg]."""
    z = result.tip_direction[in_phase(result, phase), 2]
    return np.degrees(np.arccos(np.clip(z, -1.0, 1.0)))


def reference(name: str) -> Any:
    """Return the published code's arrays of an example."""
    return np.load(REFERENCE / f"{name}.npz")


def lengths(axes: Axes, runs: Runs, name: str) -> dict[str, float]:
    """Plot length over pressure of both models; return the final lengths [mm]."""
    figures = {}
    for result, colour, label in runs.pair(name):
        axes.plot(1e-3 * result.pressure_Pa, 1e3 * result.tip_position[:, 2], color=colour, label=label)
        figures[label] = 1e3 * float(result.tip_position[-1, 2])
    axes.set(xlabel="pressure [kPa]", ylabel="length [mm]")
    return figures


def three_unit_inflation(axes: Axes, runs: Runs) -> dict[str, float]:
    """Length of three square units, with the shell reference for the same film."""
    figures = lengths(axes, runs, "three_unit_inflation")
    data = reference("Three_Unit_Compare")
    own = 1e3 * data["inflation_tip_ring_mean_z_m"]
    axes.plot(1e-3 * data["inflation_pressure_Pa"], own, ":", color=CODE, label="paper's code")
    axes.errorbar([2, 10], [42, 77], [1.5, 3], fmt="o", color=FEM, capsize=3, label="converged shells")
    figures["paper's code"] = float(own[-1])
    return figures


def ten_unit_extension(axes: Axes, runs: Runs) -> dict[str, float]:
    """Length of ten square units at 5 to 40 kPa."""
    figures = lengths(axes, runs, "ten_unit_extension")
    data = reference("Three_Point_Bending_pressure_sweep")
    own = 1e3 * data["P30000_inflation_tip_z_m"]
    axes.plot(1e-3 * data["P30000_inflation_pressure_Pa"], own, ":", color=CODE, label="paper's code")
    axes.errorbar([20], [259.5], [4.5], fmt="o", color=FEM, capsize=3, label="shells")
    return figures


def three_point_bending(axes: Axes, runs: Runs) -> dict[str, float]:
    """Deflection over force at three pressures."""
    figures, sweep = {}, reference("Three_Point_Bending_pressure_sweep")
    for line, kPa in zip(("-", "--", "-."), PRESSURES_kPa, strict=True):
        changes = {"phase.inflate.pressure_Pa": 1e3 * kPa}
        for result, colour, label in runs.pair("three_point_bending", changes, f"-{kPa}kPa"):
            shift = deflection(result, "bend")
            axes.plot(
                np.linspace(0.0, 1.2, len(shift)), shift, line, color=colour, label=f"{label}, {kPa} kPa"
            )
            figures[f"{label}, {kPa} kPa"] = float(shift[-1])
        own = 1e3 * sweep[f"P{1000 * kPa}_deflection_m"]
        axes.plot(sweep["load_total_N"], own, line, color=CODE, lw=0.8, label=f"paper's code, {kPa} kPa")
        figures[f"paper's code, {kPa} kPa"] = float(own[-1])
    axes.set(xlabel="force [N]", ylabel="deflection [mm]")
    return figures


def three_point_bending_cables(axes: Axes, runs: Runs) -> dict[str, float]:
    """Deflection over force with and without four cables at 0.5 N, 30 kPa."""
    figures = {}
    for line, tension, words in (("-", 0.5, "cables at 0.5 N"), ("--", 0.0, "slack")):
        changes = {"phase.tighten.cable_tension_N": [tension] * 4}
        pair = runs.pair("three_point_bending_cables", changes, "" if tension else "-slack")
        for result, colour, label in pair:
            shift = deflection(result, "bend")
            axes.plot(np.linspace(0.0, 2.1, len(shift)), shift, line, color=colour, label=f"{label}, {words}")
            figures[f"{label}, {words}"] = float(shift[-1])
    data = reference("Three_Point_Bending_Cable")
    own = 1e3 * data["bend_deflection_relative_to_stage_start_m"]
    axes.plot(data["bend_load_total_N"], own, ":", color=CODE, label="paper's code, cables at 0.5 N")
    figures["paper's code, cables at 0.5 N"] = float(own[-1])
    axes.set(xlabel="force [N]", ylabel="deflection [mm]")
    return figures


def bending_angle(axes: Axes, runs: Runs) -> dict[str, float]:
    """Tilt of the tip over the tension of two cables."""
    figures = {}
    for result, colour, label in runs.pair("bending_angle"):
        angle = tilt(result, "pull")
        axes.plot(result.cable_tension_N[in_phase(result, "pull"), 0], angle, color=colour, label=label)
        figures[label] = float(angle[-1])
    own = reference("Bending_Angle")["bending_angle_deg_cable_path"]
    axes.plot(np.linspace(0.005, 0.5, 100), own, ":", color=CODE, label="paper's code (pressure lags)")
    figures["paper's code"] = float(own[-1])
    axes.set(xlabel="tension of each cable [N]", ylabel="tilt of the tip [deg]")
    return figures


def bending_angle_tip_load(axes: Axes, runs: Runs) -> dict[str, float]:
    """Tip's sideways place under a load of 2 x 0.5 N, then over the tension that works against it."""
    figures = {}
    for result, colour, label in runs.pair("bending_angle_tip_load"):
        rows = in_phase(result, "pull")
        y = 1e3 * result.tip_position[rows, 1]
        axes.plot(result.cable_tension_N[rows, 0], y, color=colour, label=label)
        figures[f"{label}, loaded"], figures[f"{label}, pulled"] = float(y[0]), float(y[-1])
    axes.axhline(0.0, color="0.8", lw=0.8)
    axes.set(xlabel="tension of each cable [N]", ylabel="tip along the load [mm]")
    return figures


def hexagon_arm_bending(axes: Axes, runs: Runs) -> dict[str, float]:
    """Path of the tip, seen from above, through six directions; the paper pulls one cable."""
    name = "hexagon_arm_bending"
    ours = runs.single(name, EVERY_INCREMENT, f"{name}-ours")
    # with open ends the round fails in its third direction: no stable equilibrium follows
    model = runs.single(name, {**EVERY_INCREMENT, **PAPER}, f"{name}-paper", phases=2)
    figures = {}
    for result, colour, label in ((ours, OURS, "ours"), (model, MODEL, "paper's model, cable a")):
        x, y, z = 1e3 * result.tip_position.T
        axes.plot(x, y, color=colour, label=label)
        figures[f"{label}, length"] = float(z[in_phase(result, "inflate")][-1])
        figures[f"{label}, aside at 30 N"] = float(np.hypot(x, y)[in_phase(result, "a")][-1])
    axes.set(xlabel="tip x [mm]", ylabel="tip y [mm]", aspect="equal")
    return figures


def gripper_finger_closing(axes: Axes, runs: Runs) -> dict[str, float]:
    """Path of the tip in the finger's plane."""
    figures = {}
    for result, colour, label in runs.pair("gripper_finger_closing"):
        _, y, z = 1e3 * result.tip_position.T
        axes.plot(y, z, color=colour, label=label)
        for tension in (0.6, 3.0):
            row = int(np.argmax(result.cable_tension_N[:, 0] >= tension - 1e-9))
            axes.plot(y[row], z[row], "o", ms=4, color=colour)
            axes.annotate(f"{tension:g} N", (y[row], z[row]))
        figures[f"{label}, y"], figures[f"{label}, z"] = float(y[-1]), float(z[-1])
    axes.set(xlabel="tip, outwards from the gripper's axis [mm]", ylabel="tip z [mm]", aspect="equal")
    return figures


Specimen = Callable[[Axes, Runs], dict[str, float]]
SPECIMENS: dict[str, Specimen] = {
    function.__name__: function
    for function in (
        three_unit_inflation,
        ten_unit_extension,
        three_point_bending,
        three_point_bending_cables,
        bending_angle,
        bending_angle_tip_load,
        hexagon_arm_bending,
        gripper_finger_closing,
    )
}


def main() -> int:
    """Run, plot and print the final figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("specimens", nargs="*", metavar="SPECIMEN", help=f"of {', '.join(SPECIMENS)}")
    parser.add_argument("--out", type=Path, default=Path("runs", "specimens"), help="directory of the runs")
    parser.add_argument(
        "--figures", type=Path, default=ROOT / "docs" / "specimens", help="directory of the PNGs"
    )
    parser.add_argument("--recordings", action="store_true", help="leave every run, with its recording")
    options = parser.parse_args()
    options.figures.mkdir(parents=True, exist_ok=True)
    for name in options.specimens or SPECIMENS:
        figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
        figures = SPECIMENS[name](axes, Runs(options.out, options.recordings))
        axes.set_title(load_scenario(name).title, fontsize=10)
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
        figure.savefig(options.figures / f"{name}.png", dpi=110)
        plt.close(figure)
        print(name)
        for label, value in figures.items():
            print(f"    {label:<44}{value:>9.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
