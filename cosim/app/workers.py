"""Objects in processes of their own, called by name: one that ends takes none of the others with it."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from typing import Any, Final, cast, final

from cosim.errors import InputError, WorkerError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Of these each worker takes one: there are as many workers as anybody wants processors used."""
_JOIN_S: Final = 5.0


@final
class Workers:
    """Holds objects in processes, each always in the same one.

    Args:
        make: returns object k; pickled, as is whatever goes to and fro.
        count: of objects.
        workers: processes, at least one; object k is in number k modulo their number.

    Raises:
        InputError: there are no objects, or no workers.
    """

    def __init__(self, make: Callable[[int], Any], count: int, workers: int) -> None:
        if count < 1 or workers < 1:
            raise InputError(f"{count} runs in {workers} workers; there must be at least one of each")
        context = multiprocessing.get_context("spawn")
        self.count, self._lost = count, dict[int, WorkerError]()
        self._links: list[Connection] = []
        self._processes: list[Any] = []
        for worker in range(min(workers, count)):
            here, there = context.Pipe()
            process = context.Process(
                target=_serve, args=(there,), daemon=True, name=f"cosim worker {worker}"
            )
            with one_thread_each():
                process.start()
            there.close()
            self._links.append(here)
            self._processes.append(process)
        for worker in range(len(self._links)):
            self._send(worker, (make, self.objects_of(worker)))

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
            arguments: of the call, by object.
        """
        found: dict[int, Any] = {}
        waiting: dict[Connection, int] = {}
        try:
            for worker, link in enumerate(self._links):
                asked = {k: arguments[k] for k in self.objects_of(worker) if k in arguments}
                if asked and worker not in self._lost and self._send(worker, (method, asked)):
                    waiting[link] = worker
            while waiting:
                for ready in wait(list(waiting)):
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

    def _lose(self, worker: int) -> None:
        process = self._processes[worker]
        process.join(_JOIN_S)
        code, runs = process.exitcode, ", ".join(map(str, self.objects_of(worker)))
        how = f"by {signal.Signals(-code).name}" if code is not None and code < 0 else f"with code {code}"
        self._lost[worker] = WorkerError(
            f"worker {worker} (process {process.pid}) has ended {how}, and with it runs {runs}"
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


def _called(target: Any, method: str, arguments: Iterable[Any]) -> Any:
    return target if isinstance(target, Exception) else _outcome(getattr(target, method), *arguments)


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
