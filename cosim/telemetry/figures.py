"""Figures of a summary: of what is stretched, of tip paths, of the arm, of devices."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.plan import arm_limits, tip_errors
from cosim.soft.solve.branching import (
    IN_TIME,
    LEFT,
    UNDECIDED,
    WHOLE,
    Branching,
    FilmOverlap,
    StabilityReport,
)
from cosim.telemetry import run_info, tick_batch


def elastic_figures(run: run_info.RunInfo, positions: Array) -> dict[str, Any]:
    """Return the figures of a phase that ends with the film's nodes at positions (n, 3) [m]."""
    figures: dict[str, Any] = {}
    if run.hinge_energy_share is not None:
        figures["hinge_energy_share"] = run.hinge_energy_share(positions)
    strain = None if run.stiffener_strain is None else run.stiffener_strain(positions)
    if strain is not None:
        strength = strain.strength if strain.strength < math.inf else None
        figures["stiffener"] = {"peak_strain": strain.peak, "strength_strain": strength}
    return figures


def stack_length_m(run: run_info.RunInfo, length_m: float, positions: Array) -> float:
    """Return the length of a stack whose centre line is so long: in a pack, that of its frames.

    Args:
        run: of which run.
        length_m: of the centre line.
        positions: (n, 3) [m], of the film's nodes.
    """
    return length_m if run.frames_length is None else max(length_m, run.frames_length(positions))


@final
@dataclass(frozen=True)
class TipPathFigures:
    """Errors of the ticks of one phase so far, as the path is passed.

    Args:
        ticks: seen.
        sum_m: of their distances.
        largest_m: distance.
        at_m: of path, there.
        largest_rad: angle.
    """

    ticks: int = 0
    sum_m: float = 0.0
    largest_m: float = 0.0
    at_m: float = 0.0
    largest_rad: float = 0.0

    def after(self, batch: tick_batch.TickBatch, path: tip_errors.TipPathInfo) -> "TipPathFigures":
        """Return the figures with some ticks more, all of the path's phase."""
        rows = np.flatnonzero(path.passes(batch.time_s))
        if not len(rows):
            return self
        wanted = path.at(batch.time_s[rows])
        away, turned = tip_errors.tip_distances(wanted, batch.tip_position[rows], batch.tip_direction[rows])
        place = int(np.argmax(away))
        farther = not away[place] <= self.largest_m  # what is not a number is told as well
        return TipPathFigures(
            self.ticks + len(rows),
            self.sum_m + float(away.sum()),
            float(away[place]) if farther else self.largest_m,
            float(wanted.along_m[place]) if farther else self.at_m,
            max(self.largest_rad, float(turned.max())),
        )

    def figures(self, path: tip_errors.TipPathInfo) -> dict[str, Any]:
        """Return them for the summary, beside what was planned."""
        planned = path.planned
        mean_m = self.sum_m / self.ticks if self.ticks else 0.0
        found = tip_errors.TipErrors(self.largest_m, mean_m, self.at_m, self.largest_rad)
        return {
            "length_m": planned.course.length_m,
            "speed_m_s": planned.course.speed_m_s,
            **found.figures(),
            "planned": planned.compensated.figures(),
            "uncompensated": planned.uncompensated and planned.uncompensated.figures(),
        }


def path_lines(phases: list[dict[str, Any]]) -> list[str]:
    """Return the Markdown lines on the phases that follow a path; none without one."""
    rows = [(phase["name"], phase["tip_path"]) for phase in phases if "tip_path" in phase]
    if not rows:
        return []
    head = "| tip path | length [mm] | speed [mm/s] | of | largest error [mm] | mean [mm] | angle [deg] |"
    lines = ["", head, "|---|---|---|---|---|---|---|"]
    for name, path in rows:
        for of, found in (
            ("run", path),
            ("planned", path["planned"]),
            ("uncompensated", path["uncompensated"]),
        ):
            lines.append("| " + " | ".join((*_begin(name, path), of, *_cells(found))) + " |")
    return lines


def _begin(name: str, path: dict[str, Any]) -> tuple[str, str, str]:
    return name, f"{1e3 * path['length_m']:.1f}", f"{1e3 * path['speed_m_s']:g}"


def _cells(found: dict[str, Any] | None) -> tuple[str, ...]:
    if found is None:
        return ("no equilibria", "", "")
    scaled = (
        (found["largest_error_m"], 1e3),
        (found["mean_error_m"], 1e3),
        (found["largest_angle_rad"], 180.0 / np.pi),
    )
    return tuple("?" if value is None else f"{scale * value:.3f}" for value, scale in scaled)


