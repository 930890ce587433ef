"""Objects in their own processes, called by name: one that ends takes none of the others with it.

Each process is that of an executor with one worker. A process that has ended, or that does not answer in
time, is lost with its objects until `replace` starts another one in its place. What cannot be sent to an
object is the failure of that object alone.
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
from typing import Any, Final, final

from cosim.errors import InputError, WorkerError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Of these each worker takes one: there are as many workers as anybody wants processors used."""
_JOIN_S: Final = 5.0
ANSWER_S: Final = 600.0
"""Wall time within which a process has to answer a call; no step of a run takes as long."""


@final
class _OneProcess(SpawnContext):
    """Spawns the process of an executor with one worker; `process` is that."""

    process: SpawnProcess

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        self.process = SpawnProcess(*args, **kwargs)
        return self.process


@final
class Workers:
    """Holds objects in processes, each always in the same one.

    Args:
        make: returns object k; pickled, as is whatever goes to and fro.
        count: of objects.
        workers: processes, at least one; object k is in number k modulo their number.
        answer_s: wall time within which a process has to answer a call [s].

    Raises:
        InputError: there are no objects, or no workers.
    """

    def __init__(
        self, make: Callable[[int], Any], count: int, workers: int, answer_s: float = ANSWER_S
    ) -> None:
        if count < 1 or workers < 1:
            raise InputError(f"{count} runs in {workers} workers; there must be at least one of each")
        self.count, self._make, self._answer_s = count, make, answer_s
        self._workers = min(workers, count)
        self._lost = dict[int, WorkerError]()
        self._begun = [self._begin(worker) for worker in range(self._workers)]

    def _begin(self, worker: int) -> tuple[ProcessPoolExecutor, SpawnProcess]:
        """Start a process that makes its objects."""
        context = _OneProcess()
        executor = ProcessPoolExecutor(1, context, _hold, (self._make, self.objects_of(worker)))
        with one_thread_each():
            executor.submit(os.getpid)  # the first call of an executor starts its process
        return executor, context.process

    def replace(self, objects: Iterable[int]) -> None:
        """Start lost processes that hold some of the objects again, with all that they hold at its start.

        Args:
            objects: wanted.
        """
        for worker in sorted({k % self._workers for k in objects} & self._lost.keys()):
            self._begun[worker] = self._begin(worker)
            del self._lost[worker]

    @property
    def processes(self) -> tuple[int, ...]:
        """Number of the process of each worker."""
        return tuple(process.pid or 0 for _, process in self._begun)

    def objects_of(self, worker: int) -> list[int]:
        """Return which objects a worker holds."""
        return list(range(worker, self.count, self._workers))

    def call(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> dict[int, Any]:
        """Call a method of some objects, and return what each returns, or the error that it raises.

        Args:
            method: name.
            arguments: of the call, by object; where they cannot be pickled, that object's answer says so.
        """
        packed = {k: _packed(given) for k, given in arguments.items()}
        found: dict[int, Any] = {k: one for k, one in packed.items() if isinstance(one, Exception)}
        asked: dict[Future[dict[int, Any]], int] = {}
        try:
            for worker in set(range(self._workers)) - self._lost.keys():
                own = {k: one for k in self.objects_of(worker) if isinstance(one := packed.get(k), bytes)}
                try:
                    if own:
                        asked[self._begun[worker][0].submit(_called, method, own)] = worker
                except BrokenExecutor:
                    self._lose(worker)
            answered, silent = wait(asked, self._answer_s)
            for future in silent:
                self._lose(asked[future], silent=True)
            for future in answered:
                try:
                    found |= future.result()
                except BrokenExecutor:
                    self._lose(asked[future])
        except BaseException:  # answers that nobody has taken would be those of the next call
            self.close()
            raise
        lost = {k: self._lost[k % self._workers] for k in arguments if k not in found}
        return {k: (found | lost)[k] for k in arguments}

    def close(self) -> None:
        """End all processes."""
        for worker in range(self._workers):
            self._end(worker)
            self._lost.setdefault(worker, WorkerError(f"worker {worker} has been closed"))

    def _end(self, worker: int) -> None:
        executor, process = self._begun[worker]
        process.kill()
        executor.shutdown(cancel_futures=True)
        process.join(_JOIN_S)

    def _lose(self, worker: int, *, silent: bool = False) -> None:
        """End what is left of a process that has ended or, silent, that hangs or has been stopped."""
        self._end(worker)
        process, runs = self._begun[worker][1], ", ".join(map(str, self.objects_of(worker)))
        code = process.exitcode
        how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with code {code}"
        what = f"did not answer within {self._answer_s:g} s and was ended" if silent else f"has ended {how}"
        self._lost[worker] = WorkerError(
            f"worker {worker} (process {process.pid}) {what}, and with it runs {runs}; "
            "reset them to begin again"
        )


_HELD: Final[dict[int, Any]] = {}
"""Objects that this process holds."""


def _hold(make: Callable[[int], Any], places: Iterable[int]) -> None:
    begin_process()
    _HELD.update({k: _outcome(make, k) for k in places})


def begin_process() -> None:
    """Set up a process that only works: it leaves Ctrl-C to the one that started it, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        # a parent that is killed cannot tell its workers, who would wait for ever
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes that are started meanwhile take one thread each.

    They are told by their environment: a script that they read may import numpy before anything else.
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
    """Return arguments as they are sent, or why they cannot be."""
    try:
        return pickle.dumps(arguments)
    except Exception as error:  # whatever the pickling of anybody's objects raises
        return InputError(
            f"the request cannot be sent to another process: {type(error).__name__}: {error}; "
            "give values that can be pickled"
        )


def _called(method: str, asked: Mapping[int, bytes]) -> dict[int, Any]:
    """Return what a method of the objects that are held here returns, or the errors that it raises."""

    def answer(k: int) -> Any:
        if isinstance(_HELD[k], Exception):
            raise _HELD[k]
        return getattr(_HELD[k], method)(*pickle.loads(asked[k]))

    return {k: _outcome(answer, k) for k in asked}


def _outcome(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function returns, or the error that it raises."""
    try:
        return function(*arguments)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return RuntimeError(f"{type(error).__name__}: {error}")
        return error
