"""Ticks as columns are what they are one by one."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import build_simulation
from cosim.base.frames import Pose, quaternion_from_rotation, quaternions_from_rotations, rotation_from_vector
from cosim.base.solid import LinkContact
from cosim.config.loading import load_scenario
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.devices.measurement import bending_angle
from cosim.telemetry.snapshot import FilmShape, Snapshot
from cosim.telemetry.tick_batch import TickBatch
from tests.conftest import made_up_snapshot

OF_SNAPSHOT = (
    "tick", "time_s", "phase", "joint_position", "joint_velocity", "joint_torque", "joint_target",
    "body_position", "body_quaternion", "body_contact_force", "node_position", "pressure_Pa", "volume_m3",
    "chamber_pressure_Pa", "chamber_volume_m3", "cable_tension_N", "tip_position", "tip_direction", "sag_m",
    "tick_wall_s",
)  # fmt: skip
OF_LEDGER = (*(f.name for f in fields(LedgerEntry) if f.name != "wrench"), "power_error", "power_error_W")
TOUCH = LinkContact("forearm", "table", 0.01, False)


def snapshots(fidelity: str) -> list[Snapshot]:
    """Return ticks in which the flange and the pressure move; nobody has read their shapes."""
    phase = {"name": "inflate", "duration_s": 0.02, "increments": 8, "pressure_Pa": 3e3}
    turn = phase | {"name": "turn", "flange_turn": {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.01}}
    overrides = {"model.published": True, "fidelity": fidelity, "phase": [phase, turn]}
    return list(islice(build_simulation(load_scenario("ur5e_hexagon_arm", overrides)).steps(), 1, 16))


def made_up(tick: int, **changes: Any) -> Snapshot:
    """Return a snapshot in which no value is that of another tick."""
    made = made_up_snapshot(tick, 0.002)
    entry = replace(
        made.ledger, contacts=tick, contact_force_N=2.0 * tick, self_contacts=3 * tick, trials=tick,
        scheme="iterated" if tick % 2 else "staggered", algorithmic_mass=tick > 3, slides=tick,
        interface_residual=1e-3 * tick, power_size_W=1.0 * tick, momentum_error=1e-6 * tick,
    )  # fmt: skip
    flange = Pose(rotation_from_vector(np.array([0.1 * tick, 0.0, 0.0])), np.array([0.3, 0.01 * tick, 0.7]))
    given = {"link_contacts": (TOUCH,) * (tick == 4), "ledger": entry, "world_from_flange": flange}
    return replace(made, **(given | changes))


def same(found: Any, expected: Any) -> bool:
    """Whether two values have the same types and bits, all that they are made of included."""
    if type(found) is not type(expected):
        return False
    if isinstance(found, np.ndarray):
        alike = found.shape == expected.shape and found.dtype == expected.dtype
        return alike and found.tobytes() == expected.tobytes()
    if is_dataclass(found):
        return all(same(getattr(found, f.name), getattr(expected, f.name)) for f in fields(found))
    return bool(found == expected)


def assert_reads(batch: TickBatch, ticks: list[Snapshot], tolerance: float) -> None:
    """Check that a batch shows what snapshots do."""
    assert len(batch) == len(ticks)
    for name in OF_SNAPSHOT:
        expected = np.array([getattr(tick, name) for tick in ticks])
        found = getattr(batch, name)
        assert found.dtype == expected.dtype
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=1e-15, err_msg=name)
    for name in OF_LEDGER:
        expected = np.array([getattr(tick.ledger, name) for tick in ticks])
        np.testing.assert_array_equal(getattr(batch, name), expected, err_msg=name)
    wrenches, flanges = [tick.ledger.wrench for tick in ticks], [tick.world_from_flange for tick in ticks]
    np.testing.assert_array_equal(batch.flange_force, [wrench.force for wrench in wrenches])
    np.testing.assert_array_equal(batch.flange_torque, [wrench.torque for wrench in wrenches])
    np.testing.assert_array_equal(batch.flange_position, [pose.translation for pose in flanges])
    np.testing.assert_array_equal(batch.flange_rotation, [pose.rotation for pose in flanges])
    quaternions = [pose.quaternion for pose in flanges]
    np.testing.assert_allclose(batch.flange_quaternion, quaternions, rtol=0.0, atol=1e-15)
    angles = [bending_angle(tick.tip_direction, tick.world_from_flange) for tick in ticks]
    np.testing.assert_allclose(batch.bending_angle_rad, angles, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("fidelity", ["lumped", "rigid"])
def test_a_batch_shows_what_its_ticks_do(fidelity: str) -> None:
    ticks = snapshots(fidelity)
    batch = TickBatch.of(ticks)
    assert np.ptp(batch.tip_position, axis=0).max() > 1e-6
    assert "_figures" not in vars(ticks[3].film)  # it was not read one by one
    assert_reads(batch, ticks, 1e-13)


def test_snapshots_of_a_batch_are_those_it_was_made_of() -> None:
    ticks = [made_up(tick) for tick in range(6)]
    batch = TickBatch.of(ticks)
    assert_reads(batch, ticks, 0.0)
    assert all(same(found, tick) for found, tick in zip(batch, ticks, strict=True))
    assert same(batch.snapshot(-1), ticks[5])
    assert not same(batch.snapshot(-1), ticks[4])
    with pytest.raises(IndexError):
        batch.snapshot(6)


def test_what_a_batch_gives_away_is_its_own() -> None:
    """Whoever keeps a snapshot keeps no other ticks, and cannot write to it."""
    batch = TickBatch.of(snapshots("lumped"))
    first = batch.snapshot(3)
    for name in ("joint_position", "body_quaternion", "chamber_pressure_Pa", "cable_tension_N"):
        value = getattr(first, name)
        assert not np.shares_memory(value, getattr(batch, name))
        assert value.base.size == value.size
        with pytest.raises(ValueError, match="read-only"):
            value[...] = np.nan


def test_some_ticks_and_parts_together_are_the_same_ticks() -> None:
    ticks = [made_up(tick) for tick in range(8)]
    batch = TickBatch.of(ticks)
    assert_reads(batch.some(np.array([1, 4, 6])), [ticks[1], ticks[4], ticks[6]], 0.0)
    assert batch.some(np.array([1, 4, 6])).link_contacts == {1: (TOUCH,)}
    joined = TickBatch.joined([TickBatch.of(ticks[:3]), TickBatch.of(ticks[3:])])
    assert_reads(joined, ticks, 0.0)
    assert joined.link_contacts == batch.link_contacts == {4: (TOUCH,)}
    assert same(joined.snapshot(4), ticks[4])


def test_shapes_of_two_runs_are_read_by_their_values() -> None:
    ticks = [snapshots("lumped")[3], snapshots("lumped")[4].kept(), snapshots("lumped")[5]]
    batch = TickBatch.of(ticks)
    assert isinstance(batch.snapshot(0).film, FilmShape)
    assert_reads(batch, ticks, 0.0)


def test_a_target_may_be_free_in_part_or_absent() -> None:
    target = np.array([0.4, np.nan, 0.3])
    batch = TickBatch.of([made_up(1), made_up(2, tip_target=target)])
    assert batch.has_tip_target.tolist() == [False, True]
    np.testing.assert_array_equal(batch.tip_target, [np.full(3, np.nan), target])
    assert batch.snapshot(0).tip_target is None
    np.testing.assert_array_equal(batch.snapshot(1).tip_target, target)


def test_only_iterated_ticks_count_their_trials() -> None:
    batch = TickBatch.of([made_up(tick) for tick in range(4)])
    assert batch.iterated_trials.tolist() == [0, 1, 0, 3]
    assert batch.cable_length_m.shape == (4, 0)


def test_many_quaternions_are_those_of_each_rotation() -> None:
    # half turns about every axis, where another component is the largest, and turns in between
    turns = np.concatenate([np.pi * np.eye(3), np.random.default_rng(1).normal(size=(40, 3)) * 2.0])
    rotations = np.array([rotation_from_vector(turn) for turn in turns])
    one_by_one = [quaternion_from_rotation(rotation) for rotation in rotations]
    np.testing.assert_allclose(quaternions_from_rotations(rotations), one_by_one, rtol=0.0, atol=1e-15)
