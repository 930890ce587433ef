"""A soft robot in somebody's MuJoCo model, stepped by somebody's loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, final

import numpy as np

from cosim.app.preparation import log, named_body, prepared
from cosim.base import kept_parts, state_file
from cosim.base.columns import TickRow, TickTable
from cosim.base.frames import Array, IntArray, Wrench
from cosim.base.state import restore_states, states_of
from cosim.base.state_checks import KnownStates, check_state, check_states
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.plugins import note_kinds
from cosim.config.schema.phase import FlangePoseTable, StartTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.settings import ClockTable
from cosim.devices.command_checks import row_of_numbers
from cosim.devices.command_source import StepToTake
from cosim.devices.controller import Command
from cosim.errors import InputError, SolverError

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody
    from cosim.devices.controller import Measurement
    from cosim.plan.commands import SoftCommand
    from cosim.rigid.scene.host_model import HostModel, HostSource
    from cosim.rigid.scene.host_scene import Data, HostScene, Model
    from cosim.soft.body.body import SoftBody
    from cosim.soft.body.loads import Loads
    from cosim.stepping.parts import Parts
    from cosim.stepping.scene_carrier import HostCarrier

Values: TypeAlias = "float | Sequence[float] | Mapping[str, float]"
"""One number for all, or one each in order, or some by name."""
_AHEAD: Final = 64
"""Ticks whose commands are found at once."""


@final
@dataclass(frozen=True)
class AttachedState(state_file.WrittenState):
    """A soft robot and the scene that it hangs on, between two ticks; made by `Attached.save`.

    Args:
        tick: ticks taken.
        soft: state of the soft side.
        parts: states of scene, exchange and commands, by name.
        loads: on the soft robot in the last tick.
        ledger: of it.
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


_AGAIN: Final = "; after an interrupted or failed step, call reset(model, data) or restore(saved)"


