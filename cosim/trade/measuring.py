"""Runs the candidates of a trade and measures each against the reference of its group.

Tip position, objects and contact forces are sampled at common times. The flange force is compared by its
moving mean: from tick to tick it chatters, and its values do not converge with the tick; what it passes on
over some time does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import CosimError
from cosim.trade.candidate import Candidate
from cosim.trade.commands import with_commands
from cosim.trade.curve import Curve, Follow, TooSlowError, trace, unfollowed
from cosim.trade.measured import FORCE_WINDOW_S, Measured
from cosim.trade.simulation import Build

SAMPLE_S = 0.02


SLOWEST = 0.05
"""Real-time factor below which a candidate is stopped, unless told otherwise."""

_REFERENCE_SLOWEST = 0.1  # share of that bound which a reference has to keep: nothing is measured without it


@final
@dataclass(frozen=True)
class Telling:
    """Who is told of candidates.

    Args:
        begin: of a candidate's place in the list, counted from 0, before it runs.
        advance: of the share of its run that is done, now and then.
        done: of its figures.
    """

    begin: Callable[[int, Candidate], None] = lambda _place, _candidate: None
    advance: Callable[[float], None] = lambda _share: None
    done: Callable[[Measured], None] = lambda _result: None


def measure(
    scenario: Scenario,
    candidates: Sequence[Candidate],
    build: Build,
    telling: Telling | None = None,
    *,
    follow: Follow = unfollowed,
    slowest: float = SLOWEST,
) -> list[Measured]:
    """Run all candidates, each group's reference before its others.

    Args:
        scenario: that they change.
        candidates: to run.
        build: makes a simulation.
        telling: who is told of them.
        follow: what else sees every snapshot, inside the measured time.
        slowest: real-time factor below which a candidate is stopped, a reference at a tenth of it; 0: none.
    """
    telling = telling or Telling()
    comparison = _Comparison(scenario, build)
    results: list[Measured] = []
    for place, candidate in enumerate(candidates):
        telling.begin(place, candidate)
        least = slowest * (_REFERENCE_SLOWEST if candidate.reference else 1.0)
        try:
            changed = load_scenario(comparison.basis(candidate), candidate.changes)
            curve = trace(changed, build, follow, slowest=least, advance=telling.advance)
        except TooSlowError as error:
            result = Measured(candidate, failure=f"stopped: {error}")
        except CosimError as error:
            result = Measured(candidate, failure=f"failed: {type(error).__name__}: {error}")
        else:
            result = comparison.result(candidate, curve, statics=changed.mode == "quasistatic")
        results.append(result)
        telling.done(result)
    return results


class _Comparison:
    """What candidates start from and are measured against."""

    def __init__(self, scenario: Scenario, build: Build) -> None:
        self._scenario, self._build = scenario, build
        self._commanded: Scenario | None = None
        self._references: dict[str, Curve] = {}
        self._bases: dict[str, Curve] = {}

    def basis(self, candidate: Candidate) -> Scenario:
        """Return the scenario that a candidate changes."""
        if not candidate.commanded:
            return self._scenario
        if self._commanded is None:
            self._commanded = with_commands(self._scenario, self._build)
        return self._commanded

    def result(self, candidate: Candidate, curve: Curve, *, statics: bool) -> Measured:
        """Return a candidate's figures; it may be what others are measured against."""
        first = candidate.reference and candidate.group not in self._references
        if first:
            self._references[candidate.group] = curve
        if candidate.base:
            self._bases[candidate.group] = curve
        reference, base = self._references.get(candidate.group), self._bases.get(candidate.group)
        found = compared(candidate, curve, reference, None if base is reference else base, statics=statics)
        return replace(found, reference=first)


def compared(
    candidate: Candidate,
    curve: Curve,
    reference: Curve | None,
    base: Curve | None = None,
    *,
    statics: bool = False,
) -> Measured:
    """Return a candidate's figures; of statics, which have no time between phase ends, only those there.

    Args:
        candidate: which.
        curve: of it.
        reference: what it is measured against.
        base: the model as it is; None where that is the reference.
        statics: whether the candidate is quasistatic.
    """
    if reference is None:
        return Measured(candidate, curve.real_time_factor, iterations=curve.iterations)
    end_error = _end_distance(curve, reference)
    if statics:
        return Measured(
            candidate, curve.real_time_factor, end_error_m=end_error, iterations=curve.iterations,
            base_error_m=np.nan if base is None else _end_distance(curve, base),
        )  # fmt: skip
    times = np.arange(0.0, min(curve.time_s[-1], reference.time_s[-1]) + 0.5 * SAMPLE_S, SAMPLE_S)
    here, there = curve.at(times), reference.at(times)
    distance = _distances(here.tip, there.tip)
    moved = _distances(here.objects, there.objects)
    return Measured(
        candidate,
        curve.real_time_factor,
        tip_error_m=float(distance.max()),
        tip_rms_m=float(np.sqrt((distance**2).mean())),
        end_error_m=end_error,
        force_error_N=_force_error(curve, reference, times),
        contact_error_N=float(np.sqrt(((here.contact - there.contact) ** 2).mean())),
        iterations=curve.iterations,
        object_error_m=float(moved.max()) if moved.size else np.nan,
        base_error_m=np.nan if base is None else float(_distances(here.tip, base.at(times).tip).max()),
    )


def _force_error(curve: Curve, reference: Curve, times: Array) -> float:
    """Return the largest difference [N] of the flange force's moving mean.

    The window is centred on each compared time, and moved into the run at its ends; of a shorter run, it is
    all of it.

    Args:
        curve: of a candidate.
        reference: what it is measured against.
        times: (n,) [s], compared.
    """
    last_s = min(float(curve.time_s[-1]), float(reference.time_s[-1]))
    window_s = min(FORCE_WINDOW_S, last_s)
    begin_s = np.clip(times - 0.5 * window_s, 0.0, last_s - window_s)
    here, there = (each.mean_force(begin_s, begin_s + window_s) for each in (curve, reference))
    return float(_distances(here, there).max())


def _distances(here: Array, there: Array) -> Array:
    return np.asarray(np.linalg.norm(here - there, axis=-1))


def _end_distance(curve: Curve, other: Curve) -> float:
    ends = curve.tip[list(curve.phase_ends)], other.tip[list(other.phase_ends)]
    return float(_distances(*ends).max())
