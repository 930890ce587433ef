"""Objects in their own processes, called by name: one that ends takes none of the others with it.

A process that has ended, or that does not answer in time, is lost with its objects until `replace` starts
another one in its place. What cannot be sent to an object is the failure of that object alone.
"""

import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from typing import Any, Final, cast, final

from cosim.errors import InputError, WorkerError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Of these each worker takes one: there are as many workers as anybody wants processors used."""
_JOIN_S: Final = 5.0
ANSWER_S: Final = 600.0
"""Wall time within which a process has to answer a call; no step of a run takes as long."""


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
        self._lost = dict[int, WorkerError]()
        begun = [self._begin(worker) for worker in range(min(workers, count))]
        self._processes: list[Any] = [process for process, _ in begun]
        self._links: list[Connection] = [link for _, link in begun]
        for worker in range(len(begun)):
            self._send(worker, (make, self.objects_of(worker)))

    def _begin(self, worker: int) -> tuple[Any, Connection]:
        """Start a process; return it and this end of the link to it."""
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there,), daemon=True, name=f"cosim worker {worker}")
        with one_thread_each():
            process.start()
        there.close()
        return process, here

    def replace(self, objects: Iterable[int]) -> None:
        """Start lost processes that hold some of the objects again, with all that they hold at its start.

        Args:
            objects: wanted.
        """
        for worker in sorted({k % len(self._links) for k in objects} & self._lost.keys()):
            self._links[worker].close()
            self._processes[worker], self._links[worker] = self._begin(worker)
            del self._lost[worker]
            self._send(worker, (self._make, self.objects_of(worker)))

    @property
    def processes(self) -> tuple[int, ...]:
        """Number of the process of each worker."""
        return tuple(process.pid or 0 for process in self._processes)

    def objects_of(self, worker: int) -> list[int]:
        """Return which objects a worker holds."""
        return list(range(worker, self.count, len(self._processes)))

    def call(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> dict[int, Any]:
        """Call a method of some objects, and return what each returns, or the error that it raises.

        Args:
            method: name.
            arguments: of the call, by object; where they cannot be pickled, that object's answer says so.
        """
        packed = {k: _packed(given) for k, given in arguments.items()}
        found: dict[int, Any] = {k: one for k, one in packed.items() if isinstance(one, Exception)}
        waiting: dict[Connection, int] = {}
        try:
            for worker, link in enumerate(self._links):
                asked = {k: packed[k] for k in self.objects_of(worker) if k in packed.keys() - found.keys()}
                if asked and worker not in self._lost and self._send(worker, (method, asked)):
                    waiting[link] = worker
            until = time.monotonic() + self._answer_s
            while waiting:
                answered = wait(list(waiting), max(0.0, until - time.monotonic()))
                if not answered:
                    for worker in waiting.values():
                        self._end_silent(worker)
                    break
                for ready in answered:
                    link = cast("Connection", ready)
                    found |= self._received(waiting.pop(link), link)
        except BaseException:  # answers that nobody has taken would be those of the next call
            self.close()
            raise
        lost = {k: self._lost[k % len(self._links)] for k in arguments if k not in found}
        return {k: (found | lost)[k] for k in arguments}

    def close(self) -> None:
        """End all processes."""
        for link in self._links:
            link.close()
        for worker, process in enumerate(self._processes):
            process.terminate()
            process.join(_JOIN_S)
            self._lost.setdefault(worker, WorkerError(f"worker {worker} has been closed"))

    def _send(self, worker: int, what: Any) -> bool:
        try:
            self._links[worker].send(what)
        except (BrokenPipeError, ConnectionResetError):
            self._lose(worker)
            return False
        return True

    def _received(self, worker: int, link: Connection) -> dict[int, Any]:
        try:
            answer: dict[int, Any] = link.recv()
        except (EOFError, ConnectionResetError):
            self._lose(worker)
            return {}
        return answer

    def _end_silent(self, worker: int) -> None:
        """End a process that has not answered in time: it hangs, or has been stopped."""
        process, runs = self._processes[worker], ", ".join(map(str, self.objects_of(worker)))
        process.kill()
        process.join(_JOIN_S)
        self._lost[worker] = WorkerError(
            f"worker {worker} (process {process.pid}) did not answer within {self._answer_s:g} s and was "
            f"ended, and with it runs {runs}; reset them to begin again"
        )

    def _lose(self, worker: int) -> None:
        process = self._processes[worker]
        process.join(_JOIN_S)
        code, runs = process.exitcode, ", ".join(map(str, self.objects_of(worker)))
        how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with code {code}"
        self._lost[worker] = WorkerError(
            f"worker {worker} (process {process.pid}) has ended {how}, and with it runs {runs}; "
            "reset them to begin again"
        )


def _serve(link: Connection) -> None:
    """Hold objects and answer calls until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked is interrupted, and ends this process
    try:
        make, places = link.recv()
        held = {k: _outcome(make, k) for k in places}
        while True:
            method, asked = link.recv()
            link.send({k: _called(held[k], method, arguments) for k, arguments in asked.items()})
    except (EOFError, ConnectionResetError, BrokenPipeError):
        return


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


def _called(target: Any, method: str, packed: bytes) -> Any:
    if isinstance(target, Exception):
        return target
    return _outcome(lambda: getattr(target, method)(*pickle.loads(packed)))


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
