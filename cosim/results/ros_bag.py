"""A run as a ROS 2 bag of MCAP, for `ros2 bag play`, readers of bags, and Foxglove. Times are those of the
run, from 0 on; frames are `world`, `flange`, `tip`, one for each body of the scene, and `camera_NAME`.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.base.frames import Array, quaternion_from_rotation, rotations_from_quaternions
from cosim.base.resources import extra_module
from cosim.base.writing import writing
from cosim.errors import InputError
from cosim.results.episodes import png
from cosim.results.result import RunResult
from cosim.results.result_builder import frame_rows
from cosim.results.run_columns import COLUMNS
from cosim.telemetry.camera_image import CameraInfo

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

BAG: Final = "bag"
"""Name of the folder, and of the .mcap file in it."""
FILM_PER_s: Final = 10.0
"""Largest rate of the film's shapes; each takes about 100 kB."""
_WORLD, _FLANGE, _TIP = "world", "flange", "tip"
_OF_TRIANGLES: Final[dict[str, Any]] = {
    "ns": "film", "id": 0, "type": 11, "action": 0, "frame_locked": False, "colors": [], "uv_coordinates": [],
    "text": "", "texture_resource": "", "mesh_resource": "", "mesh_use_embedded_materials": False,
}  # fmt: skip
"""Fields of a `visualization_msgs/msg/Marker` that is a TRIANGLE_LIST, without textures and text."""
_FILM_COLOUR: Final = (0.85, 0.6, 0.3, 0.9)
_METADATA: Final = "metadata.yaml"
_TOPICS: Final = {"chamber_pressure_Pa": "pressure_Pa", "cable_tension_N": "tension_N"}
"""Topics by column; each chamber or cable is published under its name."""
_OPTICAL: Final = np.array([1.0, -1.0, -1.0])
"""ROS has a camera's y axis down and its z axis along the line of sight."""
_NO_BYTES: Final = np.zeros(0, np.uint8)

Message = tuple[str, str, Any]
"""Topic, type and content."""


def check_bags() -> Any:
    """Return the library that writes bags.

    Raises:
        InputError: it is not installed.
    """
    return extra_module("rosbags.rosbag2", "bag")


def write_bag(result: RunResult, folder: Path) -> int:
    """Write a run as a bag and return its number of messages.

    Args:
        result: of a run.
        folder: of the bag; an existing bag is replaced.

    Raises:
        InputError: rosbags is not installed, the run is quasi-static, or the folder has other files.
        OutputError: the bag cannot be written.
    """
    library = check_bags()
    from rosbags.typesys import Stores, get_typestore

    if result.stage.mode != "dynamic":
        raise InputError(
            f"{result.stage.scenario}: a quasi-static run has no time, which a bag needs; run it with mode = "
            "'dynamic'"
        )
    if folder.exists() and any(entry.name not in (_METADATA, f"{BAG}.mcap") for entry in folder.iterdir()):
        raise InputError(f"{folder}: has files that are not of a bag; move them")
    store, count = get_typestore(Stores.ROS2_HUMBLE), 0
    with writing(folder):
        shutil.rmtree(folder, ignore_errors=True)
        plugin = library.StoragePlugin.MCAP
        with library.Writer(folder, version=library.Writer.VERSION_LATEST, storage_plugin=plugin) as bag:
            connections: dict[str, Any] = {}
            for time_s, (topic, kind, message) in _Messages(result, store).all():
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=store)
                bag.write(connections[topic], _ns(time_s), store.serialize_cdr(message, kind))
                count += 1
    return count


def _ns(time_s: float) -> int:
    return round(1e9 * time_s)


