"""Sequences of live commands, saves, restores, branches, resets and actions with wrong values mixed in.

Each step of a sequence is accepted, or ends in an error of cosim that names the key. A twin is given what was
accepted and nothing else: after every step the saved states of both are the same in every bit, and what is
restored is what was saved. Another exception or warning, an error without the key, more than 10 s of a step
and another state are findings.
"""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Several
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Final, final

from cosim.errors import CosimError, SolverError
from tests.fuzz.live_steps import Subject
from tests.fuzz.live_subjects import SUBJECTS
from tests.fuzz.verdict import FINDING, Trial, Verdict

SLOW_S: Final = 10.0
STEPS: Final = 6


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


@final
class Sequence(Trial):
    """Sequences of one surface."""

    def __init__(self, surface: str) -> None:
        self._surface = surface

    def begin(self, folder: Path) -> None:
        SUBJECTS[self._surface].begun(folder)

    def tried(self, seed: int, folder: Path) -> Verdict:
        told = list(try_sequence(self._surface, seed, STEPS, folder))
        case = "; ".join(f"{one.what}: {one.outcome}" for one in told)
        if told[-1].wrong:
            return Verdict(FINDING, told[-1].wrong, case)
        accepted = sum(one.outcome == "accepted" for one in told)
        return Verdict("half of it accepted" if 2 * accepted > len(told) else "most of it refused", "", case)


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


def _wrong(error: Exception, keys: Several[str]) -> str:
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
