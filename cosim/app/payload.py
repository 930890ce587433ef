"""The payload on the flange, held objects included, and how wrong a controller's torques are with it.

A soft robot's centre of mass moves as it inflates and bends. A controller with one fixed payload gives wrong
torques elsewhere: by Y (p_set - p), with Y of the arm's inverse dynamics and the payload's parameters p.
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
from cosim.results.exports import TOLD_EVERY_s
from cosim.results.result import RunResult
from cosim.telemetry.holding import HeldPart, held_parts

_FEWEST: Final = 4
_ROUNDING_s: Final = 1e-9
_MOST_OFF: Final = 0.5
"""Share of the parts' torque by which that of the wrench on the flange may differ in the mean over a run."""
_LEAST_OFF_Nm: Final = 0.1


def interpolated_rows(at: Array, time_s: Array, rows: Array, held: Sequence[HeldPart]) -> Array:
    """Return rows (n, k) of times (n,) at other times, without smearing what changes as objects are held."""
    edges = np.unique([edge for part in held for edge in (part.since_s, part.until_s)])
    here, there = (np.searchsorted(edges, times + _ROUNDING_s, side="right") for times in (time_s, at))
    found = np.empty((len(at), rows.shape[1]))
    for span in np.unique(there).tolist():
        own = here == span
        own = own if own.any() else np.arange(len(time_s)) == max(np.searchsorted(here, span) - 1, 0)
        columns = [np.interp(at[there == span], time_s[own], column) for column in rows[own].T]
        found[there == span] = np.column_stack(columns)
    return found


