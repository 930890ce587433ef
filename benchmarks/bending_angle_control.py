"""Three controllers bend the same arm to the same angle: overshoot, settling time, limit cycle.

python benchmarks/bending_angle_control.py [--sensor] [--json] [--plot FILE.png]
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np

import cosim

_LABELS: Final = {
    "bang_bang": "bang-bang on tension (the paper's law, 10 Hz)",
    "pi_tension": "PI on tension, 50 Hz",
    "pi_length": "PI on length, winch, 50 Hz",
}


_SENSOR: Final = {
    "name": "bend", "kind": "bending_angle", "noise": math.radians(0.5), "delay_s": 0.04, "rate_Hz": 50.0,
    "quantum": math.radians(0.1),
}  # fmt: skip


def main() -> None:
    """Run the scenario, print its table, and draw it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sensor", action="store_true", help="let the controllers see a sensor of the angle")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--plot", type=Path, help="file of a picture to write")
    arguments = parser.parse_args()
    changes: dict[str, Any] = {"model.published": True}
    if arguments.sensor:
        changes["sensor"] = [_SENSOR]
        changes |= {f"controller.{name}.sensors": ["bend"] for name in ("paper", "tension", "length")}
    result = cosim.run("bending_angle_control", overrides=changes)
    figures = controlled_phases(result)
    print(json.dumps(figures, indent=2) if arguments.json else table(figures))
    if arguments.plot is not None:
        draw(result, arguments.plot)


def controlled_phases(result: cosim.RunResult) -> dict[str, dict[str, Any]]:
    """Return the figures of the controller of every phase that has one."""
    found = {}
    for phase in result.summary["phases"]:
        for figures in phase["devices"].get("controllers", {}).values():
            found[phase["name"]] = figures
    return found


def table(figures: dict[str, dict[str, Any]]) -> str:
    """Return the figures as a Markdown table."""
    lines = [
        "| controller | overshoot [deg] | settled within 5 % after [s] | limit cycle, half range [deg] |",
        "|---|---|---|---|",
    ]
    for name, entry in figures.items():
        settled = entry["settling_time_s"]
        cells = [
            _LABELS[name],
            f"{math.degrees(entry['overshoot']):.2f}",
            "never" if settled is None else f"{settled:.2f}",
            f"{math.degrees(entry['ripple']):.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(result: cosim.RunResult, path: Path) -> None:
    """Draw angle and tension over the time since each controller began."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (angle, tension) = plt.subplots(2, 1, sharex=True, figsize=(8.0, 5.5), layout="constrained")
    for index, name in enumerate(result.stage.phase_names):
        if name in _LABELS:
            rows = result.phase == index
            time_s = result.time_s[rows] - result.time_s[rows][0]
            angle.plot(time_s, np.degrees(result.bending_angle_rad[rows]), label=_LABELS[name])
            tension.plot(time_s, result.cable_tension_N[rows, 0])
    angle.axhline(20.0, color="grey", linewidth=0.8)
    angle.set_ylabel("bending angle [deg]")
    angle.legend(loc="lower right")
    tension.set_ylabel("tension of the cable [N]")
    tension.set_xlabel("time since the controller began [s]")
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
