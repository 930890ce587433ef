"""Gathers the figures of a run tick by tick; `docs/summary.md` documents every key of the summary."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, TypeAlias, final

import numpy as np

from cosim.base.column import figures_of
from cosim.base.columns import TickColumns
from cosim.base.state_checks import check_state
from cosim.errors import InputError
from cosim.telemetry.energy_figures import EnergyFigures
from cosim.telemetry.figures.arm_figures import ArmFigures
from cosim.telemetry.figures.device_figures import DeviceFigures
from cosim.telemetry.figures.holding import ObjectFigures
from cosim.telemetry.figures.overlap_figures import joined_overlaps, overlap_warnings
from cosim.telemetry.figures.phase_figures import (
    chamber_figures,
    elastic_figures,
    phase_figures,
    stack_length_m,
)
from cosim.telemetry.figures.stability_figures import joined_branchings, stability_figures, with_rest
from cosim.telemetry.figures.tip_path_figures import TipPathFigures
from cosim.telemetry.figures.touched import TouchedFigures, hit_warnings
from cosim.telemetry.longer_tick import longer_tick_s
from cosim.telemetry.phase_ends import PhaseEnds, PhaseEndsBuilder
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.texts.bar_lines import bar_warnings
from cosim.telemetry.texts.bound_warnings import (
    eyelet_warnings,
    section_warnings,
    shape_warnings,
    strength_warnings,
)
from cosim.telemetry.texts.mode_lines import swing_warnings
from cosim.telemetry.texts.stability_lines import branching_lines, undecided_warnings
from cosim.telemetry.texts.summary_tables import phase_cells
from cosim.telemetry.tick_batch import Snapshot, TickBatch

SUMMARY_SCHEMA: Final = 1
Status: TypeAlias = Literal["completed", "interrupted", "failed"]


@final
@dataclass(frozen=True)
class SummaryState:
    """The figures of a run so far.

    Args:
        touched: of each body.
        energy: balance; None for a run without one.
        last: last snapshot; None before the first.
        gathered: figures of the run, by name.
        arm: of its joints.
        tip_path: of the present phase.
        devices: of the present phase.
        objects: of movable objects.
        branchings: rows of the summary.
        overlaps: rows of the summary.
        shortest_m: least length of the soft robot at the end of a phase.
        begin_s: time at the start of the present phase.
        begin_height_m: height of the flange then, against gravity.
        missed: texts on objects that were not lifted.
        phases: rows of the summary.
        ends: of phases, for studies of the finished run.
    """

    touched: TouchedFigures
    energy: EnergyFigures | None
    last: Snapshot | None = None
    gathered: dict[str, float] = field(
        default_factory=lambda: {figure.name: figure.initial for _, figure in figures_of(TickColumns)}
    )
    arm: ArmFigures = field(default_factory=ArmFigures)
    tip_path: TipPathFigures = field(default_factory=TipPathFigures)
    devices: DeviceFigures = field(default_factory=DeviceFigures)
    objects: ObjectFigures = field(default_factory=ObjectFigures)
    branchings: list[dict[str, Any]] = field(default_factory=list)
    overlaps: list[dict[str, Any]] = field(default_factory=list)
    shortest_m: float = math.inf
    begin_s: float = 0.0
    begin_height_m: float = 0.0
    missed: list[str] = field(default_factory=list)
    phases: list[dict[str, Any]] = field(default_factory=list)
    ends: PhaseEnds = field(default_factory=PhaseEnds)

    @property
    def seen(self) -> Snapshot:
        """The last snapshot.

        Raises:
            InputError: there is none.
        """
        if self.last is None:
            raise InputError("the saved figures have no snapshot")
        return self.last

    @property
    def tick(self) -> int:
        """Last tick of the figures."""
        return self.seen.tick

    @property
    def newton_iterations(self) -> int:
        """Newton iterations so far."""
        return int(self.gathered["newton_iterations"])


@final
class SummaryBuilder:
    """Gathers the figures of a run from its ticks.

    Args:
        stage: of the run.
        startup_s: wall time from the start of the command to the first snapshot, of all parts of the run.
        version: of cosim.
        resumed_at_ticks: ticks after which the run resumed.
    """

    def __init__(
        self, stage: RunInfo, startup_s: float, version: str, resumed_at_ticks: tuple[int, ...] = ()
    ) -> None:
        self._stage = stage
        self._startup_s = startup_s
        self._version = version
        self._resumed_at_ticks = resumed_at_ticks
        self._figures = tuple(figures_of(TickColumns))
        none = TouchedFigures.none(len(stage.body_names))
        self._state = SummaryState(none, None if stage.energy is None else EnergyFigures())
        self._ends = PhaseEndsBuilder(moves=stage.energy is not None)

    @property
    def state(self) -> SummaryState:
        """The figures so far; figures that do not fit the run are refused."""
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

    def observe(self, batch: TickBatch) -> TickBatch:
        """Add ticks of one phase, in order, tick 0 first; return them with their energy balance."""
        state, stage = self._state, self._stage
        self._ends.observe(batch)
        if state.last is None:
            first = batch.snapshot(0)
            state = replace(_begun(state, first, self._height(first)), shortest_m=first.center_line_m)
        elif batch.phase[0] != state.last.phase:
            self._close_phase(complete=True)
            state = _begun(self._state, state.last, self._height(state.last))
        energy = state.energy
        if energy is not None and stage.energy is not None:
            energy, each = stage.energy.after(energy, batch, batch.substeps)
            batch = replace(batch, arrays={**batch.arrays, "energy_J": each})
        last, path = batch.snapshot(-1), stage.tip_paths.get(int(batch.phase[0]))
        branchings, overlaps = state.branchings, state.overlaps
        name, time_s = stage.phase_names[last.phase], batch.time_s.tolist()
        for row, passed in batch.branchings.items():
            branchings = joined_branchings(branchings, name, time_s[row], passed)
        for row, overlap in batch.overlaps.items():
            overlaps = joined_overlaps(overlaps, name, time_s[row], overlap)
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
        self,
        status: Status,
        reason: str | None,
        wall_s: float,
        errors: RunErrors | None = None,
        compiling_s: float = 0.0,
    ) -> dict[str, Any]:
        """Return the summary, ready for JSON (numbers that are not finite become None).

        Args:
            status: how the run ended.
            reason: why it was interrupted or failed; None for a completed run.
            wall_s: wall time from the first snapshot to the end, of all parts of the run.
            errors: error bars; None: not requested.
            compiling_s: wall time that kernels were compiled.
        """
        if self._state.last is not None:
            self._close_phase(complete=status == "completed")
        errors = errors or RunErrors(reason="not requested")
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
            "compiling_s": compiling_s,
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
            "error": {
                "reason": errors.reason,
                "iterations": errors.iterations,
                "wall_s": errors.wall_s,
                "longer_tick_s": longer_tick_s(phases, stage.tick_s, stage.lengths_s),
            },
            "branchings": state.branchings,
            "overlaps": state.overlaps,
            "objects": state.objects.figures(stage.objects),
            "arm": self._arm_section(),
            "warnings": [*self._warnings(), *bar_warnings(phases)],
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
        of_arm: list[str] = []
        if planned is not None:
            of_arm = [*planned.warnings(), *state.arm.warnings(planned.limits, self._stage.phase_names)]
        return [
            *self._stage.rounded,
            *of_arm,
            *state.missed,
            *strength_warnings(state.phases),
            *undecided_warnings(state.branchings),
            *swing_warnings(state.phases),
            *section_warnings(self._stage.section_model),
            *eyelet_warnings(state.phases),
            *hit_warnings(state.touched.figures(self._stage.body_names, self._stage.tick_s)),
            *shape_warnings(state.phases),
            *overlap_warnings(state.overlaps),
        ]

    def _height(self, snapshot: Snapshot) -> float:
        """Return the height of the flange, against gravity."""
        down = self._stage.gravity / max(float(np.linalg.norm(self._stage.gravity)), 1e-30)
        return -float(down @ snapshot.world_from_flange.translation)

    def _close_phase(self, *, complete: bool) -> None:
        """Add the row of a phase that has ended."""
        state, stage, last = self._state, self._stage, self._state.last
        if last is None:
            return
        name, missed = stage.phase_names[last.phase], state.missed
        if complete and stage.grasps and stage.objects:
            lifted_m = self._height(last) - state.begin_height_m
            missed = [*missed, *state.objects.not_lifted(stage.objects, name, state.begin_s, lifted_m)]
        branchings = with_rest(state.branchings, name, last.stability)
        row = self._row(last, name, [each for each in branchings if each["phase"] == name], complete)
        parts, energy = stage.energy, state.energy
        row["energy"] = None if parts is None or energy is None else energy.figures(parts.elastic)
        path, tip_path, devices = stage.tip_paths.get(last.phase), state.tip_path, state.devices
        if path is not None:
            row["tip_path"], tip_path = tip_path.figures(path), TipPathFigures()
        if stage.devices is not None:
            row["devices"], devices = devices.figures(stage.devices), DeviceFigures()
        self._state = replace(
            state, missed=missed, branchings=branchings, shortest_m=min(state.shortest_m, row["length_m"]),
            tip_path=tip_path, devices=devices, phases=[*state.phases, row],
        )  # fmt: skip

    def _row(
        self, last: Snapshot, name: str, branchings: list[dict[str, Any]], complete: bool
    ) -> dict[str, Any]:
        """Return the row of a phase, from its last snapshot and its branchings."""
        state, stage = self._state, self._stage
        iterations = state.newton_iterations - sum(phase["newton_iterations"] for phase in state.phases)
        row = phase_figures(last, name, iterations, complete=complete)
        row |= chamber_figures(last, stage.chamber_names)
        row["branchings"] = [*branching_lines(branchings), *undecided_warnings(branchings)]
        row |= stability_figures(last.stability, branchings, stage.decay)
        row |= elastic_figures(stage, last.node_position)
        target = stage.tip_directions.get(last.phase)
        if target is not None:
            across = np.linalg.norm(np.cross(target, last.tip_direction))
            row["tip_angle_error_rad"] = float(np.arctan2(across, np.dot(target, last.tip_direction)))
        length_m = stack_length_m(stage, row["length_m"], last.node_position)
        row["extension_ratio"] = None if stage.stored_m is None else length_m / stage.stored_m
        shortest_m = min(state.shortest_m, row["length_m"])
        row["pack_ratio"] = row["length_m"] / shortest_m if shortest_m > 0.0 else None
        return row


def _begun(state: SummaryState, snapshot: Snapshot, height_m: float) -> SummaryState:
    """Return the state at the start of a phase, with the flange at a height."""
    return replace(state, begin_s=snapshot.time_s, begin_height_m=height_m)


def reason_of(error: BaseException) -> str:
    """Return the summary's text on an error."""
    return f"{type(error).__name__}: {error}"


def json_ready(value: Any) -> Any:
    """Return a value as types of JSON; numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_ready(value.tolist())
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
