"""The payload on the flange, held objects included, and the error Y (p_set - p) of a controller's torques
with a fixed payload p_set, as the payload p changes while a soft robot moves (Y: inverse dynamics).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from cosim.app import ended_run, run_files
from cosim.base.frames import Array, Mask, rotations_from_quaternions
from cosim.config.loading import load_scenario
from cosim.errors import InputError
from cosim.results.result import RunResult
from cosim.results.urscript import UPDATE_EVERY_s
from cosim.telemetry.held_parts import HeldPart, held_parts

_LEAST_ROWS: Final = 4
_ROUNDING_s: Final = 1e-9
_MOST_OFF: Final = 0.5
"""Allowed mean difference of the wrench's torque from that of the payload's parts, over the latter."""
_LEAST_OFF_Nm: Final = 0.1


@final
@dataclass(frozen=True, eq=False)
class _FlangeBody:
    """A rigid body on the flange next to the soft robot.

    Args:
        present: (rows,), 1 while it is there, otherwise 0.
        mass: [kg].
        center: (rows, 3) [m], flange frame.
        inertia: (rows, 3, 3) [kg m^2] about that, flange axes.
    """

    present: Array
    mass: float
    center: Array
    inertia: Array


def interpolated_rows(at: Array, time_s: Array, rows: Array, held: Sequence[HeldPart]) -> Array:
    """Return rows (n, k) of times (n,) at other times, with steps where objects are grasped or released."""
    edges = np.unique([edge for part in held for edge in (part.since_s, part.until_s)])
    spans, spans_at = (np.searchsorted(edges, times + _ROUNDING_s, side="right") for times in (time_s, at))
    result = np.empty((len(at), rows.shape[1]))
    for span in np.unique(spans_at).tolist():
        used = spans == span
        used = used if used.any() else np.arange(len(time_s)) == max(np.searchsorted(spans, span) - 1, 0)
        columns = [np.interp(at[spans_at == span], time_s[used], column) for column in rows[used].T]
        result[spans_at == span] = np.column_stack(columns)
    return result


def payload_rows(result: RunResult, held: Sequence[HeldPart] | None = None) -> Array:
    """Return the payload on the flange at every tick, as the columns of `PAYLOAD` (rows, 10).

    The soft robot, bodies fixed next to it, and objects while they are held are taken as one rigid body, in
    the flange frame; inertia about the centre of mass. Sums are of m, m c and the inertia about the flange's
    origin, I + m (c.c 1 - c c^T).

    Args:
        result: of a run.
        held: held objects, with times; None: those of the run.
    """
    turn = rotations_from_quaternions(result.flange_quaternion)
    center = np.einsum("nji,nj->ni", turn, result.soft_center - result.flange_position)
    inertia = np.einsum("nji,njk,nkl->nil", turn, result.soft_inertia, turn)
    mass = np.full(len(center), result.stage.soft_mass_kg)
    moment, about = mass[:, None] * center, inertia + mass[:, None, None] * _parallel(center)
    parts = held_parts(result.summary) if held is None else held
    for part in _parts(result, turn, parts):
        mass = mass + part.present * part.mass
        moment = moment + np.outer(part.present, [part.mass]) * part.center
        own = part.inertia + part.mass * _parallel(part.center)
        about = about + part.present[:, None, None] * own
    center = moment / mass[:, None]
    inertia = about - mass[:, None, None] * _parallel(center)
    six = inertia[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return np.column_stack([mass, center, six])


def _parts(result: RunResult, turn: Array, held: Sequence[HeldPart]) -> Iterator[_FlangeBody]:
    """Yield the bodies on the flange next to the soft robot.

    Args:
        result: of a run.
        turn: (rows, 3, 3), world from flange.
        held: held objects, with times.
    """
    rows, objects = len(turn), {entry.name: entry for entry in result.stage.objects}
    if result.stage.mounted:
        mass, center, inertia = _split(result.stage.mounted)
        yield _FlangeBody(np.ones(rows), mass, np.tile(center, (rows, 1)), np.tile(inertia, (rows, 1, 1)))
    for part in held:
        entry = objects[part.name]
        mass, center, inertia = _split(entry.figures)
        axes = np.einsum(
            "nji,njk->nik", turn, rotations_from_quaternions(result.body_quaternion[:, entry.body])
        )
        origin = np.einsum("nji,nj->ni", turn, result.body_position[:, entry.body] - result.flange_position)
        present = part.at(result.time_s + _ROUNDING_s).astype(np.float64)
        turned = np.einsum("nij,jk,nlk->nil", axes, inertia, axes)
        yield _FlangeBody(present, mass, origin + axes @ center, turned)


def _split(figures: Sequence[float]) -> tuple[float, Array, Array]:
    """Return mass, centre (3,) and inertia (3, 3) of a row as of `PAYLOAD`."""
    mass, x, y, z, xx, yy, zz, xy, xz, yz = figures
    return mass, np.array([x, y, z]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _parallel(points: Array) -> Array:
    """Return the inertia (n, 3, 3) of a unit mass at points (n, 3) about the origin."""
    squares = np.einsum("ni,ni->n", points, points)[:, None, None] * np.eye(3)
    return np.asarray(squares - np.einsum("ni,nj->nij", points, points))


@final
@dataclass(frozen=True, eq=False)
class PayloadTorque:
    """Torque errors of a controller that treats the soft robot as a rigid payload.

    Args:
        time_s: (rows,) of the run.
        joint_names: base to flange.
        fixed: (10,), as `PAYLOAD`: the constant payload with the least torque error while nothing is held.
        holding: the same for each time that objects are held: those objects, and the payload with them.
        bare: (rows,), whether the payload touches held objects only; other rows are left out of fits and
            text, as no payload explains them.
        by_fixed: (rows, joints) [N m], errors with these payloads, each at its time.
        by_schedule: (rows, joints) [N m], errors with the present payload, updated every 0.5 s and when
            objects are grasped or released.
    """

    time_s: Array
    joint_names: tuple[str, ...]
    fixed: Array
    holding: tuple[tuple[tuple[HeldPart, ...], Array], ...]
    bare: Mask
    by_fixed: Array
    by_schedule: Array

    def __repr__(self) -> str:
        """Return a line for each payload, then the largest torque error of both ways to set it."""
        lines = [_payload_text("empty", self.fixed)] if self.holding else []
        lines += [_payload_text(_held_text(parts), figures) for parts, figures in self.holding]
        each = "one payload, with held objects" if self.holding else "one payload"
        rows = {each: self.by_fixed, f"updated every {UPDATE_EVERY_s:g} s": self.by_schedule}
        lines += [f"{name}: {self._largest(wrong)}" for name, wrong in rows.items()]
        pressed_s = float(np.diff(self.time_s, append=self.time_s[-1]) @ ~self.bare)
        if pressed_s:
            lines.append(f"left out: {pressed_s:.3g} s in which it presses on something that is not held")
        return "\n".join(lines)

    def _largest(self, wrong: Array) -> str:
        wrong = np.where(self.bare[:, None], wrong, 0.0)
        row, joint = np.unravel_index(int(np.argmax(np.abs(wrong))), wrong.shape)
        return (
            f"wrong by up to {abs(wrong[row, joint]):.3g} N m ({self.joint_names[joint]}, "
            f"{self.time_s[row]:.3g} s), root mean square {np.sqrt(np.mean(wrong[self.bare] ** 2)):.3g} N m"
        )


def _payload_text(name: str, figures: Array) -> str:
    center = ", ".join(f"{1e3 * value:.1f}" for value in figures[1:4].tolist())
    return f"{name}: {figures[0]:.3g} kg, centre ({center}) mm"


def _held_text(parts: Sequence[HeldPart]) -> str:
    names = ", ".join(f"'{part.name}' ({part.mass_kg:.3g} kg)" for part in parts)
    since_s, until_s = max(part.since_s for part in parts), min(part.until_s for part in parts)
    return f"with {names} from {since_s:.3g} s to {f'{until_s:.3g} s' if until_s < np.inf else 'the end'}"


def payload_torque(run: RunResult | str | Path) -> PayloadTorque:
    """Return the torque errors of a controller that treats the soft robot as a rigid payload.

    With q of the run, Y p the torque of a payload p by inverse dynamics, and w the wrench on the flange of
    everything on it, a palm included: error = Y p_set + J^T w.

    Args:
        run: its result, or its directory; the arm is that of the scenario there.

    Raises:
        InputError: there is no such run, it has no files or no arm, or is quasi-static; or the wrench on the
            flange differs much from that of the payload.
    """
    from cosim.build.arms import placed_arm  # here: wrong input is refused before engines are loaded
    from cosim.kinematics.arm import Arm

    result = run if isinstance(run, RunResult) else ended_run.load_run(run)
    if result.directory is None or result.stage.mode != "dynamic" or not result.stage.joint_names:
        raise InputError(f"{result.stage.scenario}: needs a dynamic run of an arm, with files (out=...)")
    scenario = load_scenario(result.directory / run_files.SCENARIO)
    arm = Arm(placed_arm(scenario.robot, scenario.arm_base), gravity=scenario.gravity_m_s2)
    q, speed = result.joint_position, result.joint_velocity
    acceleration = np.gradient(speed, result.time_s, axis=0)
    _, by_payload = arm.torque_rows(q, speed, acceleration, np.zeros(q.shape[1]))
    wrench = np.hstack([result.flange_force, result.flange_torque])
    true = -np.stack([arm.jacobian(row).T @ load for row, load in zip(q, wrench, strict=True)])
    figures, times, parts = payload_rows(result), result.time_s, held_parts(result.summary)
    updates = np.arange(0.0, times[-1] + UPDATE_EVERY_s, UPDATE_EVERY_s)
    updates = np.unique(
        [*updates, *(edge for part in parts for edge in (part.since_s, part.until_s) if edge < times[-1])]
    )
    columns = interpolated_rows(times, updates, interpolated_rows(updates, times, figures, parts), parts)
    scheduled = np.stack([_parameters(row) for row in columns])
    present = np.array([part.at(times + _ROUNDING_s) for part in parts], dtype=bool)
    present = present.reshape(len(parts), len(times))
    bare = present.any(axis=0) | ((result.contacts == 0) & (result.palm_contacts == 0))
    by_parts = np.einsum("njk,nk->nj", by_payload, np.stack([_parameters(row) for row in figures]))
    if not any(phase.forces for phase in scenario.phases):  # dead loads are not part of the payload
        _check_wrench(by_payload[bare], true[bare], by_parts[bare], figures[bare])
    fixed, errors, holding = payload_rows(result, ()).mean(axis=0), np.empty_like(true), []
    codes = present.T @ 2 ** np.arange(len(parts))
    for code in np.unique(codes).tolist():
        rows, held = codes == code, [part for k, part in enumerate(parts) if int(code) >> k & 1]
        best = _best_fixed(by_payload[rows], by_parts[rows], figures[rows])
        errors[rows] = by_payload[rows] @ _parameters(best) - true[rows]
        if held:
            holding.append((tuple(held), best))
        else:
            fixed = best
    return PayloadTorque(
        times,
        result.stage.joint_names,
        fixed,
        tuple(sorted(holding, key=lambda entry: max(part.since_s for part in entry[0]))),
        bare,
        errors,
        np.einsum("njk,nk->nj", by_payload, scheduled) - true,
    )


def _best_fixed(by_payload: Array, torque: Array, figures: Array) -> Array:
    """Return the payload (10,) of mean mass and inertia whose centre gives the least torque error.

    Args:
        by_payload: (rows, joints, 10).
        torque: (rows, joints) [N m].
        figures: (rows, 10) of the parts.
    """
    from scipy.optimize import least_squares

    mass, center, inertia = np.split(figures.mean(axis=0), (1, 4))

    def error(position: Array) -> Array:
        payload = _parameters(np.concatenate([mass, position, inertia]))
        return np.ravel(by_payload @ payload - torque)

    return np.concatenate([mass, least_squares(error, center).x, inertia])


def _check_wrench(by_payload: Array, by_wrench: Array, by_parts: Array, figures: Array) -> None:
    """Check that the wrench on the flange is that of the payload's parts, in the mean over a run.

    Args:
        by_payload: (rows, joints, 10).
        by_wrench: (rows, joints) [N m], torque of the wrench on the flange.
        by_parts: (rows, joints) [N m], torque of the parts.
        figures: (rows, 10) of the parts.

    Raises:
        InputError: it differs too much.
    """
    if len(by_wrench) < _LEAST_ROWS:
        return
    off, size = np.abs((by_wrench - by_parts).mean(axis=0)).max(), np.abs(by_parts).mean(axis=0).max()
    if off > max(_MOST_OFF * size, _LEAST_OFF_Nm):
        center = _best_fixed(by_payload, by_wrench, figures)[1:4]
        away = np.linalg.norm(center - figures[:, 1:4].mean(axis=0))
        raise InputError(
            f"the wrench on the flange would put the payload's centre of gravity {1e3 * away:.0f} mm from "
            "that of the soft robot, its palm and held objects: something else acts on them that the run "
            "does not name; export a run in which they hang freely"
        )


def _parameters(figures: Array) -> Array:
    from cosim.kinematics.inertial_parameters import inertial_parameters

    return inertial_parameters(*_split(figures.tolist()))
