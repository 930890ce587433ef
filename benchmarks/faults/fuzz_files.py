"""Mutated scenario and robot files: each is refused with its key's path, solved, or unsolved by name.

    python benchmarks/faults/fuzz_files.py [--level load|build] [--count N] [--seed S] [--keep DIR]

At the level "build" COUNT cases are built: those that are refused when they are loaded do not count.

Every case has a seed of its own, S, S + 1, ... A finding (a traceback, a refusal without the key's path,
60 s of CPU time, 1 GB of memory when loaded, 4 GB when built) is printed with its seed, and its file is kept
in DIR; so is what ends in order, but takes more than 10 s of CPU time. Exit code 1 if there are findings.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, get_args

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.faults.trial import Case, Level, Verdict, case_of, try_case, unchanged

SLOW_CPU_S: Final = 10.0
CPU_LIMIT_S: Final = 60.0
MEMORY_LIMIT_BYTES: Final = {"load": 1 << 30, "build": 4 << 30}
_LOOK_EVERY_S = 0.5
_SEEDS_AT_ONCE = 500


def run_cases(seeds: Sequence[int], level: Level) -> Iterator[tuple[int, Case, Verdict]]:
    """Yield (seed, case, verdict) of each seed, tried in a process that a hang or a crash may cost.

    Args:
        seeds: of the cases.
        level: see `try_case`.
    """
    waiting = list(seeds)
    while waiting:
        done = 0
        with TemporaryDirectory() as folder:
            for seed, verdict in _worker_results(waiting, level, Path(folder)):
                yield seed, case_of(seed), verdict
                done += 1
        waiting = waiting[done:]


def counted_cases(first: int, count: int, level: Level) -> Iterator[tuple[int, Case, Verdict]]:
    """Yield cases from a first seed on until a number of them are done that count at a level."""
    seed, left = first, count
    while left > 0:
        for found in run_cases(range(seed, seed + _SEEDS_AT_ONCE), level):
            yield found
            seed += 1
            left -= level == "load" or found[2].kind != "refused when loaded"
            if left == 0:
                return


def _worker_results(seeds: list[int], level: Level, folder: Path) -> Iterator[tuple[int, Verdict]]:
    """Yield results of one worker process, until all are there or it had to be ended."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    worker = multiprocessing.get_context("fork").Process(
        target=_work, args=(seeds, level, folder, theirs), daemon=True
    )
    worker.start()
    theirs.close()
    assert worker.pid is not None
    try:
        ours.recv()
        for seed in seeds:
            begun = _cpu_s(worker.pid)
            while not ours.poll(_LOOK_EVERY_S):
                if _cpu_s(worker.pid) - begun > CPU_LIMIT_S:
                    yield seed, Verdict("finding", f"more than {CPU_LIMIT_S:g} s of CPU time")
                    return
            try:
                verdict = ours.recv()
                used = _cpu_s(worker.pid) - begun
                if used > SLOW_CPU_S and verdict.kind != "finding":
                    verdict = Verdict(
                        "slow", f"{used:.0f} s of CPU time, then {verdict.kind}: {verdict.what}"
                    )
                yield seed, verdict
            except EOFError:
                worker.join()
                yield seed, Verdict("finding", f"the process ended with code {worker.exitcode}")
                return
    finally:
        worker.kill()
        worker.join()


def _work(seeds: list[int], level: Level, folder: Path, results: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT_BYTES[level],) * 2)
    if level == "build":
        try_case(unchanged("ur5e_hexagon_arm"), level, folder)  # loads engines and kernels
    results.send(None)
    for seed in seeds:
        try:
            verdict = try_case(case_of(seed), level, folder)
        except MemoryError as error:
            verdict = Verdict("finding", f"out of memory: {error}")
        results.send(verdict)


def _cpu_s(process: int) -> float:
    """Return the CPU time [s] that a process has used."""
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the cases, print findings and counts, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--level", choices=get_args(Level), default="load")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", metavar="DIR", type=Path, help="directory for the files of findings")
    options = parser.parse_args(arguments)
    started, counts = time.perf_counter(), Counter[str]()
    for seed, case, verdict in counted_cases(options.seed, options.count, options.level):
        counts[verdict.kind] += 1
        if verdict.kind not in ("finding", "slow"):
            continue
        print(f"seed {seed}, {case.source}: {case.changes}\n    {verdict.kind}: {verdict.what}", flush=True)
        if options.keep is not None:
            options.keep.mkdir(parents=True, exist_ok=True)
            (options.keep / f"{options.level}_{seed}.toml").write_text(case.text, encoding="utf-8")
    told = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    seeds = f"seeds {options.seed} to {options.seed + counts.total() - 1}"
    print(f"{options.level}, {seeds}: {told}; {time.perf_counter() - started:.0f} s")
    return int(counts["finding"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
