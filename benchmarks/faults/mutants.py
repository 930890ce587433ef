"""Do the tests notice small faults? Draws faults from the sources, and runs the tests with one at a time.

    python -m benchmarks.faults.mutants --seed 11 --count 60 --folder mutants

The draw depends on the sources and the seed alone: every line that can have a fault is equally likely, and
every fault that it can have as well; so a room's share is that of its code. A fault is found if a test fails
or computes for ever; one that is not found has passed every test but those that fail without it. The tests
that run the faulty function come first, and the first failure ends a run. Needs git; takes a minute a fault,
and as long as all tests for each that is not found.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from queue import SimpleQueue
from signal import SIGPROF
from typing import final

from benchmarks.faults.code_faults import Fault, faults
from benchmarks.faults.records import Choice, TestRecords, file_of
from benchmarks.faults.source_tree import SourceTree

ROOT = Path(__file__).resolve().parents[2]
_PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "benchmarks.faults.records", "-p", "no:cacheprovider")
_NO_IMPORT = "while loading conftest"
_AT_MOST_S = 7200.0
_PASSED, _FAILED, _NOT_COLLECTED = 0, 1, 2


@final
@dataclass(frozen=True)
class Verdict:
    """What the tests said to a fault.

    Args:
        found: whether any noticed.
        by: the first test that did; empty if none, or if the program did not get as far as a test.
        wall_s: that it took.
    """

    found: bool
    by: str
    wall_s: float


_faults = cache(faults)


def draw(seed: int, count: int, folders: Sequence[str] = (".",), root: Path = ROOT) -> list[Fault]:
    """Return faults drawn at random, each in a line of its own.

    Args:
        seed: of the draw.
        count: of faults.
        folders: of the package that they are drawn from, such as coupling or soft/contact.
        root: of the tree.
    """
    by_line: dict[tuple[str, int], list[Fault]] = {}
    for path in sorted({path for folder in folders for path in (root / "cosim" / folder).rglob("*.py")}):
        for fault in _faults(str(path.relative_to(root)), path.read_bytes()):
            by_line.setdefault((fault.path, fault.line), []).append(fault)
    chance = random.Random(seed)
    return [chance.choice(by_line[line]) for line in chance.sample(sorted(by_line), count)]


def judge(fault: Fault, sound: SourceTree, records: TestRecords, folder: Path, *, near: bool) -> Verdict:
    """Return what tests say to a fault.

    Args:
        fault: the fault.
        sound: the tree without it.
        records: of the tests in that.
        folder: for a copy of it.
        near: whether by the tests that run what it is in, or by all others.
    """
    tree, began = sound.linked(folder), time.monotonic()
    tree.replace(fault.path, fault.applied((sound.root / fault.path).read_bytes()))
    running = [test for test in records.order(fault) if test not in records.failed]
    if near:
        paths, choice = list(dict.fromkeys(map(file_of, running))), Choice(running, [], records.cpu_s)
    else:
        paths, choice = ["tests"], Choice(None, [*running, *records.failed], records.cpu_s)
    by = _first_failure(tree, paths, choice) if paths else ""
    return Verdict(bool(by), by, time.monotonic() - began)


def _first_failure(tree: SourceTree, paths: list[str], choice: Choice) -> str:
    """Return the first test that fails; empty for none."""
    (tree.folder / "choice.json").write_text(json.dumps(asdict(choice)), encoding="utf-8")
    command = (*_PYTEST, "-x", "--tb=no", f"--choice={tree.folder}/choice.json", *paths)
    try:
        run = subprocess.run(
            command, cwd=tree.root, env=tree.environment(), capture_output=True, text=True, timeout=_AT_MOST_S
        )
    except subprocess.TimeoutExpired:
        return "time"
    if run.returncode == _PASSED:
        return ""
    if run.returncode == -SIGPROF:
        return "time"
    broken = _NO_IMPORT in run.stdout + run.stderr  # by what the fault is in
    if run.returncode > _NOT_COLLECTED and not broken:
        raise RuntimeError(f"pytest ended with {run.returncode}: {run.stdout[-2000:]} {run.stderr[-2000:]}")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
    return failed[1] if failed else f"exit code {run.returncode}"


def record(folder: Path, repository: Path = ROOT, processes: int = 0) -> tuple[SourceTree, TestRecords]:
    """Return the sound tree and what its tests run, kept in a folder from the first time on.

    Args:
        folder: for them.
        repository: of which what git tracks is copied.
        processes: that run the tests; 0 for this one's child alone.

    Raises:
        RuntimeError: the tests cannot be run.
    """
    sound, kept = SourceTree(folder / "sound"), folder / "records"
    if not kept.exists():
        SourceTree.of_repository(repository, sound.folder)
        kept.mkdir()
        spread = ("-n", str(processes), "--dist", "loadfile") if processes else ()
        command = (*_PYTEST, *spread, "--tb=short", f"--write-records={kept}", "tests")
        ended = subprocess.run(command, cwd=sound.root, env=sound.environment()).returncode
        if ended not in (_PASSED, _FAILED):
            raise RuntimeError(f"pytest ended with {ended}")
    return sound, TestRecords.read(kept, sound.root)


def main() -> None:
    """Draw, run and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--count", type=int, default=60, help="of faults")
    parser.add_argument("--folders", nargs="+", default=["."], help="of the package; all of it unless given")
    parser.add_argument("--folder", type=Path, required=True, help="for trees, records and results")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    folder: Path = options.folder.resolve()
    sound, records = record(folder, processes=options.workers)
    for test in records.failed:
        print(f"fails without any fault, and is left out: {test}")
    free: SimpleQueue[Path] = SimpleQueue()
    for k in range(options.workers):
        free.put(folder / f"faulty_{k}")

    def found(fault: Fault, near: bool) -> bool:
        place = free.get()
        verdict = judge(fault, sound, records, place, near=near)
        free.put(place)
        lines = fault.difference((sound.root / fault.path).read_bytes())
        entry = {**asdict(fault), "difference": lines, "near": near, **asdict(verdict)}
        with (folder / "results.jsonl").open("a", encoding="utf-8") as results:
            results.write(json.dumps(entry) + "\n")
        tests = "the tests that run it" if near else "any test"
        end = f"found by {verdict.by}" if verdict.found else f"NOT FOUND by {tests}"
        where = f"{fault.path}:{fault.line} {fault.owner}, {fault.kind}"
        print("\n".join([f"{where}: {end}, {verdict.wall_s:.0f} s", *lines]), flush=True)
        return verdict.found

    drawn = draw(options.seed, options.count, options.folders, sound.root)
    left = drawn
    for near in (True, False):
        with ThreadPoolExecutor(options.workers) as pool:
            verdicts = pool.map(partial(found, near=near), left)
            left = [fault for fault, noticed in zip(left, verdicts, strict=True) if not noticed]
    print(f"{len(drawn) - len(left)} of {len(drawn)} found, seed {options.seed}")


if __name__ == "__main__":
    main()
