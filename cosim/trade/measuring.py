"""Runs the members of a trade and measures each against the reference of its group.

Tip position and flange force are sampled at common times; the speed is simulated time over CPU time
of the loop (not wall time, so that other work on the machine does not count).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import final

import numpy as np

from cosim.errors import CosimError
from cosim.frames import Array
from cosim.scenario.loading import load_scenario
from cosim.scenario.schema import Scenario
from cosim.scenario.snapshot import Snapshot
from cosim.trade.members import Member
from cosim.trade.simulation import Build

SAMPLE_S = 0.02


@final
@dataclass(frozen=True)
class Curve:
    """What a member did.

    Args:
        time_s: (k,).
        tip: (k, 3) [m].
        force: (k, 3) [N], of the soft robot on the flange.
        contact: (k,) [N], sum of the normal forces of all contacts.
        phase_ends: (phases,) indices of the last snapshot of each phase.
        cpu_s: of the loop.
        iterations: Newton iterations a tick.
    """

    time_s: Array
    tip: Array
    force: Array
    contact: Array
    phase_ends: tuple[int, ...]
    cpu_s: float
    iterations: float

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return tip (n, 3), force (n, 3) and contact force (n,) at given times (n,)."""
        tip, force = (
            np.stack([np.interp(times, self.time_s, values[:, axis]) for axis in range(3)], axis=1)
            for values in (self.tip, self.force)
        )
        return tip, force, np.interp(times, self.time_s, self.contact)


@final
@dataclass(frozen=True)
class Measured:
    """A member's cost and errors; errors are NaN where there is nothing to measure against.

    Args:
        member: which.
        real_time_factor: simulated time over CPU time of the loop.
        tip_error_m: largest distance from the reference's tip over the run.
        tip_rms_m: root mean square of it.
        end_error_m: largest at the ends of phases.
        force_error_N: largest difference of the flange force over the run.
        contact_error_N: root mean square difference of the sum of normal contact forces over the run.
        iterations: Newton iterations a tick.
        failure: why it did not finish; empty if it did.
    """

    member: Member
    real_time_factor: float = np.nan
    tip_error_m: float = np.nan
    tip_rms_m: float = np.nan
    end_error_m: float = np.nan
    force_error_N: float = np.nan
    contact_error_N: float = np.nan
    iterations: float = np.nan
    failure: str = ""

    @classmethod
    def numbers(cls) -> tuple[str, ...]:
        """Return the names of its figures."""
        return tuple(entry.name for entry in fields(cls) if entry.name not in ("member", "failure"))

    @property
    def comparable(self) -> bool:
        """Whether it has finished and was measured against another one."""
        return not self.failure and not self.member.reference and bool(np.isfinite(self.tip_error_m))


def measure(
    scenario: Scenario, members: Sequence[Member], build: Build, tell: Callable[[Measured], None]
) -> list[Measured]:
    """Run all members, each group's reference before its others.

    Args:
        scenario: that they change.
        members: to run.
        build: makes a simulation.
        tell: told of each when it is done.
    """
    references: dict[str, Curve] = {}
    results: list[Measured] = []
    for member in members:
        try:
            curve = trace(load_scenario(scenario, member.changes), build)
        except CosimError as error:
            result = Measured(member, failure=f"{type(error).__name__}: {error}")
        else:
            if member.reference:
                references[member.group] = curve
            statics = member.changes.get("mode", scenario.mode) == "quasistatic"
            result = _compared(member, curve, references.get(member.group), statics=statics)
        results.append(result)
        tell(result)
    return results


def trace(scenario: Scenario, build: Build) -> Curve:
    """Run a scenario without recording and keep its curves.

    Raises:
        CosimError: it cannot be built or solved.
    """
    snapshots = build(scenario).steps()
    rows = [_row(next(snapshots))]  # before the clock starts: this one finds the start equilibrium
    iterations = 0
    began = time.process_time()
    for snapshot in snapshots:
        rows.append(_row(snapshot))
        iterations += snapshot.ledger.newton_iterations
    spent = time.process_time() - began
    phases = [row[4] for row in rows]
    ends = [k for k in range(1, len(rows)) if k + 1 == len(rows) or phases[k + 1] != phases[k]]
    return Curve(
        time_s=np.array([row[0] for row in rows]),
        tip=np.array([row[1] for row in rows]),
        force=np.array([row[2] for row in rows]),
        contact=np.array([row[3] for row in rows]),
        phase_ends=tuple(ends),
        cpu_s=spent,
        iterations=iterations / max(1, len(rows) - 1),
    )


def _row(snapshot: Snapshot) -> tuple[float, Array, Array, float, int]:
    ledger = snapshot.ledger
    return snapshot.time_s, snapshot.tip_position, ledger.wrench.force, ledger.contact_force_N, snapshot.phase


def _compared(member: Member, curve: Curve, reference: Curve | None, *, statics: bool) -> Measured:
    """Return a member's figures; of statics, which have no time between phase ends, only those there."""
    factor = float(curve.time_s[-1]) / curve.cpu_s if curve.cpu_s > 0.0 else np.nan
    if reference is None:
        return Measured(member, factor, iterations=curve.iterations)
    ends = curve.tip[list(curve.phase_ends)] - reference.tip[list(reference.phase_ends)]
    end_error = float(np.linalg.norm(ends, axis=1).max())
    if statics:
        return Measured(member, factor, end_error_m=end_error, iterations=curve.iterations)
    times = np.arange(0.0, min(curve.time_s[-1], reference.time_s[-1]) + 0.5 * SAMPLE_S, SAMPLE_S)
    (tip, force, contact), (true_tip, true_force, true_contact) = curve.at(times), reference.at(times)
    distance = np.linalg.norm(tip - true_tip, axis=1)
    return Measured(
        member,
        factor,
        tip_error_m=float(distance.max()),
        tip_rms_m=float(np.sqrt((distance**2).mean())),
        end_error_m=end_error,
        force_error_N=float(np.linalg.norm(force - true_force, axis=1).max()),
        contact_error_N=float(np.sqrt(((contact - true_contact) ** 2).mean())),
        iterations=curve.iterations,
    )
