"""Ticks as columns are what they are one by one."""

from __future__ import annotations

import pickle
from itertools import islice
from typing import Any

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.base.column import columns_of
from cosim.base.columns import TickColumns
from cosim.base.frames import (
    Twist,
    Wrench,
    quaternion_from_rotation,
    quaternions_from_rotations,
    rotation_from_vector,
)
from cosim.base.solid import LinkContact
from cosim.config.loading import load_scenario
from cosim.devices.measurement import bending_angle
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.conftest import made_up_snapshot
from tests.ticks import changed

TOUCH = LinkContact("forearm", "table", 0.01, False)


def snapshots(fidelity: str) -> list[Snapshot]:
    """Return ticks in which the flange and the pressure move; nobody has read their shapes."""
    phase = {"name": "inflate", "duration_s": 0.02, "increments": 8, "pressure_Pa": 3e3}
    turn = phase | {"name": "turn", "flange_turn": {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.01}}
    overrides = {"model.published": True, "fidelity": fidelity, "phase": [phase, turn], "clock.tick_s": 4e-3}
    return list(islice(build_simulation(load_scenario("ur5e_hexagon_arm", overrides)).steps(), 1, 16))


def made_up(tick: int, **changes: Any) -> Snapshot:
    """Return a snapshot in which no value is that of another tick."""
    given: dict[str, Any] = {
        "contacts": tick, "contact_force_N": 2.0 * tick, "self_contacts": 3 * tick, "trials": tick,
        "scheme": "iterated" if tick % 2 else "staggered", "algorithmic_mass": tick > 3, "slides": tick,
        "interface_residual": 1e-3 * tick, "power_size_W": 1.0 * tick, "momentum_error": 1e-6 * tick,
        "flange_rotation": rotation_from_vector(np.array([0.1 * tick, 0.0, 0.0])),
        "flange_position": np.array([0.3, 0.01 * tick, 0.7]),
    }  # fmt: skip
    if tick == 4:
        given["link_contacts"] = (TOUCH,)
    return changed(made_up_snapshot(tick, 0.002), **(given | changes))


def shown(value: Any) -> Any:
    """Return a value of a row as columns hold it."""
    if isinstance(value, Wrench):
        return [*value.force, *value.torque]
    if isinstance(value, Twist):
        return [*value.linear, *value.angular]
    return np.full(3, np.nan) if value is None else value


def assert_reads(batch: TickBatch, ticks: list[Snapshot], tolerance: float = 0.0) -> None:
    """Check that a batch shows what snapshots do, in every column."""
    assert len(batch) == len(ticks)
    for name in columns_of(TickColumns):
        expected, found = np.array([shown(getattr(tick, name)) for tick in ticks]), getattr(batch, name)
        assert found.dtype.kind == expected.dtype.kind, name
        if found.dtype.kind in "US":
            assert found.tolist() == expected.tolist()
        else:
            np.testing.assert_allclose(found, expected, rtol=tolerance, atol=1e-3 * tolerance, err_msg=name)


@pytest.mark.parametrize("fidelity", ["lumped", "rigid"])
def test_a_batch_shows_what_its_ticks_do(fidelity: str) -> None:
    ticks = snapshots(fidelity)
    batch = TickBatch.of(ticks)
    assert np.ptp(batch.tip_position, axis=0).max() > 1e-6
    assert_reads(batch, ticks, 1e-12)
    quaternions = [tick.world_from_flange.quaternion for tick in ticks]
    np.testing.assert_allclose(batch.flange_quaternion, quaternions, rtol=0.0, atol=1e-15)
    angles = [bending_angle(tick.tip_direction, tick.world_from_flange) for tick in ticks]
    np.testing.assert_allclose(batch.bending_angle_rad, angles, rtol=0.0, atol=1e-12)


def test_snapshots_of_a_batch_are_those_it_was_made_of() -> None:
    ticks = [made_up(tick) for tick in range(6)]
    batch = TickBatch.of(ticks)
    assert_reads(batch, ticks)
    assert_reads(TickBatch.of(list(batch)), ticks)
    assert batch.snapshot(-1).tick == 5
    assert (type(ticks[3].tick), type(ticks[3].time_s), type(ticks[3].scheme)) == (int, float, str)
    with pytest.raises(IndexError):
        batch.snapshot(6)


def test_a_snapshot_does_not_change_with_its_batch() -> None:
    """Whoever keeps a snapshot keeps no other ticks, and cannot write to it."""
    batch = TickBatch.of(snapshots("lumped"))
    for first in (batch.snapshot(3), pickle.loads(pickle.dumps(batch.snapshot(3)))):
        for name in (
            "joint_position",
            "body_quaternion",
            "chamber_pressure_Pa",
            "tip_position",
            "node_position",
        ):
            value = getattr(first, name)
            assert not np.shares_memory(value, getattr(batch, name))
            np.testing.assert_array_equal(value, getattr(batch, name)[3])
            with pytest.raises(ValueError, match="read-only"):
                value[...] = np.nan


def test_some_ticks_and_parts_together_are_the_same_ticks() -> None:
    ticks = [made_up(tick) for tick in range(8)]
    batch = TickBatch.of(ticks)
    assert_reads(batch.some(np.array([1, 4, 6])), [ticks[1], ticks[4], ticks[6]])
    assert batch.some(np.array([1, 4, 6])).link_contacts == {1: (TOUCH,)}
    joined = TickBatch.joined([TickBatch.of(ticks[:3]), TickBatch.of(ticks[3:])])
    assert_reads(joined, ticks)
    assert joined.link_contacts == batch.link_contacts == {4: (TOUCH,)}


def test_shapes_of_two_runs_are_read_by_their_values() -> None:
    ticks = [snapshots("lumped")[3], snapshots("lumped")[4].kept(), snapshots("lumped")[5]]
    assert_reads(TickBatch.of(ticks), ticks)


def test_a_target_may_be_free_in_part_or_absent() -> None:
    target = np.array([0.4, np.nan, 0.3])
    batch = TickBatch.of([made_up(1), made_up(2, tip_target=target)])
    assert batch.has_tip_target.tolist() == [False, True]
    np.testing.assert_array_equal(batch.tip_target, [np.full(3, np.nan), target])
    assert batch.snapshot(0).tip_target is None
    np.testing.assert_array_equal(batch.snapshot(1).tip_target, target)


def test_figures_are_those_of_a_snapshot_and_old_names_say_so() -> None:
    tick = made_up(3)
    with pytest.warns(DeprecationWarning, match="off the snapshot"):
        assert tick.ledger.contacts == tick.contacts == 3
    with pytest.warns(DeprecationWarning, match="off the snapshot"):
        np.testing.assert_array_equal(tick.film.tip_position, tick.tip_position)


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