@final
class _Messages:
    """Makes the messages of a run, tick by tick.

    Args:
        result: of the run.
        store: ROS's types of messages.
    """

    def __init__(self, result: RunResult, store: "Typestore") -> None:
        self._result, self._types = result, store.types
        every = frame_rows(result.frame_time_s, FILM_PER_s)
        self._film = dict(zip(result.frame_tick[every].tolist(), every.tolist(), strict=True))
        self._turns = rotations_from_quaternions(result.flange_quaternion)
        self._tip = [_facing(direction) for direction in result.tip_direction]
        self._pictures = {
            camera.name: {tick: k for k, tick in enumerate(result.images[camera.name].tick.tolist())}
            for camera in result.stage.cameras
        }

    def all(self) -> Iterator[tuple[float, Message]]:
        """Yield instants [s] and messages, in order."""
        makers: Sequence[Callable[[int], Iterator[Message]]] = (
            self._joints, self._poses, self._wrench, self._numbers, self._shape, self._seen,
        )  # fmt: skip
        for row, time_s in enumerate(self._result.time_s.tolist()):
            for make in makers:
                for message in make(row):
                    yield time_s, message

    def _of(self, kind: str, **values: Any) -> Any:
        return self._types[kind](**values)

    def _header(self, row: int, frame: str) -> Any:
        sec, nanosec = divmod(_ns(float(self._result.time_s[row])), 10**9)
        stamp = self._of("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._of("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, values: Array, kind: str = "geometry_msgs/msg/Vector3") -> Any:
        x, y, z = values.tolist()
        return self._of(kind, x=x, y=y, z=z)

    def _turn(self, quaternion: Array) -> Any:
        w, x, y, z = quaternion.tolist()
        return self._of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _joints(self, row: int) -> Iterator[Message]:
        run, kind = self._result, "sensor_msgs/msg/JointState"
        if not run.stage.joint_names:
            return
        states = (run.joint_position[row], run.joint_velocity[row], run.joint_torque[row])
        targets = (run.joint_target[row], np.zeros(0), np.zeros(0))
        for topic, (position, velocity, effort) in (("/joint_states", states), ("/joint_targets", targets)):
            arrays = {"position": position, "velocity": velocity, "effort": effort}
            names = list(run.stage.joint_names)
            yield topic, kind, self._of(kind, header=self._header(row, ""), name=names, **arrays)

    def _poses(self, row: int) -> Iterator[Message]:
        run = self._result
        frames = [(_FLANGE, run.flange_position[row], run.flange_quaternion[row])]
        frames += [(_TIP, run.tip_position[row], self._tip[row])]
        frames += zip(run.stage.body_names, run.body_position[row], run.body_quaternion[row], strict=True)
        yield "/tf", "tf2_msgs/msg/TFMessage", self._moved(row, frames)
        pose = self._of(
            "geometry_msgs/msg/Pose",
            position=self._vector(run.tip_position[row], "geometry_msgs/msg/Point"),
            orientation=self._turn(self._tip[row]),
        )
        kind = "geometry_msgs/msg/PoseStamped"
        yield "/tip_pose", kind, self._of(kind, header=self._header(row, _WORLD), pose=pose)

    def _moved(self, row: int, frames: Sequence[tuple[str, Array, Array]]) -> Any:
        """Return the poses of frames, by names, positions (3,) and quaternions (4,)."""
        header, moved = self._header(row, _WORLD), []
        for name, position, turn in frames:
            transform = self._of(
                "geometry_msgs/msg/Transform", translation=self._vector(position), rotation=self._turn(turn)
            )
            stamped = {"header": header, "child_frame_id": name, "transform": transform}
            moved.append(self._of("geometry_msgs/msg/TransformStamped", **stamped))
        return self._of("tf2_msgs/msg/TFMessage", transforms=moved)

    def _wrench(self, row: int) -> Iterator[Message]:
        run, kind, turn = self._result, "geometry_msgs/msg/WrenchStamped", self._turns[row].T
        force, torque = turn @ run.flange_force[row], turn @ run.flange_torque[row]
        both = {"force": self._vector(force), "torque": self._vector(torque)}
        wrench = self._of("geometry_msgs/msg/Wrench", **both)
        yield "/flange_wrench", kind, self._of(kind, header=self._header(row, _FLANGE), wrench=wrench)

    def _numbers(self, row: int) -> Iterator[Message]:
        run, kind = self._result, "std_msgs/msg/Float64"
        for column, topic in _TOPICS.items():
            values = getattr(run, column)[row]
            names = COLUMNS[column].components(run.stage.names_along, values.shape)
            for name, value in zip(names, values.tolist(), strict=True):
                yield f"/{topic}/{_topic(name)}", kind, self._of(kind, data=value)

    def _shape(self, row: int) -> Iterator[Message]:
        run, kind = self._result, "visualization_msgs/msg/Marker"
        frame = self._film.get(int(run.tick[row]))
        if frame is None or not len(run.stage.soft_triangles):
            return
        point = self._types["geometry_msgs/msg/Point"]
        corners = run.node_position[frame][run.stage.soft_triangles.ravel()]
        still = self._of(
            "geometry_msgs/msg/Pose",
            position=point(x=0.0, y=0.0, z=0.0),
            orientation=self._turn(np.array([1.0, 0.0, 0.0, 0.0])),
        )
        colour = self._of("std_msgs/msg/ColorRGBA", **dict(zip("rgba", _FILM_COLOUR, strict=True)))
        image, mesh = "sensor_msgs/msg/CompressedImage", "visualization_msgs/msg/MeshFile"
        marker = self._of(
            kind,
            header=self._header(row, _WORLD),
            pose=still,
            scale=self._vector(np.ones(3)),
            color=colour,
            lifetime=self._of("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            points=[point(x=x, y=y, z=z) for x, y, z in corners.tolist()],
            texture=self._of(image, header=self._header(row, ""), format="", data=_NO_BYTES),
            mesh_file=self._of(mesh, filename="", data=_NO_BYTES),
            **_OF_TRIANGLES,
        )
        yield "/film", kind, marker

    def _seen(self, row: int) -> Iterator[Message]:
        run = self._result
        for camera in run.stage.cameras:
            picture = self._pictures[camera.name].get(int(run.tick[row]))
            if picture is None:
                continue
            topic, seen, (width, height) = (
                f"/camera/{_topic(camera.name)}",
                run.images[camera.name],
                camera.size,
            )
            frame = f"camera_{camera.name}"
            header = self._header(row, frame)
            turn = quaternion_from_rotation(seen.rotation[picture] * _OPTICAL)
            yield "/tf", "tf2_msgs/msg/TFMessage", self._moved(row, [(frame, seen.position[picture], turn)])
            kind, file = "sensor_msgs/msg/CompressedImage", png(seen.rgb[picture])
            data = np.frombuffer(file, np.uint8)
            yield f"{topic}/image", kind, self._of(kind, header=header, format="png", data=data)
            size, depth = {"height": height, "width": width}, seen.depth_m[picture].astype("<f4").tobytes()
            kind, of = "sensor_msgs/msg/Image", {"encoding": "32FC1", "is_bigendian": 0, "step": 4 * width}
            data = np.frombuffer(depth, np.uint8)
            yield f"{topic}/depth", kind, self._of(kind, header=header, **size, **of, data=data)
            kind = "sensor_msgs/msg/CameraInfo"
            yield f"{topic}/camera_info", kind, self._lens(header, camera)

    def _lens(self, header: Any, camera: CameraInfo) -> Any:
        """Return the pinhole model of a camera."""
        (width, height), length = camera.size, camera.focal_length
        k = np.array([[length, 0.0, 0.5 * width], [0.0, length, 0.5 * height], [0.0, 0.0, 1.0]])
        whole = self._of(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        projection = np.hstack([k, np.zeros((3, 1))])
        return self._of(
            "sensor_msgs/msg/CameraInfo", header=header, height=height, width=width,
            distortion_model="plumb_bob", d=np.zeros(5), k=k.ravel(), r=np.eye(3).ravel(),
            p=projection.ravel(), binning_x=0, binning_y=0, roi=whole,
        )  # fmt: skip


def _topic(name: str) -> str:
    """Return a name as a part of a topic: letters, digits and '_', not beginning with a digit."""
    valid = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in name)
    return valid if valid[:1].isalpha() else f"_{valid}"


def _facing(direction: Array) -> Array:
    """Return the quaternion (w, x, y, z) of the shortest turn from z to a unit direction (3,)."""
    x, y, z = direction.tolist()
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    turn = np.array([1.0 + z, -y, x, 0.0])
    return np.asarray(turn / np.linalg.norm(turn))
