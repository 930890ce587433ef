"""One recording of several arms: each writes as if it were alone, below its own name.

It stands alone so that the recorder of a run need not know of other arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import rerun as rr

from cosim.recording.blueprint import RunViews, blueprint, path_of_arm

_RIGID = "/world/rigid/"


@final
class ArmsStream:
    """The stream of all arms.

    Args:
        stream: to write to.
        arms: their names; the first one writes what all share: bodies, name and properties of the recording.
        live: whether a viewer follows.
    """

    def __init__(self, stream: rr.RecordingStream, arms: Sequence[str], *, live: bool) -> None:
        self.stream, self._live = stream, live
        self._views: dict[str, RunViews | None] = dict.fromkeys(arms)
        self._open = set(arms)

    def of(self, arm: str) -> ArmStream:
        """Return the stream of one arm."""
        return ArmStream(self, arm, shared=arm == next(iter(self._views)))

    def show(self, views: RunViews) -> None:
        """Lay the recording out, once the views of all arms are known."""
        self._views[views.arm] = views
        known = [each for each in self._views.values() if each is not None]
        if len(known) == len(self._views):
            self.stream.send_blueprint(blueprint(known, live=self._live))

    def leave(self, arm: str) -> bool:
        """Let an arm write no more; return whether it was the last one."""
        self._open.discard(arm)
        return not self._open


@final
class ArmStream:
    """What one arm writes to, in place of a `rr.RecordingStream`.

    Args:
        group: of all arms.
        arm: its name.
        shared: whether it writes what all share.
    """

    def __init__(self, group: ArmsStream, arm: str, *, shared: bool) -> None:
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
        """Lay out the views of the arm."""
        self._group.show(replace(views, arm=self._arm))

    def leave(self) -> bool:
        """Write no more; return whether no arm does."""
        return self._group.leave(self._arm)

    def flush(self) -> None:
        """Bring all to the file."""
        self._group.stream.flush()

    def disconnect(self) -> None:
        """End the file."""
        self._group.stream.disconnect()
