"""`cosim.linearise`: a run's next tick as a discrete linear model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from cosim.app.simulation import Simulation, stepped_run
from cosim.base.frames import Array
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots import beam_robot, film_robot
from cosim.coupling.robots.shape_reader import MeshReader
from cosim.devices.flange_offset import joint_rate
from cosim.errors import InputError
from cosim.reduced.sections.figures import FIGURES
from cosim.soft.body.body import SoftBody
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.linear_step import LinearStep
from cosim.stepping.dynamic import DynamicSimulation
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

_ROUNDING: Final = 1e-12
_MOVES = 1e-6  # of an eigenvalue of A: below it is what a tick forgets
_ARM = ("joint_position", "joint_velocity", "joint_acceleration")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_FRAME_s: Final = 1.0 / 30.0  # of a recording of modes
_FRAMES: Final = 60  # of each mode
_SWING: Final = 0.08  # of the film's size


@final
@dataclass(frozen=True, repr=False)
class LinearModel:
    """Small changes of a run, tick by tick: x+ = A x + B u, y+ = C x+ + D u.

    The inputs act through the tick that leads to x+ and y+; y is the change of the tip.

    Args:
        a: (n, n) [state per state].
        b: (n, inputs) [state per input].
        c: (3, n) [m per state].
        d: (3, inputs) [m per input]: of a pressure, by which the film swells at once.
        inputs: names: "pressure_Pa" (with .NAME of several chambers), "cable_tension_N.NAME", and with an arm
            "flange_twist.vx" to ".wz", see `cosim.Command`.
        outputs: names, "tip_position_m.x" and so on, world axes.
        parts: (rows, n) each, of the run's state by x: "joint_position" [rad], "joint_velocity" [rad/s],
            "joint_acceleration" (of the last ticks, where joints carry algorithmic mass), "joint_reference"
            [rad], "wrench" (force and torque on the flange, centre and inertia of the soft robot), "shape"
            (of the section model's frames, or of the film's motions, and their rates), and "film" [m], all
            coordinates of the film's nodes.
        step_s: time from x to x+ [s], a tick.
        integrator: of the soft robot's steps.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parts: dict[str, Array]
    step_s: float
    integrator: str

    def held(self, ticks: int = 1, inputs: Sequence[str] | None = None) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of some inputs that are held for so many ticks, as by a controller.

        Args:
            ticks: from x to x+, such as a controller's period over the clock's tick.
            inputs: names; all unless given. The state is that of `driven_by(inputs)`.

        Raises:
            InputError: there is no such input.
        """
        model = self if inputs is None else self.driven_by(inputs)
        a, b = np.eye(len(model.a)), np.zeros_like(model.b)
        for _ in range(ticks):
            a, b = model.a @ a, model.a @ b + model.b
        return a, b, model.c, model.d

    def driven_by(self, inputs: Sequence[str]) -> LinearModel:
        """Return the model with some inputs alone, and without references of joints that none of them moves.

        Args:
            inputs: names.

        Raises:
            InputError: there is no such input.
        """
        for name in inputs:
            if name not in self.inputs:
                raise InputError(f"no input {name!r} in the linear model; there are {', '.join(self.inputs)}")
        own = [self.inputs.index(name) for name in inputs]
        b, references = self.b[:, own], self.parts["joint_reference"]
        pushed = np.abs(references @ b).max(axis=1, initial=0.0)
        there = np.abs(references).max(axis=1, initial=0.0) > _MOVES
        still = references[there & (pushed <= _ROUNDING * np.abs(b).max(initial=1.0))]
        basis = np.eye(len(self.a))
        if len(still) and (np.count_nonzero(still, axis=1) == 1).all():
            basis = basis[:, ~still.any(axis=0)]
        elif len(still):
            from scipy.linalg import null_space  # here: it takes long to load

            basis = null_space(still)
        return replace(
            self, a=basis.T @ self.a @ basis, b=basis.T @ b, c=self.c @ basis, d=self.d[:, own],
            inputs=tuple(inputs), parts={name: part @ basis for name, part in self.parts.items()},
        )  # fmt: skip

    def poles(self) -> tuple[Array, Array]:
        """Return the poles (k,) [1/s] of continuous motion, slow ones first, with eigenvectors (n, k) of A.

        A pole's imaginary part is its angular frequency, minus its real part the decay. What the integrator
        adds to both is taken off: a step h multiplies a motion exp(l t) by z with l h = 1 - 1 / z (implicit
        Euler) or 3/2 - 2 / z + 1 / (2 z^2) (BDF2, whose second z for the same l is left out).
        """
        values, vectors = np.linalg.eig(self.a)
        poles = np.array([self._pole(value) for value in values.tolist()])
        order = np.argsort(np.abs(poles), kind="stable")[: np.isfinite(poles).sum()]
        return poles[order], vectors[:, order]

    def _pole(self, z: complex) -> complex:
        """Return the pole of an eigenvalue of A; infinite where it is none."""
        if abs(z) < _MOVES:
            return complex(np.inf)
        if self.integrator != "bdf2":
            return (1.0 - 1.0 / z) / self.step_s
        away = 1.5 - 2.0 / z + 0.5 / z**2
        return away / self.step_s if (z * (3.0 - 2.0 * away)).real > 2.0 else complex(np.inf)

    def slow(self, fastest_Hz: float) -> LinearModel:
        """Return the model of slow motions alone; fast ones then follow the inputs at once.

        Their share of the tip is in D. Its states have no meaning but by `parts`.

        Args:
            fastest_Hz: of the motions that are kept, abs(pole) / 2 pi.
        """
        # here: it takes long to load
        from scipy.linalg import schur, solve_sylvester

        bound = 2.0 * np.pi * fastest_Hz
        t, z, k = schur(self.a, sort=lambda re, im: abs(self._pole(complex(re, im))) <= bound)
        mixed = solve_sylvester(t[:k, :k], -t[k:, k:], t[:k, k:])
        slow, rest = z[:, :k], z[:, k:]
        fast = rest - slow @ mixed
        static = fast @ np.linalg.solve(np.eye(len(t) - k) - t[k:, k:], rest.T @ self.b)
        return replace(
            self, a=t[:k, :k], b=slow.T @ self.b + mixed @ (rest.T @ self.b), c=self.c @ slow,
            d=self.d + self.c @ static, parts={name: part @ slow for name, part in self.parts.items()},
        )  # fmt: skip

    def modes(self, count: int) -> tuple[Array, Array, Array]:
        """Return the slowest swings: frequencies (k,) [Hz], decays (k,) [1/s] and shapes (k, nodes, 3).

        A shape is complex: the film's nodes move along Re(shape exp(l t)), the largest component by 1.

        Args:
            count: k, at most so many.
        """
        poles, vectors = self.poles()
        swings = np.flatnonzero(poles.imag > 0.0)[:count]
        shapes = (self.parts["film"] @ vectors[:, swings]).T.reshape(len(swings), -1, 3)
        rows = shapes.reshape(len(swings), shapes.shape[1] * 3)
        largest = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
        return np.abs(poles[swings]) / (2.0 * np.pi), -poles[swings].real, shapes / largest[:, None, None]

    def write_modes(self, simulation: Simulation, path: str | Path, *, count: int = 4) -> None:
        """Write the slowest swings as moving shapes in a Rerun recording, each for 2 s.

        Args:
            simulation: that was linearised, where it was then.
            path: of the recording (.rrd); an old file is replaced.
            count: how many, at most.

        Raises:
            InputError: nothing swings.
            OutputError: the file cannot be written.
        """
        found = zip(*self.modes(count), strict=True)
        modes = {
            f"mode {k}: {f:.3g} Hz, decay {d:.2g}/s": shape for k, (f, d, shape) in enumerate(found, start=1)
        }
        if not modes:
            raise InputError(f"count = {count}: no mode swings; give 1 or more, or less damping")
        soft = stepped_run(simulation).soft
        _write_mode_shapes(Path(path), simulation.stage, simulation.snapshot, soft.body, modes)

    def __repr__(self) -> str:
        """Return its size and its slowest swings."""
        frequencies, decays, _ = self.modes(5)
        swings = ", ".join(f"{f:.3g} Hz (-{d:.3g}/s)" for f, d in zip(frequencies, decays, strict=True))
        return f"LinearModel of {len(self.a)} states, {', '.join(self.inputs)} -> tip; swings: {swings}"


def linearise(
    simulation: Simulation, *, motions: int = 40, inputs: Sequence[str] | None = None
) -> LinearModel:
    """Return the linear model of a simulation's next ticks, about where it is, as if it was at rest.

    Before its first tick, the model is that after one tick; the simulation stays where it is.

    The soft step of a tick is exact: tangent, mass and losses of the implicit step, losses along cables
    held. Of a film, it is that of its slowest natural modes, and of how it gives way to each load and lags
    behind the flange; faster motion follows at once. The rigid step is by central differences of MuJoCo's
    step. Contact is not part of it.

    Args:
        simulation: in mode "dynamic", fidelity "section", "lumped" or "refined", staggered exchange.
        motions: of a film, how many natural modes; with as many as free components nothing is left out.
        inputs: names of those to have, see `LinearModel.driven_by`; None: all.

    Raises:
        InputError: it is of another kind, or touches something; or there is no such input.
    """
    if simulation.snapshot.tick:
        found = _about(simulation, motions)
    else:
        here = simulation.save()
        try:
            simulation.step()
            found = _about(simulation, motions)
        finally:
            simulation.restore(here)
    return found if inputs is None else found.driven_by(inputs)


def _about(simulation: Simulation, motions: int) -> LinearModel:
    """Return the linear model about where a simulation is.

    Raises:
        InputError: see `linearise`.
    """
    run, scenario = stepped_run(simulation), simulation.scenario
    soft = run.soft if isinstance(run, DynamicSimulation) else None
    if motions < 1:
        raise InputError(f"motions = {motions}: a linear model needs 1 or more natural modes of the film")
    tick_s = scenario.clock.tick_s
    if isinstance(soft, beam_robot.BeamRobot):
        soft_step = soft.linear_step(tick_s)
    elif isinstance(soft, film_robot.FilmRobot):
        soft_step = soft.linear_step(tick_s, motions)
    else:
        raise InputError(
            "a linear model is of a film or section model in time: set mode = 'dynamic' and fidelity = "
            f"'lumped', 'refined' or 'section'; here are {scenario.mode!r} and {scenario.fidelity!r}"
        )
    carrier = run.carrier
    rigid, jacobian = carrier.linear_rigid_step(), carrier.flange_jacobian()
    chambers = [chamber.name for chamber in soft.body.gas_chambers]
    load_names = _load_names(scenario, soft_step, chambers)
    return _joined(scenario, soft_step, load_names, rigid, jacobian)


def _joined(
    scenario: Scenario, soft: LinearStep, load_names: list[str], rigid: Array, jacobian: Array
) -> LinearModel:
    """Return the tick of both sides: the rigid step first, the soft one with the flange's new pose.

    Args:
        scenario: of the run.
        soft: the soft step.
        load_names: of its loads.
        rigid: the arm's next state by its state, wrench, references and their rates.
        jacobian: (6, joints), of the flange.
    """
    tick_s, joints = scenario.clock.tick_s, jacobian.shape[1]
    sizes = (joints, joints, len(rigid) - 2 * joints, joints, FIGURES, soft.states)
    ends = np.cumsum((0, *sizes))
    names = (*_ARM, "joint_reference", "wrench", "shape")
    rates = _rates(jacobian)
    inputs = [*load_names, *(f"flange_twist.{axis}" for axis in _TWIST[: rates.shape[1]])]
    count, loads = int(ends[-1]), len(soft.loads)
    columns = np.eye(count + len(inputs))
    part = dict(zip(names, np.split(columns[:count], ends[1:-1]), strict=True))
    pace = rates @ columns[count + loads :]
    before = [part[name] for name in (*_ARM, "wrench", "joint_reference")]
    moved = rigid @ np.concatenate([*before, pace])
    flange = jacobian @ moved[:joints] if joints else np.zeros((6, columns.shape[1]))
    ended = soft.matrix @ np.concatenate([part["shape"], flange, columns[count : count + loads]])
    reference = part["joint_reference"] + tick_s * pace
    whole = np.concatenate([moved, reference, ended[soft.states :], ended[: soft.states]])
    size = soft.nodes.shape[2]
    parts = {name: rows[:, :count] for name, rows in part.items()}
    frames, d = parts["shape"][:size], np.zeros((3, len(inputs)))
    parts["film"], d[:, :loads] = soft.nodes.reshape(-1, size) @ frames, soft.tip[:, size:]
    return LinearModel(
        whole[:, :count], whole[:, count:], soft.tip[:, :size] @ frames, d, tuple(inputs),
        tuple(f"tip_position_m.{axis}" for axis in "xyz"), parts, tick_s, scenario.solver.integrator,
    )  # fmt: skip


def _rates(jacobian: Array) -> Array:
    """Return the joint speeds (joints, 6) by the flange's twist; (joints, 0) where it cannot have any."""
    try:
        return np.array([joint_rate(jacobian, twist) for twist in np.eye(6)]).T
    except InputError:
        return np.zeros((jacobian.shape[1], 0))


