"""A sample of mutated scenario and robot files: refused with the key's path, solved, or unsolved by name."""

from __future__ import annotations

import math
from itertools import count, islice
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks.faults.fuzz_files import main
from benchmarks.faults.mutations import Mutation, mutated, mutations_of
from benchmarks.faults.trial import Case, Verdict, case_of, try_case, unchanged
from cosim.errors import ScenarioError

LOADED, BUILT = 300, 8


def test_mutated_files_load_or_are_refused_with_a_path(tmp_path: Path) -> None:
    verdicts = {seed: try_case(case_of(seed), "load", tmp_path) for seed in range(LOADED)}
    assert {seed: verdict.what for seed, verdict in verdicts.items() if verdict.kind == "finding"} == {}
    kinds = [verdict.kind for verdict in verdicts.values()]
    several = [seed for seed in verdicts if case_of(seed).alone]
    assert len(several) > LOADED / 4
    assert kinds.count("refused in part") <= len(several) / 50
    assert kinds.count("refused when loaded") > LOADED / 3
    assert kinds.count("completed") > LOADED / 30


def test_mutated_files_that_load_run_or_are_refused_with_a_path(tmp_path: Path) -> None:
    # without targets: to plan them for a robot that lost its frames took 79 s of processor time
    quick = (seed for seed in count() if "tip_" not in case_of(seed).text)
    loading = (seed for seed in quick if try_case(case_of(seed), "load", tmp_path).kind == "completed")
    verdicts = {seed: try_case(case_of(seed), "build", tmp_path) for seed in islice(loading, BUILT)}
    assert {seed: verdict.what for seed, verdict in verdicts.items() if verdict.kind == "finding"} == {}
    assert "completed" in [verdict.kind for verdict in verdicts.values()]


@pytest.mark.parametrize(
    ("key", "kind"), [("tip_path.speed_m_s", "refused when built"), ("duration_s", "finding")]
)
def test_only_what_takes_statics_may_be_refused_by_the_run_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, kind: str
) -> None:
    def refused(_scenario: Any) -> None:
        raise ScenarioError(f"phase.follow.{key}", "is too fast")

    monkeypatch.setattr("benchmarks.faults.trial._check", lambda _scenario: "")
    monkeypatch.setattr("benchmarks.faults.trial._run", refused)
    assert try_case(unchanged("tip_path"), "build", tmp_path).kind == kind


def test_a_seed_means_one_file() -> None:
    assert case_of(7) == case_of(7) != case_of(8)


def test_integers_beyond_all_floats_are_scaled_too() -> None:
    for number in (10**400, -(10**400)):
        source = {"x": number}
        changed = [mutated(source, mutations_of(source, Random(seed))) for seed in range(60)]
        scaled = [table["x"] for table, done in changed if done[0].startswith("multiply")]
        assert scaled
        assert set(scaled) <= {math.inf, -math.inf}


def test_findings_are_told_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def tried(case: Case, level: str, folder: Path) -> Verdict:
        return Verdict("finding", "traceback here") if case == case_of(2) else Verdict("completed", "")

    monkeypatch.setattr("benchmarks.faults.fuzz_files.try_case", tried)
    assert main(["--count", "4", "--keep", str(tmp_path / "kept")]) == 1
    assert capsys.readouterr().out.startswith("seed 2, ")
    assert (tmp_path / "kept" / "load_2" / "case.toml").read_text(encoding="utf-8") == case_of(2).text


def test_a_mutation_whose_place_another_has_taken_away_is_left_out() -> None:
    def lost(table: dict[str, Any], place: Any, _rng: Random, _source: Any) -> str:
        table.pop("a", None)
        return f"lost with {place}"

    both = [Mutation(("b",), lost, 0), Mutation(("a", "x"), lost, 0)]
    assert mutated({"a": {"x": 1}, "b": 2}, both) == ({"b": 2}, ["lost with ('b',)"])


def test_the_last_entry_of_a_list_is_changed_first() -> None:
    def deleted(table: dict[str, Any], place: Any, _rng: Random, _source: Any) -> str:
        del table["l"][place[1]]
        return str(place[1])

    pair = [Mutation(("l", k), deleted, 0) for k in (2, 10)]
    assert mutated({"l": list(range(11))}, pair)[0]["l"] == [0, 1, 3, 4, 5, 6, 7, 8, 9]
