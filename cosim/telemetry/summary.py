"""The figures of a run, gathered tick by tick, and its last lines; `docs/summary.md` documents every key."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from cosim.base.column import ends_of, figures_of
from cosim.base.columns import TickColumns
from cosim.base.state_checks import check_state
from cosim.errors import InputError
from cosim.plan.arm_limits import PLANNED
from cosim.telemetry import bounds, figures, holding, tick_batch, touched
from cosim.telemetry.energy_figures import EnergyFigures
from cosim.telemetry.figures import branching_lines, overlap_lines, standing_lines, undecided_warnings
from cosim.telemetry.phase_ends import PhaseEnds, PhaseEndsBuilder
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

_ITSELF: Final = "contact with itself"
_NAMED: Final = 3
"""Phases that a line names, the rest are counted."""
_WIDTH: Final = len("stability: ")


def closing_lines(summary: dict[str, Any], directory: Path, recordings: Sequence[Path]) -> list[str]:
    """Return the lines that end a run on screen: six, one for tip targets, and each object.

    Args:
        summary: of the run.
        directory: that its files are in.
        recordings: those of the run, oldest first.
    """
    lines = [
        ("modelled", modelled_line(summary)),
        ("stability", stability_line(summary)),
        ("overlap", overlap_line(summary)),
        *(("target", text) for text in figures.target_lines(summary["phases"])),
        *(("object", text) for text in holding.object_lines(summary["objects"])),
        ("error", error_line(summary)),
        ("warnings", warnings_line(summary)),
        ("files", files_line(summary, directory, recordings)),
    ]
    return [f"{name + ':':<{_WIDTH}}{text}" for name, text in lines]


def quiet_line(summary: dict[str, Any], directory: Path) -> str:
    """Return the one line that ends a run where nothing else is shown."""
    found = [_counted(len(summary["warnings"]), "warning")]
    found += [_counted(len(summary["branchings"]), "branching")] if summary["branchings"] else []
    depth_m = max((row["depth_m"] for row in summary["overlaps"]), default=None)
    found += [] if depth_m is None else [f"films overlap by {1e3 * depth_m:.2g} mm"]
    return f"{summary['status']}, {', '.join(found)}: {directory}"


def modelled_line(summary: dict[str, Any]) -> str:
    """Return what was modelled, and what was left out."""
    rows = summary["modelled"]
    modelled, left = ([row["what"] for row in rows if row["included"] is kept] for kept in (True, False))
    return f"{', '.join(modelled) or 'nothing'}; left out: {', '.join(left) or 'nothing'}"


def stability_line(summary: dict[str, Any]) -> str:
    """Return where the soft robot was unstable, and how it was continued; else its lowest frequency."""
    rows = summary["branchings"]
    lines = [*branching_lines(rows), *undecided_warnings(rows), *standing_lines(summary["phases"])]
    if lines:
        more = f"; {len(lines) - 1} more: branchings in the summary" if len(lines) > 1 else ""
        return lines[0] + more
    known = [phase for phase in summary["phases"] if phase["lowest_frequency_Hz"] is not None]
    if not known:
        return "no unstable state was seen; no natural frequency is known"
    lowest = min(known, key=lambda phase: float(phase["lowest_frequency_Hz"]))
    frequency = f"{lowest['lowest_frequency_Hz']:.3g} Hz (phase '{lowest['name']}')"
    return f"no unstable state was seen; lowest natural frequency {frequency}"


def overlap_line(summary: dict[str, Any]) -> str:
    """Return whether films passed through one another, or how hard they press where that is modelled."""
    lines = overlap_lines(summary["overlaps"])
    if lines:
        return lines[0]
    force_N, depth_m = summary["max_self_contact_force_N"], summary["max_self_contact_depth_m"]
    if force_N:
        return f"none: films press on one another with up to {force_N:.3g} N, {1e3 * depth_m:.2g} mm deep"
    row = next((row for row in summary["modelled"] if row["what"] == _ITSELF), None)
    if row is None or (row["included"] and summary["section_model"] is None):
        return "none: films do not touch one another"
    return f"none was seen; {_ITSELF}: {row['reason']}"


def error_line(summary: dict[str, Any]) -> str:
    """Return how far each figure may be off, the largest over the phases; or why that is not known."""
    rows = [(phase["name"], phase["error"]) for phase in summary["phases"] if phase["error"] is not None]
    texts = []
    for key, (name, unit, scale) in bounds.BARS.items():
        known = {phase: scale * row[key] for phase, row in rows if row[key] is not None}
        if known:
            worst = max(known, key=lambda phase: known[phase])
            texts.append(f"{name} {known[worst]:.2g} {unit} ('{worst}')")
    without = dict[str, list[str]]()
    for phase, row in rows:
        if row["reason"]:
            without.setdefault(row["reason"], []).append(f"'{phase}'")
    more = [f"no bar in {_some(phases)}: {why}" for why, phases in without.items()]
    reason = summary["error"]["reason"]
    left = [reason if texts else f"not worked out: {reason}"] if reason else []
    return "; ".join([*([", ".join(texts)] if texts else []), *more, *left])


def warnings_line(summary: dict[str, Any]) -> str:
    """Return how many there are, and the first that has not been shown before the run."""
    texts = summary["warnings"]
    if not texts:
        return "none"
    first = next((text for text in texts if not text.startswith(PLANNED)), texts[0])
    return f"1: {first}" if len(texts) == 1 else f"{len(texts)}, all in the summary; {first}"


def files_line(summary: dict[str, Any], directory: Path, recordings: Sequence[Path]) -> str:
    """Return how the run ended, and what it left."""
    command_s, bars_s = summary["command_s"], summary["error"]["wall_s"]
    factor = summary["simulated_s"] / command_s if command_s > 0.0 else 0.0
    spent = [f"start {summary['startup_s']:.1f} s", f"ticks {summary['wall_s']:.1f} s"]
    spent += [f"error bars {bars_s:.1f} s"] if bars_s > 0.0 else []
    names = ["summary.json", *(path.name for path in recordings[-1:])]
    look = f"; open it: cosim view {directory}" if recordings else ""
    return (
        f"{directory}: {', '.join(names)}{look}; {summary['status']}, {summary['simulated_s']:.2f} s in "
        f"{command_s:.2f} s ({', '.join(spent)}; x{factor:.2f} real time)"
    )


def _some(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _counted(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s'[: count != 1]}"


def swing_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the first phase whose lowest mode cannot swing, as the integrator stops it.

    Within one period that takes nine tenths of its amplitude, and more than what is declared.

    Args:
        phases: of the summary.
    """
    for phase in phases:
        for mode in phase.get("modes", ())[:1]:
            frequency, numerical = mode["frequency_Hz"], mode["numerical_decay_per_s"] or 0.0
            if numerical > max(mode["declared_decay_per_s"] or 0.0, math.log(10.0) * frequency):
                return [
                    f"phase '{phase['name']}': the soft robot cannot swing at its lowest frequency, "
                    f"{frequency:.3g} Hz: ticks damp it by {numerical:.2g} per s; use solver.integrator = "
                    "'bdf2' or a shorter clock.tick_s"
                ]
    return []


