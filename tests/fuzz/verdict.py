"""What became of one case, and the trial of cases in processes that a hang or a crash may cost."""

from __future__ import annotations

import gc
import multiprocessing
import os
import resource
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, final

SLOW_CPU_S = 10.0
"""A case that takes more is reported too, even if it ends in order."""
FINDING, SLOW = "finding", "slow"
_LOOK_EVERY_S = 0.5


@final
@dataclass(frozen=True)
class Verdict:
    """What became of a case.

    Args:
        kind: "finding", "slow", or an outcome that may be.
        what: the error, or what is wrong with it.
        case: what was tried, in words.
    """

    kind: str
    what: str
    case: str = ""


class Trial(ABC):
    """A kind of cases, each of a seed."""

    cpu_limit_s: ClassVar[float] = 60.0
    memory_limit_bytes: ClassVar[int] = 4 << 30

    @abstractmethod
    def begin(self, folder: Path) -> None:
        """Load and compile what all cases need."""

    @abstractmethod
    def tried(self, seed: int, folder: Path) -> Verdict:
        """Return what became of a case; its files are in the folder."""


def traceback_verdict(error: BaseException, case: str = "") -> Verdict:
    """Return the finding that an error is which is not cosim's own."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(frame.filename).name}:{frame.lineno}"
    return Verdict(FINDING, f"traceback {type(error).__name__} at {place}: {str(error)[:300]}", case)


def verdicts(trial: Trial, seeds: Sequence[int], keep: Path) -> Iterator[tuple[int, Verdict]]:
    """Yield (seed, verdict) of each seed, tried in another process; a new one where that was lost.

    Args:
        trial: of which kind the cases are.
        seeds: of the cases.
        keep: gets the files of findings and of slow cases.
    """
    waiting = list(seeds)
    while waiting:
        for seed, verdict in _of_one_worker(trial, waiting, keep):
            yield seed, verdict
            waiting.remove(seed)


def _of_one_worker(trial: Trial, seeds: list[int], keep: Path) -> Iterator[tuple[int, Verdict]]:
    """Yield results of one worker process, until all are there or it had to be ended."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    worker = multiprocessing.get_context("fork").Process(
        target=_work, args=(trial, seeds, keep, theirs), daemon=True
    )
    worker.start()
    theirs.close()
    assert worker.pid is not None
    try:
        ours.recv()
        for seed in list(seeds):
            begun = _cpu_s(worker.pid)
            while not ours.poll(_LOOK_EVERY_S):
                if _cpu_s(worker.pid) - begun > trial.cpu_limit_s:
                    yield seed, Verdict(FINDING, f"more than {trial.cpu_limit_s:g} s of CPU time")
                    return
            try:
                verdict = ours.recv()
            except EOFError:
                worker.join()
                yield seed, Verdict(FINDING, f"the process ended with code {worker.exitcode}")
                return
            used = _cpu_s(worker.pid) - begun
            if used > SLOW_CPU_S and verdict.kind != FINDING:
                what = f"{used:.0f} s of CPU time, then {verdict.kind}: {verdict.what}"
                verdict = Verdict(SLOW, what, verdict.case)
            yield seed, verdict
    finally:
        worker.kill()
        worker.join()


def _work(trial: Trial, seeds: list[int], keep: Path, results: Connection) -> None:
    with TemporaryDirectory() as place:
        trial.begin(Path(place))
        resource.setrlimit(resource.RLIMIT_AS, (trial.memory_limit_bytes,) * 2)
        results.send(None)
        for seed in seeds:
            folder = keep / f"{type(trial).__name__.lower()}_{seed}"
            folder.mkdir(parents=True, exist_ok=True)
            try:
                verdict = trial.tried(seed, folder)
            except MemoryError as error:
                verdict = Verdict(FINDING, f"out of memory: {error}")
            except Exception as error:  # that is what is looked for
                verdict = traceback_verdict(error)
            if verdict.kind not in (FINDING, SLOW):
                _remove(folder)
            gc.collect()  # simulations are held by cycles; the bound of memory is that of one case
            results.send(verdict)


def _remove(folder: Path) -> None:
    """Remove a folder, whatever links and folders a case has left in it."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            _remove(path)
        else:
            path.unlink()
    folder.rmdir()


def _cpu_s(process: int) -> float:
    """Return the CPU time [s] that a process has used."""
    try:
        words: Any = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
