"""Episodes in LeRobot's layout, read with pyarrow alone: rows, pictures, places of episodes, figures."""

from __future__ import annotations

import io
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pyarrow import parquet

import cosim
from cosim import LearningEpisode, write_episodes
from cosim.errors import InputError
from cosim.results import episodes as module
from cosim.results.episodes import png
from tests.devices import device_parts

RANDOM = np.random.default_rng(2)


def made(steps: int, task: str = "reach") -> LearningEpisode:
    columns = {
        "observation.state": RANDOM.standard_normal((steps, 3)),
        "action": RANDOM.standard_normal((steps, 2)).astype(np.float32),
        "next.reward": RANDOM.standard_normal(steps),
        "next.done": np.arange(steps) == steps - 1,
    }
    images = {"eye": RANDOM.integers(0, 256, (steps, 4, 5, 3), dtype=np.uint8)}
    return LearningEpisode(task, columns, images, {"action": ("left", "right")})


def rows(root: Path) -> list[dict[str, Any]]:
    """Return all steps, file after file, as the description of the data set says they are laid out."""
    info = json.loads((root / "meta/info.json").read_text())
    found: list[dict[str, Any]] = []
    for k in range(len(list(root.glob("data/*/*.parquet")))):
        found += parquet.read_table(root / info["data_path"].format(chunk_index=0, file_index=k)).to_pylist()
    return found


@pytest.mark.parametrize("file_MB", [100, 0])
def test_every_step_is_read_back_with_its_episode_and_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file_MB: int
) -> None:
    monkeypatch.setattr(module, "_FILE_MB", file_MB)
    given, root = [made(4), made(3, "lift"), made(5)], tmp_path / "data"
    write_episodes(root, given, 50.0)
    steps, index = rows(root), 0
    for k, episode in enumerate(given):
        for frame in range(len(episode)):
            step = steps[index]
            assert (step["episode_index"], step["frame_index"], step["index"]) == (k, frame, index)
            assert step["timestamp"] == pytest.approx(frame / 50.0)
            assert step["task_index"] == (0 if episode.task == "reach" else 1)
            for name in ("observation.state", "action", "next.reward", "next.done"):
                assert step[name] == pytest.approx(episode.columns[name][frame].astype(np.float32)), name
            picture = Image.open(io.BytesIO(step["observation.images.eye"]["bytes"]))
            assert np.array_equal(np.array(picture), episode.images["eye"][frame])
            index += 1
    assert index == len(steps) == 12
    told = parquet.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [each["length"] for each in told] == [4, 3, 5]
    assert [each["dataset_from_index"] for each in told] == [0, 4, 7]
    assert [each["dataset_to_index"] for each in told] == [4, 7, 12]
    assert [each["tasks"] for each in told] == [["reach"], ["lift"], ["reach"]]
    assert [each["data/file_index"] for each in told] == ([0, 0, 0] if file_MB else [0, 1, 2])
    for k, each in enumerate(told):
        path = root / f"data/chunk-000/file-{each['data/file_index']:03d}.parquet"
        assert k in parquet.read_table(path)["episode_index"].to_pylist()