def _load_names(scenario: Scenario, soft: LinearStep, chambers: list[str]) -> list[str]:
    cables = scenario.soft_robot.cable_names()
    names = {"pressure_Pa": chambers if len(chambers) > 1 else [], "cable_tension_N": cables}
    return [f"{kind}.{names[kind][of]}" if names[kind] else kind for kind, of in soft.loads]


def _write_mode_shapes(
    path: Path, stage: RunInfo, here: Snapshot, body: SoftBody, modes: Mapping[str, Array]
) -> None:
    """Write a recording of modes; the largest motion of a node is 8 % of the film's size, and does not decay.

    Args:
        path: of the recording; an old file is replaced.
        stage: of the run that they are of.
        here: what they swing about.
        body: whose nodes they move.
        modes: shapes (n, 3), complex, the largest component by 1, by what they are called.

    Raises:
        OutputError: the file cannot be written.
    """
    from cosim.recording.rerun_recorder import RerunRecorder  # here: it takes long to load

    ticks = len(modes) * _FRAMES
    own = replace(
        stage, title=f"Natural modes: {stage.title}", tick_s=_FRAME_s, ticks=ticks,
        duration_s=ticks * _FRAME_s, phase_names=tuple(modes), tip_paths={}, energy=None, cameras=(),
    )  # fmt: skip
    recorder = RerunRecorder(path, frames_per_s=2.0 / _FRAME_s)  # every tick is a frame
    recorder.open(own)
    for batch in _swings(here, body, list(modes.values())):
        recorder.record(batch)
    recorder.close("\n".join(f"- {name}" for name in modes), "completed")


def _swings(here: Snapshot, body: SoftBody, shapes: list[Array]) -> Iterator[TickBatch]:
    """Yield the frames of each mode."""
    reader, rest = MeshReader(body, FilmPotential(body).gas.enclosed_volumes), np.array(here.node_position)
    swing = _SWING * float(np.ptp(rest, axis=0).max())
    turns = np.exp(4j * np.pi * np.arange(_FRAMES) / _FRAMES)
    still = replace(here.table, stability={}, branchings={}, overlaps={}, images={})
    frames = still.some(np.zeros(_FRAMES, np.int64)).changed(tip_target=np.full((_FRAMES, 3), np.nan))
    for k, shape in enumerate(shapes):
        films = [np.ascontiguousarray(rest + swing * (shape * turn).real) for turn in turns]
        tick = np.arange(k * _FRAMES, (k + 1) * _FRAMES)
        moved = frames.changed(tick=tick, time_s=tick * _FRAME_s, phase=np.full(_FRAMES, k))
        yield replace(moved, film=FilmShapes(reader, films))
