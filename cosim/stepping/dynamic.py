"""The dynamic mode: carrier and soft body advance by ticks of the clock."""

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
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.base.solid import LinkContact


_NO_PHASE: Final = -1
_TESTED_AT: Final = (0.75, 1.0)
"""Shares of a phase's ramp after which stability is looked at; it is so at the phase's end as well."""
_TESTED_RAMP_TICKS: Final = 16
"""Of a ramp in which it is looked: a look costs about as much as ten ticks."""


@final
@dataclass(frozen=True)
class _Asked:
    """What ticks of a phase ask for.

    Args:
        phase: its index.
        first: ticks of the phase at the end of the first.
        servos: n rows.
        loads: (n,), at the ends of the ticks.
        ahead: whether they are known before what happens in them.
    """

    phase: int
    first: int
    servos: ServoCommands
    loads: Sequence[Loads]
    ahead: bool

    def some(self, to: Cursor, most: int) -> "_Asked | None":
        """Return what ticks from one on ask for, up to so many; None where that has not been worked out."""
        place = to.done - self.first
        if self.phase != to.phase or not 0 <= place < len(self.loads):
            return None
        servos, loads = self.servos.part(place, place + most), self.loads[place : place + most]
        return _Asked(to.phase, to.done, servos, loads, self.ahead)


_SUDDEN: Final = 3.0
"""Times its mean speed, or that of the last look, from which on the tip moves all at once."""
_MEAN_s: Final = 0.25
_LEAST_SPEED: Final = 0.05  # sizes of the drawn body in a second


@final
@dataclass(frozen=True)
class TipSpeed:
    """How the tip has moved until now, seen from the flange: what leaves an unstable state speeds up.

    Args:
        tip: (3,) [m], flange frame; NaN before the first tick.
        mean: [m/s], over the last quarter of a second.
        looked: [m/s], at the last look at the motion that continues; 0 where it is no faster than its mean.
    """

    tip: Array
    mean: float = 0.0
    looked: float = 0.0

    def after(self, tips: Array, tick_s: float, least: float) -> "tuple[list[int], TipSpeed]":
        """Return the ticks at whose ends the tip has become much faster than before, and what follows.

        Args:
            tips: (k, 3) [m], flange frame.
            tick_s: of the clock.
            least: speed [m/s] below which it counts as at rest.
        """
        rows, mean, looked = [], self.mean, self.looked
        a, b, c = self.tip.tolist()
        for row, (x, y, z) in enumerate(tips.tolist()):
            way = math.sqrt((x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c))
            speed = way / tick_s if way >= 0.0 else 0.0  # in the first tick it is not known
            looked = looked if speed > mean else 0.0
            if speed > max(least, _SUDDEN * max(mean, looked)):
                rows.append(row)
                looked = speed
            mean += (speed - mean) * tick_s / (_MEAN_s + tick_s)
            a, b, c = x, y, z
        return rows, TipSpeed(tips[-1], mean, looked)


_STILL: Final = TipSpeed(np.full(3, np.nan))


@final
@dataclass(frozen=True)
class DynamicState:
    """What the next looks at stability depend on.

    Args:
        undecided_in: the last phase in which the soft robot was unstable, or -1.
        speed: of its tip.
    """

    undecided_in: int = _NO_PHASE
    speed: TipSpeed = _STILL