def test_the_description_says_what_columns_tasks_and_figures_are(tmp_path: Path) -> None:
    given = [made(4), made(3, "lift")]
    write_episodes(tmp_path, given, 50.0, robot="ur5e")
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"], info["fps"]) == (2, 7, 2, 50)
    schema = parquet.read_schema(tmp_path / "data/chunk-000/file-000.parquet")
    assert sorted(schema.names) == sorted(info["features"])
    assert info["features"]["action"] == {"dtype": "float32", "shape": [2], "names": ["left", "right"]}
    assert info["features"]["next.done"]["dtype"] == "bool"
    assert info["features"]["observation.images.eye"]["shape"] == [4, 5, 3]
    tasks = parquet.read_table(tmp_path / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": "reach"}, {"task_index": 1, "task": "lift"}]
    assert tasks.to_pandas().index.tolist() == ["reach", "lift"]  # as LeRobot looks tasks up
    figures = json.loads((tmp_path / "meta/stats.json").read_text())
    state = np.concatenate([each.columns["observation.state"] for each in given])
    assert figures["observation.state"]["mean"] == pytest.approx(state.mean(axis=0))
    assert figures["observation.state"]["std"] == pytest.approx(state.std(axis=0))
    pixels = np.concatenate([each.images["eye"] for each in given]).reshape(-1, 3) / 255.0
    assert np.ravel(figures["observation.images.eye"]["max"]) == pytest.approx(pixels.max(axis=0))
    assert np.shape(figures["observation.images.eye"]["mean"]) == (3, 1, 1)


def test_a_run_is_an_episode_of_states_and_what_was_asked_next(tmp_path: Path) -> None:
    short = {"phase.inflate.duration_s": 0.2}
    result = cosim.run(device_parts.scenario(tmp_path, device_parts.INFLATE, overrides=short))
    episode = cosim.episode_of(result, 50.0)
    ticks = np.arange(0, 50, 5)
    state, action = episode.columns["observation.state"], episode.columns["action"]
    names = list(episode.names["observation.state"])
    assert len(episode) == len(ticks)
    tips = state[:, [names.index(f"tip_position.{axis}") for axis in "xyz"]]
    assert tips == pytest.approx(result.tip_position[ticks].astype(np.float32))
    pressures = action[:, list(episode.names["action"]).index("chamber_pressure_Pa.chamber")]
    assert pressures == pytest.approx(result.chamber_pressure_Pa[ticks + 5, 0])
    assert episode.task == result.stage.title


@pytest.mark.parametrize(("height", "width"), [(48, 64), (45, 63)])
def test_pictures_in_videos_are_read_back_by_ffmpeg_alone(tmp_path: Path, height: int, width: int) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    given = [shown(4, height, width, 0), shown(7, height, width, 40)]
    write_episodes(tmp_path, given, 25.0, video=True)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    key = "observation.images.eye"
    told = info["features"][key]
    assert (told["dtype"], told["shape"]) == ("video", [height, width, 3])
    assert (told["info"]["video.fps"], told["info"]["video.codec"]) == (25.0, "h264")
    assert key not in rows(tmp_path)[0]
    places = parquet.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for episode, each in zip(given, places, strict=True):
        chunk, file = each[f"videos/{key}/chunk_index"], each[f"videos/{key}/file_index"]
        path = tmp_path / info["video_path"].format(video_key=key, chunk_index=chunk, file_index=file)
        command = [ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        read = subprocess.run(command, capture_output=True, check=True)
        said = read.stderr.decode()
        assert "Video: h264" in said
        assert "25 fps" in said
        assert told["info"]["video.pix_fmt"] in said
        assert each[f"videos/{key}/from_timestamp"] == 0.0
        assert each[f"videos/{key}/to_timestamp"] == pytest.approx(len(episode) / 25.0)
        seen = np.frombuffer(read.stdout, np.uint8).reshape(-1, height, width, 3)
        assert seen.shape == episode.images["eye"].shape
        assert np.abs(seen.astype(int) - episode.images["eye"]).mean() < 2.0


def shown(steps: int, height: int, width: int, begin: int) -> LearningEpisode:
    """Return an episode whose pictures are shades that get brighter from step to step."""
    rows, columns = np.mgrid[:height, :width]
    flat = np.stack([rows, columns, rows + columns], axis=2)
    images = np.array([flat + 12 * k + begin for k in range(steps)]).astype(np.uint8)
    return LearningEpisode("look", {"action": np.zeros((steps, 2))}, {"eye": images})


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are no episodes"):
        write_episodes(tmp_path / "none", [], 50.0)
    other = LearningEpisode("reach", {**made(3).columns, "action": np.zeros((3, 4))}, made(3).images)
    with pytest.raises(InputError, match="episode 1: action differs from episode 0"):
        write_episodes(tmp_path / "other", [made(3), other], 50.0)
    short = LearningEpisode("reach", made(3).columns, made(2).images, made(3).names)
    with pytest.raises(InputError, match="episode 1: eye has 2 rows, others 3"):
        write_episodes(tmp_path / "short", [made(3), short], 50.0)
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="is not empty; give a new or empty directory"):
        write_episodes(tmp_path, [made(3)], 50.0)
    assert png(made(1).images["eye"][0]).startswith(b"\x89PNG")
