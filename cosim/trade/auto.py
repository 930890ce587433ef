"""Chooses fidelity, tick and integrator of a scenario by a short trade, whose figures are kept on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cosim.base.identity import code_identity
from cosim.base.whole_files import keep, kept
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.writing import to_table
from cosim.errors import ScenarioError
from cosim.trade.candidates import Candidate, short_candidates
from cosim.trade.measuring import Build, Follow, Measured, Telling, compile_for_trade, measure, unfollowed
from cosim.trade.report import Requirement, entry, figures_text, pareto_front, pick, result_line

_WITHOUT = ("name", "title", "fidelity", "auto")
"""What the figures of a scenario do not depend on."""


def chosen_fidelity(
    scenario: Scenario, build: Build, cache: Path, tell: Callable[[str], None], follow: Follow = unfollowed
) -> Scenario:
    """Return the scenario with its fidelity chosen, if it asks for that; otherwise as it is.

    Args:
        scenario: checked.
        build: makes a simulation.
        cache: directory of kept figures.
        tell: told what is measured and what is chosen.
        follow: what follows the run that is chosen for, as its cost counts.

    Raises:
        ScenarioError: no candidate meets the requirement; the message names the nearest.
    """
    if scenario.fidelity != "auto" or scenario.auto is None:
        return scenario
    requirement = Requirement(
        scenario.auto.budget, scenario.auto.tolerance_m, scenario.auto.force_tolerance_N
    )
    results, source = figures(replace(scenario, fidelity="lumped", auto=None), build, cache, tell, follow)
    found = pick(results, requirement)
    if found is None:
        raise ScenarioError("auto", f"no candidate meets {requirement.words}; {_nearest(results)}")
    said = f"{found.candidate.name}: {figures_text(found)}"
    tell(f"auto: chose {said} ({source})")
    plain = replace(scenario, fidelity="lumped", auto=None)
    chosen = load_scenario(plain, found.candidate.changes)
    return replace(chosen, auto=replace(scenario.auto, chosen=said))


def figures(
    scenario: Scenario, build: Build, cache: Path, tell: Callable[[str], None], follow: Follow = unfollowed
) -> tuple[list[Measured], str]:
    """Return the measured candidates of a scenario, and where their figures come from."""
    candidates = short_candidates(scenario)
    path = cache / f"trade_{content_hash(scenario, candidates)}.kept"
    found = kept(path, lambda data: _unpacked(data, candidates))
    if found is not None:
        return found, f"measured before: {path}"
    tell(f"auto: measuring {len(candidates)} ways to run '{scenario.name}', once")
    compile_for_trade(scenario, tell)
    telling = Telling(done=lambda result: tell(f"auto: {result_line(result)}"))
    results = measure(scenario, candidates, build, telling, follow=follow)
    keep(path, json.dumps([entry(result) for result in results]).encode())
    return results, f"measured now, kept in {path}"


def content_hash(scenario: Scenario, candidates: Sequence[Candidate]) -> str:
    """Return what names the figures of a scenario: a hash of all that they depend on.

    The code is among it: another program may measure something else, or run at another speed.
    """
    table = {key: value for key, value in to_table(scenario).items() if key not in _WITHOUT}
    ways = [dict(candidate.changes) for candidate in candidates]
    text = json.dumps([code_identity(), table, ways], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _unpacked(data: bytes, candidates: Sequence[Candidate]) -> list[Measured]:
    rows: list[dict[str, Any]] = json.loads(data)
    return [
        Measured(
            candidate,
            failure=row["failure"] or "",
            reference=row["reference"],
            **{key: _number(row[key]) for key in Measured.numbers()},
        )
        for candidate, row in zip(candidates, rows, strict=True)
    ]


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _nearest(results: Sequence[Measured]) -> str:
    front = pareto_front(results)
    if not front:
        return "none of them ran to its end"
    ends = {id(result): result for result in (front[0], front[-1])}.values()
    return "there are " + " and ".join(f"{result.candidate.name} ({figures_text(result)})" for result in ends)
