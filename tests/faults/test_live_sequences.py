"""A sample of sequences of live commands with wrong values mixed in, and that a fault among them is found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import cosim
from benchmarks.faults.live_sequences import main, try_sequence
from benchmarks.faults.live_subjects import SUBJECTS

SEQUENCES, STEPS = 8, 6


@pytest.mark.parametrize("surface", list(SUBJECTS))
def test_wrong_values_are_refused_by_name_and_leave_no_trace(surface: str, tmp_path: Path) -> None:
    told = [one for seed in range(SEQUENCES) for one in try_sequence(surface, seed, STEPS, tmp_path)]
    assert [(one.what, one.wrong) for one in told if one.wrong] == []
    outcomes = [one.outcome for one in told]
    assert len(outcomes) == SEQUENCES * STEPS
    assert outcomes.count("accepted") > len(outcomes) / 4
    assert outcomes.count("InputError") > len(outcomes) / 8


@pytest.mark.parametrize("fault", ["a trace", "a foreign error"])
def test_a_fault_is_found(
    fault: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    step = cosim.Simulation.step

    def faulty(self: cosim.Simulation, *given: Any, **named: Any) -> Any:
        try:
            return step(self, *given, **named)
        except cosim.InputError:
            if fault == "a foreign error":
                raise KeyError("pressure") from None
            step(self, 1)
            raise

    monkeypatch.setattr(cosim.Simulation, "step", faulty)
    assert main(["--surface", "film", "--count", "6"]) == 1
    said = capsys.readouterr().out
    assert ("KeyError" if fault == "a foreign error" else "another state") in said
    assert said.splitlines()[-1].startswith("6 sequences: ")
