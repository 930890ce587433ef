"""A sample of mutated files of arms, cells, bodies and objects: refused by `cosim check`, or finite."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from benchmarks.faults import fuzz_files
from benchmarks.faults.rigid_files import rigid_case, unchanged
from benchmarks.faults.rigid_trial import try_files

SAMPLE = 120


def test_mutated_files_are_refused_or_finite() -> None:
    """In processes of their own, as a crash of an engine would take the tests with it."""
    command = [sys.executable, fuzz_files.__file__, "--level", "check", "--count", str(SAMPLE)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout
    last = done.stdout.splitlines()[-1]
    counts = {kind: int(count) for count, kind in re.findall(r"(\d+) (refused when loaded|completed)", last)}
    assert counts["refused when loaded"] > SAMPLE / 3
    assert counts["completed"] > SAMPLE / 6


def test_files_as_they_are_are_fine_and_what_must_be_refused_is_not(tmp_path: Path) -> None:
    for case in unchanged():
        assert try_files(case, tmp_path).kind == "completed", case.source
        assert try_files(replace(case, refused=True), tmp_path).kind == "finding"


def test_a_seed_means_the_same_files() -> None:
    assert rigid_case(7) == rigid_case(7) != rigid_case(8)
