"""What a snapshot shows of the film, asked for late, is that of the tick it was taken at."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.coupling.soft_sides.shape_reader import MeshReader
from cosim.telemetry.film_shape import FilmShape
from cosim.telemetry.snapshot import Snapshot
from tests.soft.bodies import hexagon_arm

MADE_LATER = (
    "node_position", "tip_position", "tip_direction", "sag_m", "volume_m3", "chamber_volume_m3",
)  # fmt: skip


def snapshot_of(shape: Any) -> Snapshot:
    """Return a snapshot in which only what depends on the film's shape means something."""
    given = {field.name: None for field in fields(Snapshot) if field.init}
    return Snapshot(**(given | dict.fromkeys(MADE_LATER, shape)))


def test_what_the_shape_decides_is_made_once_and_kept() -> None:
    body, asked = hexagon_arm(2), 0

    def volumes(positions: Array) -> tuple[float, ...]:
        nonlocal asked
        asked += 1
        return 1e-3, 2e-3

    snapshot = snapshot_of(FilmShape(MeshReader(body, volumes), body.positions, Pose()))
    assert asked == 0
    assert snapshot.volume_m3 == pytest.approx(3e-3)
    assert snapshot.chamber_volume_m3 == pytest.approx([1e-3, 2e-3])
    assert snapshot.tip_position == pytest.approx(body.tip_position(body.positions))
    assert snapshot.sag_m == pytest.approx(0.0, abs=1e-12)
    assert snapshot.tip_position is snapshot.tip_position
    assert asked == 1
    copy = replace(snapshot, tick=2)
    assert (copy.volume_m3, copy.kept_shape) == (snapshot.volume_m3, None)


def test_a_name_that_does_not_exist_is_refused() -> None:
    body = hexagon_arm(2)
    for shape in (None, FilmShape(MeshReader(body, lambda _x: (1.0,)), body.positions, Pose())):
        with pytest.raises(AttributeError, match="'Snapshot' object has no attribute 'third'"):
            _ = snapshot_of(shape).third  # type: ignore[attr-defined]


@pytest.mark.parametrize("fidelity", ["lumped", "rigid"])
def test_a_snapshot_asked_late_shows_its_own_tick(fidelity: str) -> None:
    def taken(asked_at_once: bool) -> list[Snapshot]:
        steps = build(load_scenario("ur5e_hexagon_arm", {"fidelity": fidelity})).steps()
        snapshots = []
        for _ in range(6):
            snapshots.append(next(steps))
            if asked_at_once:
                for name in MADE_LATER:
                    getattr(snapshots[-1], name)
        return snapshots

    for early, late in zip(taken(True), taken(False), strict=True):
        for name in MADE_LATER:
            np.testing.assert_array_equal(getattr(early, name), getattr(late, name), err_msg=name)
