"""Cameras: depths of a known plane, the film's silhouette, places, rates, files; and what is refused."""

from __future__ import annotations

from ctypes.util import find_library
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import cosim
from cosim.base.frames import Array
from cosim.errors import InputError, OutputError, ScenarioError
from cosim.rigid.scene import renderer
from cosim.telemetry.camera_image import CameraImage
from tests.devices import device_parts

pytestmark = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa")), reason="nothing draws without a screen here"
)

INFLATE = """
[[phase]]
name = "inflate"
duration_s = 0.4
pressure_Pa = 20e3
cable_tension_N = [0.3, 0.0]
"""
SIDE = {
    "name": "side", "position_m": [0.25, 0.0, 0.03], "direction": [-1.0, 0.0, 0.0], "size": [320, 240],
    "fov_rad": 0.4, "rate_Hz": 20.0,
}  # fmt: skip
STILL: dict[str, Any] = {"phase": [], "fidelity": "rigid", "contact.enabled": False}


def rays(image: CameraImage, fov_rad: float) -> Array:
    """Return where the centre of every pixel looks (h, w, 3), world axes, 1 along the line of sight."""
    height, width = image.depth_m.shape
    focal = 0.5 * height / np.tan(0.5 * fov_rad)
    x = (np.arange(width) + 0.5 - 0.5 * width) / focal
    y = (0.5 * height - 0.5 - np.arange(height)) / focal
    local = np.stack([*np.broadcast_arrays(x, y[:, None]), np.full((height, width), -1.0)], axis=-1)
    return np.asarray(local @ image.rotation.T)


