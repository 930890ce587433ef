"""Snapshots as numbers that can be compared."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.telemetry.snapshot import Snapshot


def numbers(snapshot: Snapshot) -> dict[str, Any]:
    """Return what a snapshot shows, as arrays, wall time left out."""
    ledger = snapshot.ledger
    flange, twist, wrench = snapshot.world_from_flange, snapshot.flange_twist, ledger.wrench
    shown = {
        "flange": [*flange.translation, *flange.rotation.ravel()],
        "twist": [*twist.linear, *twist.angular],
        "wrench": [*wrench.force, *wrench.torque],
        "nodes": snapshot.node_position,
        "target": snapshot.joint_target,
    }
    for name in (
        "tick", "time_s", "phase", "joint_position", "joint_velocity", "joint_torque", "body_position",
        "body_contact_force", "body_quaternion", "cable_tension_N",
        "chamber_pressure_Pa", "chamber_volume_m3", "tip_position", "sag_m",
    ):  # fmt: skip
        shown[name] = getattr(snapshot, name)
    for field in fields(LedgerEntry):
        if field.name not in ("wrench", "scheme"):
            shown[field.name] = getattr(ledger, field.name)
    return {name: np.asarray(value, dtype=np.float64) for name, value in shown.items()}


def assert_close(found: list[Snapshot], expected: list[Snapshot], tolerance: float) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        mine, others = numbers(one), numbers(other)
        for name, value in mine.items():
            np.testing.assert_allclose(value, others[name], rtol=tolerance, atol=tolerance, err_msg=name)
