"""What is counted of a run: what its plan and its start have cost is no cost of its ticks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HOLDS = """
schema = 2
title = "An inflated core stays as it is, then its pressure changes by a share"
robot = "none"
soft_robot = "square_core"
model.published = true
mode = "{mode}"
clock.tick_s = 0.01

[start]
flange = {{ position_m = [0.0, 0.0, 0.0], direction = [0.0, 0.0, -1.0] }}
pressure_Pa = 10e3

[[phase]]
name = "hold"
duration_s = 0.1

[[phase]]
name = "change"
duration_s = 0.1
pressure_Pa = {end_Pa}
"""


def test_tangents_of_the_plan_are_not_those_of_the_loop(tmp_path: Path) -> None:
    kept = tmp_path / "kept.json"
    command = [sys.executable, "benchmarks/real_time.py", "--repeats", "2", "--json", str(kept)]
    for mode in ("dynamic", "quasistatic"):
        for name, end_Pa in (("still", 10e3), ("moved", 12e3)):
            path = tmp_path / f"{mode}_{name}.toml"
            path.write_text(HOLDS.format(mode=mode, end_Pa=end_Pa), encoding="utf-8")
            command.append(str(path))
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300.0)
    found = {Path(key).stem: figures for key, figures in json.loads(kept.read_text("utf-8")).items()}
    for mode in ("dynamic", "quasistatic"):
        still, moved = found[f"{mode}_still"], found[f"{mode}_moved"]
        # a tick at rest looks at the balance once and finds it; stability and the natural frequency are found
        # once, at the end of each phase of ten ticks
        assert still["gradients"] == 1.0
        assert still["tangents"] <= 0.2
        assert still["tangents_before"] == moved["tangents_before"] > 5.0
        assert moved["tangents"] > 0.0
        assert moved["gradients"] > 1.0
