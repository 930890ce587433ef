"""What runs the designs of a study: processes of this machine, a Dask cluster, or any executor.

Hands designs out to workers and takes rows in, whatever happens to the workers.
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
from cosim.sweeps.table import LOST, Row, Task

PROCESSES: Final = "processes"
_SCHEMES: Final = ("tcp://", "tls://", "ucx://", "ws://", "wss://")
"""What addresses of Dask schedulers begin with."""
_CONNECT_S: Final = 15
_QUEUED: Final = 4
"""Designs handed out per worker: enough that none waits for its next one."""
_QUEUED_UNKNOWN: Final = 256


@final
@dataclass(frozen=True)
class Pool:
    """An executor, ready to work.

    Args:
        executor: of the standard library's kind.
        window: designs to hand out at a time.
        replaceable: whether another one can be made when it breaks.
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
        """Open the executor; one that was made here is closed at the end, and drops what is queued.

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