def payload_rows(result: RunResult, held: Sequence[HeldPart] | None = None) -> Array:
    """Return what hangs on the flange at every tick, as the columns of `PAYLOAD` (rows, 10).

    Of the soft robot, what is fixed next to it, and objects while they are held, as one rigid body, in the
    flange frame; inertia about the centre of mass. Sums are of m, m c and the inertia about the flange's
    origin, I + m (c.c 1 - c c^T).

    Args:
        result: of a run.
        held: when it held what; as the run did unless given.
    """
    turn = rotations_from_quaternions(result.flange_quaternion)
    center = np.einsum("nji,nj->ni", turn, result.soft_center - result.flange_position)
    inertia = np.einsum("nji,njk,nkl->nil", turn, result.soft_inertia, turn)
    mass = np.full(len(center), result.stage.soft_mass_kg)
    moment, about = mass[:, None] * center, inertia + mass[:, None, None] * _parallel(center)
    parts = held_parts(result.summary) if held is None else held
    for there, other, place, own in _others(result, turn, parts):
        mass, moment = mass + there * other, moment + np.outer(there, [other]) * place
        about = about + there[:, None, None] * (own + other * _parallel(place))
    center = moment / mass[:, None]
    inertia = about - mass[:, None, None] * _parallel(center)
    six = inertia[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return np.column_stack([mass, center, six])


def _others(
    result: RunResult, turn: Array, held: Sequence[HeldPart]
) -> Iterator[tuple[Array, float, Array, Array]]:
    """Yield what hangs on the flange next to the soft robot.

    Args:
        result: of a run.
        turn: (rows, 3, 3), world from flange.
        held: when it held what.

    Yields:
        When it is there (rows,), 1 or 0; mass; centre (rows, 3) and inertia (rows, 3, 3), flange frame.
    """
    rows, objects = len(turn), {entry.name: entry for entry in result.stage.objects}
    if result.stage.mounted:
        mass, center, inertia = _split(result.stage.mounted)
        yield np.ones(rows), mass, np.tile(center, (rows, 1)), np.tile(inertia, (rows, 1, 1))
    for part in held:
        entry = objects[part.name]
        mass, center, inertia = _split(entry.figures)
        axes = np.einsum(
            "nji,njk->nik", turn, rotations_from_quaternions(result.body_quaternion[:, entry.body])
        )
        origin = np.einsum("nji,nj->ni", turn, result.body_position[:, entry.body] - result.flange_position)
        there = part.at(result.time_s + _ROUNDING_s).astype(np.float64)
        yield there, mass, origin + axes @ center, np.einsum("nij,jk,nlk->nil", axes, inertia, axes)


def _split(figures: Sequence[float]) -> tuple[float, Array, Array]:
    """Return mass, centre (3,) and inertia (3, 3) of a row as of `PAYLOAD`."""
    mass, x, y, z, xx, yy, zz, xy, xz, yz = figures
    return mass, np.array([x, y, z]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _parallel(points: Array) -> Array:
    """Return (n, 3, 3): what a unit mass at points (n, 3) adds to the inertia."""
    squares = np.einsum("ni,ni->n", points, points)[:, None, None] * np.eye(3)
    return np.asarray(squares - np.einsum("ni,nj->nij", points, points))


@final
@dataclass(frozen=True, eq=False)
class PayloadTorque:
    """The torque by which a controller is wrong that thinks of the soft robot as a rigid payload.

    Args:
        time_s: (rows,) of the run.
        joint_names: base to flange.
        fixed: (10,), the one payload nearest in torque to that of each instant while nothing is held, as
            `PAYLOAD`.
        holding: the same for each time that objects are held: those objects, and the payload with them.
        bare: (rows,), whether nothing but held objects bears on what hangs on the flange; other rows count
            neither in the fits nor in the text, as no payload explains them.
        by_fixed: (rows, joints) [N m], wrong with these payloads, each at its time.
        by_schedule: (rows, joints) [N m], wrong with the payload of that instant, updated every 0.5 s and as
            objects are taken or let go.
    """

    time_s: Array
    joint_names: tuple[str, ...]
    fixed: Array
    holding: tuple[tuple[tuple[HeldPart, ...], Array], ...]
    bare: Mask
    by_fixed: Array
    by_schedule: Array

    def __repr__(self) -> str:
        """Return a line for each payload, then for both ways to set it the largest wrong torque."""
        lines = [_payload_text("empty", self.fixed)] if self.holding else []
        lines += [_payload_text(_held_text(parts), figures) for parts, figures in self.holding]
        each = "one payload, with what is held" if self.holding else "one payload"
        rows = {each: self.by_fixed, f"told every {TOLD_EVERY_s:g} s": self.by_schedule}
        lines += [f"{name}: {self._largest(wrong)}" for name, wrong in rows.items()]
        pressed_s = float(np.diff(self.time_s, append=self.time_s[-1]) @ ~self.bare)
        if pressed_s:
            lines.append(
                f"left out: {pressed_s:.3g} s in which it presses on something that it does not hold"
            )
        return "\n".join(lines)

    def _largest(self, wrong: Array) -> str:
        wrong = np.where(self.bare[:, None], wrong, 0.0)
        row, joint = np.unravel_index(int(np.argmax(np.abs(wrong))), wrong.shape)
        return (
            f"wrong by up to {abs(wrong[row, joint]):.3g} N m ({self.joint_names[joint]}, "
            f"{self.time_s[row]:.3g} s), root mean square {np.sqrt(np.mean(wrong[self.bare] ** 2)):.3g} N m"
        )


def _payload_text(name: str, figures: Array) -> str:
    place = ", ".join(f"{1e3 * value:.1f}" for value in figures[1:4].tolist())
    return f"{name}: {figures[0]:.3g} kg, centre ({place}) mm"


def _held_text(parts: Sequence[HeldPart]) -> str:
    names = ", ".join(f"'{part.name}' ({part.mass_kg:.3g} kg)" for part in parts)
    since_s, until_s = max(part.since_s for part in parts), min(part.until_s for part in parts)
    return f"with {names} from {since_s:.3g} s to {f'{until_s:.3g} s' if until_s < np.inf else 'the end'}"


def payload_torque(run: RunResult | str | Path) -> PayloadTorque:
    """Return how wrong the torque of a controller is that takes the soft robot for a rigid payload.

    With q of the run, Y p the torque of a payload p by inverse dynamics, and w the wrench on the flange of
    all that hangs there, a palm included: wrong = Y p_set + J^T w.

    Args:
        run: its result, or its directory; the arm is that of the scenario there.

    Raises:
        InputError: there is no such run, it has no files, no arm, or no time; or the wrench on the
            flange is far from that of what hangs there, with the centre of gravity that it would need.
    """
    from cosim.build.arms import placed_arm  # here: engines are loaded where they are needed
    from cosim.kinematics.arm import Arm

    result = run if isinstance(run, RunResult) else ended_run.load_run(run)
    if result.directory is None or result.stage.mode != "dynamic" or not result.stage.joint_names:
        raise InputError(f"{result.stage.scenario}: needs a run in time of an arm, with files (out=...)")
    scenario = load_scenario(result.directory / run_files.SCENARIO)
    arm = Arm(placed_arm(scenario.robot, scenario.arm_base), gravity=scenario.gravity_m_s2)
    q, speed = result.joint_position, result.joint_velocity
    pushing = np.gradient(speed, result.time_s, axis=0)
    _, by_payload = arm.torque_rows(q, speed, pushing, np.zeros(q.shape[1]))
    wrench = np.hstack([result.flange_force, result.flange_torque])
    true = -np.stack([arm.jacobian(row).T @ load for row, load in zip(q, wrench, strict=True)])
    figures, times, parts = payload_rows(result), result.time_s, held_parts(result.summary)
    told = np.arange(0.0, times[-1] + TOLD_EVERY_s, TOLD_EVERY_s)
    told = np.unique(
        [*told, *(edge for part in parts for edge in (part.since_s, part.until_s) if edge < times[-1])]
    )
    columns = interpolated_rows(times, told, interpolated_rows(told, times, figures, parts), parts)
    scheduled = np.stack([_parameters(row) for row in columns])
    there = np.array([part.at(times + _ROUNDING_s) for part in parts], dtype=bool)
    there = there.reshape(len(parts), len(times))
    bare = there.any(axis=0) | ((result.contacts == 0) & (result.palm_contacts == 0))
    by_parts = np.einsum("njk,nk->nj", by_payload, np.stack([_parameters(row) for row in figures]))
    if not any(phase.forces for phase in scenario.phases):  # dead loads are no part of the payload
        _check_borne(by_payload, (true, by_parts), figures, bare)
    fixed, wrong, holding = payload_rows(result, ()).mean(axis=0), np.empty_like(true), []
    codes = there.T @ 2 ** np.arange(len(parts))
    for code in np.unique(codes).tolist():
        rows, held = codes == code, [part for k, part in enumerate(parts) if int(code) >> k & 1]
        found = _best_fixed(by_payload[rows], by_parts[rows], figures[rows])
        wrong[rows] = by_payload[rows] @ _parameters(found) - true[rows]
        if held:
            holding.append((tuple(held), found))
        else:
            fixed = found
    return PayloadTorque(
        times,
        result.stage.joint_names,
        fixed,
        tuple(sorted(holding, key=lambda entry: max(part.since_s for part in entry[0]))),
        bare,
        wrong,
        np.einsum("njk,nk->nj", by_payload, scheduled) - true,
    )


def _best_fixed(by_payload: Array, torque: Array, figures: Array) -> Array:
    """Return the payload (10,) of mean mass and inertia whose centre makes the least wrong torque.

    Args:
        by_payload: (rows, joints, 10).
        torque: (rows, joints) [N m].
        figures: (rows, 10) of the parts.
    """
    from scipy.optimize import least_squares

    mass, center, inertia = np.split(figures.mean(axis=0), (1, 4))

    def wrong(place: Array) -> Array:
        payload = _parameters(np.concatenate([mass, place, inertia]))
        return np.ravel(by_payload @ payload - torque)

    return np.concatenate([mass, least_squares(wrong, center).x, inertia])


def _check_borne(by_payload: Array, torques: tuple[Array, Array], figures: Array, bare: Mask) -> None:
    """Check that what acts on the flange is borne by the parts that hang there, in the mean over a run.

    Args:
        by_payload: (rows, joints, 10).
        torques: (rows, joints) [N m], of the wrench on the flange and of the parts.
        figures: (rows, 10) of the parts.
        bare: (rows,), whether nothing else is known to bear on them.

    Raises:
        InputError: something else does.
    """
    true, by_parts = (torque[bare] for torque in torques)
    if len(true) < _FEWEST:
        return
    off, own = np.abs((true - by_parts).mean(axis=0)).max(), np.abs(by_parts).mean(axis=0).max()
    if off > max(_MOST_OFF * own, _LEAST_OFF_Nm):
        place = _best_fixed(by_payload[bare], true, figures[bare])[1:4]
        away = np.linalg.norm(place - figures[bare, 1:4].mean(axis=0))
        raise InputError(
            f"the wrench on the flange would put the payload's centre of gravity {1e3 * away:.0f} mm from "
            "that of the soft robot, its palm and held objects: something else bears on them that the run "
            "does not name; export a run in which they hang freely"
        )


def _parameters(figures: Array) -> Array:
    from cosim.kinematics.inertial_parameters import inertial_parameters

    mass, x, y, z, xx, yy, zz, xy, xz, yz = figures.tolist()
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return inertial_parameters(mass, np.array([x, y, z]), inertia)
