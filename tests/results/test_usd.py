"""Runs as USD, read back by its own library: units, axes, bodies and film in time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import rotations_from_quaternions
from cosim.base.kept_parts import KeptParts
from cosim.build.arm_parts import ArmParts
from cosim.cli.main import main
from cosim.config.loading import load_scenario

SHORT: dict[str, Any] = {
    "soft_robot": "square_core", "start.cable_tension_N": [], "clock.tick_s": 0.004,
    "recording.frames_per_s": 50, "solver.damping_per_s": 2.0,
    "phase": [{"name": "fill", "duration_s": 0.1, "settle_s": 0.02, "pressure_Pa": 5e3}],
}  # fmt: skip


def volume_m3(points: Any, triangles: Any) -> float:
    """Return the volume that triangles enclose, from their first corner on."""
    a, b, c = (np.asarray(points, float)[triangles[:, k]] - points[0] for k in range(3))
    return float(np.einsum("kr,kr->", a, np.cross(b, c)) / 6.0)


def test_a_run_as_usd_is_the_run(tmp_path: Path) -> None:
    """In metres with z up; bodies where they were at each frame, and a film of the same volume."""
    pxr = pytest.importorskip("pxr", reason="needs usd-core")
    assert pxr
    from pxr import Usd, UsdGeom

    result = cosim.run("ur5e_hexagon_arm", overrides=SHORT, out=tmp_path / "run")
    assert main(["export", str(tmp_path / "run"), "--usd"]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "run" / "scene.usdc"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    rate = stage.GetTimeCodesPerSecond()
    film = UsdGeom.Mesh.Get(stage, "/World/Film")
    triangles = np.array(film.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    samples = film.GetPointsAttr().GetTimeSamples()
    assert [code / rate for code in samples] == pytest.approx(result.frame_time_s.tolist(), abs=1e-9)
    worst = 0.0
    for frame, code in enumerate(samples):
        nodes, points = result.node_position[frame], np.array(film.GetPointsAttr().Get(code), float)
        points += np.array(film.ComputeLocalToWorldTransform(code))[3, :3]
        np.testing.assert_allclose(points, nodes, rtol=0.0, atol=1e-7)
        volume = volume_m3(nodes, result.stage.soft_triangles)
        worst = max(worst, abs(volume_m3(points, triangles) / volume - 1.0))
    assert worst < 1e-6
    assert volume > 1.5e-5
    shapes = ArmParts(load_scenario(tmp_path / "run" / "scenario.toml"), KeptParts()).scene.shapes
    shape, code = shapes[-1], samples[-1]
    name, row = result.stage.body_names[shape.body], np.searchsorted(result.tick, result.frame_tick[-1])
    mesh = UsdGeom.Mesh.Get(stage, f"/World/Scene/{name}/shape_{len(shapes) - 1}")
    at = np.array(mesh.ComputeLocalToWorldTransform(code)).T
    turn = rotations_from_quaternions(result.body_quaternion[row, [shape.body]])[0]
    np.testing.assert_allclose(at[:3, :3], turn, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(at[:3, 3], result.body_position[row, shape.body], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(mesh.GetPointsAttr().Get(), shape.vertices, rtol=0.0, atol=1e-7)


def test_usd_without_its_library_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    assert main(["export", str(tmp_path), "--usd"]) == 2
    assert "pip install 'cosim[usd]'" in capsys.readouterr().err
