"""Mutated files: each is refused with its key's path, solved, or unsolved by name.

    python benchmarks/faults/fuzz_files.py [--level load|build|check] [--count N] [--seed S] [--keep DIR]

At the levels "load" and "build" files of scenarios and soft robots are mutated. At "build" COUNT cases are
built: those that are refused when they are loaded do not count. At the level "check" URDF, MJCF, arm.toml,
cells, and meshes of bodies and objects are mutated, and `cosim check` reads them.

Every case has a seed of its own, S, S + 1, ... A finding (a traceback, a refusal without the key's path,
60 s of CPU time, 10 s at the level "check", 1 GB of memory when loaded, else 4 GB) is printed with its seed,
and its files are kept in DIR; so is what ends in order, but takes more than 10 s of CPU time. Exit code 1 if
there are findings.
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
from typing import Final, Literal, TypeAlias, get_args

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.faults import rigid_files
from benchmarks.faults.rigid_files import RigidCase
from benchmarks.faults.trial import Case, Verdict, case_of, try_case, unchanged

Level = Literal["load", "build", "check"]
AnyCase: TypeAlias = Case | RigidCase
SLOW_CPU_S: Final = 10.0
CPU_LIMIT_S: Final = {"load": 60.0, "build": 60.0, "check": 10.0}
MEMORY_LIMIT_BYTES: Final = {"load": 1 << 30, "build": 4 << 30, "check": 4 << 30}
_LOOK_EVERY_S = 0.5
_SEEDS_AT_ONCE = 500


def run_cases(seeds: Sequence[int], level: Level) -> Iterator[tuple[int, AnyCase, Verdict]]:
    """Yield (seed, case, verdict) of each seed, tried in a process that a hang or a crash may cost.

    Args:
        seeds: of the cases.
        level: of the cases.
    """
    waiting = list(seeds)
    while waiting:
        done = 0
        with TemporaryDirectory() as folder:
            for seed, verdict in _worker_results(waiting, level, Path(folder)):
                yield seed, _case(seed, level), verdict
                done += 1
        waiting = waiting[done:]


def counted_cases(first: int, count: int, level: Level) -> Iterator[tuple[int, AnyCase, Verdict]]:
    """Yield cases from a first seed on until a number of them are done that count at a level."""
    seed, left = first, count
    while left > 0:
        for found in run_cases(range(seed, seed + _SEEDS_AT_ONCE), level):
            yield found
            seed += 1
            left -= level != "build" or found[2].kind != "refused when loaded"
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
                if _cpu_s(worker.pid) - begun > CPU_LIMIT_S[level]:
                    yield seed, Verdict("finding", f"more than {CPU_LIMIT_S[level]:g} s of CPU time")
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
    for case in _first(level):  # loads engines and kernels
        _tried(case, level, folder)
    results.send(None)
    for seed in seeds:
        try:
            verdict = _tried(_case(seed, level), level, folder)
        except MemoryError as error:
            verdict = Verdict("finding", f"out of memory: {error}")
        results.send(verdict)


def _case(seed: int, level: Level) -> AnyCase:
    return rigid_files.rigid_case(seed) if level == "check" else case_of(seed)


def _first(level: Level) -> list[AnyCase]:
    """Return cases that nothing is wrong with."""
    if level == "check":
        return list(rigid_files.unchanged())
    return [unchanged("ur5e_hexagon_arm")] if level == "build" else []


def _tried(case: AnyCase, level: Level, folder: Path) -> Verdict:
    if isinstance(case, Case):
        return try_case(case, "build" if level == "build" else "load", folder)
    from benchmarks.faults.rigid_trial import try_files  # here: files that are only loaded need no engine

    return try_files(case, folder)


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
            case.write(options.keep / f"{options.level}_{seed}")
    told = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    seeds = f"seeds {options.seed} to {options.seed + counts.total() - 1}"
    print(f"{options.level}, {seeds}: {told}; {time.perf_counter() - started:.0f} s")
    return int(counts["finding"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
