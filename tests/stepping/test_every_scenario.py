"""Every scenario of the project that no golden run takes whole builds and starts, headless."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from cosim.base.resources import list_scenarios
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.config.several_arms import has_arms
from tests.golden.runs import RUNS, Scenario

SNAPSHOTS = 12
WHOLE = {run.name for run in RUNS.values() if isinstance(run, Scenario) and not run.changes}
NAMES = [name for name in list_scenarios() if not has_arms(name) and name not in WHOLE]


@pytest.mark.parametrize(
    "name", [name for name in list_scenarios() if not has_arms(name) and name not in WHOLE]
)
def test_a_scenario_starts_and_continues(name: str) -> None:
    scenario = load_scenario(name)
    simulation = build(scenario)
    snapshots = list(islice(simulation.steps(), SNAPSHOTS))
    assert [snapshot.tick for snapshot in snapshots] == list(range(len(snapshots)))
    # what a tick may leave out of balance: the bound of its mode, or of a tick that is not iterated further
    bound = scenario.solver.residual_tolerance_N if scenario.mode == "quasistatic" else 0.1
    for snapshot in snapshots:
        assert np.isfinite(snapshot.node_position).all()
        assert snapshot.residual_N <= bound
        assert snapshot.momentum_error < 1e-10
        assert np.linalg.norm(snapshot.tip_direction) == pytest.approx(1.0)