def swing_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the natural modes of the phase with the lowest frequency; none are known: nothing.

    Args:
        phases: of the summary.
    """
    known = [phase for phase in phases if phase.get("modes")]
    if not known:
        return []
    phase = min(known, key=lambda phase: float(phase["modes"][0]["frequency_Hz"]))
    modes = phase["modes"]
    frequencies = ", ".join(f"{mode['frequency_Hz']:.3g}" for mode in modes)
    text = f"{frequencies} Hz (phase '{phase['name']}')"
    if modes[0]["declared_decay_per_s"] is None:
        return [text]
    declared, numerical = (
        ", ".join(f"{mode[key]:.2g}" for mode in modes)
        for key in ("declared_decay_per_s", "numerical_decay_per_s")
    )
    return [f"{text}; they decay at {declared} per s as declared, and by ticks at {numerical} more"]


def phase_cells(phase: dict[str, Any]) -> tuple[str, ...]:
    """Return a phase's row of the table for people: name, end, pressure, cables, tip, sag, tip error."""
    return (
        phase["name"] + ("" if phase["complete"] else " (incomplete)"),
        f"{phase['end_s']:.2f}",
        _scaled([entry["pressure_Pa"] for entry in phase["chambers"].values()], 1e-3),
        _scaled(phase["cable_tension_N"], 1.0),
        _scaled(phase["tip_position_m"], 1e3),
        _scaled(phase["sag_m"], 1e3),
        _scaled(phase["tip_error_m"], 1e3, 3) if "tip_error_m" in phase else "",
    )


