"""CPU time of a call, repeated: other work on the machine does not count as waiting."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def call_times(run: Callable[[], object], repeats: int) -> list[float]:
    """Return the CPU times [s] of the calling thread in so many calls."""
    times = []
    for _ in range(repeats):
        began = time.thread_time()
        run()
        times.append(time.thread_time() - began)
    return times


def least_ms(run: Callable[[], object], repeats: int = 60) -> float:
    """Return the least of them [ms]."""
    return 1e3 * min(call_times(run, repeats))


def median_s(run: Callable[[], object], repeats: int = 20) -> float:
    """Return the median of them [s]."""
    return statistics.median(call_times(run, repeats))
