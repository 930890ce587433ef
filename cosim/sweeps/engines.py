"""Sends designs to workers and receives their rows: processes of this machine, a Dask cluster, or any
executor.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Final, TypeAlias, final

from cosim.app.workers import begin_process, one_thread_each
from cosim.base.compilation import processors
from cosim.errors import InputError
from cosim.sweeps.designs import LOST, Row, Task

PROCESSES: Final = "processes"
_SCHEMES: Final = ("tcp://", "tls://", "ucx://", "ws://", "wss://")
"""Beginnings of the addresses of Dask schedulers."""
_CONNECT_S: Final = 15
_QUEUED: Final = 4
"""Designs sent to each worker at once, so that no worker waits."""
_QUEUED_UNKNOWN: Final = 256
_DIED: Final = "the worker's process died: out of memory, or by an error in a library"


Run: TypeAlias = Callable[[Task], Row]
"""Runs a design in a worker."""


@final
@dataclass(frozen=True)
class IdentifiedTask:
    """A task with the identity of its design."""

    identity: str
    task: Task


@final
@dataclass(frozen=True)
class Pool:
    """An executor, ready to work.

    Args:
        executor: of the standard library's type.
        window: designs to send at a time.
        replaceable: whether another one can be made if it breaks.
    """

    executor: Executor
    window: int
    replaceable: bool


@final
class Engine:
    """Makes the executor of a sweep.

    Args:
        engine: "processes", the address of a Dask scheduler, such as "tcp://127.0.0.1:8786", or an executor,
            which is left open.
        workers: processes of this machine; None: one for each processor this process may use.

    Raises:
        InputError: there is no such engine.
    """

    def __init__(self, engine: Executor | str = PROCESSES, workers: int | None = None) -> None:
        if isinstance(engine, str) and engine != PROCESSES and not engine.startswith(_SCHEMES):
            raise InputError(
                f"--engine {engine}: give '{PROCESSES}', or the address of a Dask scheduler, such as "
                "tcp://127.0.0.1:8786"
            )
        if workers is not None and workers < 1:
            raise InputError(f"--workers {workers}: must be at least 1")
        if workers is not None and engine != PROCESSES:
            raise InputError(f"--workers {workers}: counts the processes of this machine; leave it out")
        self._engine = engine
        self._workers = workers or processors()

    @contextmanager
    def pool(self) -> Iterator[Pool]:
        """Open the executor; if it was made here, it is closed at the end, without queued designs.

        Raises:
            InputError: the cluster cannot be reached, or Dask is not installed.
        """
        if isinstance(self._engine, Executor):
            yield Pool(self._engine, _QUEUED_UNKNOWN, replaceable=False)
        elif self._engine == PROCESSES:
            with one_thread_each():
                executor = ProcessPoolExecutor(self._workers, get_context("spawn"), begin_process)
                try:
                    yield Pool(executor, _QUEUED * self._workers, replaceable=True)
                finally:
                    executor.shutdown(cancel_futures=True)
        else:
            with _client(self._engine) as client:
                executor, threads = client.get_executor(), sum(client.nthreads().values())
                yield Pool(executor, _QUEUED * max(threads, 1), replaceable=False)


@contextmanager
def _client(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f"--engine {address}: needs Dask: pip install 'cosim[dask]'") from None
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--engine {address}: no scheduler answers there ({error}); start one: dask scheduler"
        ) from error
    with client:
        yield client


def rows_of(engine: Engine, run: Run, tasks: Iterable[IdentifiedTask]) -> Iterator[tuple[str, Row]]:
    """Yield identity and row of each task, in the order of their completion.

    When a process dies, all designs in progress are lost; they run again one by one to find the design that
    ends its worker.

    Args:
        engine: makes the workers.
        run: called by the workers.
        tasks: read a few ahead of the workers.
    """
    rest = iter(tasks)
    broken: list[IdentifiedTask] = []
    while True:
        with engine.pool() as pool:
            broken = yield from _sent(pool, run, rest)
        if not broken:
            return
        for each in broken:
            if not pool.replaceable:
                yield each.identity, Row(LOST, _DIED)
                continue
            with engine.pool() as another:
                if (yield from _sent(another, run, [each])):
                    yield each.identity, Row(LOST, _DIED)
        if not pool.replaceable:
            yield from ((each.identity, Row(LOST, _DIED)) for each in rest)
            return


def _sent(
    pool: Pool, run: Run, tasks: Iterable[IdentifiedTask]
) -> Generator[tuple[str, Row], None, list[IdentifiedTask]]:
    """Yield rows until all tasks are done; return the tasks in progress when the executor broke."""
    running: dict[Future[Row], IdentifiedTask] = {}
    broken: list[IdentifiedTask] = []
    for each in tasks:
        try:
            running[pool.executor.submit(run, each.task)] = each
        except BrokenExecutor:
            broken.append(each)
            break
        if len(running) >= pool.window:
            yield from _received(running, broken)
        if broken:
            break
    while running:
        yield from _received(running, broken)
    return broken


def _received(
    running: dict[Future[Row], IdentifiedTask], broken: list[IdentifiedTask]
) -> Iterator[tuple[str, Row]]:
    for future in wait(running, return_when=FIRST_COMPLETED).done:
        each = running.pop(future)
        try:
            yield each.identity, future.result()
        except BrokenExecutor:
            broken.append(each)
        except Exception as error:  # a cluster lost its worker, or a task cannot be pickled
            yield each.identity, Row(LOST, f"{type(error).__name__}: {error}")
