"""Writes several arms to one Rerun recording. Each arm has a stream of its own, which puts the name of the
arm in front of its entities. Only the first arm writes what all arms share: bodies, name and properties of
the recording.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import rerun as rr

from cosim.recording.blueprint import RunViews, blueprint
from cosim.recording.entity_paths import path_of_arm

_RIGID = "/world/rigid/"


@final
class SceneStream:
    """The stream of a recording of several arms.

    Args:
        stream: of Rerun, to write to.
        arms: names of the arms; the first one writes the shared entities.
        live: whether a viewer shows the run while it is simulated.
    """

    def __init__(self, stream: rr.RecordingStream, arms: Sequence[str], *, live: bool) -> None:
        self.stream, self._live = stream, live
        self._views: dict[str, RunViews | None] = dict.fromkeys(arms)
        self._open = set(arms)

    def of(self, arm: str) -> "ArmStream":
        """Make the stream of one arm."""
        return ArmStream(self, arm, shared=arm == next(iter(self._views)))

    def show(self, views: RunViews) -> None:
        """Set the views of an arm; with those of the last arm, the layout is written."""
        self._views[views.arm] = views
        known = [each for each in self._views.values() if each is not None]
        if len(known) == len(self._views):
            self.stream.send_blueprint(blueprint(known, live=self._live))

    def leave(self, arm: str) -> bool:
        """Close the stream of an arm; return whether it was the last open one."""
        self._open.discard(arm)
        return not self._open


@final
class ArmStream:
    """The stream of one arm, with the methods of `rr.RecordingStream` that are used.

    Args:
        group: stream of the whole recording.
        arm: name of the arm.
        shared: whether it writes the entities that all arms share.
    """

    def __init__(self, group: SceneStream, arm: str, *, shared: bool) -> None:
        self._group, self._arm, self._shared = group, arm, shared

    def log(self, path: str, entity: Any, **options: Any) -> None:
        """Log an entity of the arm."""
        if self._shared or not path.startswith(_RIGID):
            self._group.stream.log(path_of_arm(self._arm, path), entity, **options)

    def send_columns(self, path: str, *columns: Any) -> None:
        """Write columns of an entity of the arm."""
        if self._shared or not path.startswith(_RIGID):
            self._group.stream.send_columns(path_of_arm(self._arm, path), *columns)

    def send_recording_name(self, name: str) -> None:
        """Name the recording."""
        if self._shared:
            self._group.stream.send_recording_name(name.removesuffix(f": {self._arm}"))

    def send_property(self, name: str, values: Any) -> None:
        """Write a property of the recording."""
        if self._shared:
            self._group.stream.send_property(name, values)

    def show(self, views: RunViews) -> None:
        """Set the views of the arm."""
        self._group.show(replace(views, arm=self._arm))

    def leave(self) -> bool:
        """Close the stream; return whether it was the last open one."""
        return self._group.leave(self._arm)

    def flush(self) -> None:
        """Write all buffered data to the file."""
        self._group.stream.flush()

    def disconnect(self) -> None:
        """End the file."""
        self._group.stream.disconnect()
