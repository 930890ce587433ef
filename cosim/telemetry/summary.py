"""The figures of a run, gathered tick by tick; `docs/summary.md` documents every key."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from cosim.base.state_check import check_state
from cosim.errors import InputError
from cosim.telemetry.closing import error_line, swing_lines, swing_warnings
from cosim.telemetry.figures import (
    ArmFigures,
    DeviceFigures,
    DeviceFiguresState,
    ExchangeFigures,
    TipPathFigures,
    arm_table,
    branching_lines,
    elastic_figures,
    footing_figures,
    joined_branchings,
    joined_overlaps,
    largest,
    overlap_lines,
    path_lines,
    resting,
    standing_lines,
    strength_warnings,
    undecided_warnings,
)
from cosim.telemetry.snapshot import RunErrors, RunInfo, Snapshot
from cosim.telemetry.tick_batch import TickBatch


def phase_row(phase: dict[str, Any]) -> str:
    """Return the Markdown line on a phase."""
    cells = (
        phase["name"] + ("" if phase["complete"] else " (incomplete)"),
        f"{phase['end_s']:.2f}",
        _scaled([entry["pressure_Pa"] for entry in phase["chambers"].values()], 1e-3),
        _scaled(phase["cable_tension_N"], 1.0),
        _scaled(phase["tip_position_m"], 1e3),
        _scaled(phase["sag_m"], 1e3),
        _scaled(phase["tip_error_m"], 1e3, 3) if "tip_error_m" in phase else "",
    )
    return "| " + " | ".join(cells) + " |"


def _scaled(value: Any, scale: float, digits: int = 1) -> str:
    if isinstance(value, list):
        return ", ".join(_scaled(item, scale, digits) for item in value)
    return "?" if value is None else f"{scale * value:.{digits}f}"


def summary_markdown(summary: dict[str, Any]) -> str:
    """Return the summary as a Markdown text for people."""
    factor = summary["real_time_factor"]
    lines = [
        f"## {summary['title']}",
        "",
        f"Status: **{summary['status']}**" + (f" ({summary['reason']})" if summary["reason"] else ""),
        "",
        f"- {summary['simulated_s']:.3f} s simulated in {summary['wall_s']:.2f} s"
        + (f", real-time factor {factor:.2f}" if factor is not None else ""),
        f"- {summary['ticks']} of {summary['planned_ticks']} ticks of {1e3 * summary['tick_s']:g} ms, "
        f"{summary['newton_iterations']} Newton iterations"
        + (f", {summary['slides']} slides to another branch of equilibria" if summary["slides"] else ""),
        f"- largest residual {_figure(summary['max_equilibrium_residual_N'])} N, "
        f"largest power error {_figure(summary['max_interface_power_error_W'])} W",
        "",
        *(f"- warning: {line}" for line in summary["warnings"]),
        *(f"- stability: {line}" for line in branching_lines(summary["branchings"])),
        *(f"- stability: {line}" for line in standing_lines(summary["phases"])),
        *(f"- natural frequencies: {line}" for line in swing_lines(summary["phases"])),
        *(f"- overlap: {line}" for line in overlap_lines(summary["overlaps"])),
        f"- error: {error_line(summary)}",
        *arm_table(summary["arm"]),
        "| phase | end [s] | pressure [kPa] | cables [N] | tip [mm] | sag [mm] | tip error [mm] |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = [phase_row(phase) for phase in summary["phases"]]
    return "\n".join(lines + rows + path_lines(summary["phases"])) + "\n"


def _figure(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.2e}"


SUMMARY_SCHEMA = 1
Status = Literal["completed", "interrupted", "failed"]

_LARGEST: Final = (
    "residual_N", "stability_ratio", "contact_force_N", "contact_depth_m", "self_contact_force_N",
    "self_contact_depth_m",
)  # fmt: skip
"""Of every tick: the largest of the run is kept."""

# of the builder; the rest is gathered
_GIVEN = {"_stage", "_startup_s", "_version", "_resumed_at_ticks", "_last", "_devices"}


@final
@dataclass(frozen=True)
class SummaryState:
    """The figures of a run so far.

    Args:
        last: snapshot seen.
        gathered: from all snapshots up to it, by name.
        devices: figures of the devices; None without any.
    """

    last: Snapshot
    gathered: dict[str, Any]
    devices: DeviceFiguresState | None

    @property
    def tick(self) -> int:
        """Tick up to which they count."""
        return self.last.tick


@final
class SummaryBuilder:
    """Gathers the figures of a run from its ticks and keeps only what the summary needs.

    Args:
        stage: of the run.
        startup_s: wall time from the start of the command to the first snapshot; of all parts of the run.
        version: of cosim.
        resumed_at_ticks: after which the run went on.
    """

    def __init__(
        self, stage: RunInfo, startup_s: float, version: str, resumed_at_ticks: tuple[int, ...] = ()
    ) -> None:
        self._stage = stage
        self._startup_s = startup_s
        self._version = version
        self._resumed_at_ticks = resumed_at_ticks
        self._phases: list[dict[str, Any]] = []
        self._last: Snapshot | None = None
        self._newton_iterations = 0
        self._slides = 0
        self._phase_iterations = 0
        self._max_residual_N = 0.0
        self._max_power_error_W = 0.0
        self._max_stability_ratio = 0.0
        self._exchange = ExchangeFigures()
        self._contact_since_s = math.nan
        self._max_contact_force_N = 0.0
        self._max_contact_depth_m = 0.0
        self._max_self_contact_force_N = 0.0
        self._max_self_contact_depth_m = 0.0
        self._self_contact_since_s: float | None = None
        self._arm = ArmFigures()
        self._energy = None if stage.energy is None else stage.energy.begin()
        self._tip_path = TipPathFigures()
        self._branchings: list[dict[str, Any]] = []
        self._overlaps: list[dict[str, Any]] = []
        self._devices = None if stage.devices is None else DeviceFigures(stage.devices)

    def observe(self, batch: TickBatch) -> None:
        """Take in ticks of one phase; they come in order, tick 0 first."""
        if self._last is not None and batch.phase[0] != self._last.phase:
            self._close_phase(complete=True)
        self._last = batch.snapshot(-1)
        if self._devices is not None:
            self._devices.observe(batch)
        iterations = int(batch.newton_iterations.sum())
        self._newton_iterations += iterations
        self._slides += int(batch.slides.sum())
        self._phase_iterations += iterations
        name = self._stage.phase_names[self._last.phase]
        for row, passed in batch.branchings.items():
            self._branchings = joined_branchings(self._branchings, name, batch.time_s.item(row), passed)
        for row, overlaps in batch.overlaps.items():
            self._overlaps = joined_overlaps(self._overlaps, name, batch.time_s.item(row), overlaps)
        if self._self_contact_since_s is None and batch.self_contacts.any():
            self._self_contact_since_s = batch.time_s.item(int(np.argmax(batch.self_contacts > 0)))
        self._exchange = self._exchange.after(batch)
        if self._energy is not None and self._stage.energy is not None:
            self._energy = self._energy.after(batch, self._stage.energy)
        path = self._stage.tip_paths.get(int(batch.phase[0]))
        if path is not None:
            self._tip_path = self._tip_path.after(batch, path)
        if self._stage.arm is not None:
            dynamic = self._stage.mode == "dynamic"
            self._arm = self._arm.after(batch, self._stage.arm.limits, dynamic=dynamic)
        if math.isnan(self._contact_since_s) and batch.contacts.any():
            self._contact_since_s = batch.time_s.item(int(np.argmax(batch.contacts > 0)))
        self._max_power_error_W = largest(self._max_power_error_W, np.abs(batch.power_error_W))
        for name in _LARGEST:
            here = f"_max_{name}"
            setattr(self, here, largest(getattr(self, here), getattr(batch, name)))

    def save_state(self) -> SummaryState:
        """Return the figures so far; there is a snapshot."""
        assert self._last is not None, "observe() comes before save_state()"
        gathered = {name: copy(value) for name, value in vars(self).items() if name not in _GIVEN}
        return SummaryState(self._last.kept(), gathered, self._devices and self._devices.save_state())

    def restore_state(self, state: SummaryState) -> None:
        """Go on from figures of `save_state`.

        Raises:
            InputError: they are not those of this run.
        """
        own = {name: value for name, value in vars(self).items() if name not in _GIVEN}
        if own.keys() != state.gathered.keys() or (self._devices is None) is not (state.devices is None):
            raise InputError(f"the saved figures are {', '.join(state.gathered)}")
        check_state(
            state.gathered,
            own | {"_phases": [], "_branchings": [], "_overlaps": []},
            place="figures",
            finite=False,
        )
        for phase in state.gathered["_phases"]:
            phase_row(json_ready(phase))
        self._last = state.last
        vars(self).update({name: copy(value) for name, value in state.gathered.items()})
        if self._devices is not None and state.devices is not None:
            self._devices.restore_state(state.devices)

    @property
    def newton_iterations(self) -> int:
        """Taken so far."""
        return self._newton_iterations

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
        if self._last is not None:
            self._close_phase(complete=status == "completed")
        errors = errors or RunErrors(reason="it was not asked for")
        stage, last = self._stage, self._last
        simulated_s = last.time_s if last is not None else 0.0
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
            "simulated_s": simulated_s,
            "real_time_factor": simulated_s / wall_s if wall_s > 0.0 else None,
            "ticks": last.tick if last is not None else 0,
            "planned_ticks": stage.ticks,
            "resumed_at_ticks": self._resumed_at_ticks,
            "newton_iterations": self._newton_iterations,
            "slides": self._slides,
            "max_equilibrium_residual_N": self._max_residual_N,
            "max_interface_power_error_W": self._max_power_error_W,
            "max_stability_ratio": self._max_stability_ratio,
            **self._exchange.summary(),
            "contact_since_s": self._contact_since_s,
            "max_contact_force_N": self._max_contact_force_N,
            "max_contact_depth_m": self._max_contact_depth_m,
            "max_self_contact_force_N": self._max_self_contact_force_N,
            "max_self_contact_depth_m": self._max_self_contact_depth_m,
            "self_contact_since_s": self._self_contact_since_s,
            "soft_weight_N": stage.soft_weight_N,
            "section_model": stage.section_model,
            "modelled": [vars(decision) for decision in stage.modelled],
            "expected_error": stage.expected_error,
            "error": {"reason": errors.reason, "iterations": errors.iterations, "wall_s": errors.wall_s},
            "branchings": self._branchings,
            "overlaps": self._overlaps,
            "arm": self._arm_section(),
            "warnings": self._warnings(),
            "phases": [row | {"error": errors.phases.get(k)} for k, row in enumerate(self._phases)],
        }
        return {key: json_ready(value) for key, value in summary.items()}

    def _arm_section(self) -> dict[str, Any] | None:
        planned = self._stage.arm
        if planned is None:
            return None
        run = self._arm.figures(planned.limits, self._stage.phase_names)
        return {"planned": planned.figures(), "run": run}

    def _warnings(self) -> list[str]:
        planned = self._stage.arm
        beyond = [*strength_warnings(self._phases), *undecided_warnings(self._branchings)]
        beyond += swing_warnings(self._phases)
        if planned is None:
            return beyond
        return [*planned.warnings(), *self._arm.warnings(planned.limits, self._stage.phase_names), *beyond]

    def _close_phase(self, *, complete: bool) -> None:
        if self._last is None:
            return
        name = self._stage.phase_names[self._last.phase]
        figures = _phase_figures(self._last, name, self._phase_iterations, complete)
        figures |= _chamber_figures(self._last, self._stage.chamber_names)
        self._branchings = resting(self._branchings, name, self._last.footing)
        own = [row for row in self._branchings if row["phase"] == name]
        figures["branchings"] = [*branching_lines(own), *undecided_warnings(own)]
        figures |= footing_figures(self._last.footing, own, self._stage.decay)
        figures |= elastic_figures(self._stage, self._last.node_position)
        parts, energy = self._stage.energy, self._energy
        figures["energy"] = None if parts is None or energy is None else energy.figures(parts)
        path = self._stage.tip_paths.get(self._last.phase)
        if path is not None:
            figures["tip_path"], self._tip_path = self._tip_path.figures(path), TipPathFigures()
        self._phases.append(
            figures if self._devices is None else figures | {"devices": self._devices.close_phase()}
        )
        self._phase_iterations = 0


def _phase_figures(last: Snapshot, name: str, newton_iterations: int, complete: bool) -> dict[str, Any]:
    wrench = last.ledger.wrench
    figures: dict[str, Any] = {
        "name": name,
        "complete": complete,
        "end_s": last.time_s,
        "newton_iterations": newton_iterations,
        "pressure_Pa": last.pressure_Pa,
        "volume_m3": last.volume_m3,
        "cable_tension_N": last.cable_tension_N,
        "joint_position_rad": last.joint_position,
        "flange_position_m": last.world_from_flange.translation,
        "flange_quaternion": last.world_from_flange.quaternion,
        "tip_position_m": last.tip_position,
        "tip_direction": last.tip_direction,
        "sag_m": last.sag_m,
        "length_m": last.film.center_line_m,
        "flange_wrench": {"force_N": wrench.force, "torque_Nm": wrench.torque},
    }
    if last.tip_target is not None:
        figures["tip_target_m"] = last.tip_target
        # components that the target leaves free are NaN
        figures["tip_error_m"] = float(np.sqrt(np.nansum((last.tip_position - last.tip_target) ** 2)))
    return figures


def _chamber_figures(last: Snapshot, names: tuple[str, ...]) -> dict[str, Any]:
    """Return pressure and volume of each chamber, by name."""
    pairs = zip(last.chamber_pressure_Pa, last.chamber_volume_m3, strict=True)
    figures = [{"pressure_Pa": pressure, "volume_m3": volume} for pressure, volume in pairs]
    return {"chambers": dict(zip(names, figures, strict=True))}


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
