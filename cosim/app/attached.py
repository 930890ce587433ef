"""A soft robot in a user's MuJoCo model, stepped in the user's loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, final

import numpy as np

from cosim.app.preparation import log
from cosim.base import kept_parts, state_file
from cosim.base.columns import TickRow, TickTable
from cosim.base.frames import Array, IntArray, Wrench
from cosim.base.state import restore_states, states_of
from cosim.base.state_checks import KnownStates, check_state, check_states
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import row_of_numbers
from cosim.devices.command_source import StepToTake
from cosim.devices.controller import Command
from cosim.errors import InputError, SolverError

if TYPE_CHECKING:
    from cosim.devices.controller import Measurement
    from cosim.plan.commands import SoftCommand
    from cosim.rigid.scene.host_model import HostModel
    from cosim.rigid.scene.host_scene import Data, HostScene, Model
    from cosim.soft.body.body import SoftBody
    from cosim.soft.body.loads import Loads
    from cosim.stepping.host_carrier import HostCarrier
    from cosim.stepping.parts import Parts

Values: TypeAlias = "float | Sequence[float] | Mapping[str, float]"
"""One number for all, one each in order, or some by name."""
_AHEAD: Final = 64
"""Ticks whose commands are computed at once."""
_REMEDY: Final = "; after an interrupted or failed step, call reset(model, data) or restore(saved)"


@final
@dataclass(frozen=True)
class AttachedState(state_file.WrittenState):
    """A soft robot and the scene of its mount, between two ticks; made by `Attached.save`.

    Args:
        tick: number of ticks taken.
        soft: state of the soft side.
        parts: states of scene, exchange and commands, by name.
        loads: on the soft robot in the last tick.
        ledger: row of the last tick.
    """

    tick: int
    soft: Any
    parts: dict[str, Any]
    loads: Any
    ledger: Any

    @property
    def _ticks(self) -> int:
        return self.tick


class _Stage(Enum):
    BETWEEN = ""
    STEPPING = "before() was called twice; after mj_step comes after(model, data)"
    BROKEN_OFF = "the last step of the soft robot was broken off"


@dataclass
class _MountedRun:
    """The run of a soft robot that is mounted in a scene.

    Args:
        scene: of the user's model.
        carrier: of the soft robot.
        parts: of the run.
        loads: on the soft robot at the end of the tick in progress.
        tick: number of ticks taken.
        steps: number of MuJoCo's steps in the tick in progress.
        stage: between two steps, in one, or broken off.
        ledger: returns the row of the last tick.
        ahead: commands of later ticks, until there is a new command.
        ahead_tick: the first of these ticks.
    """

    scene: HostScene
    carrier: HostCarrier
    parts: Parts
    loads: Loads
    ledger: Callable[[], TickRow]
    ahead: tuple[SoftCommand, ...] = ()
    ahead_tick: int = 0
    tick: int = 0
    steps: int = 0
    stage: _Stage = _Stage.BETWEEN

    def stateful(self) -> dict[str, Any]:
        """Return the parts with a state, without the soft side, by name, see `restore_states`."""
        return {**self.carrier.parts(), **self.parts.commands.parts()}


@contextmanager
def _uninterrupted(run: _MountedRun) -> Iterator[None]:
    """Change a run in a block; if Ctrl-C interrupts it, the run is broken off."""
    stage, run.stage = run.stage, _Stage.BROKEN_OFF
    try:
        yield
    except Exception:
        run.stage = stage
        raise
    run.stage = stage


@final
class Attached:
    """A soft robot on a site or body of a user's MuJoCo model; made by `attach`.

    Call `before(model, data)` and `after(model, data)` around every `mujoco.mj_step(model, data)`; `step`
    does all three. The loads on the scene are those of the last tick, as in a staggered run of `Simulation`.
    The first `before` brings the soft robot to rest at the present pose of its mount.

    Args:
        scenario: with the soft robot, without arm and phases.
        host: the MuJoCo model.
        body: a soft body in place of the scenario's soft robot.
    """

    def __init__(self, scenario: Scenario, host: HostModel, body: SoftBody | None) -> None:
        from cosim.build.soft_model import SoftModel  # here: wrong input is refused before engines are loaded

        self.scenario, self._host = scenario, host
        self._model = SoftModel(scenario, kept_parts.KeptParts(on_disk=True), body, log)
        self._waiting: list[tuple[Command, int]] = []
        self._mounted_run: _MountedRun | None = None
        self._known = KnownStates()

    @property
    def spec(self) -> Any:
        """The `mujoco.MjSpec` to compile; None for a compiled model."""
        return self._host.spec

    @property
    def tick_s(self) -> float:
        """Length of a tick of the soft robot [s]."""
        return self.scenario.clock.tick_s

    def before(self, model: Model, data: Data) -> None:
        """Apply the wrench of the soft robot for one step of MuJoCo.

        Args:
            model: compiled model, with the body that carries the soft robot.
            data: its state, with all other forces of your loop set.

        Raises:
            InputError: they are of another model, or `after` has not been called.
            SolverError: there is no state at rest to start from.
        """
        run = self._mounted_run
        if run is None:
            run = self._start(model, data)
        _check(run, model, data)
        if run.stage is not _Stage.BETWEEN:
            raise InputError(f"{run.stage.value}{_REMEDY}")
        run.scene.check_step()
        run.stage = _Stage.BROKEN_OFF  # until the end of this method, whatever interrupts it
        if not run.steps:
            run.loads = self._loads(run)
            run.carrier.begin()
        run.scene.begin_step()
        run.stage = _Stage.STEPPING

    def after(self, model: Model, data: Data) -> None:
        """Step the soft robot, with the pose of its mount after one step of MuJoCo.

        Afterwards poses and velocities in `data` are those at the end of the step.

        Args:
            model: as of `before`.
            data: the same, one `mj_step` later.

        Raises:
            InputError: `before` has not been called, or not exactly one step has been taken.
            SolverError: the physics could not be solved; `restore` returns to a saved state.
        """
        run = self._mounted_run
        if run is None or run.stage is _Stage.BETWEEN:
            raise InputError("after() was called without before(); call before(model, data) ahead of mj_step")
        _check(run, model, data)
        if run.stage is _Stage.BROKEN_OFF:
            raise InputError(f"{run.stage.value}{_REMEDY}")
        run.stage = _Stage.BROKEN_OFF
        run.scene.end_step()
        steps = (run.steps + 1) % self._host.steps
        if not steps:
            try:
                taken = run.carrier.end(run.loads)
            except SolverError as error:
                where = f"soft robot at {self._host.at!r}, {run.scene.time_s:.4f} s"
                raise error.at(where) from error.__cause__
            run.tick, run.ledger = run.tick + 1, taken.last
        run.steps, run.stage = steps, _Stage.BETWEEN

    def step(self, model: Model, data: Data, steps: int = 1) -> None:
        """Take steps of MuJoCo with the soft robot, each of them `before`, `mj_step`, `after`.

        Args:
            model: as of `before`.
            data: its state.
            steps: number of steps.

        Raises:
            InputError: as of `before` and `after`.
            SolverError: the same.
        """
        for _ in range(steps):
            self.before(model, data)
            scene = self._run.scene
            try:
                scene.step()
                self.after(model, data)
            except BaseException:  # Ctrl-C as well: MuJoCo's data must be as the loop has set it
                self._run.stage = _Stage.BROKEN_OFF
                scene.abandon_step()
                raise

    def reset(self, model: Model, data: Data) -> None:
        """Begin again: bring the soft robot to rest where its mount is, as after `mj_resetData`.

        Args:
            model: compiled, with the body that carries the soft robot.
            data: its state; the soft robot's base may move, its start is computed for a mount at rest.

        Raises:
            InputError: they are of another model, or the soft robot begins inside of something.
            SolverError: there is no state at rest.
        """
        self._break_off()
        self._start(model, data)

    def _break_off(self) -> None:
        """Break off the step in progress, if any."""
        if self._mounted_run is not None:
            self._mounted_run.stage = _Stage.BROKEN_OFF
            self._mounted_run.scene.abandon_step()

    def _start(self, model: Model, data: Data) -> _MountedRun:
        from cosim.build.simulation import build_hosted  # here: it loads engines
        from cosim.coupling.ticks import rest_columns, sizes_of

        scene = self._host.scene(model, data)
        carrier, parts = build_hosted(self.scenario, self._model, scene)
        loads = parts.loads(parts.plan.command)
        at_rest = parts.brought_to_rest(carrier.flange_pose, loads)
        if self.scenario.contact.enabled and (deep := scene.begins_in(at_rest.state.positions)):
            raise InputError(
                f"{deep}; move the mount, whose z axis it hangs along, or attach with "
                'overrides={"contact.enabled": False}'
            )
        self._check_far(scene, at_rest.state.positions)
        carrier.couple(at_rest.wrench)
        parts.plan.phases[0].holding.apply(parts.soft, carrier.flange_pose)
        parts.commands.begin_phase(0)
        for command, ticks in self._waiting:
            parts.commands.command(command, ticks)
        sizes = sizes_of(0, len(scene.body_names), len(parts.soft.pressures_Pa))
        rest = TickRow(TickTable(rest_columns(at_rest, sizes)))
        run = _MountedRun(scene, carrier, parts, loads, lambda: rest)
        self._mounted_run, self._waiting = run, []
        return run

    def _check_far(self, scene: HostScene, positions: Array) -> None:
        """Check that the second body is near the tip of a film with nodes `positions` (n, 3) [m].

        Raises:
            InputError: it is farther away than the film is long, or the tip has less than three nodes.
        """
        body, far = self._model.body, self._host.far
        if far is None:
            return
        if len(body.tip) < 3:
            raise InputError(
                f"at: the tip of the soft robot has {len(body.tip)} nodes; gluing needs at least 3"
            )
        tip = body.tip_position(positions)
        away = float(np.linalg.norm(scene.far_position - tip))
        most = float(np.linalg.norm(tip - scene.flange_pose.translation))
        if away > most:
            raise InputError(
                f"at: {far!r} is {away:.4g} m from the soft robot's tip at {np.round(tip, 4).tolist()}, "
                f"farther than the film is long ({most:.4g} m); move it to the tip before the first before()"
            )

    def command(self, command: Command, over_s: float = 0.0) -> None:
        """Command pressures, tensions and the like from the next tick on; see `Command`.

        Args:
            command: its values are reached evenly within a time and then held.
            over_s: that time [s]; one tick at least.

        Raises:
            InputError: the command names something that does not exist.
        """
        if not isinstance(over_s, float | int) or not 0.0 <= over_s < float("inf"):
            raise InputError(f"over_s is {over_s!r}; must be a time in seconds, 0 or more")
        ticks = max(1, round(over_s / self.tick_s))
        self._ask(command, ticks)

    def _ask(self, command: Command, ticks: int) -> None:
        if self._mounted_run is None:
            self._waiting.append((command, ticks))
        else:
            with _uninterrupted(self._mounted_run):
                self._mounted_run.parts.commands.command(command, ticks)
                self._mounted_run.ahead = ()

    @property
    def pressure_Pa(self) -> tuple[float, ...]:
        """Gauge pressure of each chamber; set it to a number for all, one each, or some by name."""
        return tuple(self._parts.soft.pressures_Pa)

    @pressure_Pa.setter
    def pressure_Pa(self, values: Values) -> None:
        names = self.scenario.soft_robot.chamber_names()
        self._ask(Command(pressure_Pa=_by_name(values, names, "pressure_Pa")), 1)

    @property
    def tension_N(self) -> tuple[float, ...]:
        """Tension of each cable at its base in the last tick; set it to a number, one each, or by name."""
        return tuple(self._run.loads.cable_tension_N)

    @tension_N.setter
    def tension_N(self, values: Values) -> None:
        names = self.scenario.soft_robot.cable_names()
        self._ask(Command(cable_tension_N=_by_name(values, names, "tension_N")), 1)

    @property
    def tick(self) -> int:
        """Ticks of the soft robot since it was brought to rest."""
        return self._run.tick

    @property
    def wrench(self) -> Wrench:
        """Present wrench of the soft robot on its mount, at the mount's origin, world axes."""
        return self._run.carrier.wrench

    @property
    def far_wrench(self) -> Wrench:
        """Wrench of the soft joint on the second body, at its named site or body, world axes."""
        return self._run.carrier.far_wrench

    @property
    def ledger(self) -> TickRow:
        """Row of the exchange in the last tick."""
        return self._run.ledger()

    @property
    def tip_position(self) -> Array:
        """(3,) [m], world."""
        return self._model.body.tip_position(self._run.carrier.positions)

    @property
    def film(self) -> Array:
        """Nodes of the film (n, 3) [m], world."""
        return self._run.carrier.positions.copy()

    @property
    def triangles(self) -> IntArray:
        """Nodes of each triangle of the film (m, 3)."""
        return self._model.body.triangles

    def draw(self, scene: Any) -> None:
        """Add the film to a `mujoco.MjvScene`, such as `user_scn` of a passive viewer, one geom a triangle.

        Args:
            scene: to which the geoms are added.

        Raises:
            InputError: the scene has no room for it.
        """
        from cosim.rigid.scene.renderer import add_film  # here: it loads MuJoCo

        add_film(scene, self._run.carrier.positions, self.triangles)

    @property
    def node_mass_kg(self) -> Array:
        """(n,), of the film's nodes."""
        return self._model.body.node_mass.copy()

    def measure(self) -> Measurement:
        """Return a measurement of the present state, without noise; without joints of the scene."""
        run = self._run
        return run.parts.measured(run.tick * self.tick_s, np.array(run.loads.cable_tension_N))

    def save(self) -> AttachedState:
        """Return the present state, MuJoCo's included; saving does not affect later ticks.

        Raises:
            InputError: a tick is in progress.
        """
        run = self._run
        if run.stage is _Stage.BROKEN_OFF:
            raise InputError(f"{run.stage.value}{_REMEDY}")
        if run.stage is _Stage.STEPPING or run.steps:
            raise InputError("a tick is in progress; save after after(), at the end of the soft robot's tick")
        return self._state(run)

    def _state(self, run: _MountedRun) -> AttachedState:
        soft, parts = run.parts.soft.full_state, states_of(run.stateful())
        saved = AttachedState(run.tick, soft, parts, run.loads, self.ledger)
        self._known.add(saved)
        return saved

    def restore(self, saved: AttachedState | str | Path) -> None:
        """Restore a saved state, or that of a file, with MuJoCo's data.

        Args:
            saved: result of `save`, or a file's path.

        Raises:
            InputError: the file cannot be read, or the state does not fit.
        """
        run = self._run
        state = state_file.load(Path(saved)) if isinstance(saved, str | Path) else saved
        if not isinstance(state, AttachedState):
            raise InputError(f"{saved}: holds a {type(state).__name__}, not an attached soft robot")
        states = run.carrier.completed(state.parts)
        if state not in self._known:
            sizes = dict[str, int]()
            check_state(state, self._state(run), AttachedState, sizes=sizes)
            check_states(run.stateful(), states, "state", sizes)
        self._break_off()
        run.parts.soft.full_state = state.soft
        restore_states(run.stateful(), states)
        run.tick, run.loads, run.ledger = state.tick, state.loads, lambda: state.ledger
        run.steps, run.ahead = 0, ()
        self._known.add(state)
        run.stage = _Stage.BETWEEN

    @property
    def _run(self) -> _MountedRun:
        if self._mounted_run is None:
            raise InputError("the soft robot is not mounted yet; call before() or reset() with model, data")
        return self._mounted_run

    @property
    def _parts(self) -> Parts:
        return self._run.parts

    def _loads(self, run: _MountedRun) -> Loads:
        """Return the loads on the soft robot at the end of the next tick."""
        parts, done = run.parts, run.tick + 1
        if not run.ahead_tick <= done < run.ahead_tick + len(run.ahead):
            commands = parts.commands.ahead(0, done, _AHEAD)
            run.ahead, run.ahead_tick = () if commands is None else commands.soft, done
        if run.ahead:
            return parts.loads(run.ahead[done - run.ahead_tick])
        step = StepToTake(0, done, run.tick * self.tick_s, self.tick_s)
        return parts.loads(parts.command(step).soft)

    def __repr__(self) -> str:
        """Return one line: soft robot, mount and tick."""
        when = "not begun" if self._mounted_run is None else f"tick {self.tick}"
        return f"{self.scenario.soft_robot.name} attached at {self._host.at!r}, {when}"


def _check(run: _MountedRun, model: Model, data: Data) -> None:
    if not run.scene.is_of(model, data):
        raise InputError(
            "the soft robot is mounted in another model and data; call reset(model, data) to move it"
        )


def _by_name(values: Values, names: tuple[str, ...], key: str) -> dict[str, float]:
    """Return values by name.

    Raises:
        InputError: the number of values differs from the number of names.
    """
    if isinstance(values, Mapping):
        return dict(values)
    if isinstance(values, Real):
        return dict.fromkeys(names, float(values))
    return dict(zip(names, row_of_numbers(values, len(names), key), strict=True))
