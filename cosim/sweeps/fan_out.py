"""Hands designs out to workers and takes rows in, whatever happens to the workers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from typing import Final, TypeAlias

from cosim.sweeps.engines import Engine, Pool
from cosim.sweeps.task import LOST, Row, Task

Run: TypeAlias = Callable[[Task], Row]
"""What a worker does with a design; it is sent to it."""
Named: TypeAlias = tuple[str, Task]
"""A design with the name of its contents."""
_DIED: Final = "the worker's process died, for want of memory or in a library"


def rows_of(engine: Engine, run: Run, tasks: Iterable[Named]) -> Iterator[tuple[str, Row]]:
    """Yield the row of each task, by its name, as they are done.

    When a process dies, all designs under way are gone with it; they run again one by one, so that the one
    that ends its worker is known.

    Args:
        engine: makes the workers.
        run: what they do.
        tasks: read a few ahead of the workers.
    """
    rest = iter(tasks)
    broken: list[Named] = []
    while True:
        with engine.pool() as pool:
            broken = yield from _fed(pool, run, rest)
        if not broken:
            return
        for name, task in broken:
            if not pool.replaceable:
                yield name, Row(LOST, _DIED)
                continue
            with engine.pool() as another:
                if (yield from _fed(another, run, [(name, task)])):
                    yield name, Row(LOST, _DIED)
        if not pool.replaceable:
            yield from ((name, Row(LOST, _DIED)) for name, _ in rest)
            return


def _fed(pool: Pool, run: Run, tasks: Iterable[Named]) -> Generator[tuple[str, Row], None, list[Named]]:
    """Yield rows until all tasks are done; return those that were under way when the executor broke."""
    under_way: dict[Future[Row], Named] = {}
    broken: list[Named] = []
    for named in tasks:
        try:
            under_way[pool.executor.submit(run, named[1])] = named
        except BrokenExecutor:
            broken.append(named)
            break
        if len(under_way) >= pool.window:
            yield from _taken(under_way, broken)
        if broken:
            break
    while under_way:
        yield from _taken(under_way, broken)
    return broken


def _taken(under_way: dict[Future[Row], Named], broken: list[Named]) -> Iterator[tuple[str, Row]]:
    for future in wait(under_way, return_when=FIRST_COMPLETED).done:
        name, task = under_way.pop(future)
        try:
            yield name, future.result()
        except BrokenExecutor:
            broken.append((name, task))
        except Exception as error:  # of a cluster that lost its worker, or of a task that does not travel
            yield name, Row(LOST, f"{type(error).__name__}: {error}")
