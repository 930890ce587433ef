"""The wall time that this process spends on compiling kernels, for the summary of a run."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Final

_SPENT_S: Final = [0.0]
"""Since the last call of `take_s`."""


@contextmanager
def counted() -> Iterator[None]:
    """Count the time of a block that compiles kernels."""
    began = perf_counter()
    try:
        yield
    finally:
        _SPENT_S[0] += perf_counter() - began


def take_s() -> float:
    """Return the time [s] counted since the last call."""
    spent_s, _SPENT_S[0] = _SPENT_S[0], 0.0
    return spent_s
