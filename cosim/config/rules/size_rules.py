"""Bounds on how much a scenario may ask for: triangles, ticks, increments, solids, periods of a shake."""

from __future__ import annotations

from typing import Final

from cosim.config.schema.given_body import AnySoftRobot, GivenBodyTable
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError

MOST_TRIANGLES: Final = 200_000
MOST_TICKS: Final = 1_000_000_000
MOST_INCREMENTS: Final = 10_000_000
MOST_SOLIDS: Final = 2_000
MOST_SHAKE_PERIODS: Final = 1_000


def check_sizes(scenario: Scenario, faults: Faults) -> None:
    """Check that what a scenario asks for can be built within minutes and some gigabytes.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the bounds that are exceeded.
    """
    with faults:
        _check_triangles(scenario)
    with faults:
        solids = sum(max(1, bool(entry.shape) + len(entry.parts)) for entry in scenario.objects)
        if solids > MOST_SOLIDS:
            raise ScenarioError("object", f"makes {solids} solids in all; at most {MOST_SOLIDS} are allowed")
    with faults:
        segments = sum(wire.segments for wire in scenario.wires)
        if segments > MOST_SOLIDS:
            raise ScenarioError(
                "wire", f"makes {segments} segments in all; at most {MOST_SOLIDS} are allowed"
            )
    with faults:
        for phase in scenario.phases:
            with faults:
                _check_shake(phase)
    _check_length(scenario)


def triangle_count(robot: AnySoftRobot) -> int:
    """Return how many triangles the mesh of a soft robot has, with its copies and attachments."""
    if isinstance(robot, GivenBodyTable):
        return robot.triangles
    copies = 1 if robot.copies is None else robot.copies.count
    own = 0 if robot.stack is None else robot.stack.triangles  # mesh files have a bound of their own
    return copies * own + sum(triangle_count(part.robot) for part in robot.attachments)


def check_ends(scenario: Scenario) -> None:
    """Check that a scenario has phases, with which it ends.

    Raises:
        ScenarioError: it has none.
    """
    if scenario.endless:
        raise ScenarioError(
            "phase",
            "is missing: the scenario holds its start without end; give a [[phase]] with a duration_s, or "
            "step and command it with cosim.Simulation",
        )


def _check_triangles(scenario: Scenario) -> None:
    finer = scenario.fidelity == "refined"
    triangles = triangle_count(scenario.soft_robot) * (4 if finer else 1)
    if triangles > MOST_TRIANGLES:
        also = ", fidelity = 'refined'" if finer else ""
        raise ScenarioError(
            "soft_robot.stack",
            f"makes {triangles:,} triangles, copies and attachments counted; at most {MOST_TRIANGLES:,} are "
            f"allowed: take fewer units, sides, refine{also}",
        )


def _check_shake(phase: PhaseTable) -> None:
    if phase.flange_shake is None:
        return
    periods = phase.flange_shake.frequency_Hz * phase.duration_s
    if periods > MOST_SHAKE_PERIODS:
        raise ScenarioError(
            f"phase.{phase.name}.flange_shake.frequency_Hz",
            f"makes {periods:g} periods in one phase; at most {MOST_SHAKE_PERIODS} are allowed",
        )


def _check_length(scenario: Scenario) -> None:
    """Check ticks or increments, by the mode; the phase that makes most of them is named."""
    if scenario.endless:
        return
    quasistatic = scenario.mode == "quasistatic"
    tick_s = scenario.clock.tick_s
    counts = [p.increments if quasistatic else (p.duration_s + p.settle_s) / tick_s for p in scenario.phases]
    most, what = (MOST_INCREMENTS, "increments") if quasistatic else (MOST_TICKS, "ticks")
    if sum(counts) <= most:
        return
    phase = scenario.phases[max(range(len(counts)), key=counts.__getitem__)]
    key = "increments" if quasistatic else "duration_s" if phase.duration_s > phase.settle_s else "settle_s"
    raise ScenarioError(
        f"phase.{phase.name}.{key}", f"all phases make {sum(counts):.3g} {what}; at most {most:g} are allowed"
    )