def _scaled(value: Any, scale: float, digits: int = 1) -> str:
    if isinstance(value, list):
        return ", ".join(_scaled(item, scale, digits) for item in value)
    return "?" if value is None else f"{scale * value:.{digits}f}"


def summary_markdown(summary: dict[str, Any]) -> str:
    """Return the summary as a Markdown text for people."""
    lines = [
        f"## {summary['title']}",
        "",
        f"Status: **{summary['status']}**" + (f" ({summary['reason']})" if summary["reason"] else ""),
        "",
        f"- {summary['simulated_s']:.3f} s simulated in {summary['command_s']:.2f} s: start "
        f"{summary['startup_s']:.2f} s, ticks {summary['wall_s']:.2f} s, error bars "
        f"{summary['error']['wall_s']:.2f} s",
        f"- {summary['ticks']} of {summary['planned_ticks']} ticks of {1e3 * summary['tick_s']:g} ms, "
        f"{summary['newton_iterations']} Newton iterations"
        + (f", {summary['slides']} slides to another branch of equilibria" if summary["slides"] else ""),
        f"- largest residual {_figure(summary['max_equilibrium_residual_N'])} N, "
        f"largest power error {_figure(summary['max_interface_power_error_W'])} W",
        "",
        *(f"- warning: {line}" for line in summary["warnings"]),
        *(f"- stability: {line}" for line in figures.branching_lines(summary["branchings"])),
        *(f"- stability: {line}" for line in figures.standing_lines(summary["phases"])),
        *(f"- natural frequencies: {line}" for line in swing_lines(summary["phases"])),
        *(f"- overlap: {line}" for line in figures.overlap_lines(summary["overlaps"])),
        *(f"- contact: {line}" for line in touched.touched_lines(summary["touched"])),
        *(f"- target: {line}" for line in figures.target_lines(summary["phases"])),
        *(f"- object: {line}" for line in holding.object_lines(summary["objects"])),
        f"- error: {error_line(summary)}",
        *figures.arm_table(summary["arm"]),
        "| phase | end [s] | pressure [kPa] | cables [N] | tip [mm] | sag [mm] | tip error [mm] |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = [f"| {' | '.join(phase_cells(phase))} |" for phase in summary["phases"]]
    return "\n".join(lines + rows + figures.path_lines(summary["phases"])) + "\n"


def _figure(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.2e}"


SUMMARY_SCHEMA = 1
Status = Literal["completed", "interrupted", "failed"]


@final
@dataclass(frozen=True)
class SummaryState:
    """The figures of a run so far.

    Args:
        touched: of each body.
        energy: balance; None where the run has none.
        last: snapshot seen; None before the first.
        gathered: figures of the run, by name.
        arm: of its joints.
        tip_path: of the present phase.
        devices: of the present phase.
        objects: that can move.
        branchings: rows of the summary.
        overlaps: rows of the summary.
        shortest_m: least length of the soft robot at the end of a phase.
        began: when the present phase began [s], and how high the flange was then [m].
        missed: objects that were not lifted, in words.
        phases: rows of the summary.
        ends: of phases, for studies of the finished run.
    """

    touched: touched.TouchedFigures
    energy: EnergyFigures | None
    last: Snapshot | None = None
    gathered: dict[str, float] = field(
        default_factory=lambda: {figure.name: figure.initial for _, figure in figures_of(TickColumns)}
    )
    arm: figures.ArmFigures = field(default_factory=figures.ArmFigures)
    tip_path: figures.TipPathFigures = field(default_factory=figures.TipPathFigures)
    devices: figures.DeviceFigures = field(default_factory=figures.DeviceFigures)
    objects: holding.ObjectFigures = field(default_factory=holding.ObjectFigures)
    branchings: list[dict[str, Any]] = field(default_factory=list)
    overlaps: list[dict[str, Any]] = field(default_factory=list)
    shortest_m: float = math.inf
    began: tuple[float, float] = (0.0, 0.0)
    missed: list[str] = field(default_factory=list)
    phases: list[dict[str, Any]] = field(default_factory=list)
    ends: PhaseEnds = field(default_factory=PhaseEnds)

    @property
    def seen(self) -> Snapshot:
        """The last snapshot.

        Raises:
            InputError: none was seen.
        """
        if self.last is None:
            raise InputError("the saved figures are of no snapshot")
        return self.last

    @property
    def tick(self) -> int:
        """Tick up to which they count."""
        return self.seen.tick

    @property
    def newton_iterations(self) -> int:
        """Taken so far."""
        return int(self.gathered["newton_iterations"])


@final
class SummaryBuilder:
    """Gathers the figures of a run from its ticks and keeps only what the summary needs.

    Args:
        stage: of the run.
        startup_s: wall time from the start of the command to the first snapshot; of all parts of the run.
        version: of cosim.
        resumed_at_ticks: after which the run resumed.
    """

    def __init__(
        self, stage: RunInfo, startup_s: float, version: str, resumed_at_ticks: tuple[int, ...] = ()
    ) -> None:
        self._stage = stage
        self._startup_s = startup_s
        self._version = version
        self._resumed_at_ticks = resumed_at_ticks
        self._figures = tuple(figures_of(TickColumns))
        none = touched.TouchedFigures.none(len(stage.body_names))
        self._state = SummaryState(none, None if stage.energy is None else stage.energy.begin())
        self._ends = PhaseEndsBuilder(stage.ticks, moves=stage.energy is not None)

    @property
    def state(self) -> SummaryState:
        """The figures so far; those of another run are refused."""
        last = self._state.last
        shown = None if last is None else last.kept()
        return replace(self._state, last=shown, ends=self._ends.state)

    @state.setter
    def state(self, state: SummaryState) -> None:
        sizes = {"cables": len(self._stage.cables), "bodies": len(self._stage.body_names)}
        check_state(state, self._state, SummaryState, place="figures", sizes=sizes, finite=False)
        if state.gathered.keys() != self._state.gathered.keys():
            raise InputError(f"the saved figures are {', '.join(state.gathered)}")
        for phase in state.phases:
            phase_cells(json_ready(phase))
        self._state, self._ends.state = state, state.ends

    def observe(self, batch: tick_batch.TickBatch) -> tick_batch.TickBatch:
        """Take in ticks of one phase, in order, tick 0 first; return them with their energy balance."""
        state, stage = self._state, self._stage
        self._ends.observe(batch)
        if state.last is None:
            first = batch.snapshot(0)
            state = replace(state, shortest_m=first.center_line_m, began=(first.time_s, self._height(first)))
        elif batch.phase[0] != state.last.phase:
            self._close_phase(complete=True)
            state = replace(self._state, began=(state.last.time_s, self._height(state.last)))
        energy = state.energy
        if energy is not None and stage.energy is not None:
            energy, each = stage.energy.after(energy, batch, batch.pieces)
            batch = replace(batch, arrays={**batch.arrays, "energy_J": each})
        last, path = batch.snapshot(-1), stage.tip_paths.get(int(batch.phase[0]))
        branchings, overlaps = state.branchings, state.overlaps
        name, time_s = stage.phase_names[last.phase], batch.time_s.tolist()
        for row, passed in batch.branchings.items():
            branchings = figures.joined_branchings(branchings, name, time_s[row], passed)
        for row, found in batch.overlaps.items():
            overlaps = figures.joined_overlaps(overlaps, name, time_s[row], found)
        dynamic, arm = stage.mode == "dynamic", stage.arm
        self._state = replace(
            state,
            last=last,
            gathered={
                figure.name: figure.after(
                    state.gathered[figure.name], getattr(batch, column.name), batch.time_s
                )
                for column, figure in self._figures
            },
            touched=state.touched.after(batch, stage.tick_s) if dynamic else state.touched,
            devices=state.devices if stage.devices is None else state.devices.after(batch),
            objects=state.objects.after(batch, stage.objects) if stage.objects else state.objects,
            branchings=branchings,
            overlaps=overlaps,
            energy=energy,
            tip_path=state.tip_path if path is None else state.tip_path.after(batch, path),
            arm=state.arm if arm is None else state.arm.after(batch, arm.limits, dynamic=dynamic),
        )
        return batch

    def finish(
        self, status: Status, reason: str | None, wall_s: float, errors: RunErrors | None = None
    ) -> dict[str, Any]:
        """Return the summary, ready for JSON (numbers that are not finite become None).

        Args:
            status: how the run ended.
            reason: why it was interrupted or failed, else None.
            wall_s: wall time from the first snapshot to the end, of all parts of the run.
            errors: how far its figures may be off; None: that was not asked for.
        """
        if self._state.last is not None:
            self._close_phase(complete=status == "completed")
        errors = errors or RunErrors(reason="it was not asked for")
        stage, state, last = self._stage, self._state, self._state.last
        simulated_s = last.time_s if last is not None else 0.0
        phases = [row | {"error": errors.phases.get(k)} for k, row in enumerate(state.phases)]
        summary = {
            "schema": SUMMARY_SCHEMA,
            "cosim_version": self._version,
            "scenario": stage.scenario,
            "title": stage.title,
            "mode": stage.mode,
            "status": status,
            "reason": reason,
            "tick_s": stage.tick_s,
            "startup_s": self._startup_s,
            "wall_s": wall_s,
            "command_s": self._startup_s + wall_s + errors.wall_s,
            "simulated_s": simulated_s,
            "real_time_factor": simulated_s / wall_s if wall_s > 0.0 else None,
            "ticks": last.tick if last is not None else 0,
            "planned_ticks": stage.ticks,
            "resumed_at_ticks": self._resumed_at_ticks,
            **state.gathered,
            "touched": state.touched.figures(stage.body_names, stage.tick_s),
            "soft_weight_N": stage.soft_weight_N,
            "tip_measured_by": stage.tip_measured_by,
            "section_model": stage.section_model,
            "modelled": [vars(decision) for decision in stage.modelled],
            "expected_error": stage.expected_error,
            "error": {"reason": errors.reason, "iterations": errors.iterations, "wall_s": errors.wall_s},
            "branchings": state.branchings,
            "overlaps": state.overlaps,
            "objects": state.objects.figures(stage.objects),
            "arm": self._arm_section(),
            "warnings": [*self._warnings(), *bounds.bar_warnings(phases)],
            "phases": phases,
        }
        return {key: json_ready(value) for key, value in summary.items()}

    def _arm_section(self) -> dict[str, Any] | None:
        planned = self._stage.arm
        if planned is None:
            return None
        run = self._state.arm.figures(planned.limits, self._stage.phase_names)
        return {"planned": planned.figures(), "run": run}

    def _warnings(self) -> list[str]:
        planned, state = self._stage.arm, self._state
        beyond = [*bounds.strength_warnings(state.phases), *figures.undecided_warnings(state.branchings)]
        beyond += [*swing_warnings(state.phases), *bounds.section_warnings(self._stage.section_model)]
        beyond += bounds.eyelet_warnings(state.phases)
        beyond += touched.hit_warnings(state.touched.figures(self._stage.body_names, self._stage.tick_s))
        beyond += [*bounds.shape_warnings(state.phases), *figures.overlap_warnings(state.overlaps)]
        beyond = [*state.missed, *beyond]
        if planned is None:
            return beyond
        return [*planned.warnings(), *state.arm.warnings(planned.limits, self._stage.phase_names), *beyond]

    def _height(self, at: Snapshot) -> float:
        """Return how high the flange is, against gravity."""
        down = self._stage.gravity / max(float(np.linalg.norm(self._stage.gravity)), 1e-30)
        return -float(down @ at.world_from_flange.translation)

    def _close_phase(self, *, complete: bool) -> None:
        """Add the row of a phase that has ended."""
        state, stage, last = self._state, self._stage, self._state.last
        if last is None:
            return
        name, missed = stage.phase_names[last.phase], state.missed
        if complete and stage.grasps and stage.objects:
            lifted_m = self._height(last) - state.began[1]
            missed = [*missed, *state.objects.not_lifted(stage.objects, name, state.began[0], lifted_m)]
        branchings = figures.resting(state.branchings, name, last.footing)
        row = self._row(last, name, [each for each in branchings if each["phase"] == name], complete)
        parts, energy = stage.energy, state.energy
        row["energy"] = None if parts is None or energy is None else energy.figures(parts)
        path, tip_path, devices = stage.tip_paths.get(last.phase), state.tip_path, state.devices
        if path is not None:
            row["tip_path"], tip_path = tip_path.figures(path), figures.TipPathFigures()
        if stage.devices is not None:
            row["devices"], devices = devices.figures(stage.devices), figures.DeviceFigures()
        self._state = replace(
            state, missed=missed, branchings=branchings, shortest_m=min(state.shortest_m, row["length_m"]),
            tip_path=tip_path, devices=devices, phases=[*state.phases, row],
        )  # fmt: skip

    def _row(
        self, last: Snapshot, name: str, branchings: list[dict[str, Any]], complete: bool
    ) -> dict[str, Any]:
        """Return what a phase's last snapshot shows, with the branchings of that phase."""
        state, stage = self._state, self._stage
        iterations = state.newton_iterations - sum(phase["newton_iterations"] for phase in state.phases)
        row = _phase_figures(last, name, iterations, complete)
        row |= _chamber_figures(last, stage.chamber_names)
        row["branchings"] = [*figures.branching_lines(branchings), *figures.undecided_warnings(branchings)]
        row |= figures.footing_figures(last.footing, branchings, stage.decay)
        row |= figures.elastic_figures(stage, last.node_position)
        wanted = stage.tip_directions.get(last.phase)
        if wanted is not None:
            across = np.linalg.norm(np.cross(wanted, last.tip_direction))
            row["tip_angle_error_rad"] = float(np.arctan2(across, np.dot(wanted, last.tip_direction)))
        length_m = figures.stack_length_m(stage, row["length_m"], last.node_position)
        row["extension_ratio"] = None if stage.stored_m is None else length_m / stage.stored_m
        shortest_m = min(state.shortest_m, row["length_m"])
        row["pack_ratio"] = row["length_m"] / shortest_m if shortest_m > 0.0 else None
        return row


def _phase_figures(last: Snapshot, name: str, newton_iterations: int, complete: bool) -> dict[str, Any]:
    wrench = last.flange_wrench
    found: dict[str, Any] = {
        "name": name,
        "complete": complete,
        "newton_iterations": newton_iterations,
        **{figure.name: getattr(last, column.name) for column, figure in ends_of(TickColumns)},
        "flange_wrench": {"force_N": wrench.force, "torque_Nm": wrench.torque},
    }
    if last.tip_target is not None:
        found["tip_target_m"] = last.tip_target
        # components that the target leaves free are NaN
        found["tip_error_m"] = float(np.sqrt(np.nansum((last.tip_position - last.tip_target) ** 2)))
    return found


def _chamber_figures(last: Snapshot, names: tuple[str, ...]) -> dict[str, Any]:
    """Return pressure and volume of each chamber, by name."""
    pairs = zip(last.chamber_pressure_Pa, last.chamber_volume_m3, strict=True)
    found = [{"pressure_Pa": pressure, "volume_m3": volume} for pressure, volume in pairs]
    return {"chambers": dict(zip(names, found, strict=True))}


def reason_of(error: BaseException) -> str:
    """Return why a run failed, as the summary says it."""
    return f"{type(error).__name__}: {error}"


def json_ready(value: Any) -> Any:
    """Return a value of JSON's own kinds; numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_ready(value.tolist())
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