@dataclass
class _Hung:
    """A soft robot that hangs on a scene.

    Args:
        scene: somebody's.
        carrier: of the soft robot.
        parts: of the run.
        loads: on the soft robot at the end of the tick in progress.
        tick: ticks taken.
        steps: of MuJoCo taken in the tick in progress.
        stage: between two steps, in one, or broken off.
        ledger: returns that of the last tick.
        ahead: what ticks to come are asked for, as long as nothing new is commanded.
        ahead_tick: the first of them.
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
        """Return what the ticks to come depend on besides the soft side, by name, see `restore_states`."""
        return {**self.carrier.parts(), **self.parts.commands.parts()}


@contextmanager
def _uninterrupted(run: _Hung) -> Iterator[None]:
    """Change a run in a block; if Ctrl-C ends it in the middle, the run is broken off."""
    stage, run.stage = run.stage, _Stage.BROKEN_OFF
    try:
        yield
    except Exception:
        run.stage = stage
        raise
    run.stage = stage


@final
class Attached:
    """A soft robot on a site or body of somebody's MuJoCo model; made by `attach`.

    Around every `mujoco.mj_step(model, data)` come `before(model, data)` and `after(model, data)`; `step` is
    all three. What acts on the scene is that of the last tick, as in a staggered run of `Simulation`. The
    first `before` brings the soft robot to rest where its mount is then.

    Args:
        scenario: with the soft robot, without arm and phases.
        host: the model to hang on.
        body: a soft body in place of the scenario's soft robot.
    """

    def __init__(self, scenario: Scenario, host: HostModel, body: SoftBody | None) -> None:
        from cosim.build.soft_model import SoftModel  # here, so that wrong input needs no engine

        self.scenario, self._host = scenario, host
        self._model = SoftModel(scenario, kept_parts.KeptParts(on_disk=True), body, log)
        self._waiting: list[tuple[Command, int]] = []
        self._hung: _Hung | None = None
        self._known = KnownStates()

    @property
    def spec(self) -> Any:
        """The `mujoco.MjSpec` to compile; None where a compiled model was given."""
        return self._host.spec

    @property
    def tick_s(self) -> float:
        """Length of a tick of the soft robot [s]."""
        return self.scenario.clock.tick_s

    def before(self, model: Model, data: Data) -> None:
        """Apply the wrench of the soft robot, for one step of MuJoCo.

        Args:
            model: compiled, with the body that carries the soft robot.
            data: its state, with all other forces of your loop set.

        Raises:
            InputError: they are of another model, or `after` has not been called.
            SolverError: the soft robot finds no rest at its start.
        """
        run = self._hung
        if run is None:
            run = self._begun(model, data)
        _check(run, model, data)
        if run.stage is not _Stage.BETWEEN:
            raise InputError(f"{run.stage.value}{_AGAIN}")
        run.scene.check_step()
        run.stage = _Stage.BROKEN_OFF  # until all of it is done, whatever interrupts it
        if not run.steps:
            run.loads = self._loads(run)
            run.carrier.begin()
        run.scene.begin_step()
        run.stage = _Stage.STEPPING

    def after(self, model: Model, data: Data) -> None:
        """Move the soft robot to where one step of MuJoCo has brought its mount.

        Afterwards poses and velocities in `data` are those at the end of the step.

        Args:
            model: as of `before`.
            data: the same, one `mj_step` later.

        Raises:
            InputError: `before` has not been called, or more or less than one step has been taken.
            SolverError: the physics could not be solved; `restore` leads back to a saved state.
        """
        run = self._hung
        if run is None or run.stage is _Stage.BETWEEN:
            raise InputError("after() was called without before(); call before(model, data) ahead of mj_step")
        _check(run, model, data)
        if run.stage is _Stage.BROKEN_OFF:
            raise InputError(f"{run.stage.value}{_AGAIN}")
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
            steps: how many.

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
            except BaseException:  # Ctrl-C as well: MuJoCo's data is to be as the loop has set it
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
            SolverError: there is no rest.
        """
        self._break_off()
        self._begun(model, data)

    def _break_off(self) -> None:
        """Leave the step in progress, if there is one."""
        if self._hung is not None:
            self._hung.stage = _Stage.BROKEN_OFF
            self._hung.scene.abandon_step()

    def _begun(self, model: Model, data: Data) -> _Hung:
        from cosim.build.simulation import build_hosted  # here, see above
        from cosim.coupling.ticks import rest_columns, sizes_of

        scene = self._host.scene(model, data)
        carrier, parts = build_hosted(self.scenario, self._model, scene)
        loads = parts.loads(parts.plan.command)
        found = parts.brought_to_rest(carrier.flange_pose, loads)
        if self.scenario.contact.enabled and (deep := scene.begins_in(found.state.positions)):
            raise InputError(
                f"{deep}; move the mount, whose z axis it hangs along, or attach with "
                'overrides={"contact.enabled": False}'
            )
        self._check_far(scene, found.state.positions)
        carrier.couple(found.wrench)
        parts.plan.phases[0].holding.apply(parts.soft, carrier.flange_pose)
        parts.commands.begin_phase(0)
        for command, ticks in self._waiting:
            parts.commands.command(command, ticks)
        sizes = sizes_of(0, len(scene.body_names), len(parts.soft.pressures_Pa))
        rest = TickRow(TickTable(rest_columns(found, sizes)))
        run = _Hung(scene, carrier, parts, loads, lambda: rest)
        self._hung, self._waiting = run, []
        return run

    def _check_far(self, scene: HostScene, positions: Array) -> None:
        """Check that the second body is at the film's other end, whose nodes are `positions` (n, 3) [m].

        Raises:
            InputError: it is farther away than the film is long, or that end has less than three nodes.
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
        """Ask for pressures, tensions and the like from the next tick on; see `Command`.

        Args:
            command: its values are reached evenly within a time and held then.
            over_s: that time [s]; one tick at least.

        Raises:
            InputError: it names what there is not.
        """
        if not isinstance(over_s, float | int) or not 0.0 <= over_s < float("inf"):
            raise InputError(f"over_s is {over_s!r}; must be a time in seconds, 0 or more")
        ticks = max(1, round(over_s / self.tick_s))
        self._ask(command, ticks)

    def _ask(self, command: Command, ticks: int) -> None:
        if self._hung is None:
            self._waiting.append((command, ticks))
        else:
            with _uninterrupted(self._hung):
                self._hung.parts.commands.command(command, ticks)
                self._hung.ahead = ()

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
        """What the soft robot exerts on its mount at present, at its origin, world axes."""
        return self._run.carrier.wrench

    @property
    def far_wrench(self) -> Wrench:
        """What the soft joint exerts on the second body, at the site or body named for it, world axes."""
        return self._run.carrier.far_wrench

    @property
    def ledger(self) -> TickRow:
        """What was exchanged in the last tick."""
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
        """Add the film to a `mujoco.MjvScene`, such as `user_scn` of a passive viewer, a geom a triangle.

        Args:
            scene: that gets the geoms.

        Raises:
            InputError: the scene has no room for it.
        """
        from cosim.rigid.scene.renderer import add_film  # here: it brings MuJoCo

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
        """Return the present state, MuJoCo's included; saving has no effect on the ticks to come.

        Raises:
            InputError: a tick is in progress.
        """
        run = self._run
        if run.stage is _Stage.BROKEN_OFF:
            raise InputError(f"{run.stage.value}{_AGAIN}")
        if run.stage is _Stage.STEPPING or run.steps:
            raise InputError("a tick is in progress; save after after(), at the end of the soft robot's tick")
        return self._state(run)

    def _state(self, run: _Hung) -> AttachedState:
        soft, parts = run.parts.soft.full_state, states_of(run.stateful())
        saved = AttachedState(run.tick, soft, parts, run.loads, self.ledger)
        self._known.add(saved)
        return saved

    def restore(self, saved: AttachedState | str | Path) -> None:
        """Go to a saved state, or that of a file; MuJoCo's data goes there too.

        Args:
            saved: what `save` has returned, or a file's path.

        Raises:
            InputError: the file cannot be read, or the state does not fit.
        """
        run = self._run
        state = state_file.load(Path(saved)) if isinstance(saved, str | Path) else saved
        if not isinstance(state, AttachedState):
            raise InputError(f"{saved}: holds no attached soft robot but a {type(state).__name__}")
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
    def _run(self) -> _Hung:
        if self._hung is None:
            raise InputError("the soft robot hangs on nothing yet; call before() or reset() with model, data")
        return self._hung

    @property
    def _parts(self) -> Parts:
        return self._run.parts

    def _loads(self, run: _Hung) -> Loads:
        """Return what acts on the soft robot at the end of the tick that begins."""
        parts, done = run.parts, run.tick + 1
        if not run.ahead_tick <= done < run.ahead_tick + len(run.ahead):
            found = parts.commands.ahead(0, done, _AHEAD)
            run.ahead, run.ahead_tick = () if found is None else found.soft, done
        if run.ahead:
            return parts.loads(run.ahead[done - run.ahead_tick])
        step = StepToTake(0, done, run.tick * self.tick_s, self.tick_s)
        return parts.loads(parts.command(step).soft)

    def __repr__(self) -> str:
        """Return one line: what hangs where."""
        when = "not begun" if self._hung is None else f"tick {self.tick}"
        return f"{self.scenario.soft_robot.name} attached at {self._host.at!r}, {when}"


def attach(
    spec: HostSource,
    at: str | tuple[str, str],
    robot: str | Path | None = None,
    *,
    tick_s: float | None = None,
    overrides: Mapping[str, Any] | None = None,
    body: AnyBody | None = None,
) -> Attached:
    """Hang a soft robot on a site or body of a MuJoCo model, and leave the loop to whoever has it.

    Args:
        spec: `mujoco.MjSpec`, which is compiled afterwards; path of an MJCF, which `Attached.spec` is then
            read from; or a compiled `mujoco.MjModel`.
        at: name of a site, or else of a body: its frame is the flange, the soft robot hangs along its z axis.
            Two names: a soft joint, whose tip ring is glued to the second, as it is at the start.
        robot: name of a soft robot that comes with cosim, or path of its file.
        tick_s: of the soft robot, one or several timesteps; None: MuJoCo's timestep.
        overrides: values by key path of a scenario, such as {"fidelity": "section",
            "start.pressure_Pa": 20e3, "solver.damping_per_s": 2.0}; gravity and clock are the model's.
        body: a soft body in place of `robot`.

    Raises:
        InputError: the model has no such site or body, its integrator is RK4, a key is wrong, or the soft
            joint's model has no film that could give way.
    """
    from cosim.rigid.scene.host_model import HostModel  # here: it brings MuJoCo

    if (robot is None) == (body is None):
        raise InputError("robot and body: give one of them, the name or file of a soft robot or a soft body")
    named, changes = named_body(body), dict(overrides or {})
    for key, where in (("clock.tick_s", "tick_s"), ("gravity_m_s2", "model.opt.gravity"), ("robot", "spec")):
        if key in changes:
            raise InputError(f"overrides: {key} cannot be set here; {where} has it")
    host = HostModel.of(spec, at, tick_s)
    scenario = load_scenario(_scenario(host, robot), changes, named and named.table())
    if not scenario.endless or scenario.mode != "dynamic" or scenario.coupling.scheme != "staggered":
        raise InputError(
            "overrides: attached soft robots have no phases, mode 'dynamic', coupling.scheme 'staggered'; "
            "leave these keys out"
        )
    if host.far is not None and scenario.fidelity not in ("lumped", "refined"):
        raise InputError(
            f"overrides: fidelity is {scenario.fidelity!r}; a soft joint needs 'lumped' or 'refined'"
        )
    chosen = prepared(scenario, log)
    note_kinds(chosen)
    return Attached(chosen, host, named and named.body)


def _scenario(host: HostModel, robot: str | Path | None) -> Scenario:
    """Return a scenario that holds a soft robot still; its start is found where the mount is."""
    start = StartTable(FlangePoseTable((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    table = load_soft_robot("hexagon_arm" if robot is None else robot)
    tick_s = host.steps * host.timestep_s
    return Scenario(
        2, "attached", f"a soft robot at {host.at}", NO_ARM, table, start,
        gravity_m_s2=host.gravity, clock=ClockTable(tick_s),
    )  # fmt: skip


def _check(run: _Hung, model: Model, data: Data) -> None:
    if not run.scene.is_of(model, data):
        raise InputError("the soft robot hangs on another model and data; call reset(model, data) to move it")


def _by_name(values: Values, names: tuple[str, ...], key: str) -> dict[str, float]:
    """Return values by name, as they may be given.

    Raises:
        InputError: there are not as many as names.
    """
    if isinstance(values, Mapping):
        return dict(values)
    if isinstance(values, Real):
        return dict.fromkeys(names, float(values))
    return dict(zip(names, row_of_numbers(values, len(names), key), strict=True))
