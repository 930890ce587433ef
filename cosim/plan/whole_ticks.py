"""Phases that do not last whole ticks: the whole number nearest to (duration + settling) / tick is simulated,
and for a linear ramp that nearest to duration / tick, so that the curves shift.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Final

import numpy as np

from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario

_WHOLE: Final = 1e-6
"""Distance of a number of ticks from a whole one that is rounding."""
_US: Final = 1e-6
"""Proposed ticks are whole numbers of this time [s]."""
_FACTOR: Final = 5
"""Largest ratio of a proposed tick and the given one."""
_LONGEST_S: Final = 0.1
"""Longest tick that `clock.tick_s` allows."""


def lengths_s(scenario: Scenario) -> tuple[float, ...]:
    """Return the durations that ticks should divide [s]: of phases, linear ramps, and periods of controllers.

    A tip path is left out: its duration follows from the path, and is stretched to whole ticks.

    Args:
        scenario: checked. In statics or without phases there are no durations.
    """
    if scenario.endless or scenario.mode != "dynamic":
        return ()
    of_phases = [length for phase in scenario.phases for length in _lengths_of(phase)]
    return (*of_phases, *(each.period_s for each in scenario.controllers if each.period_s))


def are_whole(lengths: Sequence[float], tick_s: float) -> bool:
    """Return whether a tick divides all durations.

    Args:
        lengths: durations [s].
        tick_s: [s].
    """
    return all(_is_whole(length, tick_s) for length in lengths)


def rounding_warnings(scenario: Scenario) -> list[str]:
    """Return a warning if phases do not last whole ticks: which, by how much curves shift, and what to set.

    Args:
        scenario: checked.
    """
    tick_s, asked = scenario.clock.tick_s, lengths_s(scenario)
    odd = [each for each in scenario.phases if asked and not are_whole(_lengths_of(each), tick_s)]
    if not odd:
        return []
    names = ", ".join(f"'{phase.name}' {_times(phase, tick_s)}" for phase in odd)
    remedies = [", ".join(f"{key} = {value:.9g}" for key, value in _changes(odd, tick_s))]
    if (divides_s := _dividing_tick_s(scenario, asked)) is not None:
        remedies.insert(0, f"clock.tick_s = {divides_s:.9g}, which divides all phases")
    return [
        f"phases are rounded to whole ticks of {tick_s:.9g} s: {names}. Curves shift by up to "
        f"{1e3 * _largest_shift_s(scenario):.3g} ms. Set {', or '.join(remedies)}, the rounded times"
    ]


def _lengths_of(phase: PhaseTable) -> tuple[float, ...]:
    if phase.tip_path is not None:
        return ()
    whole_s = phase.duration_s + phase.settle_s
    return (phase.duration_s, whole_s) if phase.ramp == "linear" else (whole_s,)


def _is_whole(length_s: float, tick_s: float) -> bool:
    ticks = length_s / tick_s
    return abs(ticks - round(ticks)) < _WHOLE


def _rounded_s(length_s: float, tick_s: float) -> float:
    return max(1, round(length_s / tick_s)) * tick_s


def _times(phase: PhaseTable, tick_s: float) -> str:
    """Return the asked duration of a phase and the rounded one; those of its ramp if only that is rounded."""
    *ramps, whole_s = _lengths_of(phase)
    ramp = [f"(linear ramp) {_change(each, tick_s)}" for each in ramps if not _is_whole(each, tick_s)]
    return _change(whole_s, tick_s) if not _is_whole(whole_s, tick_s) else ramp[0]


def _change(length_s: float, tick_s: float) -> str:
    return f"{length_s:.9g} s becomes {_rounded_s(length_s, tick_s):.9g} s"


def _changes(phases: Sequence[PhaseTable], tick_s: float) -> Iterator[tuple[str, float]]:
    """Return keys with the nearest durations of whole ticks."""
    for phase in phases:
        duration_s = _rounded_s(phase.duration_s, tick_s)
        settle_s = _rounded_s(phase.duration_s + phase.settle_s, tick_s) - duration_s
        for key, value, given in (
            ("duration_s", duration_s, phase.duration_s),
            ("settle_s", settle_s, phase.settle_s),
        ):
            if not math.isclose(value, given, rel_tol=0.0, abs_tol=_WHOLE * tick_s):
                yield f"phase.{phase.name}.{key}", value


def _largest_shift_s(scenario: Scenario) -> float:
    """Return the largest shift of an end of a phase or of a linear ramp [s]; shifts of phases add up."""
    tick_s, phases = scenario.clock.tick_s, scenario.phases
    shifts = [_rounded_s(each, tick_s) - each for each in (p.duration_s + p.settle_s for p in phases)]
    ends = list(accumulate(shifts, initial=0.0))
    ramps = [
        begin + _rounded_s(phase.duration_s, tick_s) - phase.duration_s
        for begin, phase in zip(ends, phases, strict=False)
        if phase.ramp == "linear" and phase.tip_path is None
    ]
    return max(map(abs, (*ends, *ramps)))


def _dividing_tick_s(scenario: Scenario, lengths: Sequence[float]) -> float | None:
    """Return the tick nearest to the given one that divides all durations; None without one near it."""
    whole_us = [round(length / _US) for length in lengths]
    if any(abs(us - length / _US) > _WHOLE * us for us, length in zip(whole_us, lengths, strict=True)):
        return None
    tick_us, greatest = scenario.clock.tick_s / _US, math.gcd(*whole_us)
    rates_Hz = [*(each.rate_Hz for each in scenario.sensors), *(each.rate_Hz for each in scenario.cameras)]
    longest_s = min([_LONGEST_S, *(1.0 / rate_Hz for rate_Hz in rates_Hz if rate_Hz)])
    ticks = np.arange(
        max(1, math.ceil(tick_us / _FACTOR - _WHOLE)), min(_FACTOR * tick_us, longest_s / _US) + _WHOLE
    )
    ticks = ticks[greatest % ticks == 0]
    if not len(ticks):
        return None
    return round(float(ticks[np.argmin(np.abs(np.log(ticks / tick_us)))]) * _US, 9)