_SATURATED: Final = 1.0 - 1e-9
"""Share of a joint's torque above which its servo has no more to give."""


@final
@dataclass(frozen=True)
class LastRow:
    """What the next row is compared with.

    Args:
        time_s: simulated.
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
    """

    time_s: float
    position: Annotated[Array, ("joints",)]
    velocity: Annotated[Array, ("joints",)]


@final
@dataclass(frozen=True)
class ArmFigures:
    """Figures of the ticks so far.

    Args:
        extremes: by quantity.
        saturated_s: (joints,), how long each servo gave all it can; (0,) before the first tick.
        touches: of links.
        last: row seen.
    """

    extremes: dict[str, arm_limits.Extreme] = field(default_factory=dict)
    saturated_s: Annotated[Array, ("*",)] = field(default_factory=lambda: np.zeros(0))
    touches: tuple[arm_limits.Touch, ...] = ()
    last: LastRow | None = None

    def after(
        self, batch: tick_batch.TickBatch, limits: arm_limits.ArmLimits, *, dynamic: bool
    ) -> "ArmFigures":
        """Return the figures with some ticks more.

        The servos act on the error at the start of a tick: there the reference is compared with the joints.

        Args:
            batch: the ticks.
            limits: of the arm.
            dynamic: whether the mode is.
        """
        time_s, q, v, torque = batch.time_s, batch.joint_position, batch.joint_velocity, batch.joint_torque
        last = self.last or LastRow(float(time_s[0]), q[0], v[0])
        values = {"position": q, "torque": torque, "tracking_error": q - batch.joint_target}
        span_s = np.diff(time_s, prepend=last.time_s)
        if dynamic:
            values["velocity"] = v
            gone = np.where(span_s > 0.0, span_s, np.inf)[:, None]
            values["acceleration"] = np.diff(v, axis=0, prepend=last.velocity[None]) / gone
            values["tracking_error"] = np.concatenate([last.position[None], q[:-1]]) - batch.joint_target
        extremes = dict(self.extremes)
        for name, rows in values.items():
            found = limits.extreme(name, rows, time_s, batch.phase, extremes.get(name))
            if found is not None:
                extremes[name] = found
        saturated_s = np.zeros(len(limits.joint_names))
        if "torque" in extremes and extremes["torque"].excess >= _SATURATED - 1.0:
            saturated_s = span_s @ (np.abs(torque) >= _SATURATED * limits.torque)
        touches = self.touches
        for row, contacts in batch.link_contacts.items():
            touches = arm_limits.with_touches(touches, contacts, float(time_s[row]), int(batch.phase[row]))
        return ArmFigures(
            extremes, saturated_s + (self.saturated_s if len(self.saturated_s) else 0.0), touches,
            LastRow(float(time_s[-1]), q[-1].copy(), v[-1].copy()),
        )  # fmt: skip

    def figures(self, limits: arm_limits.ArmLimits, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return them for the summary."""
        found = {name: extreme.figures(phase_names) for name, extreme in self.extremes.items()}
        return {
            **{name: found.get(name) for name in arm_limits.UNITS},
            "saturated_s": dict(zip(limits.joint_names, self.saturated_s.tolist(), strict=False)),
            "contacts": [touch.figures(phase_names) for touch in self.touches],
        }

    def warnings(self, limits: arm_limits.ArmLimits, phase_names: tuple[str, ...]) -> list[str]:
        """Return one line for whatever went beyond its bound, and for each contact; what is worst first."""
        error = self.extremes.get("tracking_error")
        beyond = [extreme for extreme in self.extremes.values() if extreme.beyond and extreme is not error]
        lines = [extreme.text(phase_names) for extreme in beyond]
        full = np.flatnonzero(self.saturated_s)
        names, given = limits.joint_names, limits.torque
        units = np.where(limits.prismatic, "N", "N m")
        spent = ", ".join(
            f"{names[k]} gave all of its {given[k]:g} {units[k]} for {self.saturated_s[k]:.3f} s"
            for k in full
        )
        if error is not None and error.beyond:
            collapsed = f"the arm did not hold: {spent}; " if spent else "the arm did not follow its plan: "
            lines.insert(0, collapsed + error.text(phase_names))
        elif spent:
            lines.insert(0, spent)
        return lines + [touch.text(phase_names) for touch in self.touches]


def arm_table(arm: dict[str, Any] | None) -> list[str]:
    """Return the Markdown lines of a summary's section on the arm; none without one."""
    if arm is None:
        return []
    lines = ["", "| arm | of | joint | value | bound | at [s] | phase |", "|---|---|---|---|---|---|---|"]
    for of, found in arm.items():
        for name in arm_limits.UNITS:
            extreme = found.get(name)
            if extreme is None:
                continue
            value, bound = ("none" if x is None else f"{x:.4g}" for x in (extreme["value"], extreme["bound"]))
            cells = (
                f"{name.replace('_', ' ')} [{extreme['unit']}]", of, extreme["joint"], value, bound,
                f"{extreme['time_s']:.2f}", extreme["phase"],
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]


SETTLED_SHARE: Final = 0.05
"""Of the step from the first value to the setpoint, within which a controlled quantity counts as settled."""


@final
@dataclass(frozen=True)
class DeviceFigures:
    """The devices in the ticks of a phase so far.

    Args:
        last: report seen.
        time_s: of the ticks.
        measured: by each controller, by its name.
        setpoint: of each controller.
    """

    last: ActuationReport | None = None
    time_s: tuple[float, ...] = ()
    measured: dict[str, tuple[float, ...]] = field(default_factory=dict)
    setpoint: dict[str, float] = field(default_factory=dict)

    def after(self, batch: tick_batch.TickBatch) -> "DeviceFigures":
        """Return the same with further ticks, which come in order."""
        measured = {name: list(values) for name, values in self.measured.items()}
        setpoint = dict(self.setpoint)
        for report in batch.devices:
            for control in () if report is None else report.controls:
                if control.measured is not None and control.setpoint is not None:
                    setpoint[control.name] = control.setpoint
                    measured.setdefault(control.name, []).append(control.measured)
        kept = {name: tuple(values) for name, values in measured.items()}
        return DeviceFigures(batch.devices[-1], (*self.time_s, *batch.time_s.tolist()), kept, setpoint)

    def figures(self, names: DeviceNames) -> dict[str, Any]:
        """Return the figures of the phase that ends."""
        devices = self.last
        if devices is None:
            return {}
        figures: dict[str, Any] = {
            "cable_length_m": devices.cable_length_m,
            "cable_unstretched_m": devices.unstretched_m,
            "cable_off_drum_m": devices.off_drum_m,
            "bending_angle_rad": devices.bending_angle_rad,
        }
        if names.winches:
            figures["lost_steps"] = devices.lost_steps
        if devices.pumps:
            figures["pumps"] = dict(zip(names.pumps, map(asdict, devices.pumps), strict=True))
        if self.measured:
            time_s = np.array(self.time_s)
            figures["controllers"] = {
                name: control_figures(time_s[-len(values) :], np.array(values), self.setpoint[name])
                for name, values in self.measured.items()
            }
        return figures


def control_figures(time_s: Array, measured: Array, setpoint: float) -> dict[str, Any]:
    """Return how well a quantity was brought to its setpoint.

    Args:
        time_s: (samples,), the first one right after the phase began.
        measured: (samples,), in the unit of the setpoint.
        setpoint: constant.

    Returns:
        setpoint; measured, the last value; overshoot, how far beyond the setpoint it went, seen from the
        first value; settling_time_s, after which it stayed within a twentieth of the step, None where that is
        not before the last tenth of the time; ripple, half the range in the last third of the time.
    """
    step = setpoint - float(measured[0])
    beyond = float(np.max((measured - setpoint) * np.sign(step)))
    outside = np.flatnonzero(np.abs(measured - setpoint) > SETTLED_SHARE * abs(step))
    last = int(outside[-1]) if len(outside) else 0
    settled = None if last >= 0.9 * len(measured) else float(time_s[last] - time_s[0])
    end = measured[2 * len(measured) // 3 :]
    return {
        "setpoint": setpoint,
        "measured": float(measured[-1]),
        "overshoot": max(beyond, 0.0),
        "settling_time_s": settled,
        "ripple": 0.5 * float(np.ptp(end)),
    }


_ALIKE_m: Final = 1e-3
_ONE_WAY: Final = 0.8  # cosine of the angle between two directions


def joined_branchings(
    found: list[dict[str, Any]], phase: str, time_s: float, more: Sequence[Branching]
) -> list[dict[str, Any]]:
    """Return the branchings of a run so far; looks in a phase in time that see one direction are one.

    Args:
        found: before.
        phase: name of the phase of the tick that follows.
        time_s: of its end.
        more: that it has met.
    """
    joined = list(found)
    for each in more:
        row: dict[str, Any] = {"phase": phase, "time_s": time_s, "until_s": time_s} | vars(each)
        seen = [k for k, before in enumerate(joined) if before["phase"] == phase and _one_way(before, row)]
        if seen:
            stays = UNDECIDED in (row["chosen"], joined[seen[0]]["chosen"])
            joined[seen[0]] = joined[seen[0]] | {"until_s": time_s, "chosen": UNDECIDED if stays else LEFT}
        else:
            joined.append(row)
    return joined


def _one_way(one: dict[str, Any], other: dict[str, Any]) -> bool:
    along = sum(a * b for a, b in zip(one["direction"], other["direction"], strict=True))
    return one["chosen"] in IN_TIME and other["chosen"] in IN_TIME and abs(along) > _ONE_WAY


def joined_overlaps(
    found: list[dict[str, Any]], phase: str, time_s: float, overlaps: Sequence[FilmOverlap]
) -> list[dict[str, Any]]:
    """Return the overlaps of a run so far: the deepest of each phase and link, and since when there is one.

    Args:
        found: before.
        phase: name of the phase.
        time_s: of the look.
        overlaps: that were found then.
    """
    joined = list(found)
    for overlap in overlaps:
        what = phase, overlap.link, overlap.arm
        here = [k for k, row in enumerate(joined) if (row["phase"], row["link"], row["arm"]) == what]
        row = {"phase": phase, "since_s": time_s, "time_s": time_s} | vars(overlap)
        if not here:
            joined.append(row)
        elif overlap.depth_m > joined[here[0]]["depth_m"]:
            joined[here[0]] = row | {"since_s": joined[here[0]]["since_s"]}
    return joined


def overlap_lines(overlaps: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on how deep films have passed through one another, and one on each link or arm.

    Args:
        overlaps: of the summary.
    """
    lines = []
    for link, arm in dict.fromkeys(map(_passed, overlaps)):
        rows = [row for row in overlaps if _passed(row) == (link, arm)]
        deepest = max(rows, key=lambda row: float(row["depth_m"]))
        what, most, remedy = f"the film is in link '{link}' of the arm", "up to", ""
        if arm is not None:
            what, most = f"the film passes through that of arm '{arm}'", "at least"
            remedy = "; films of different arms do not touch: keep them apart"
        elif link is None:
            what = "films pass through one another"
            remedy = '; with contact.self_contact = "auto" they press on one another'
        lines.append(
            f"{what} from {rows[0]['since_s']:.4g} s on, by {most} {1e3 * deepest['depth_m']:.2g} mm "
            f"at {deepest['time_s']:.4g} s (phase '{deepest['phase']}', {deepest['place']}){remedy}"
        )
    return lines


def _passed(row: Mapping[str, Any]) -> tuple[str | None, str | None]:
    """Return which link and which arm's film a film is in; older runs know of neither."""
    return row.get("link"), row.get("arm")


def overlap_warnings(overlaps: list[dict[str, Any]]) -> list[str]:
    """Return a warning for each arm whose film a film has passed through; see `overlap_lines`."""
    return overlap_lines([row for row in overlaps if row.get("arm") is not None])


_OF_FOOTING: Final = (
    "stability", "lowest_frequency_Hz", "disturbed_tip_m", "load_margin", "losses_held"
)  # fmt: skip


def footing_figures(
    footing: StabilityReport | None, branchings: list[dict[str, Any]], decay: run_info.Decay | None = None
) -> dict[str, Any]:
    """Return how firmly the soft robot stands at the end of a phase; nothing is known where it is None.

    Args:
        footing: there.
        branchings: of the phase.
        decay: of the run, see `RunInfo`.
    """
    if footing is None:
        return {**dict.fromkeys(_OF_FOOTING), "modes": []}
    return {
        "stability": footing.stability([(row["extent"], row["snap"]) for row in branchings]),
        **{name: getattr(footing, name) for name in _OF_FOOTING[1:]},
        "modes": [
            _mode(frequency, decay, own)
            for frequency, own in zip_longest(footing.frequencies_Hz, footing.losses_per_s, fillvalue=0.0)
        ],
    }


def _mode(frequency_Hz: float, decay: run_info.Decay | None, own_per_s: float) -> dict[str, Any]:
    declared, numerical = (None, None) if decay is None else decay(frequency_Hz, own_per_s)
    return {
        "frequency_Hz": frequency_Hz, "declared_decay_per_s": declared, "numerical_decay_per_s": numerical,
    }  # fmt: skip


def resting(
    branchings: list[dict[str, Any]], phase: str, footing: StabilityReport | None
) -> list[dict[str, Any]]:
    """Return branchings with where a phase, in which rounding decided on the side, comes to rest.

    Args:
        branchings: of the run so far.
        phase: name of the phase, at its end.
        footing: there.
    """
    tip = None if footing is None else footing.rests_at_m
    return [
        row | {"tip_m": tip} if row["phase"] == phase and row["chosen"] in IN_TIME else row
        for row in branchings
    ]


def undecided_warnings(branchings: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each unstable state in motion from which more than a wrinkle moves."""
    return [
        f"{_whereabouts(row)}; the run was there from {row['time_s']:.4g} to {row['until_s']:.4g} s, and "
        f"{row['chosen']}{_rest_of(row)}"
        for row in branchings
        if row["chosen"] in IN_TIME and row["extent"] >= WHOLE
    ]


def target_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on how far the tip ends off its targets, the largest over the phases, if any.

    Args:
        phases: of the summary.
    """
    texts = []
    for key, scale, unit in (("tip_error_m", 1e3, "mm"), ("tip_angle_error_rad", 180.0 / math.pi, "degrees")):
        known = {phase["name"]: phase[key] for phase in phases if phase.get(key) is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            texts.append(f"{scale * known[worst]:.3g} {unit} (phase '{worst}')")
    return [f"tip off by {' and '.join(texts)}"] if texts else []


def branching_lines(branchings: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each large branching in statics, and one on those that move little.

    Args:
        branchings: of the summary.
    """
    small = [row for row in branchings if row["extent"] < WHOLE or _alike(row)]
    lines = [_branching_line(row) for row in branchings if row["chosen"] not in IN_TIME and row not in small]
    little = (
        f"{len(small)} branchings of wrinkles, or to sides that are alike: see branchings in summary.json"
    )
    return [*lines, little] if small else lines


def _alike(row: dict[str, Any]) -> bool:
    """Return whether both sides of a branching hardly differ, as of a stack that leans to any side."""
    sides = row["tip_m"], row["other_tip_m"]
    return not row["snap"] and None not in sides and math.dist(*sides) < _ALIKE_m


def _rest_of(row: dict[str, Any]) -> str:
    if row["tip_m"] is None:
        return ""
    rest = f"; held as it ends, it comes to rest with its tip at {_place(row['tip_m'])}"
    return f"{rest}, one of several places where it would stay"


def standing_lines(phases: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each phase at whose end little is needed to move the soft robot far.

    Args:
        phases: of the summary.
    """
    lines = []
    for row in phases:
        stability, margin, tip_m = (row[name] for name in ("stability", "load_margin", "disturbed_tip_m"))
        if stability == "unstable":
            lines.append(f"phase '{row['name']}' ends unstable")
        elif stability == "undetermined":
            lines.append(
                f"phase '{row['name']}' may end unstable: its loads have no potential, the symmetric part "
                "of its tangent, losses held, is not positive definite"
            )
        elif stability is not None and stability.startswith("near"):
            most = "" if margin is None else f", all loads changed by {100.0 * margin:+.2g} % would do"
            lines.append(
                f"phase '{row['name']}' ends {stability}: a millionth of its loads moves the tip by "
                f"{1e3 * tip_m:.2g} mm{most}"
            )
    return lines


def _branching_line(row: dict[str, Any]) -> str:
    line, other = _whereabouts(row), row["other_tip_m"]
    if row["snap"] and row["tip_m"] is not None:
        return f"{line}, the tip from {_place(other)} to {_place(row['tip_m'])}: {row['chosen']}"
    if row["tip_m"] is None:
        return f"{line}; {row['chosen']}"
    beside = "" if other is None else f"; on the other side it is at {_place(other)}"
    return f"{line}; tip at {_place(row['tip_m'])}: {row['chosen']}{beside}"


def _whereabouts(row: dict[str, Any]) -> str:
    pressures = "/".join(f"{1e-3 * value:.4g}" for value in row["pressure_Pa"]) or "0"
    tensions = "/".join(f"{value:.4g}" for value in row["cable_tension_N"])
    loads = f"{pressures} kPa" + (f", cables at {tensions} N" if any(row["cable_tension_N"]) else "")
    way = ", ".join(f"{round(value, 2) + 0.0:g}" for value in row["direction"])
    does, moves = "branches", f"gives way along ({way}) or against it"
    held = " (by the symmetric part of its tangent, with losses held)" if row["losses_held"] else ""
    if row["snap"]:
        does, moves = "snaps", f"moves along ({way})"
    return (
        f"phase '{row['phase']}' {does} at {loads} ({100.0 * row['load_factor']:.3g} % of its way): "
        f"{row['place']} {moves}{held}"
    )


def _place(position_m: Sequence[float]) -> str:
    return "(" + ", ".join(f"{1e3 * value:.1f}" for value in position_m) + ") mm"
