"""Runs as bags, read by another library than the one that writes them."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import cosim
from cosim.app import preparation
from cosim.base.frames import rotations_from_quaternions
from cosim.cli.main import main
from cosim.results import ros_bag
from cosim.results.result import CameraImages
from cosim.telemetry.camera_image import CameraInfo


@pytest.fixture
def result(
    made_up_build: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> cosim.RunResult:
    monkeypatch.setattr(preparation, "build_simulation", made_up_build())
    overrides = {"clock.tick_s": 0.01, "recording.frames_per_s": 50}
    found = cosim.run("ur5e_hexagon_arm", overrides=overrides, out=tmp_path / "run")
    turns = np.random.default_rng(1).normal(size=(len(found.tick), 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return replace(found, arrays={**found.arrays, "flange_quaternion": turns})


def read(path: Path) -> dict[str, list[tuple[float, Any]]]:
    """Return the messages of a bag, by topic, with their times [s]."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, said in reader.iter_decoded_messages():
            found[channel.topic].append((1e-9 * message.log_time, said))
    return found


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def test_a_bag_holds_what_the_run_saw(result: cosim.RunResult, tmp_path: Path) -> None:
    ros_bag.write_bag(result, tmp_path / "bag")
    found = read(tmp_path / "bag" / "bag.mcap")
    ticks = len(result.tick)
    joints = found["/joint_states"]
    assert [time_s for time_s, _ in joints] == pytest.approx(result.time_s.tolist(), abs=1e-9)
    assert list(joints[0][1].name) == list(result.stage.joint_names)
    np.testing.assert_array_equal([message.position for _, message in joints], result.joint_position)
    np.testing.assert_array_equal([message.effort for _, message in joints], result.joint_torque)
    targets = [message.position for _, message in found["/joint_targets"]]
    np.testing.assert_array_equal(targets, result.joint_target)
    tips = [xyz(message.pose.position) for _, message in found["/tip_pose"]]
    np.testing.assert_array_equal(tips, result.tip_position)
    turn = rotations_from_quaternions(result.flange_quaternion)
    forces = np.array([xyz(message.wrench.force) for _, message in found["/flange_wrench"]])
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turn, forces), result.flange_force, atol=1e-12)
    pressures = [message.data for _, message in found["/pressure_Pa/chamber"]]
    assert pressures == result.chamber_pressure_Pa[:, 0].tolist()
    frames = {entry.child_frame_id: entry.transform for entry in found["/tf"][-1][1].transforms}
    assert set(frames) == {"flange", "tip", *result.stage.body_names}
    assert xyz(frames["flange"].translation) == result.flange_position[-1].tolist()
    assert len(found["/tf"]) == ticks


def test_the_command_says_what_it_wrote(
    result: cosim.RunResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(tmp_path / "run"), "--bag"]) == 0
    count = sum(map(len, read(tmp_path / "run" / "bag" / "bag.mcap").values()))
    assert f"bag, {count} messages" in capsys.readouterr().out


def test_the_film_is_drawn_ten_times_a_second(result: cosim.RunResult, tmp_path: Path) -> None:
    ros_bag.write_bag(result, tmp_path / "bag")
    films = read(tmp_path / "bag" / "bag.mcap")["/film"]
    assert len(films) == np.floor(10.0 * result.time_s[-1] + 1e-6) + 1
    time_s, last = films[-1]
    nodes = result.node_position[int(np.argmin(np.abs(result.frame_time_s - time_s)))]
    corners = [xyz(point) for point in last.points]
    np.testing.assert_array_equal(corners, nodes[result.stage.soft_triangles.ravel()])


def test_what_a_camera_saw_is_in_the_bag(result: cosim.RunResult, tmp_path: Path) -> None:
    random, rows = np.random.default_rng(5), [0, 3, 7]
    turns = random.normal(size=(3, 4))
    turns = rotations_from_quaternions(turns / np.linalg.norm(turns, axis=1, keepdims=True))
    pictures = {
        "tick": result.tick[rows],
        "time_s": result.time_s[rows],
        "rgb": random.integers(0, 256, (3, 4, 6, 3), dtype=np.uint8),
        "depth_m": random.uniform(0.1, 2.0, (3, 4, 6)).astype(np.float32),
        "segments": np.zeros((3, 4, 6), np.int16),
        "position": random.normal(size=(3, 3)),
        "rotation": turns,
    }
    seen = CameraImages(pictures)
    stage = replace(result.stage, cameras=(CameraInfo("tip", (6, 4), 0.9, 10.0),))
    ros_bag.write_bag(replace(result, stage=stage, images={"tip": seen}), tmp_path / "bag")
    found = read(tmp_path / "bag" / "bag.mcap")
    shown, depths, lenses = (found[f"/camera/tip/{name}"] for name in ("image", "depth", "camera_info"))
    assert [time_s for time_s, _ in shown] == pytest.approx(result.time_s[rows].tolist())
    for k, (_, picture) in enumerate(shown):
        assert (picture.header.frame_id, picture.format) == ("camera_tip", "png")
        np.testing.assert_array_equal(np.array(Image.open(io.BytesIO(bytes(picture.data)))), seen.rgb[k])
        depth = np.frombuffer(bytes(depths[k][1].data), "<f4").reshape(4, 6)
        np.testing.assert_array_equal(depth, seen.depth_m[k])
    height = lenses[0][1].height
    assert height / 2.0 / lenses[0][1].k[4] == pytest.approx(np.tan(0.45))
    frames = [each for _, message in found["/tf"] for each in message.transforms]
    placed = [each.transform for each in frames if each.child_frame_id == "camera_tip"]
    for k, each in enumerate(placed):
        turn = each.rotation
        (rotation,) = rotations_from_quaternions(np.array([[turn.w, turn.x, turn.y, turn.z]]))
        np.testing.assert_allclose(rotation[:, 2], -seen.rotation[k][:, 2], atol=1e-12)  # along the sight
        np.testing.assert_allclose(rotation[:, 0], seen.rotation[k][:, 0], atol=1e-12)
        np.testing.assert_array_equal(xyz(each.translation), seen.position[k])


def test_the_tip_points_along_z_of_its_frame() -> None:
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        (turn,) = rotations_from_quaternions(ros_bag._facing(unit)[None])
        np.testing.assert_allclose(turn[:, 2], unit, atol=1e-12)
    down = ros_bag._facing(np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(rotations_from_quaternions(down[None])[0, :, 2], [0.0, 0.0, -1.0])


def test_other_files_in_the_folder_are_not_replaced(result: cosim.RunResult, tmp_path: Path) -> None:
    ros_bag.write_bag(result, tmp_path / "bag")
    ros_bag.write_bag(result, tmp_path / "bag")  # its own is replaced
    (tmp_path / "bag" / "notes.txt").write_text("mine")
    with pytest.raises(cosim.InputError, match="has files that are not of a bag"):
        ros_bag.write_bag(result, tmp_path / "bag")
    assert (tmp_path / "bag" / "notes.txt").read_text() == "mine"
