"""Rows of columns are snapshots like any other, and a block reads them as it reads those."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.app.driver import build_simulation
from cosim.app.first_run import with_fidelity_chosen
from cosim.base.state_archive import read_archive, write_archive
from cosim.build import section_cache as section_model
from cosim.config.loading import load_scenario
from cosim.coupling.batch.batch import SectionLockstep
from cosim.coupling.soft_sides.chain_reader import ChainRows
from cosim.devices.device_loop import bending_angle
from cosim.telemetry.block import Block
from cosim.telemetry.snapshot import LedgerEntry, Snapshot
from cosim.telemetry.tick_columns import FROM_ROW, TickColumns
from tests.small_section import on_a_ur5e, section

SCENARIO = on_a_ur5e(
    20e3,
    """
[[phase]]
name = "turn"
duration_s = 0.08
pressure_Pa = 25e3
cable_tension_N = [2.0, 0.0]
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.02 }
""",
)
WALL_S = 1.5e-4
BEGIN, END = 11, 31
IN_BLOCKS = (
    "tick", "time_s", "phase", "joint_position", "joint_velocity", "joint_torque", "joint_target",
    "body_position", "body_quaternion", "body_contact_force",
    "pressure_Pa", "chamber_pressure_Pa", "cable_tension_N", "tip_position", "tip_direction", "sag_m",
    "chamber_volume_m3", "volume_m3", "node_position",
)  # fmt: skip
IN_LEDGERS = (
    "power_error_W", "power_error", "momentum_error", "residual_N", "newton_iterations", "stability_ratio",
    "contacts", "contact_force_N", "contact_depth_m", "self_contacts", "self_contact_force_N",
    "self_contact_depth_m", "interface_residual",
)  # fmt: skip


def columns_of(snapshots: Sequence[Snapshot], **changes: Any) -> TickColumns:
    """Return the columns of which the snapshots are the rows."""

    def stacked(read: Callable[[Snapshot], Any]) -> Any:
        return np.array([read(snapshot) for snapshot in snapshots])

    first, kept = snapshots[0], [snapshot.kept_shape for snapshot in snapshots]
    shapes = [shape.shape for shape in kept if shape is not None]
    assert kept[0] is not None
    frames, pressures = np.array([s.frames for s in shapes]), np.array([s.pressure_Pa for s in shapes])
    reader: Any = kept[0].reader
    given: dict[str, Any] = {
        "phase": first.phase,
        "shapes": ChainRows(reader, frames, pressures),
        "flange_position": stacked(lambda s: s.world_from_flange.translation),
        "flange_rotation": stacked(lambda s: s.world_from_flange.rotation),
        "flange_twist": stacked(lambda s: np.concatenate([s.flange_twist.linear, s.flange_twist.angular])),
        "wrench": stacked(lambda s: np.concatenate([s.ledger.wrench.force, s.ledger.wrench.torque])),
        "tip_target": first.tip_target,
        "tick_wall_s": WALL_S,
    }
    for name in (field.name for field in fields(TickColumns) if field.name not in given):
        of_ledger = name in {field.name for field in fields(LedgerEntry)}
        given[name] = stacked(lambda s, n=name, o=of_ledger: getattr(s.ledger if o else s, n))  # type: ignore[misc]
    return TickColumns(**(given | changes))


@pytest.fixture(scope="module")
def snapshots(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    """Ticks of a section arm that moves; nobody has read their shapes."""
    path = tmp_path_factory.mktemp("columns") / "three_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(path.parent / "cache"))
        patch.setattr(section_model, "build_model", lambda *_: section().model)
        patch.setattr(SectionLockstep, "of", lambda *_: None)  # which would show rows
        scenario = with_fidelity_chosen(load_scenario(path), lambda _text: None)
        made = list(build_simulation(scenario).steps())
    for snapshot in made:
        vars(snapshot)["tick_wall_s"] = WALL_S
    return made


@pytest.fixture
def rows(snapshots: list[Snapshot]) -> list[Snapshot]:
    """Some of these ticks, as rows of columns."""
    columns = columns_of(snapshots[BEGIN:END])
    return [Snapshot.of_row(columns, row) for row in range(len(columns))]


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


def assert_same(found: Snapshot, expected: Snapshot) -> None:
    for field in fields(Snapshot):
        if field.name not in ("kept_shape", "kept_row"):
            mine, others = getattr(found, field.name), getattr(expected, field.name)
            assert same(mine, others), f"{field.name}: {mine} is not {others}"
    assert found.kept_shape is not None
    assert expected.kept_shape is not None
    assert same(found.kept_shape.shape, expected.kept_shape.shape)
    assert found.kept_shape.reader is expected.kept_shape.reader


def test_a_row_shows_what_an_ordinary_snapshot_does(snapshots: list[Snapshot], rows: list[Snapshot]) -> None:
    assert np.ptp([snapshot.tip_position for snapshot in snapshots[BEGIN:END]], axis=0).max() > 1e-5
    for row, snapshot in zip(rows, snapshots[BEGIN:END], strict=True):
        assert_same(row, snapshot)
        assert row.joint_position is row.joint_position
        with pytest.raises(AttributeError, match="'Snapshot' object has no attribute 'third'"):
            _ = row.third  # type: ignore[attr-defined]


def test_a_row_makes_nothing_before_it_is_asked(rows: list[Snapshot]) -> None:
    row = rows[3]
    assert set(vars(row)) == {"tick", "time_s", "phase", "kept_row"}
    _ = row.tip_position
    assert set(vars(row)) == {"tick", "time_s", "phase", "kept_row", "kept_shape", "tip_position"}


def test_what_a_row_gives_away_is_its_own(snapshots: list[Snapshot], rows: list[Snapshot]) -> None:
    """Whoever keeps an array keeps no other rows, and may write to it."""
    first, second = rows[4], Snapshot.of_row(*rows[4].kept_row)  # type: ignore[misc]
    for name in FROM_ROW:
        value = getattr(first, name)
        if isinstance(value, np.ndarray):
            assert value.base is None
            value[...] = np.nan
    assert_same(second, snapshots[BEGIN + 4])


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda row: pickle.loads(pickle.dumps(row))])
def test_copies_are_without_the_other_rows(
    snapshots: list[Snapshot], rows: list[Snapshot], copied: Callable[[Snapshot], Snapshot]
) -> None:
    found, expected = copied(rows[5]), copied(snapshots[BEGIN + 5])
    assert found.kept_row is None
    assert set(FROM_ROW) <= set(vars(found))
    for name in FROM_ROW:
        if name != "kept_shape":
            assert same(getattr(found, name), getattr(expected, name)), name
    np.testing.assert_array_equal(found.tip_position, expected.tip_position)
    row, snapshot = len(pickle.dumps(copied(rows[5]))), len(pickle.dumps(snapshots[BEGIN + 5]))
    assert row < 1.01 * snapshot
    changed = replace(rows[5], tick=99)
    assert (changed.tick, changed.kept_row) == (99, None)
    assert same(changed.ledger, snapshots[BEGIN + 5].ledger)


def test_a_row_in_an_archive_is_an_ordinary_snapshot(
    snapshots: list[Snapshot], rows: list[Snapshot], tmp_path: Path
) -> None:
    for name, snapshot in (("row", rows[6]), ("made", snapshots[BEGIN + 6])):
        write_archive(tmp_path / name, {}, snapshot)
    found, expected = (read_archive(tmp_path / name) for name in ("row", "made"))
    for field in fields(Snapshot):
        assert same(getattr(found, field.name), getattr(expected, field.name)), field.name
    assert (tmp_path / "row").stat().st_size == (tmp_path / "made").stat().st_size


def test_blocks_read_rows_and_snapshots_alike(snapshots: list[Snapshot]) -> None:
    """Two pieces of columns with ordinary snapshots around them; all ticks, and every third."""
    pieces = [columns_of(snapshots[BEGIN:20]), columns_of(snapshots[20:END])]
    made = [Snapshot.of_row(columns, row) for columns in pieces for row in range(len(columns))]
    mixed = [*snapshots[:BEGIN], *made, *snapshots[END:]]
    for step in (1, 3):
        block, ordinary = Block(mixed[::step]), snapshots[::step]
        assert len(block.pieces) == 4
        for name in IN_BLOCKS:
            expected = np.array([getattr(snapshot, name) for snapshot in ordinary])
            np.testing.assert_allclose(getattr(block, name), expected, rtol=1e-13, atol=1e-12, err_msg=name)
        for name in IN_LEDGERS:
            expected = np.array([getattr(snapshot.ledger, name) for snapshot in ordinary])
            assert getattr(block, name).dtype == expected.dtype
            np.testing.assert_array_equal(getattr(block, name), expected, err_msg=name)
        wrenches = [snapshot.ledger.wrench for snapshot in ordinary]
        np.testing.assert_array_equal(block.flange_force, [wrench.force for wrench in wrenches])
        np.testing.assert_array_equal(block.flange_torque, [wrench.torque for wrench in wrenches])
        flanges = [snapshot.world_from_flange for snapshot in ordinary]
        np.testing.assert_array_equal(block.flange_position, [pose.translation for pose in flanges])
        np.testing.assert_array_equal(block.flange_rotation, [pose.rotation for pose in flanges])
        assert block.tick_wall_s == pytest.approx(WALL_S)
        angles = [bending_angle(s.tip_direction, s.world_from_flange) for s in ordinary]
        np.testing.assert_allclose(block.bending_angle_rad, angles, rtol=0.0, atol=1e-12)
        assert block.cable_length_m.shape == (len(block), 0)
        assert not block.has_tip_target.any()
        assert not block.iterated_trials.any()


def test_a_target_of_a_piece_is_that_of_its_rows(snapshots: list[Snapshot]) -> None:
    target = np.array([0.4, np.nan, 0.3])
    columns = columns_of(snapshots[BEGIN:END], tip_target=target)
    block = Block([snapshots[BEGIN - 1], *(Snapshot.of_row(columns, row) for row in (0, 5))])
    assert block.has_tip_target.tolist() == [False, True, True]
    np.testing.assert_array_equal(block.tip_target, [np.full(3, np.nan), target, target])
    assert block.snapshots[2].tip_target is target
