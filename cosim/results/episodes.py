"""Episodes for learning in the layout of LeRobot's data sets, version 3.0, without LeRobot: `data/` has a row
for every step, with images as PNG or, in `videos/`, as an MP4 for every episode and camera; `meta/` describes
columns, episodes and statistics. Source: LeRobotDataset v3.0,
https://huggingface.co/docs/lerobot/lerobot-dataset-v3.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array
from cosim.base.video import encoded, encoder
from cosim.base.whole_files import whole_file, write_whole
from cosim.base.writing import writing
from cosim.errors import InputError
from cosim.results.result import RunResult
from cosim.results.result_builder import frame_rows
from cosim.results.run_columns import COLUMNS

if TYPE_CHECKING:
    import pyarrow as pa

VERSION: Final = "v3.0"
_DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO: Final = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"
_FILE_MB: Final = 100
_FILES_A_CHUNK: Final = 1000
_CODING: Final = ("-an", "-c:v", "libx264", "-crf", "18", "-g", "2")
"""Every second picture of a video is a key frame, so that single pictures are read quickly."""
_STATE: Final = (
    "joint_position", "flange_position", "flange_quaternion", "tip_position", "chamber_pressure_Pa",
    "cable_tension_N",
)  # fmt: skip
_ACTION: Final = ("joint_target", "chamber_pressure_Pa", "cable_tension_N")
_IMAGE: Final = "observation.images."


@final
@dataclass(frozen=True, eq=False)
class LearningEpisode:
    """Steps of an episode, a row each.

    Args:
        task: in words.
        columns: by name, such as "observation.state", "action", "next.reward"; (steps,) or (steps, k) each.
        images: by the camera's name, (steps, height, width, 3), colours from 0 to 255.
        names: of the numbers of a row, by column.
    """

    task: str
    columns: Mapping[str, NDArray[Any]]
    images: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def episode_of(result: RunResult, frames_per_s: float, task: str | None = None) -> LearningEpisode:
    """Return a run as an episode.

    "observation.state" contains joints, flange, tip, pressures and tensions at a step; "action" the joints'
    targets, pressures and tensions at the next step. The last step has no action and is left out. Cameras
    with an image at every step are included.

    Args:
        result: of the run.
        frames_per_s: steps per simulated second.
        task: in words; None: the run's title.

    Raises:
        InputError: the run is shorter than two steps.
    """
    rows = frame_rows(result.time_s, frames_per_s)
    if len(rows) < 2:
        raise InputError(f"the run has {len(rows)} steps at {frames_per_s:g} /s; an episode needs two")

    def joined(names: Sequence[str], at: Any) -> Array:
        columns = [getattr(result, name)[at].reshape(len(at), -1) for name in names]
        return np.hstack(columns).astype(np.float32)

    def named(names: Sequence[str]) -> list[str]:
        along = result.stage.names_along
        return [
            f"{name}.{part}"
            for name in names
            for part in COLUMNS[name].components(along, getattr(result, name).shape[1:])
        ]

    columns = {"observation.state": joined(_STATE, rows[:-1]), "action": joined(_ACTION, rows[1:])}
    taken = {name: dict(zip(one.tick.tolist(), one.rgb, strict=True)) for name, one in result.images.items()}
    ticks = result.tick[rows[:-1]].tolist()
    complete = {name: by_tick for name, by_tick in taken.items() if by_tick.keys() >= {*ticks}}
    images = {name: np.array([by_tick[tick] for tick in ticks]) for name, by_tick in complete.items()}
    names = {"observation.state": named(_STATE), "action": named(_ACTION)}
    return LearningEpisode(task or result.stage.title, columns, images, names)


def write_episodes(
    directory: str | Path,
    episodes: Sequence[LearningEpisode],
    frames_per_s: float,
    robot: str = "cosim",
    *,
    video: bool = False,
) -> None:
    """Write episodes to a new or empty directory.

    Args:
        directory: of the data set.
        episodes: at least one, all with the same columns and cameras.
        frames_per_s: steps per second of all of them.
        robot: name of the robot.
        video: whether images are written as videos (H.264, lossy) instead of PNG; needs imageio-ffmpeg.

    Raises:
        InputError: the directory is not empty, an episode does not fit, or imageio-ffmpeg is not installed.
        OutputError: a file cannot be written.
    """
    root = Path(directory)
    _check(root, episodes)
    if video:
        encoder()
    with writing(root):
        tasks = list(dict.fromkeys(episode.task for episode in episodes))
        begins = np.cumsum([0, *map(len, episodes)]).tolist()
        files = _write_data(root, episodes, tasks, frames_per_s, video=video)
        videos = _write_videos(root, episodes, frames_per_s) if video else {}
        _write_parquet(root / _EPISODES, _episode_table(episodes, begins, files, videos))
        _write_parquet(root / "meta/tasks.parquet", _task_table(tasks))
        write_whole(root / "meta/stats.json", json.dumps(_statistics(episodes), indent=2))
        videos_info = {
            "video_files_size_in_mb": _FILE_MB if video else 0,
            "video_path": _VIDEO if video else None,
        }
        info = {
            "codebase_version": VERSION,
            "robot_type": robot,
            "total_episodes": len(episodes),
            "total_frames": begins[-1],
            "total_tasks": len(tasks),
            "chunks_size": _FILES_A_CHUNK,
            "data_files_size_in_mb": _FILE_MB,
            "fps": frames_per_s if frames_per_s % 1.0 else int(frames_per_s),
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": _DATA,
            **videos_info,
            "features": _features(episodes[0], frames_per_s if video else None),
        }
        write_whole(root / "meta/info.json", json.dumps(info, indent=2))


def _check(root: Path, episodes: Sequence[LearningEpisode]) -> None:
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise InputError(f"{root}: is not empty; give a new or empty directory")
    if not episodes:
        raise InputError("there are no episodes to write")
    first = _features(episodes[0])
    for number, episode in enumerate(episodes):
        if (features := _features(episode)) != first:
            differing = next(key for key in {**first, **features} if first.get(key) != features.get(key))
            raise InputError(
                f"episode {number}: {differing} differs from episode 0; all episodes need the same columns"
            )
        for name, rows in {**episode.columns, **episode.images}.items():
            if len(rows) != len(episode) or not len(rows):
                raise InputError(f"episode {number}: {name} has {len(rows)} rows, others {len(episode)}")


def _features(episode: LearningEpisode, shown_per_s: float | None = None) -> dict[str, Any]:
    """Return the description of each column; with a rate, images are in videos."""
    features: dict[str, Any] = {}
    for name, rows in episode.columns.items():
        kind = np.float32 if rows.dtype.kind == "f" else np.bool_ if rows.dtype.kind == "b" else np.int64
        shape, names = list(rows.shape[1:]) or [1], episode.names.get(name)
        features[name] = {"dtype": np.dtype(kind).name, "shape": shape, "names": names and list(names)}
    for name, rows in episode.images.items():
        axes = ["height", "width", "channels"]
        about = {"shape": list(rows.shape[1:]), "names": axes}
        if shown_per_s is None:
            features[f"{_IMAGE}{name}"] = {"dtype": "image", **about}
        else:
            features[f"{_IMAGE}{name}"] = {"dtype": "video", **about, "info": _video_info(rows, shown_per_s)}
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    return features


def _video_info(rows: NDArray[np.uint8], shown_per_s: float) -> dict[str, Any]:
    _, height, width, channels = rows.shape
    return {
        "video.height": height, "video.width": width, "video.channels": channels, "video.codec": "h264",
        "video.pix_fmt": _pixels(height, width), "video.fps": shown_per_s, "video.is_depth_map": False,
        "has_audio": False,
    }  # fmt: skip


def _pixels(height: int, width: int) -> str:
    """Return the pixel format: with colours at half the resolution, as usual, if both sizes are even."""
    return "yuv444p" if height % 2 or width % 2 else "yuv420p"


def _write_videos(
    root: Path, episodes: Sequence[LearningEpisode], shown_per_s: float
) -> dict[str, list[float | int]]:
    """Write a video for every episode and camera, and return their columns in the table of episodes."""
    columns: dict[str, list[float | int]] = {}
    for name in episodes[0].images:
        key, files = f"{_IMAGE}{name}", [divmod(k, _FILES_A_CHUNK) for k in range(len(episodes))]
        for (chunk, file), episode in zip(files, episodes, strict=True):
            path = root / _VIDEO.format(video_key=key, chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            height, width = episode.images[name].shape[1:3]
            source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}")
            rate = ("-framerate", f"{shown_per_s:.9g}")
            with encoded(path, (*source, *rate), (*_CODING, "-pix_fmt", _pixels(height, width))) as write:
                for picture in episode.images[name]:
                    write(picture.tobytes())
        columns[f"videos/{key}/chunk_index"] = [chunk for chunk, _ in files]
        columns[f"videos/{key}/file_index"] = [file for _, file in files]
        columns[f"videos/{key}/from_timestamp"] = [0.0] * len(episodes)
        columns[f"videos/{key}/to_timestamp"] = [len(episode) / shown_per_s for episode in episodes]
    return columns


def _write_data(
    root: Path, episodes: Sequence[LearningEpisode], tasks: list[str], frames_per_s: float, *, video: bool
) -> list[tuple[int, int]]:
    """Write the steps of all episodes, up to about 100 MB a file and a row group an episode.

    Returns:
        Numbers of chunk and file of each episode.

    Args:
        root: directory of the data set.
        episodes: to be written.
        tasks: of all episodes.
        frames_per_s: steps per second.
        video: whether images are in videos.
    """
    from pyarrow import parquet

    files: list[tuple[int, int]] = []
    number, size, steps, writer = -1, _FILE_MB * 2**20, 0, None
    try:
        for k, episode in enumerate(episodes):
            counts = np.arange(len(episode))
            index: dict[str, NDArray[Any]] = {
                "timestamp": (counts / frames_per_s).astype(np.float32),
                "frame_index": counts,
                "episode_index": np.full(len(episode), k),
                "index": steps + counts,
                "task_index": np.full(len(episode), tasks.index(episode.task)),
            }
            table = _step_table(episode, index, {} if video else episode.images)
            if writer is None or size + table.nbytes > _FILE_MB * 2**20:
                if writer is not None:
                    writer.close()
                number, size = number + 1, 0
                chunk, file = divmod(number, _FILES_A_CHUNK)
                path = root / _DATA.format(chunk_index=chunk, file_index=file)
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = parquet.ParquetWriter(path, table.schema, compression="snappy")
            writer.write_table(table)
            size += table.nbytes
            steps += len(episode)
            files.append(divmod(number, _FILES_A_CHUNK))
    finally:
        if writer is not None:
            writer.close()
    return files


def _step_table(
    episode: LearningEpisode, index: Mapping[str, NDArray[Any]], images: Mapping[str, NDArray[np.uint8]]
) -> pa.Table:
    import pyarrow as pa

    features, columns = _features(episode), {}
    for name, rows in {**episode.columns, **index}.items():
        values = pa.array(np.ravel(rows).astype(features[name]["dtype"]))
        columns[name] = values if rows.ndim == 1 else pa.FixedSizeListArray.from_arrays(values, rows.shape[1])
    for name, rows in images.items():
        files = [{"bytes": png(one), "path": f"{name}-{k:06d}.png"} for k, one in enumerate(rows)]
        kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        columns[f"{_IMAGE}{name}"] = pa.array(files, kind)
    return pa.table(columns)


def _episode_table(
    episodes: Sequence[LearningEpisode],
    begins: list[int],
    files: list[tuple[int, int]],
    videos: Mapping[str, list[float | int]],
) -> pa.Table:
    import pyarrow as pa

    count = len(episodes)
    return pa.table({
        "episode_index": list(range(count)),
        "tasks": [[episode.task] for episode in episodes],
        "length": [len(episode) for episode in episodes],
        "dataset_from_index": begins[:-1],
        "dataset_to_index": begins[1:],
        "data/chunk_index": [chunk for chunk, _ in files],
        "data/file_index": [file for _, file in files],
        "meta/episodes/chunk_index": [0] * count,
        "meta/episodes/file_index": [0] * count,
        **videos,
    })  # fmt: skip


def _task_table(tasks: list[str]) -> pa.Table:
    """Return the tasks as a table; pandas uses the column of texts as its index."""
    import pyarrow as pa

    table = pa.table({"task_index": list(range(len(tasks))), "task": tasks})
    described = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, kind, numpy in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    return table.replace_schema_metadata({b"pandas": json.dumps(about).encode()})


def _write_parquet(path: Path, table: pa.Table) -> None:
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        parquet.write_table(table, file)


def _statistics(episodes: Sequence[LearningEpisode]) -> dict[str, Any]:
    """Return minimum, maximum, mean, standard deviation and count of each column; of images by channel."""

    def spread(rows: Array, shape: Sequence[int], count: int) -> dict[str, Any]:
        figures = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
        return {name: value.reshape(shape).tolist() for name, value in figures.items()} | {"count": [count]}

    statistics = {}
    for name in episodes[0].columns:
        rows = np.concatenate([episode.columns[name] for episode in episodes]).astype(float)
        statistics[name] = spread(rows, rows.shape[1:] or (1,), len(rows))
    for name in episodes[0].images:
        pixels = np.concatenate([episode.images[name] for episode in episodes])
        statistics[f"{_IMAGE}{name}"] = spread(pixels.reshape(-1, 3) / 255.0, (3, 1, 1), len(pixels))
    return statistics


def png(rgb: NDArray[np.uint8]) -> bytes:
    """Return an image (height, width, 3) as a PNG file (ISO/IEC 15948) with unfiltered lines."""
    height, width = rgb.shape[:2]

    def chunks() -> Iterator[bytes]:
        header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
        lines = np.hstack([np.zeros((height, 1), np.uint8), rgb.reshape(height, -1)])
        for name, data in ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")):
            yield struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks())
