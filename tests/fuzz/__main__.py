"""Hostile inputs, seeded: python -m tests.fuzz KIND [--count N] [--seed S] [--keep DIR].

Every case has a seed of its own, S, S + 1, ... A finding (a traceback, a crash, a refusal that does not name
the key or the file, too much time or memory, another result) is printed with its seed, and its files are kept
in DIR; so is what ends in order but takes more than 10 s of CPU time. Exit code 1 if there are findings.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.fuzz import checkpoints, files, live, results, rigid
from tests.fuzz.verdict import FINDING, SLOW, Trial, verdicts

KINDS: Final[dict[str, Callable[[], Trial]]] = {
    "load": files.Loaded,
    "build": files.Built,
    "check": rigid.Checked,
    "results": results.Results,
    "checkpoints-statics": checkpoints.Statics,
    **{f"checkpoints-{name}": partial(checkpoints.Moving, name) for name in checkpoints.MOVING},
    **{f"live-{name}": partial(live.Sequence, name) for name in live.SUBJECTS},
}
"""What is mutated: files that are loaded, or built as well; files of arms, cells and meshes; folders of runs
and sweeps; checkpoints that runs go on from; commands to simulations and environments."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Try cases, print findings and counts, and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", metavar="DIR", type=Path, help="folder for the files of findings")
    options = parser.parse_args(arguments)
    started, counts = time.perf_counter(), Counter[str]()
    with TemporaryDirectory() as folder:
        seeds = range(options.seed, options.seed + options.count)
        for seed, verdict in verdicts(KINDS[options.kind](), seeds, options.keep or Path(folder)):
            counts[verdict.kind] += 1
            if verdict.kind in (FINDING, SLOW):
                print(f"seed {seed}: {verdict.case}\n    {verdict.kind}: {verdict.what}", flush=True)
    told = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    print(f"{options.kind}, seeds {seeds[0]} to {seeds[-1]}: {told}; {time.perf_counter() - started:.0f} s")
    return int(counts[FINDING] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
