"""What a snapshot shows of the film, asked for late, is that of the tick it was taken at."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.base.state_file import load, save
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.coupling.robots.shape_reader import MeshReader
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.tick_batch import Snapshot
from tests.soft.bodies import hexagon_arm

READ_LATER = ("node_position", "tip_position", "tip_direction", "sag_m", "volume_m3", "chamber_volume_m3")


def test_what_the_shape_decides_is_read_once() -> None:
    body, asked = hexagon_arm(2), 0

    def volumes(_shapes: Array) -> Array:
        nonlocal asked
        asked += 1
        return np.array([[1e-3, 2e-3]])

    film = FilmShapes(MeshReader(body, volumes), [body.positions])
    assert asked == 0
    assert film.figures.volumes_m3[0] == pytest.approx([1e-3, 2e-3])
    assert film.tip_position[0] == pytest.approx(body.tip_position(body.positions))
    assert film.figures.center_line_m[0] == pytest.approx(np.linalg.norm(film.tip_position[0]))
    assert film.read().figures is film.figures
    assert asked == 1


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda film: pickle.loads(pickle.dumps(film))])
def test_copies_hold_the_values(copied: Callable[[Any], Any]) -> None:
    body = hexagon_arm(2)
    film = FilmShapes(MeshReader(body, lambda _shapes: np.ones((1, 1))), [body.positions])
    found = copied(film)
    np.testing.assert_array_equal(found.node_position(), body.positions[None])
    for name, value in vars(film.figures).items():
        np.testing.assert_array_equal(getattr(found.figures, name), value)


def test_a_saved_snapshot_survives_an_archive(tmp_path: Path) -> None:
    snapshot = next(
        build(load_scenario("ur5e_hexagon_arm", {"model.published": True, "fidelity": "rigid"})).steps()
    )
    with pytest.raises(TypeError, match=r"film._reader is a MeshReader, which no saved state can hold"):
        save(tmp_path / "state", snapshot)
    save(tmp_path / "state", snapshot.kept())
    found = load(tmp_path / "state")
    for name in READ_LATER:
        np.testing.assert_array_equal(getattr(found, name), getattr(snapshot, name), err_msg=name)


@pytest.mark.parametrize("fidelity", ["lumped", "rigid"])
def test_a_snapshot_read_late_shows_its_tick(fidelity: str) -> None:
    def taken(asked_at_once: bool) -> list[Snapshot]:
        steps = build(
            load_scenario("ur5e_hexagon_arm", {"model.published": True, "fidelity": fidelity})
        ).steps()
        snapshots = []
        for _ in range(6):
            snapshots.append(next(steps))
            if asked_at_once:
                for name in READ_LATER:
                    getattr(snapshots[-1], name)
        return snapshots

    for early, late in zip(taken(True), taken(False), strict=True):
        for name in READ_LATER:
            np.testing.assert_array_equal(getattr(early, name), getattr(late, name), err_msg=name)
