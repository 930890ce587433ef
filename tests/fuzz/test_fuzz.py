"""A sample of each kind of hostile input, in a process of its own: refused by name or fine, never a crash."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.files import case_of
from tests.fuzz.mutants import draw

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("kind", "count", "refused"),
    [
        ("load", 150, "refused when loaded"),
        ("build", 20, "refused when loaded"),
        ("check", 60, "refused when loaded"),
        ("results", 24, "refused"),
        ("checkpoints-statics", 20, "refused"),
        ("live-film", 8, "most of it refused"),
        ("live-devices", 8, "most of it refused"),
        ("live-arm", 8, "most of it refused"),
        ("live-environment", 8, "most of it refused"),
    ],
)
def test_hostile_input_is_refused_by_name_or_fine(
    kind: str, count: int, refused: str, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "tests.fuzz", kind, "--count", str(count), "--keep", str(tmp_path)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    last = done.stdout.splitlines()[-1]
    counts = {kind: int(number) for number, kind in re.findall(r"(\d+) ([a-z][a-z ]+)", last.split(": ")[1])}
    assert sum(counts.values()) == count
    # neither all is refused nor is nothing
    assert 0 < counts[refused] < count


def test_a_seed_means_one_case() -> None:
    assert case_of(7) == case_of(7) != case_of(8)
    assert draw(3, 20, ["base"]) == draw(3, 20, ["base"]) != draw(4, 20, ["base"])
