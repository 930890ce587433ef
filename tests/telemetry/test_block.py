"""Many snapshots read at once against each read by itself."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from cosim.app.driver import build_simulation
from cosim.base.frames import quaternion_from_rotation, quaternions_from_rotations, rotation_from_vector
from cosim.config.loading import load_scenario
from cosim.telemetry.block import Block
from cosim.telemetry.snapshot import Snapshot
from tests.conftest import made_up_snapshot

READ = ("node_position", "tip_position", "tip_direction", "sag_m", "chamber_volume_m3")


def snapshots(fidelity: str) -> list[Snapshot]:
    """Return ticks in which the flange and the pressure move; nobody has read their shapes."""
    phase = {"name": "inflate", "duration_s": 0.02, "increments": 8, "pressure_Pa": 3e3}
    turn = phase | {"name": "turn", "flange_turn": {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.01}}
    overrides = {"fidelity": fidelity, "phase": [phase, turn]}
    return list(islice(build_simulation(load_scenario("ur5e_hexagon_arm", overrides)).steps(), 1, 16))


@pytest.mark.parametrize("fidelity", ["lumped", "rigid"])
def test_a_block_reads_what_its_snapshots_do(fidelity: str) -> None:
    block = Block(snapshots(fidelity))
    together = {name: getattr(block, name) for name in READ}
    assert "tip_position" not in vars(block.snapshots[3])  # it was not read one by one
    assert np.ptp(together["tip_position"], axis=0).max() > 1e-6
    for name in READ:
        one_by_one = [getattr(snapshot, name) for snapshot in block.snapshots]
        np.testing.assert_allclose(together[name], one_by_one, rtol=1e-13, atol=1e-15)


def test_snapshots_made_by_hand_are_read_by_their_values() -> None:
    made = [made_up_snapshot(tick, 0.002) for tick in range(3)]
    block = Block(made)
    for name in READ:
        np.testing.assert_array_equal(getattr(block, name), [getattr(snapshot, name) for snapshot in made])


def test_many_quaternions_are_those_of_each_rotation() -> None:
    # half turns about every axis, where another component is the largest, and turns in between
    turns = np.concatenate([np.pi * np.eye(3), np.random.default_rng(1).normal(size=(40, 3)) * 2.0])
    rotations = np.array([rotation_from_vector(turn) for turn in turns])
    one_by_one = [quaternion_from_rotation(rotation) for rotation in rotations]
    np.testing.assert_allclose(quaternions_from_rotations(rotations), one_by_one, rtol=0.0, atol=1e-15)
