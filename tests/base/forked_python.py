"""New processes of Python that begin with numba loaded: loading it takes each of them 1.7 s."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

SERVER = """
import json, os, sys, traceback, numba, numpy
numba.njit(lambda: 1)()
for line in sys.stdin:
    code, environment, paths, place, out, error = json.loads(line)
    child = os.fork()
    if child == 0:
        for stream, path in ((1, out), (2, error)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), stream)
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(place)
        sys.path[:1] = paths
        failed = 0
        try:
            exec(code, {"__name__": "__main__"})
        except BaseException:
            failed = traceback.print_exc() or 1
        sys.stdout.flush()
        os._exit(failed)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@cache
def _server() -> subprocess.Popen[str]:
    """Return a process that forks others; it ends with this one."""
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    atexit.register(server.communicate)
    return server


def run_forked(code: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Return how code ended as `python -c` in a folder, from which it imports before all others.

    Args:
        code: of Python.
        folder: in which it runs.
        environment: of the process, in addition to that of this one.
    """
    server = _server()
    with TemporaryDirectory() as said:
        files = Path(said, "out"), Path(said, "error")
        given = code, os.environ | environment, [str(folder)], str(folder), *map(str, files)
        print(json.dumps(given), file=server.stdin, flush=True)
        ended = int(server.stdout.readline())  # type: ignore[union-attr]
        return subprocess.CompletedProcess(code, ended, *(file.read_text("utf-8") for file in files))
