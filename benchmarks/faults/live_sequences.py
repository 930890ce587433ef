"""Sequences of live commands, saves, restores, branches, resets and actions with wrong values mixed in.

    python benchmarks/faults/live_sequences.py [--surface NAME ...] [--count N] [--seed S] [--steps K]

Every sequence has a seed, S, S + 1, ... Each of its steps is accepted, or ends in an error of cosim that
names the key. A twin is given what was accepted and nothing else: after every step the saved states of both
are the same in every bit, and what is restored is what was saved. Findings (another exception or warning, an
error without the key, more than 10 s, another state) are printed with their seed. Exit code 1 if there are
any.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import os
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any, Final, final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.faults.live_steps import Subject
from benchmarks.faults.live_subjects import SUBJECTS
from cosim.errors import CosimError, SolverError

SLOW_S: Final = 10.0
STEPS: Final = 6
_AT_ONCE: Final = 50


@final
@dataclass(frozen=True)
class Told:
    """What became of one step.

    Args:
        what: was asked, in words.
        outcome: "accepted", or the kind of the error.
        wrong: about it; empty: nothing.
    """

    what: str
    outcome: str
    wrong: str = ""


def try_sequence(surface: str, seed: int, steps: int, folder: Path) -> Iterator[Told]:
    """Yield what became of each step of a sequence, up to one at which something is wrong.

    Args:
        surface: one of `SUBJECTS`.
        seed: of the sequence.
        steps: of it.
        folder: for files.
    """
    random = Random(f"{surface} {seed}")
    tried, twin = (SUBJECTS[surface].begun(folder / name) for name in ("tried", "twin"))
    for _ in range(steps):
        told = _told(tried, twin, random)
        yield told
        if told.wrong:
            return
    for subject in (tried, twin):
        subject.go_on()
    if tried.content() != twin.content():
        yield Told("going on", "accepted", "goes on otherwise than what was never given the refused steps")


def _told(tried: Subject, twin: Subject, random: Random) -> Told:
    """Return what became of a step that is drawn."""
    step = tried.drawn(random)
    moment, began = tried.moment(), time.perf_counter()
    error = _error_of(step.do, tried)
    spent_s = time.perf_counter() - began
    wrong = "" if error is None else _wrong(error, step.keys)
    if spent_s > SLOW_S:
        wrong = f"took {spent_s:.0f} s"
    solved = getattr(error, "result", None) is not None and tried.moment() != moment
    if not wrong and (error is None or solved):  # what was solved before an error stays
        again = _error_of(step.do, twin)
        if (type(error), str(error)) != (type(again), str(again)):
            wrong = f"{error!r}, but of the twin {again!r}"
    if not wrong and tried.content() != twin.content():
        wrong = "another state than that of what was given the accepted steps alone"
    return Told(step.what, "accepted" if error is None else type(error).__name__, wrong)


def _error_of(do: Callable[[Any], None], subject: Subject) -> Exception | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            do(subject)
    except Exception as error:  # whatever it is: that is what is looked for
        return error
    return None


def _wrong(error: Exception, keys: Sequence[str]) -> str:
    """Return what is wrong with an error; empty: nothing."""
    text = str(error)
    if not isinstance(error, CosimError):
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}: {text[:200]}"
    if not all(line.isprintable() for line in text.split("\n")):
        return f"not printable: {text!r}"
    solved = isinstance(error, SolverError) and getattr(error, "result", None) is not None
    if keys and not solved and not any(key in text for key in keys):
        return f"names none of {', '.join(keys)}: {type(error).__name__}: {text[:200]}"
    return ""


def _work(surface: str, seeds: Sequence[int], steps: int, link: Connection) -> None:
    """Try sequences in this process, which ends where one of them hangs."""
    with TemporaryDirectory() as folder:
        for seed in seeds:
            faulthandler.dump_traceback_later(SLOW_S * (steps + 2), exit=True, file=2)
            link.send(list(try_sequence(surface, seed, steps, Path(folder))))
    faulthandler.cancel_dump_traceback_later()


def sequences(surface: str, seeds: Sequence[int], steps: int) -> Iterator[tuple[int, list[Told]]]:
    """Yield (seed, what became of each step), tried in processes that a hang or a crash may cost."""
    waiting = list(seeds)
    while waiting:
        ours, theirs = multiprocessing.Pipe(duplex=False)
        arguments = (surface, waiting[:_AT_ONCE], steps, theirs)
        worker = multiprocessing.get_context("fork").Process(target=_work, args=arguments, daemon=True)
        worker.start()
        theirs.close()
        for seed in waiting[:_AT_ONCE]:
            try:
                told = ours.recv()
            except EOFError:
                worker.join()
                told = [Told("", "", f"the process ended with code {worker.exitcode}")]
            waiting.pop(0)
            yield seed, told
            if not worker.is_alive() and told[-1:] and told[-1].outcome == "":
                break
        worker.join()


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the sequences, print findings and counts, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--surface", choices=list(SUBJECTS), nargs="*", default=list(SUBJECTS))
    parser.add_argument("--count", type=int, default=2000, help="sequences, of all surfaces together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=STEPS)
    options = parser.parse_args(arguments)
    findings, each = 0, options.count // len(options.surface)
    for surface in options.surface:
        with TemporaryDirectory() as folder:  # engines and kernels are loaded once, before processes fork
            SUBJECTS[surface].begun(Path(folder))
        began, counts = time.perf_counter(), Counter[str]()
        for seed, told in sequences(surface, range(options.seed, options.seed + each), options.steps):
            counts.update(one.outcome for one in told)
            if told and told[-1].wrong:
                findings += 1
                said = "; ".join(f"{one.what}: {one.outcome}" for one in told)
                print(f"{surface}, seed {seed}: {told[-1].wrong}\n    {said}", flush=True)
        kinds = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
        print(f"{surface}: {each} sequences: {kinds}; {time.perf_counter() - began:.0f} s", flush=True)
    print(f"{each * len(options.surface)} sequences: {findings} findings")
    return int(findings > 0)


if __name__ == "__main__":
    raise SystemExit(main())
