"""A made-up run: a square chamber that stretches and swings on a moving box."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
import rerun as rr

from cosim.frames import Array, Pose, Twist, Wrench, quaternion_from_rotation, rotation_from_vector
from cosim.scenario.snapshot import LedgerEntry, RigidShape, Snapshot, Stage
from cosim.soft.chamber import PolygonalStack

MakeStage: TypeAlias = Callable[..., Stage]
MakeSnapshot: TypeAlias = Callable[..., Snapshot]

MESH = PolygonalStack(sides=4, units=3, corner_radius_m=0.04, hole_radius_m=0.004, unit_height_m=0.004).mesh()
TETRAHEDRON = RigidShape(
    body=1,
    vertices=0.1 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float),
    triangles=np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    rgba=(0.8, 0.4, 0.2, 1.0),
)


def stretch_stress(positions: Array) -> Array:
    """Stand-in for a film law: stress grows with each triangle's distance below the flange."""
    return np.asarray(1e8 * (0.5 - positions[MESH.triangles, 2].mean(axis=1)))


def make_stage(**changes: Any) -> Stage:
    """Return a stage of 1.5 s at 2 ms ticks."""
    values: dict[str, Any] = {
        "scenario": "made_up",
        "title": "A chamber on a box",
        "mode": "dynamic",
        "tick_s": 0.002,
        "duration_s": 1.5,
        "ticks": 750,
        "phase_names": ("rest", "swing"),
        "body_names": ("world", "box"),
        "shapes": (TETRAHEDRON,),
        "soft_triangles": MESH.triangles,
        "cables": (MESH.corner_line(0), MESH.corner_line(1)),
        "soft_weight_N": 2.0,
        "gravity": np.array([0.0, 0.0, -9.81]),
        "membrane_stress": stretch_stress,
        "report": "Model: made up.",
    }
    return Stage(**(values | changes))


def make_snapshot(stage: Stage, tick: int, **changes: Any) -> Snapshot:
    """Return a snapshot; from halfway on there is a tip target and tension."""
    time = tick * stage.tick_s
    late = 2 * tick >= stage.ticks
    turn = rotation_from_vector(np.array([0.0, 0.3 * np.sin(time), 0.0])) @ np.diag([1.0, -1.0, -1.0])
    flange = Pose(turn, np.array([0.3, 0.05 * time, 0.5]))
    nodes = flange.apply(MESH.positions * (1.0, 1.0, 1.0 + 3.0 * time))
    tip = nodes[MESH.ring("tip")].mean(axis=0)
    ledger = LedgerEntry(
        wrench=Wrench((0.1, 0.0, -2.0), (0.0, 0.2 * late, 0.0)),
        rigid_power_W=0.02,
        soft_power_W=-0.019,
        residual_N=0.0 if tick == 0 else 1e-7,
        newton_iterations=2,
        stability_ratio=0.4,
        algorithmic_mass=False,
    )
    values: dict[str, Any] = {
        "tick": tick,
        "time_s": time,
        "phase": int(late),
        "joint_position": np.array([0.1, 0.2]),
        "joint_target": np.array([0.1, 0.201]),
        "body_position": np.stack([np.zeros(3), flange.translation]),
        "body_quaternion": np.stack([np.array([1.0, 0.0, 0.0, 0.0]), quaternion_from_rotation(turn)]),
        "node_position": nodes,
        "world_from_flange": flange,
        "flange_twist": Twist(),
        "pressure_Pa": 1e4 * time,
        "cable_tension_N": np.array([3.0, 0.0]) * late,
        "tip_position": tip,
        "tip_direction": turn[:, 2],
        "sag_m": 0.01 * time,
        "tip_target": np.array([0.3, 0.0, 0.4]) if late else None,
        "ledger": ledger,
        "tick_wall_s": 0.001,
    }
    return Snapshot(**(values | changes))


@pytest.fixture(name="make_stage")
def _make_stage() -> MakeStage:
    return make_stage


@pytest.fixture(name="make_snapshot")
def _make_snapshot() -> MakeSnapshot:
    return make_snapshot


@pytest.fixture
def strict() -> Iterator[None]:
    """Make rerun raise on bad arguments, which it would otherwise drop with a warning."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(before)


@pytest.fixture
def rrd(tmp_path: Path) -> Path:
    """Path of a recording in a folder that does not exist yet."""
    return tmp_path / "run" / "recording.rrd"
