"""Names of the figures of a study's runs, to refuse wrong names before the runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from difflib import get_close_matches
from typing import Final

from cosim.base.column import ends_of, figures_of
from cosim.base.columns import TickColumns
from cosim.config import loading, studies
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import LONGEST_NAME
from cosim.errors import InputError, ScenarioError
from cosim.sweeps.run_figures import PHASES

OF_A_RUN: Final = (
    "tick_s", "simulated_s", "ticks", "planned_ticks",
    *(figure.name for _, figure in figures_of(TickColumns)),
    "touched", "soft_weight_N", "section_model", "error", "branchings", "overlaps", "objects",
)  # fmt: skip
OF_A_PHASE: Final = (
    "complete", "newton_iterations", *(figure.name for _, figure in ends_of(TickColumns)),
    "flange_wrench", "chambers", "lowest_frequency_Hz", "disturbed_tip_m",
    "load_margin", "losses_held", "modes", "hinge_energy_share", "stiffener", "extension_ratio",
    "pack_ratio", "energy", "devices",
)  # fmt: skip


def check_figures(study: studies.StudyTable) -> None:
    """Check that some design of a study has each of its figures; figures of a `measure` are not checked.

    Args:
        study: checked by `load_study`.

    Raises:
        ScenarioError: no design has one of them.
    """
    left, known = list(study.figures), dict[str, None]()
    for varied in studies.designs_of(study) if left and study.measure is None else ():
        with suppress(InputError):  # the row of a design that cannot be loaded has the reason
            scenario = loading.load_scenario(study.scenario, {**study.set, **varied})
            known |= dict.fromkeys(_names(scenario))
        left = [wanted for wanted in left if known and not _is_known(wanted, known)]
        if not left:
            return
    faults = [("figures", _no_such(wanted, tuple(known))) for wanted in left]
    if faults and known:
        raise ScenarioError(*faults[0], further=tuple(faults[1:]))


def _no_such(wanted: str, known: tuple[str, ...]) -> str:
    close = get_close_matches(wanted[:LONGEST_NAME], known, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"no design has '{wanted}'; there are {', '.join(known)}{hint}"


def _is_known(wanted: str, known: dict[str, None]) -> bool:
    """Return whether a name is known, or is below or above a known name."""
    return any(f"{wanted}.".startswith(f"{name}.") or name.startswith(f"{wanted}.") for name in known)


def _names(scenario: Scenario) -> Iterator[str]:
    """Yield the names of figures of the run, of its last phase, and of every phase."""
    yield from OF_A_RUN
    yield from _of_phase(scenario.phases[-1])
    for phase in scenario.phases:
        yield from (f"{PHASES}.{phase.name}.{key}" for key in _of_phase(phase))


def _of_phase(phase: PhaseTable) -> Iterator[str]:
    yield from OF_A_PHASE
    if phase.tip_target is not None:
        yield from ("tip_target_m", "tip_error_m")
        if phase.tip_target.direction is not None:
            yield "tip_angle_error_rad"
    if phase.tip_path is not None:
        yield from ("tip_path", "tip_target_m", "tip_error_m")
