"""Holds objects in worker processes and calls functions of them there. Each process belongs to an executor
with one worker, so that a process that ends, or does not answer in time, is lost with its own objects alone,
until `replace` starts another one.
"""

import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import connection, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, Final, Generic, TypeVar, final

from cosim.errors import InputError, WorkerError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that give each worker one thread: the number of workers sets how many cores work."""
ANSWER_S: Final = 600.0
"""Wall time within which a process must answer a call; no step of a run takes as long."""
_JOIN_S: Final = 5.0
_HELD: Final[dict[int, Any]] = {}
"""Objects of this process, or the errors that making them raised, by number."""
_Held = TypeVar("_Held")


@final
class _OneProcess(SpawnContext):
    """Spawns the process of an executor with one worker, as `process`."""

    process: SpawnProcess

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        self.process = SpawnProcess(*args, **kwargs)
        return self.process


@final
class Workers(Generic[_Held]):
    """Holds objects in processes, each always in the same one.

    Args:
        make: returns object k; pickled, as are functions, arguments and results.
        count: number of objects.
        workers: number of processes, at least one; object k is in process k modulo this number.
        answer_s: wall time within which a process must answer a call [s].

    Raises:
        InputError: there are no objects, or no workers.
    """

    def __init__(
        self, make: Callable[[int], _Held], count: int, workers: int, answer_s: float = ANSWER_S
    ) -> None:
        if count < 1 or workers < 1:
            raise InputError(f"{count} runs in {workers} workers; there must be at least one of each")
        self.count, self._make, self._answer_s = count, make, answer_s
        self._workers = min(workers, count)
        self._lost = dict[int, WorkerError]()
        self._started = [self._start(worker) for worker in range(self._workers)]

    def _start(self, worker: int) -> tuple[ProcessPoolExecutor, SpawnProcess]:
        """Start a process that makes its objects."""
        context = _OneProcess()
        executor = ProcessPoolExecutor(1, context, _hold, (self._make, self.objects_of(worker)))
        with one_thread_each():
            executor.submit(os.getpid)  # the first call of an executor starts its process
        return executor, context.process

    def replace(self, objects: Iterable[int]) -> None:
        """Start the lost processes of some objects again; all objects of these processes are made again.

        Args:
            objects: their numbers.
        """
        for worker in sorted({k % self._workers for k in objects} & self._lost.keys()):
            self._started[worker] = self._start(worker)
            del self._lost[worker]

    @property
    def processes(self) -> tuple[int, ...]:
        """Process number of each worker."""
        return tuple(process.pid or 0 for _, process in self._started)

    def objects_of(self, worker: int) -> list[int]:
        """Return the numbers of a worker's objects."""
        return list(range(worker, self.count, self._workers))

    def call(self, function: Callable[..., Any], arguments: Mapping[int, tuple[Any, ...]]) -> dict[int, Any]:
        """Call a function of some objects; return the result of each call, or the error that it raised.

        Args:
            function: of a module or class; its first argument is the object.
            arguments: its further arguments, by object; if they cannot be pickled, the result is an error.
        """
        packed = {k: _packed(values) for k, values in arguments.items()}
        results: dict[int, Any] = {k: one for k, one in packed.items() if isinstance(one, Exception)}
        calls: dict[Future[dict[int, Any]], int] = {}
        try:
            for worker in set(range(self._workers)) - self._lost.keys():
                sent = {k: one for k in self.objects_of(worker) if isinstance(one := packed.get(k), bytes)}
                try:
                    if sent:
                        calls[self._started[worker][0].submit(_called, function, sent)] = worker
                except BrokenExecutor:
                    self._lose(worker)
            answered, silent = wait(calls, self._answer_s)
            for call in silent:
                self._lose(calls[call], silent=True)
            for call in answered:
                try:
                    results |= call.result()
                except BrokenExecutor:
                    self._lose(calls[call])
        except BaseException:  # the next call would receive the answers to this one
            self.close()
            raise
        lost = {k: self._lost[k % self._workers] for k in arguments if k not in results}
        return {k: (results | lost)[k] for k in arguments}

    def close(self) -> None:
        """End all processes."""
        for worker in range(self._workers):
            self._end(worker)
            self._lost.setdefault(worker, WorkerError(f"worker {worker} has been closed"))

    def _end(self, worker: int) -> None:
        executor, process = self._started[worker]
        process.kill()
        executor.shutdown(cancel_futures=True)
        process.join(_JOIN_S)

    def _lose(self, worker: int, *, silent: bool = False) -> None:
        """Close the executor of a process that has ended, or (silent) does not answer and is killed."""
        self._end(worker)
        process, runs = self._started[worker][1], ", ".join(map(str, self.objects_of(worker)))
        code = process.exitcode
        how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with code {code}"
        what = f"did not answer within {self._answer_s:g} s and was ended" if silent else f"has ended {how}"
        self._lost[worker] = WorkerError(
            f"worker {worker} (process {process.pid}) {what}, and with it runs {runs}; "
            "reset them to begin again"
        )


def _hold(make: Callable[[int], Any], objects: Iterable[int]) -> None:
    begin_process()
    _HELD.update({k: _outcome(make, k) for k in objects})


def begin_process() -> None:
    """Set up a worker process: it ignores Ctrl-C, which its parent handles, and ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        # a parent that is killed cannot end its workers, which would wait for ever
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Give processes that are started in this block one thread each.

    Environment variables do this, as a script that the processes read may import numpy first.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _packed(arguments: tuple[Any, ...]) -> bytes | InputError:
    """Return pickled arguments, or the error that says why they cannot be pickled."""
    try:
        return pickle.dumps(arguments)
    except Exception as error:  # pickling a user's objects may raise anything
        return InputError(
            f"the request cannot be sent to another process: {type(error).__name__}: {error}; "
            "give values that can be pickled"
        )


def _called(function: Callable[..., Any], sent: Mapping[int, bytes]) -> dict[int, Any]:
    """Return the results of a function of objects of this process, or the errors that it raises."""

    def result(k: int) -> Any:
        if isinstance(_HELD[k], Exception):
            raise _HELD[k]
        return function(_HELD[k], *pickle.loads(sent[k]))

    return {k: _outcome(result, k) for k in sent}


def _outcome(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return a function's result, or the error that it raises."""
    try:
        return function(*arguments)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return RuntimeError(f"{type(error).__name__}: {error}")
        return error
