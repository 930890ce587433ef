"""Figures of a phase by its last snapshot."""

import math
from typing import Any

import numpy as np

from cosim.base.column import ends_of
from cosim.base.columns import TickColumns
from cosim.base.frames import Array
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot


def phase_figures(last: Snapshot, name: str, newton_iterations: int, *, complete: bool) -> dict[str, Any]:
    """Return the figures of a phase by its last snapshot."""
    wrench = last.flange_wrench
    figures: dict[str, Any] = {
        "name": name,
        "complete": complete,
        "newton_iterations": newton_iterations,
        **{figure.name: getattr(last, column.name) for column, figure in ends_of(TickColumns)},
        "flange_wrench": {"force_N": wrench.force, "torque_Nm": wrench.torque},
    }
    if last.tip_target is not None:
        figures["tip_target_m"] = last.tip_target
        # free components of the target are NaN
        figures["tip_error_m"] = float(np.sqrt(np.nansum((last.tip_position - last.tip_target) ** 2)))
    return figures


def chamber_figures(last: Snapshot, names: tuple[str, ...]) -> dict[str, Any]:
    """Return pressure and volume of each chamber, by name."""
    pairs = zip(last.chamber_pressure_Pa, last.chamber_volume_m3, strict=True)
    chambers = [{"pressure_Pa": pressure, "volume_m3": volume} for pressure, volume in pairs]
    return {"chambers": dict(zip(names, chambers, strict=True))}


def elastic_figures(run: RunInfo, positions: Array) -> dict[str, Any]:
    """Return figures of hinges and stiffeners with the film's nodes at positions (n, 3) [m]."""
    figures: dict[str, Any] = {}
    if run.hinge_energy_share is not None:
        figures["hinge_energy_share"] = run.hinge_energy_share(positions)
    strain = None if run.stiffener_strain is None else run.stiffener_strain(positions)
    if strain is not None:
        strength = strain.strength if strain.strength < math.inf else None
        figures["stiffener"] = {"peak_strain": strain.peak, "strength_strain": strength}
    return figures


def stack_length_m(run: RunInfo, length_m: float, positions: Array) -> float:
    """Return the length of a stack: that of its centre line, or of its packed frames if they are longer.

    Args:
        run: of the stack.
        length_m: of the centre line.
        positions: (n, 3) [m], of the film's nodes.
    """
    return length_m if run.frames_length is None else max(length_m, run.frames_length(positions))
