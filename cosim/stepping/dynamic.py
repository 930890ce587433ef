"""The dynamic mode: carrier and soft body advance by ticks, with checks of stability, overlap and links."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.devices.command_source import CommandsAhead, StepToTake
from cosim.errors import InstabilityError, SolverError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.branching import LEFT, UNDECIDED, WHOLE, Branching, FilmOverlap, StabilityReport
from cosim.stepping.parts import Parts
from cosim.stepping.stepped_run import Cursor, SteppedRun
from cosim.stepping.tip_speed import TipSpeed
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.base.solid import LinkContact


_NO_PHASE: Final = -1
_CHECKED_AT: Final = (0.75, 1.0)
"""Fractions of a phase's ramp after which stability is checked, in addition to the phase's end."""
_CHECKED_RAMP_TICKS: Final = 16
"""Least ticks of a ramp with such checks: a check costs about as much as ten ticks."""
_LEAST_SPEED: Final = 0.05
"""Speed of a sudden motion, in sizes of the drawn body per second, at least."""
_STILL: Final = TipSpeed(np.full(3, np.nan))


@final
@dataclass(frozen=True)
class _Inputs:
    """Inputs of ticks of a phase.

    Args:
        phase: its index.
        first: ticks of the phase at the end of the first.
        servos: commands of the servos, n rows.
        loads: (n,), at the ends of the ticks.
        ahead: whether they do not depend on the state in these ticks.
    """

    phase: int
    first: int
    servos: ServoCommands
    loads: Sequence[Loads]
    ahead: bool

    def some(self, to: Cursor, most: int) -> "_Inputs | None":
        """Return the inputs of up to `most` ticks from one on; None if they are not known."""
        row = to.done - self.first
        if self.phase != to.phase or not 0 <= row < len(self.loads):
            return None
        servos, loads = self.servos.part(row, row + most), self.loads[row : row + most]
        return _Inputs(to.phase, to.done, servos, loads, self.ahead)


@final
@dataclass(frozen=True)
class DynamicState:
    """State of the checks of stability.

    Args:
        undecided_in: last phase in which the soft robot was unstable, or -1.
        speed: of its tip.
    """

    undecided_in: int = _NO_PHASE
    speed: TipSpeed = _STILL


@final
class DynamicSimulation(SteppedRun):
    """Steps a planned run in time.

    Args:
        parts: of the run.
        stage: description of the run.
    """

    def __init__(self, parts: Parts, stage: RunInfo) -> None:
        super().__init__(parts, stage, [parts.scenario.ticks(planned.phase) for planned in parts.plan.phases])
        self._ahead: _Inputs | None = None
        self._begun: _Inputs | None = None  # of a tick that other arms have begun as well
        self._error: BaseException | None = None  # of the next tick, which has been tried
        self._state = DynamicState()
        self._least = _LEAST_SPEED * float(np.ptp(parts.soft.body.positions, axis=0).max())

    @property
    def saves_now(self) -> bool:
        """Whether no step has been taken, or begun, after the last batch."""
        return super().saves_now and self._error is None

    def _forget_ahead(self) -> None:
        self._ahead = None

    def _start(self, began: float) -> TickBatch:
        parts, self._state = self._parts, DynamicState()
        plan, carrier = parts.plan, parts.carrier
        carrier.set_configuration(plan.joints)
        loads = parts.loads(plan.command)
        start = parts.brought_to_rest(carrier.flange_pose, loads)
        if deep := carrier.begins_in(start.state.positions):
            raise InstabilityError(
                f"{deep}, and would be thrown out; move the flange or that body, or start at another pressure"
            )
        torque = carrier.hold(start.wrench)
        carrier.couple(start.wrench)
        known = {"tick": 0, "time_s": 0.0, "phase": 0, "joint_target": plan.joints, "joint_torque": torque}
        return parts.at_rest(start, known, began, branchings=start.branchings)

    def _take(self, to: Cursor, most: int) -> TickBatch:
        carrier = self._parts.carrier
        began, (error, self._error) = time.perf_counter(), (self._error, None)
        try:
            if error is not None:
                raise error
            inputs, self._begun = self._begun or self._next_inputs(to, most), None
            ticks = carrier.advance(inputs.servos, inputs.loads)
        except SolverError as failed:
            raise carrier.with_links(failed) from failed.__cause__
        self._error = ticks.error
        return self._shown(ticks, inputs, to, began)

    def checked_overlap(self) -> bool:
        """Return whether overlap of films was checked after the last tick."""
        return self._cursor is not None and bool(self._cursor.tick and self._overlap_rows(self._cursor, 1))

    def film_now(self) -> Array:
        """Return the nodes (n, 3) [m] of the film after the last tick."""
        return self._parts.shape_reader.positions(self.soft.current_shape())

    def begin_tick(self) -> None:
        """Begin the next tick; its rigid step is then taken for several arms at once."""
        assert self._cursor is not None, "the state at rest comes before"
        to = self._cursor.following(self._counts)
        assert to is not None, "all arms have the same number of ticks"
        self._begun = self._next_inputs(to, 1)
        self._parts.carrier.begin_with_others(self._begun.servos)

    def _next_inputs(self, to: Cursor, most: int) -> _Inputs:
        """Begin a phase and set the cell, if necessary, and return the inputs of the next ticks."""
        carrier = self._parts.carrier
        if to.done == 1:
            self._begin_phase(to.phase, carrier.flange_pose)
        inputs = self._inputs(to, 1 if carrier.drives_cell else most)
        if carrier.drives_cell:
            carrier.drive_cell(to.phase, to.done * self.stage.tick_s)
        return inputs

    def _inputs(self, to: Cursor, most: int) -> _Inputs:
        """Return the inputs of the next ticks; of a single one if the next depend on its state."""
        parts, tick_s = self._parts, self.stage.tick_s
        known = None if self._ahead is None else self._ahead.some(to, most)
        if known is not None:
            return known
        ahead = parts.commands.ahead(to.phase, to.done)
        if ahead is not None:
            self._ahead = self._inputs_of(ahead, to, ahead=True)
            return self._ahead.some(to, most) or self._ahead
        step = StepToTake(to.phase, to.done, to.tick * tick_s - tick_s, tick_s)
        command = parts.command(step)
        return self._inputs_of(CommandsAhead(command.joints.as_rows(), (command.soft,)), to, ahead=False)

    def _inputs_of(self, commands: CommandsAhead, to: Cursor, *, ahead: bool) -> _Inputs:
        parts = self._parts
        loads = [parts.loads(command) for command in commands.soft]
        return _Inputs(to.phase, to.done, parts.carrier.servos(commands.joints), loads, ahead)

    def _link_contacts(self, ticks: TickLog, first: int) -> "dict[int, tuple[LinkContact, ...]]":
        """Return the contacts of the arm's links, by row of the ticks from the first one on."""
        search, rows = self._parts.carrier.link_contacts_in, self._parts.link_check_rows(first, ticks.done)
        columns = ticks.joint_position, ticks.body_position, ticks.body_quaternion
        contacts = {k: search(*(column[k] for column in columns)) for k in rows}
        return {k: each for k, each in contacts.items() if each}

    def _branchings(
        self, ticks: TickLog, inputs: _Inputs, to: Cursor, ends: dict[int, StabilityReport], sudden: list[int]
    ) -> dict[int, tuple[Branching, ...]]:
        """Return the directions in which the soft robot, taken at rest, is unstable, by row.

        Args:
            ticks: that were taken.
            inputs: of the ticks.
            to: end of the first tick.
            ends: stability at the end of the phase, by row.
            sudden: rows with a sudden motion of the tip.
        """
        count, soft = self._counts[to.phase], self._parts.soft
        ramp = min(count, round(self._parts.plan.phases[to.phase].phase.duration_s / self.stage.tick_s))
        checked = [math.ceil(part * ramp) for part in _CHECKED_AT] if ramp >= _CHECKED_RAMP_TICKS else []
        rows = {at - to.done for at in checked if at < count}
        regular = {row for row in rows if 0 <= row < ticks.done}
        found = {row: stability.unstable for row, stability in ends.items()}
        for row in {*regular, *sudden} - ends.keys():
            if not ticks.contacts[row]:
                flange = Pose(ticks.flange_rotation[row], ticks.flange_position[row])
                found[row] = soft.find_instability(ticks.shapes[row], flange, inputs.loads[row])
        large: dict[int, tuple[Branching, ...]] = {
            row: (
                replace(
                    branching,
                    load_factor=(to.done + row) / count,
                    chosen=UNDECIDED if row in regular or row in ends else LEFT,
                ),
            )
            for row, branching in sorted(found.items())
            # wrinkles appear and vanish in motion
            if branching is not None and branching.extent >= WHOLE
        }
        if large:
            self._state = replace(self._state, undecided_in=to.phase)
        return large

    def _sudden(self, ticks: TickLog, film: FilmShapes) -> list[int]:
        """Return the rows with a sudden motion of the tip in the flange frame."""
        if self._parts.scenario.fidelity == "rigid":
            return []
        origin, axes = ticks.flange_position[: ticks.done], ticks.flange_rotation[: ticks.done]
        tips = np.einsum("kr,krs->ks", film.tip_position - origin, axes)
        rows, speed = self._state.speed.after(tips, self.stage.tick_s, self._least)
        self._state = replace(self._state, speed=speed)
        return rows

    def _overlaps(self, ticks: TickLog, to: Cursor) -> dict[int, tuple[FilmOverlap, ...]]:
        """Return overlaps of films with one another and with links of the arm, by row."""
        rows, joints = self._overlap_rows(to, ticks.done), ticks.joint_position
        return {row: self._parts.overlaps(ticks.shapes[row], joints[row]) for row in rows}

    def _stability(self, ticks: TickLog, inputs: _Inputs, to: Cursor) -> dict[int, StabilityReport]:
        """Return the stability at the end of a phase without contact, by row."""
        row = self._counts[to.phase] - to.done
        if row != ticks.done - 1 or ticks.contacts[row]:
            return {}
        soft, shape = self._parts.soft, ticks.shapes[row]
        flange = Pose(ticks.flange_rotation[row], ticks.flange_position[row])
        stability = soft.assess_stability(shape, flange, inputs.loads[row])
        return {} if stability is None else {row: stability}

    def _with_rest(
        self, ends: dict[int, StabilityReport], ticks: TickLog, inputs: _Inputs
    ) -> dict[int, StabilityReport]:
        """Return the stability with the tip's position at rest, after a phase with an unstable state."""
        result = dict(ends)
        for row, stability in ends.items():
            if self._state.undecided_in == inputs.phase:
                flange = Pose(ticks.flange_rotation[row], ticks.flange_position[row])
                tip = self._parts.soft.find_rest_tip(ticks.shapes[row], flange, inputs.loads[row])
                result[row] = replace(stability, rests_at_m=tip)
        return result

    def _shown(self, ticks: TickLog, inputs: _Inputs, to: Cursor, began: float) -> TickBatch:
        """Return ticks as a batch; the first one ends at `to`."""
        n, parts = ticks.done, self._parts
        film = FilmShapes(parts.shape_reader, ticks.shapes)
        ends = self._stability(ticks, inputs, to)
        branchings = self._branchings(ticks, inputs, to, ends, self._sudden(ticks, film))
        tick = np.arange(to.tick, to.tick + n)
        time_s = np.asarray(tick * self.stage.tick_s, dtype=np.float64)
        target, report = parts.tip_target(to.phase, time_s), None
        tension = np.array([load.cable_tension_N for load in inputs.loads[:n]]).reshape(n, -1)
        if not inputs.ahead:
            report = parts.commands.report(parts.carrier.flange_pose)
            tension = tension if report is None else report.cable_tension_N[None]
        reading, truth = np.zeros((2, n, 0))
        if self.stage.sensors:  # a single tick
            reading, truth = (row[None] for row in parts.sensed(time_s.item(-1), tension[-1]))
        arrays = {
            "tick": tick,
            "time_s": time_s,
            "phase": np.full(n, to.phase),
            "joint_target": inputs.servos.position[:n],
            "cable_tension_N": tension,
            "sensor_reading": reading,
            "sensor_truth": truth,
            "tick_wall_s": np.full(n, (time.perf_counter() - began) / n),
        }
        if target is not None:
            arrays["tip_target"] = target
        return TickBatch(
            {**ticks.columns(), **arrays},
            film,
            (report,) * n,
            substeps=ticks.substeps,
            link_contacts=self._link_contacts(ticks, to.tick),
            branchings=branchings,
            overlaps=self._overlaps(ticks, to),
            stability=self._with_rest(ends, ticks, inputs),
        )

    def _step_of(self, to: Cursor) -> str:
        return f"tick {to.tick} ({to.tick * self.stage.tick_s:g} s)"

    @property
    def state(self) -> DynamicState:
        """State of the checks of stability."""
        return self._state

    @state.setter
    def state(self, state: DynamicState) -> None:
        self._state, self._ahead, self._error = state, None, None
