"""Values of a snapshot that are made when first asked for are those of the tick it was taken at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from cosim.scenario.build import build
from cosim.scenario.later import later, made, put_off
from cosim.scenario.loading import load_scenario
from cosim.scenario.snapshot import Snapshot

MADE_LATER = (
    "node_position", "tip_position", "tip_direction", "sag_m", "volume_m3", "chamber_volume_m3",
)  # fmt: skip


@dataclass(frozen=True)
class Pair:
    first: int
    second: int

    def __post_init__(self) -> None:
        put_off(self)

    def __getattr__(self, name: str) -> int:
        value: int = made(self, name)
        return value


def test_what_is_put_off_is_made_once_and_kept() -> None:
    asked: list[int] = []
    pair = Pair(1, later(lambda: asked.append(0) or 7))
    assert not asked
    assert (pair.second, pair.second, len(asked)) == (7, 7, 1)
    assert replace(pair, first=2) == Pair(2, 7)


def test_a_name_that_does_not_exist_is_refused() -> None:
    with pytest.raises(AttributeError, match="'Pair' object has no attribute 'third'"):
        _ = Pair(1, 2).third


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