@final
class DynamicSimulation(SteppedRun):
    """Steps a planned run in lockstep.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: RunInfo) -> None:
        super().__init__(parts, stage, [parts.scenario.ticks(planned.phase) for planned in parts.plan.phases])
        self._ahead: _Asked | None = None
        self._begun: _Asked | None = None  # of a tick that others have begun as well
        self._error: BaseException | None = None  # of the tick to come, which has been tried
        self._state = DynamicState()
        self._least = _LEAST_SPEED * float(np.ptp(parts.soft.body.positions, axis=0).max())

    @property
    def saves_now(self) -> bool:
        """Whether no step has been taken, or begun, beyond the one shown last."""
        return super().saves_now and self._error is None

    def _forget_ahead(self) -> None:
        self._ahead = None

    def _start(self, began: float) -> TickBatch:
        parts, self._state = self._parts, DynamicState()
        plan, carrier = parts.plan, parts.carrier
        carrier.set_configuration(plan.joints)
        loads = parts.loads(plan.command)
        found = parts.brought_to_rest(carrier.flange_pose, loads)
        if deep := carrier.begins_in(found.state.positions):
            raise InstabilityError(
                f"{deep}, and would be thrown out; move the flange or that body, or start at another pressure"
            )
        torque = carrier.hold(found.wrench)
        carrier.couple(found.wrench)
        given = {"tick": 0, "time_s": 0.0, "phase": 0, "joint_target": plan.joints, "joint_torque": torque}
        return parts.at_rest(found, given, began, branchings=found.branchings)

    def _take(self, to: Cursor, most: int) -> TickBatch:
        carrier = self._parts.carrier
        began, (error, self._error) = time.perf_counter(), (self._error, None)
        try:
            if error is not None:
                raise error
            asked, self._begun = self._begun or self._to_take(to, most), None
            taken = carrier.advance(asked.servos, asked.loads)
        except SolverError as failed:
            raise carrier.with_links(failed) from failed.__cause__
        self._error = taken.error
        return self._shown(taken, asked, to, began)

    def looked(self) -> bool:
        """Return whether overlap of films is looked for after the last tick."""
        return self._cursor is not None and bool(self._cursor.tick and self._looked_at(self._cursor, 1))

    def film_now(self) -> Array:
        """Return the nodes (n, 3) [m] of the film after the last tick."""
        return self._parts.shape_reader.positions(self.soft.current_shape())

    def begin_tick(self) -> None:
        """Begin the next tick, whose rigid step is then taken for several arms at once."""
        assert self._cursor is not None, "the state at rest comes before"
        to = self._cursor.following(self._counts)
        assert to is not None, "all arms have as many ticks"
        self._begun = self._to_take(to, 1)
        self._parts.carrier.begin_with_others(self._begun.servos)

    def _to_take(self, to: Cursor, most: int) -> _Asked:
        """Return what the next ticks ask for, with phase and cell where they are in them."""
        carrier = self._parts.carrier
        if to.done == 1:
            self._begin_phase(to.phase, carrier.flange_pose)
        asked = self._asked(to, 1 if carrier.drives_cell else most)
        if carrier.drives_cell:
            carrier.drive_cell(to.phase, to.done * self.stage.tick_s)
        return asked

    def _asked(self, to: Cursor, most: int) -> _Asked:
        """Return what ticks ask for, of one alone where what happens in it decides on the next."""
        parts, tick_s = self._parts, self.stage.tick_s
        known = None if self._ahead is None else self._ahead.some(to, most)
        if known is not None:
            return known
        ahead = parts.commands.ahead(to.phase, to.done)
        if ahead is not None:
            self._ahead = self._worked_out(ahead, to, ahead=True)
            return self._ahead.some(to, most) or self._ahead
        step = StepToTake(to.phase, to.done, to.tick * tick_s - tick_s, tick_s)
        command = parts.command(step)
        return self._worked_out(CommandsAhead(command.joints.as_rows(), (command.soft,)), to, ahead=False)

    def _worked_out(self, commands: CommandsAhead, to: Cursor, *, ahead: bool) -> _Asked:
        parts = self._parts
        loads = [parts.loads(command) for command in commands.soft]
        return _Asked(to.phase, to.done, parts.carrier.servos(commands.joints), loads, ahead)

    def _link_contacts(self, taken: TickLog, first: int) -> "dict[int, tuple[LinkContact, ...]]":
        """Return what the arm's links touch in ticks from the first one on, by row."""
        search, seen = self._parts.carrier.link_contacts_in, self._parts.looks_at_links(first, taken.done)
        places = taken.joint_position, taken.body_position, taken.body_quaternion
        found = {k: search(*(rows[k] for rows in places)) for k in seen}
        return {k: contacts for k, contacts in found.items() if contacts}

    def _undecided(
        self, taken: TickLog, asked: _Asked, to: Cursor, known: tuple[dict[int, StabilityReport], list[int]]
    ) -> dict[int, tuple[Branching, ...]]:
        """Return in which directions the soft robot would give way, if it was at rest, after some ticks.

        Args:
            taken: ticks.
            asked: of them.
            to: the first one.
            known: of the last one of a phase, and in which ticks the tip has moved all at once.
        """
        ends, sudden = known
        count, soft = self._counts[to.phase], self._parts.soft
        ramp = min(count, round(self._parts.plan.phases[to.phase].phase.duration_s / self.stage.tick_s))
        looked = [math.ceil(share * ramp) for share in _TESTED_AT] if ramp >= _TESTED_RAMP_TICKS else []
        places = {at - to.done for at in looked if at < count}
        regular = {row for row in places if 0 <= row < taken.done}
        found = {row: footing.unstable for row, footing in ends.items()}
        for row in {*regular, *sudden} - ends.keys():
            if not taken.contacts[row]:
                flange = Pose(taken.flange_rotation[row], taken.flange_position[row])
                found[row] = soft.find_instability(taken.shapes[row], flange, asked.loads[row])
        large: dict[int, tuple[Branching, ...]] = {
            row: (
                replace(
                    branching,
                    load_factor=(to.done + row) / count,
                    chosen=UNDECIDED if row in regular or row in ends else LEFT,
                ),
            )
            for row, branching in sorted(found.items())
            # wrinkles come and go in motion
            if branching is not None and branching.extent >= WHOLE
        }
        if large:
            self._state = replace(self._state, undecided_in=to.phase)
        return large

    def _sudden(self, taken: TickLog, film: FilmShapes) -> list[int]:
        """Return the ticks in which the tip, seen from the flange, has become much faster than before."""
        if self._parts.scenario.fidelity == "rigid":  # its tip stays where it is
            return []
        origin, axes = taken.flange_position[: taken.done], taken.flange_rotation[: taken.done]
        seen = np.einsum("kr,krs->ks", film.tip_position - origin, axes)
        rows, speed = self._state.speed.after(seen, self.stage.tick_s, self._least)
        self._state = replace(self._state, speed=speed)
        return rows

    def _overlaps(self, taken: TickLog, to: Cursor) -> dict[int, tuple[FilmOverlap, ...]]:
        """Return where films are in one another, or in links of the arm, after some ticks."""
        rows, joints = self._looked_at(to, taken.done), taken.joint_position
        return {row: self._parts.overlaps(taken.shapes[row], joints[row]) for row in rows}

    def _footing(self, taken: TickLog, asked: _Asked, to: Cursor) -> dict[int, StabilityReport]:
        """Return how firmly the soft robot stands at the end of a phase, where it touches nothing."""
        row = self._counts[to.phase] - to.done
        if row != taken.done - 1 or taken.contacts[row]:
            return {}
        soft, here = self._parts.soft, taken.shapes[row]
        flange = Pose(taken.flange_rotation[row], taken.flange_position[row])
        found = soft.assess_stability(here, flange, asked.loads[row])
        return {} if found is None else {row: found}

    def _rests(
        self, ends: dict[int, StabilityReport], taken: TickLog, asked: _Asked
    ) -> dict[int, StabilityReport]:
        """Return how firmly it stands with where it comes to rest, if nothing has decided on its side."""
        found = dict(ends)
        for row, footing in ends.items():
            if self._state.undecided_in == asked.phase:
                flange = Pose(taken.flange_rotation[row], taken.flange_position[row])
                rests = self._parts.soft.find_rest_tip(taken.shapes[row], flange, asked.loads[row])
                found[row] = replace(footing, rests_at_m=rests)
        return found

    def _shown(self, taken: TickLog, asked: _Asked, to: Cursor, began: float) -> TickBatch:
        """Return what ticks show, the first of which ends at `to`."""
        n, parts = taken.done, self._parts
        film = FilmShapes(parts.shape_reader, taken.shapes)
        ends = self._footing(taken, asked, to)
        branchings = self._undecided(taken, asked, to, (ends, self._sudden(taken, film)))
        tick = np.arange(to.tick, to.tick + n)
        time_s = np.asarray(tick * self.stage.tick_s, dtype=np.float64)
        wanted, report = parts.wanted_tip(to.phase, time_s), None
        tension = np.array([load.cable_tension_N for load in asked.loads[:n]]).reshape(n, -1)
        if not asked.ahead:
            report = parts.commands.report(parts.carrier.flange_pose)
            tension = tension if report is None else report.cable_tension_N[None]
        reading, truth = np.zeros((2, n, 0))
        if self.stage.sensors:  # a single tick
            reading, truth = (row[None] for row in parts.sensed(time_s.item(-1), tension[-1]))
        arrays = {
            "tick": tick,
            "time_s": time_s,
            "phase": np.full(n, to.phase),
            "joint_target": asked.servos.position[:n],
            "cable_tension_N": tension,
            "sensor_reading": reading,
            "sensor_truth": truth,
            "tick_wall_s": np.full(n, (time.perf_counter() - began) / n),
        }
        if wanted is not None:
            arrays["tip_target"] = wanted
        return TickBatch(
            {**taken.columns(), **arrays},
            film,
            (report,) * n,
            pieces=taken.substeps,
            link_contacts=self._link_contacts(taken, to.tick),
            branchings=branchings,
            overlaps=self._overlaps(taken, to),
            footing=self._rests(ends, taken, asked),
        )

    def _step_of(self, to: Cursor) -> str:
        return f"tick {to.tick} ({to.tick * self.stage.tick_s:g} s)"

    @property
    def state(self) -> DynamicState:
        """What the next looks at stability depend on."""
        return self._state

    @state.setter
    def state(self, state: DynamicState) -> None:
        self._state, self._ahead, self._error = state, None, None