def silhouette(image: CameraImage, fov_rad: float, nodes: Array, triangles: Array) -> NDArray[np.bool_]:
    """Return the pixels (h, w) whose centres lie in the projection of some triangle."""
    height, width = image.depth_m.shape
    local = (nodes - image.position) @ image.rotation
    focal = 0.5 * height / np.tan(0.5 * fov_rad)
    flat = np.stack([local[:, 0], -local[:, 1]], axis=1) / -local[:, 2:] * focal + [0.5 * width, 0.5 * height]
    place = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    found = np.zeros((height, width), dtype=bool)
    for a, b, c in flat[triangles]:
        sides = [
            (q[0] - p[0]) * (place[..., 1] - p[1]) - (q[1] - p[1]) * (place[..., 0] - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        found |= np.all(np.array(sides) >= 0.0, axis=0) | np.all(np.array(sides) <= 0.0, axis=0)
    return found


def test_depths_of_the_floor_are_right_within_a_millimetre() -> None:
    above = {"name": "above", "position_m": [1.0, 1.0, 0.8], "direction": [0.0, 0.0, -1.0]}
    aslant = {"name": "aslant", "position_m": [0.9, 0.9, 0.6], "direction": [0.3, 0.2, -1.1], "fov_rad": 0.6}
    here = cosim.Simulation("ur5e_hexagon_arm", overrides={**STILL, "camera": [above, aslant]})
    floor = 2 + here.stage.body_names.index("floor")
    for name, fov in (("above", 0.8), ("aslant", 0.6)):
        image = here.image(name)
        assert image.rgb.shape == (240, 320, 3)
        assert np.all(image.segments == floor)
        exact = image.position[2] / -rays(image, fov)[..., 2]
        assert np.abs(image.depth_m - exact).max() < 1e-3, name
    assert np.ptp(image.depth_m) > 0.1


def test_the_film_is_where_its_nodes_are_and_moves_with_them(tmp_path: Path) -> None:
    given = device_parts.scenario(tmp_path, INFLATE, overrides={"camera": [SIDE]})
    here = cosim.Simulation(given)
    shares, areas = [], []
    for _ in range(2):
        image, nodes = here.image("side"), here.snapshot.node_position
        wanted = silhouette(image, 0.4, nodes, here.stage.soft_triangles)
        seen = image.segments == 1
        shares.append((wanted & seen).sum() / (wanted | seen).sum())
        areas.append(seen.sum())
        assert np.all(np.isinf(image.depth_m) == ~seen)
        here.step(here.ticks_left)
    assert min(shares) > 0.98
    assert areas[1] > 2 * areas[0]
    nearest = 0.25 - nodes[:, 0].max()
    assert image.depth_m.min() == pytest.approx(nearest, abs=1e-3)


def test_cameras_are_on_what_carries_them() -> None:
    on = [
        {"name": "wrist", "on": "flange", "position_m": [0.0, 0.1, 0.0]},
        {"name": "end", "on": "tip", "position_m": [0.0, 0.0, 0.02]},
    ]
    here = cosim.Simulation("ur5e_hexagon_arm", overrides={**STILL, "camera": on})
    here.step(cosim.Command(flange_twist=(0.1, 0.0, 0.0, 0.0, 0.3, 0.0)), ticks=5)
    shown, flange = here.snapshot, here.snapshot.world_from_flange
    wrist, end = here.image("wrist"), here.image("end")
    assert wrist.position == pytest.approx(flange.translation + 0.1 * flange.rotation[:, 1])
    assert -wrist.rotation[:, 2] == pytest.approx(flange.rotation[:, 2])
    assert wrist.rotation[:, 1] == pytest.approx(flange.rotation[:, 0])
    assert end.position == pytest.approx(shown.tip_position + 0.02 * shown.tip_direction)
    assert -end.rotation[:, 2] == pytest.approx(shown.tip_direction)
    for image in (wrist, end):
        assert image.rotation.T @ image.rotation == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(image.rotation) == pytest.approx(1.0)
    with pytest.raises(InputError, match="there is no camera 'eye'; there are: wrist, end"):
        here.image("eye")


def test_pictures_of_a_run_are_in_its_result_and_files_and_change_nothing(tmp_path: Path) -> None:
    plain = cosim.run(device_parts.scenario(tmp_path, INFLATE))
    given = device_parts.scenario(tmp_path, INFLATE, overrides={"camera": [SIDE]})
    result = cosim.run(given, out=tmp_path / "run")
    assert plain.images == {}
    assert np.array_equal(plain.node_position, result.node_position)
    images = result.images["side"]
    assert images.time_s == pytest.approx(0.05 * np.arange(9), abs=device_parts.TICK_s)
    assert images.rgb.shape == (9, 240, 320, 3)
    assert np.array_equal(result.time_s[images.tick], images.time_s)
    again = cosim.load_run(tmp_path / "run")
    assert again.stage.cameras == result.stage.cameras
    for name in ("tick", "time_s", "rgb", "depth_m", "segments", "position", "rotation"):
        read, made = getattr(again.images["side"], name), getattr(images, name)
        assert read.dtype == made.dtype
        assert np.array_equal(read, made), name


def test_without_a_library_that_draws_the_message_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = device_parts.scenario(tmp_path, INFLATE, overrides={"camera": [SIDE]})
    monkeypatch.setattr(renderer, "find_library", lambda _name: None)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(OutputError, match=r"neither is there: install EGL .* libegl1 .*MUJOCO_GL=egl"):
        cosim.Simulation(given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"up": [2.0, 0.0, 0.0]}, r"camera\.side\.up: \[2\.0, 0\.0, 0\.0\] is the direction"),
        ({"on": "palm"}, r"camera\.side\.on: 'palm': there is no palm on a flange"),
        ({"on": "wrist"}, r"camera\.side\.on: got the text 'wrist'; allowed: 'world', 'flange', 'tip'"),
        ({"size": [320, 0]}, r"camera\.side\.size\.2: 0 is out of bounds"),
    ],
)
def test_a_wrong_camera_is_refused_by_its_key(tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        device_parts.scenario(tmp_path, INFLATE, overrides={"camera": [{**SIDE, **change}]})
